"""Coupling pattern of the coordinates of large systems, and an ordering of narrow bandwidth for their Jacobian."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.system_checks import System

MAX_HALF_BANDWIDTH = 48  # diagonals on either side; each unknown costs two multiplications per pair of diagonals
MAX_NUMBERS = 2**25  # largest number of entries of the factors
MAX_MEAN_COUPLINGS = 64  # average couplings per coordinate; with more there is no narrow band

NO_BAND: tuple[int, NDArray[np.uint32]] = (-1, np.zeros(0, dtype=np.uint32))


def narrow_band(system: System, stages: int, solver: str) -> tuple[int, NDArray[np.uint32]]:
    """Return the bandwidth of a Jacobian, -1 if no ordering has a narrow band, and the position (n,) of each
    coordinate.

    The ordering is reverse Cuthill-McKee; the `stages` unknowns of a coordinate are adjacent. The Jacobian of the
    solver is sign (D_u + J(x) H'') for "implicit", J(x) H'' for "structure", D_u for "gradient".
    """
    if system.algebra is None:
        return NO_BAND
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    n = system.dim
    i, j, k, _ = system.algebra.triples
    pattern = coo_array((n, n)).tocsr()
    if solver != "structure":
        pattern = pattern + _pattern(n, np.concatenate([i, j]), np.concatenate([k, k]))
    if solver != "gradient":
        bends = _hessian(system, n)
        if bends is None:
            return NO_BAND
        pattern = pattern + _pattern(n, np.concatenate([i, j]), np.concatenate([j, i])) @ bends
    if pattern.nnz > MAX_MEAN_COUPLINGS * n:
        return NO_BAND
    both = (pattern + pattern.T).tocsr()
    order = reverse_cuthill_mckee(both, symmetric_mode=True)
    position = np.empty(n, dtype=np.uint32)
    position[order] = np.arange(n, dtype=np.uint32)
    rows, columns = both.nonzero()
    band = int(np.max(np.abs(position[rows].astype(np.int64) - position[columns].astype(np.int64)), initial=0))
    reach = stages * (band + 1) - 1
    fits = reach <= MAX_HALF_BANDWIDTH and stages * n * (3 * reach + 1) <= MAX_NUMBERS
    return (band, position) if fits else NO_BAND


def _pattern(n: int, rows: Any, columns: Any) -> Any:
    from scipy.sparse import coo_array

    return coo_array((np.ones(len(rows)), (rows, columns)), shape=(n, n)).tocsr()


def _hessian(system: System, n: int) -> Any:
    """Return the sparsity pattern of the Hessian of the Hamiltonian; None if it has too many entries."""
    rows: list[Any] = [np.zeros(0, dtype=np.int64)]
    columns: list[Any] = [np.zeros(0, dtype=np.int64)]
    for term in system.hamiltonian.terms():
        if term.form is not None:
            rows.append(term.form.rows)
            columns.append(np.asarray(term.form.indices))
            continue
        groups = list(term.couplings())
        if sum(len(group) ** 2 for group in groups) > MAX_MEAN_COUPLINGS * n:
            return None
        rows.extend(np.repeat(group, len(group)) for group in groups)
        columns.extend(np.tile(group, len(group)) for group in groups)
    return _pattern(n, np.concatenate(rows), np.concatenate(columns))
