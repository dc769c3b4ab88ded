"""The symmetric matrix of the couplings of spins on a graph."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.repeated_rows import MIN_ROWS, RepeatedRows, shapes_of

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


def coupled_spins(sites: int, edges: Integers, coupling: Floats, on_site: Floats, linear: Floats | None) -> Quadratic:
    """Return the sum of S_i . coupling S_j over edges, S_i . on_site S_i / 2 and linear . S over sites.

    Each matrix is (3, 3), or one for each edge or site.
    """
    matrix = _repeated_rows(sites, edges, coupling, on_site)
    if matrix is not None:
        return Quadratic.of_repeated_rows(matrix, linear)
    return Quadratic(_sparse_matrix(sites, edges, coupling, on_site), linear=linear)


def _repeated_rows(sites: int, edges: Integers, coupling: Floats, on_site: Floats) -> RepeatedRows | None:
    """Return the rows of equal couplings, each shape once; None for couplings that differ, or if few sites are alike."""
    if coupling.ndim > 2 or on_site.ndim > 2 or 3 * sites < MIN_ROWS or not (np.any(coupling) or np.any(on_site)):
        return None
    start, columns, turned = _neighbours(sites, edges, bool(np.any(coupling != coupling.T)))
    if not np.any(coupling):
        start, columns, turned = np.zeros_like(start), columns[:0], turned[:0]
    found = shapes_of(start, columns, turned)
    if found is None:
        return None
    shape, leaders = found
    table = []
    for site in leaders.tolist():
        row = slice(start[site], start[site + 1])
        shifts = (columns[row].astype(np.int64) - site).tolist()
        blocks = [coupling.T if flag else coupling for flag in turned[row].tolist()]
        pairs = sorted([*zip(shifts, blocks, strict=True), (0, on_site)], key=lambda pair: pair[0])
        table += [
            [(3 * shift + b - a, float(block[a, b])) for shift, block in pairs for b in range(3) if block[a, b] != 0.0]
            for a in range(3)
        ]
    return RepeatedRows.of_table((3 * shape[:, None] + np.arange(3, dtype=np.uint32)).ravel(), table)


def _neighbours(
    sites: int, edges: Integers, directed: bool
) -> tuple[Integers, npt.NDArray[np.uint32], npt.NDArray[np.uint8]]:
    """Return the sorted neighbours of all sites in compressed sparse rows, and, if directed, which edges end there."""
    first, second = edges[:, 0], edges[:, 1]
    keys = np.empty(2 * len(edges), dtype=np.int64)
    keys[: len(edges)] = 2 * (first * sites + second)
    keys[len(edges) :] = 2 * (second * sites + first) + int(directed)
    keys.sort()
    turned = (keys & 1).astype(np.uint8)
    keys >>= 1
    site = keys // sites
    keys -= site * sites
    start = np.zeros(sites + 1, dtype=np.int64)
    np.cumsum(np.bincount(site, minlength=sites), out=start[1:])
    return start, keys.astype(np.uint32), turned


def _sparse_matrix(sites: int, edges: Integers, coupling: Floats, on_site: Floats) -> Any:
    """Return M, from S_i . coupling S_j and S_i . on_site S_i / 2, as a sparse matrix."""
    import scipy.sparse

    a, b = np.nonzero(np.any(coupling.reshape(-1, 3, 3), axis=0))
    c, d = np.nonzero(np.any(on_site.reshape(-1, 3, 3), axis=0))
    value = np.broadcast_to(coupling, (len(edges), 3, 3))[:, a, b].ravel()
    on_site_values = np.broadcast_to(on_site, (sites, 3, 3))[:, c, d].ravel()
    kind = np.int32 if 3 * sites <= np.iinfo(np.int32).max else np.int64
    first, second = 3 * edges[:, :1].astype(kind), 3 * edges[:, 1:].astype(kind)
    rows, columns = (first + a.astype(kind)).ravel(), (second + b.astype(kind)).ravel()
    site = 3 * np.arange(sites, dtype=kind)[:, None]
    entries = np.concatenate([value, value, on_site_values])
    indices = (
        np.concatenate([rows, columns, (site + c.astype(kind)).ravel()]),
        np.concatenate([columns, rows, (site + d.astype(kind)).ravel()]),
    )
    return scipy.sparse.coo_matrix((entries, indices), shape=(3 * sites, 3 * sites))
