"""Sparse matrices as operations of JAX."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

# Entries of matrices that are stored with their zeros: products of small ones are faster than gathers.
MOST_DENSE = 2**12


class Sparse(NamedTuple):
    """A sparse matrix: dense if it is small, otherwise padded rows, with the column of each entry."""

    values: Any
    columns: Any

    def times(self, x: Any) -> Any:
        """Multiply a vector."""
        if self.columns is None:
            return (self.values * x).sum(-1)
        return (self.values * x[self.columns]).sum(-1)


def sparse(rows: Any, columns: Any, values: Any, shape: tuple[int, int]) -> Sparse:
    """Return the matrix with these entries, of which none is repeated; `values` may be traced."""
    rows, columns = np.asarray(rows, dtype=np.int64), np.asarray(columns, dtype=np.int64)
    if shape[0] * shape[1] <= MOST_DENSE:
        return Sparse(jnp.zeros(shape).at[rows, columns].add(values), None)
    order = np.argsort(rows, kind="stable")
    starts = np.searchsorted(rows[order], np.arange(shape[0] + 1))
    place = np.empty(len(rows), dtype=np.int64)
    place[order] = np.arange(len(rows)) - starts[rows[order]]
    width = int(np.max(np.diff(starts), initial=1))
    padded = np.zeros((shape[0], width), dtype=np.int64)
    padded[rows, place] = columns
    return Sparse(jnp.zeros((shape[0], width)).at[rows, place].add(values), padded)
