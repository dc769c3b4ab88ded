"""Sparse coadjoint action of an algebra: entries of D_u, J(x) as an operator, commuting basis elements."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact.numbers import exact_numbers
from coadjoint.algebra.exact.sparse_sums import Integers, expand, groups
from coadjoint.algebra.identities import both_orders

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator


def actions(triples: Triples, dim: int) -> tuple[Integers, Triples]:
    """Return the starts (n + 1,) and sorted entries (i, row, column, value) of every D_{e_i}."""
    both = both_orders(triples)  # (D_{e_i})_jk = c_ji^k
    order, _ = groups(both.j, both.i, both.k)
    element = both.j[order]
    starts = np.searchsorted(element, np.arange(dim + 1)).astype(np.int64)
    return starts, Triples(element, both.i[order], both.k[order], both.c[order])


def coadjoint_entries(
    starts: Integers, entries: Triples, indices: Integers, coefficients: NDArray[Any]
) -> tuple[Integers, Integers, NDArray[Any]]:
    """Return sorted unique rows, columns and values of sum_i u_i D_{e_i}, without exact zeros.

    `starts`, `entries` are from `actions`; `indices`, `coefficients` (m,) are the nonzero u_i.
    """
    element, index = expand(starts[indices], starts[indices + 1])
    constants = exact_numbers(entries.c[index].tolist()) if coefficients.dtype == object else entries.c[index]
    products = coefficients[element] * constants
    rows, columns = entries.j[index], entries.k[index]
    order, first = groups(rows, columns)
    values = np.add.reduceat(products[order], first) if order.size else products
    nonzero = np.asarray(values != 0, dtype=bool)
    representatives = order[first][nonzero]
    return rows[representatives], columns[representatives], values[nonzero]


def structure_operator(triples: Triples, x: NDArray[np.floating[Any]]) -> LinearOperator:
    """Return J(x) as a SciPy linear operator."""
    from scipy.sparse.linalg import LinearOperator

    i, j, k, c = triples
    entries, n = c * x[k], x.size

    def apply(v: Any) -> Any:
        flat = np.asarray(v).reshape(n)
        result = np.zeros(n, dtype=np.result_type(flat.dtype, entries.dtype))
        np.add.at(result, i, entries * flat[j])
        np.subtract.at(result, j, entries * flat[i])
        return result

    return LinearOperator((n, n), matvec=apply, rmatvec=lambda v: -apply(v), dtype=entries.dtype)


def neighbours(triples: Triples, dim: int) -> tuple[Integers, Integers]:
    """Return, in compressed sparse rows, the sorted j that do not commute with each i; read-only."""
    first, second = np.concatenate([triples.i, triples.j]), np.concatenate([triples.j, triples.i])
    order, starts = groups(first, second)
    first, indices = first[order[starts]], second[order[starts]]
    indptr = np.searchsorted(first, np.arange(dim + 1)).astype(np.int64)
    for column in (indptr, indices):
        column.flags.writeable = False
    return indptr, indices
