"""The symmetric matrix of the couplings of spins on a graph."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.coefficients import EnergyCoefficients, encoded
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.repeated_rows import MIN_ROWS, RepeatedRows, shapes_of, starts_of_rows

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Rows = tuple[Integers, npt.NDArray[np.uint32], Floats]


def coupled_spins(sites: int, edges: Integers, coupling: Floats, on_site: Floats, linear: Floats) -> Quadratic:
    """Return the sum of S_i . coupling S_j over edges, S_i . on_site S_i / 2 and linear . S over sites."""
    # Each matrix is (3, 3), or one for each edge or site, and the linear term (3,), or (sites, 3).
    equal = _equal_rows(sites, edges, coupling, on_site)
    of_sites = np.broadcast_to(linear, (sites, 3)).ravel() if np.any(linear) else None
    return Quadratic._of_rows(_rows(sites, edges, coupling, on_site) if equal is None else equal, of_sites)


def coefficients_of_spins(
    sites: int, edges: Integers, coupling: npt.NDArray[Any], on_site: npt.NDArray[Any], linear: npt.NDArray[Any]
) -> EnergyCoefficients:
    """Return the coefficients of the energy of `coupled_spins`, of real or complex numbers."""
    (first, second), site = 3 * edges.T, 3 * np.arange(sites)
    codes, values = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]

    def add(i: Integers, j: Integers, numbers: npt.NDArray[Any]) -> None:
        if np.any(numbers):
            codes.append(encoded(np.minimum(i, j), np.maximum(i, j)))
            values.append(np.broadcast_to(numbers, len(j)))

    for a in range(3):
        add(np.full(sites, -1), site + a, linear[..., a])
        for b in range(3):
            add(first + a, second + b, coupling[..., a, b])
        for b in range(a, 3):
            add(site + a, site + b, on_site[..., a, b] if a < b else 0.5 * on_site[..., a, b])
    return EnergyCoefficients.of_distinct(np.concatenate(codes), np.concatenate(values))


def _equal_rows(sites: int, edges: Integers, coupling: Floats, on_site: Floats) -> RepeatedRows | None:
    """Return the rows of equal couplings, each shape once; None if couplings differ, or few sites are alike."""
    if coupling.ndim > 2 or on_site.ndim > 2 or 3 * sites < MIN_ROWS or not (np.any(coupling) or np.any(on_site)):
        return None
    directed = bool(np.any(coupling != coupling.T))
    start, columns, turned = _neighbours(sites, edges if np.any(coupling) else edges[:0], directed)
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
    return starts_of_rows(site, sites), keys.astype(np.uint32), turned


def _rows(sites: int, edges: Integers, coupling: Floats, on_site: Floats) -> Rows:
    """Return the starts of rows, columns and values of the matrix, one component of the spins after the other."""
    first, second = edges.T
    own = np.arange(sites if np.any(on_site) else 0)
    keys = np.concatenate([first * sites + second, second * sites + first, own * (sites + 1)])
    order = np.argsort(keys)
    site = keys[order] // sites
    other = (keys[order] - site * sites).astype(np.uint32)
    del keys
    pattern = np.any(coupling.reshape(-1, 3, 3), axis=0) | np.any(on_site.reshape(-1, 3, 3), axis=0)
    pattern |= pattern.T
    lengths = pattern.sum(axis=1)
    begin = starts_of_rows(site, sites)
    neighbour = np.arange(len(site)) - begin[site]  # number of the neighbour of its site
    counts = np.diff(begin)[:, None] * lengths
    start = np.concatenate([[0], np.cumsum(counts.ravel())])
    columns, values = np.empty(start[-1], dtype=np.uint32), np.empty(start[-1])
    m = len(edges)
    forward, backward, same = order < m, (order >= m) & (order < 2 * m), order >= 2 * m
    for a in range(3):
        at = start[3 * site + a] + neighbour * lengths[a]
        for place, b in enumerate(np.flatnonzero(pattern[a]).tolist()):
            number = np.empty(len(site))
            number[forward] = _entry(coupling, a, b, order[forward])
            number[backward] = _entry(coupling, b, a, order[backward] - m)
            number[same] = _entry(on_site, a, b, order[same] - 2 * m)
            columns[at + place], values[at + place] = 3 * other + np.uint32(b), number
    zero = values == 0.0
    if np.any(zero):
        row = np.repeat(np.arange(3 * sites), counts.ravel())[~zero]
        start, columns, values = starts_of_rows(row, 3 * sites), columns[~zero], values[~zero]
    return start, columns, values


def _entry(matrices: Floats, a: int, b: int, number: Integers) -> Floats | float:
    return float(matrices[a, b]) if matrices.ndim == 2 else matrices[number, a, b]
