"""Energies of spins on a graph: the symmetric matrix of couplings, and driving fields."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.coefficients import EnergyCoefficients, encoded
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.repeated_rows import MIN_REPEATS, MIN_ROWS, RepeatedRows, shapes_of, starts_of_rows
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.user_functions import check_arguments

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Rows = tuple[Integers, npt.NDArray[np.uint32], Floats]


class Blocks(NamedTuple):
    """Matrices of edges or of sites: the distinct ones, (k, 3, 3), and the number of that of each edge or site."""

    distinct: Floats
    number: Integers

    @classmethod
    def of(cls, matrices: Floats, count: int) -> Blocks:
        """Return one matrix (3, 3) for all, or those of each, (count, 3, 3)."""
        if matrices.ndim == 2:
            return cls(matrices[None], np.broadcast_to(np.int64(0), count))
        return cls(matrices, np.arange(count))

    def entries(self, a: int, b: int, which: Integers) -> Floats:
        return np.asarray(self.distinct[:, a, b][self.number[which]])


def coupled_spins(sites: int, edges: Integers, coupling: Blocks, on_site: Blocks, linear: Floats) -> Quadratic:
    """Return the sum of S_i . coupling S_j over edges, S_i . on_site S_i / 2 and linear . S over sites."""
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


def _equal_rows(sites: int, edges: Integers, coupling: Blocks, on_site: Blocks) -> RepeatedRows | None:
    """Return the rows of equal couplings, each shape once; None if couplings differ, or few sites are alike."""
    kinds, own = len(coupling.distinct), len(on_site.distinct)
    couples, acts = bool(np.any(coupling.distinct)), bool(np.any(on_site.distinct))
    alike = max(kinds, own) * MIN_REPEATS <= sites and sites**2 * (2 * kinds + own) < 2**63
    if not alike or 3 * sites < MIN_ROWS or not (couples or acts):
        return None
    turned = np.arange(kinds)[:, None] * 2 + np.array([0, 1])  # codes of a matrix, and of its transpose
    same = np.all(coupling.distinct == np.swapaxes(coupling.distinct, 1, 2), axis=(1, 2))
    turned[same, 1] = turned[same, 0]
    blocks = [*np.stack([coupling.distinct, np.swapaxes(coupling.distinct, 1, 2)], axis=1).reshape(-1, 3, 3)]
    codes = turned[coupling.number]
    own_codes = 2 * kinds + on_site.number if acts else None
    start, columns, code = _neighbours(sites, edges if couples else edges[:0], codes, own_codes, 2 * kinds + own)
    blocks += [*on_site.distinct]
    found = shapes_of(start, columns, code)
    if found is None:
        return None
    shape, leaders = found
    table = []
    for site in leaders.tolist():
        row = slice(start[site], start[site + 1])
        pairs = [
            (column - site, blocks[k]) for column, k in zip(columns[row].tolist(), code[row].tolist(), strict=True)
        ]
        table += [
            [(3 * shift + b - a, float(block[a, b])) for shift, block in pairs for b in range(3) if block[a, b] != 0.0]
            for a in range(3)
        ]
    return RepeatedRows.of_table((3 * shape[:, None] + np.arange(3, dtype=np.uint32)).ravel(), table)


def _neighbours(
    sites: int, edges: Integers, codes: Integers, own: Integers | None, count: int
) -> tuple[Integers, npt.NDArray[np.uint32], npt.NDArray[np.uint32]]:
    """Return the sorted neighbours of all sites in compressed sparse rows, and codes of the matrices, below `count`."""
    m, first, second = len(edges), edges[:, 0], edges[:, 1]
    keys = np.empty(2 * m + (0 if own is None else sites), dtype=np.int64)
    keys[:m] = (first * sites + second) * count + codes[:m, 0]
    keys[m : 2 * m] = (second * sites + first) * count + codes[:m, 1]
    if own is not None:
        keys[2 * m :] = np.arange(sites) * (sites + 1) * count + own
    keys.sort()
    code = keys % count
    keys //= count
    site = keys // sites
    keys -= site * sites
    return starts_of_rows(site, sites), keys.astype(np.uint32), code.astype(np.uint32)


def _rows(sites: int, edges: Integers, coupling: Blocks, on_site: Blocks) -> Rows:
    """Return the starts of rows, columns and values of the matrix, one component of the spins after the other."""
    first, second = edges.T
    own = np.arange(sites if np.any(on_site.distinct) else 0)
    keys = np.concatenate([first * sites + second, second * sites + first, own * (sites + 1)])
    order = np.argsort(keys)
    site = keys[order] // sites
    other = (keys[order] - site * sites).astype(np.uint32)
    del keys
    pattern = np.any(coupling.distinct, axis=0) | np.any(on_site.distinct, axis=0)
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
            number[forward] = coupling.entries(a, b, order[forward])
            number[backward] = coupling.entries(b, a, order[backward] - m)
            number[same] = on_site.entries(a, b, order[same] - 2 * m)
            columns[at + place], values[at + place] = 3 * other + np.uint32(b), number
    zero = values == 0.0
    if np.any(zero):
        row = np.repeat(np.arange(3 * sites), counts.ravel())[~zero]
        start, columns, values = starts_of_rows(row, 3 * sites), columns[~zero], values[~zero]
    return start, columns, values


def driving_field(force: Callable[..., Any], sites: int, width: int = 3) -> tuple[SplitHamiltonian, bool]:
    """Return ``-sum over sites s of f_s(t) . S_s``, f a function of the time, and whether f is equal at all sites."""
    # Numba compiles `force`, which returns (3,), or (sites, 3), for the first three of the `width` coordinates of a
    # site. Components along one axis commute.
    uniform = is_uniform(force, sites)
    pieces = [(range(axis, width * sites, width), _drive(force, axis, sites, uniform)) for axis in range(3)]
    return SplitHamiltonian(pieces), uniform


def is_uniform(force: Callable[..., Any], sites: int) -> bool:
    """Return whether a field, a function of the time, is equal at all sites; raise an error if it is no field."""
    check_arguments(force, "field", "t")
    try:
        values = np.asarray(force(0.0), dtype=np.float64)
    except Exception as reason:
        raise TypeError(f"field(0.0) fails ({type(reason).__name__}: {short(str(reason))}); give numbers") from None
    if values.shape not in ((3,), (sites, 3)):
        raise ValueError(f"field(t) has shape {values.shape}; it must return (3,) or ({sites}, 3)")
    if not np.isfinite(values).all():
        raise ValueError("field(0.0) is not finite; give a function with finite values")
    return values.ndim == 1


def _drive(force: Callable[..., Any], axis: int, sites: int, uniform: bool) -> Hamiltonian:
    """Return the function of the components of all spins along an axis, and of the time."""
    if uniform:

        def value(y: Any, t: Any) -> Any:
            return -force(t)[axis] * np.sum(y)

        def gradient(y: Any, t: Any) -> Any:
            return np.full(len(y), -force(t)[axis])

    else:

        def value(y: Any, t: Any) -> Any:
            forces, total = force(t), 0.0
            for site in range(len(y)):
                total -= forces[site][axis] * y[site]
            return total

        def gradient(y: Any, t: Any) -> Any:
            forces, result = force(t), np.zeros(len(y))
            for site in range(len(y)):
                result[site] = -forces[site][axis]
            return result

    def hessian(y: Any, t: Any) -> Any:
        return np.zeros((len(y), len(y)))

    energy = Hamiltonian(value, gradient, hessian)
    energy.dim = sites  # bound without a check of the derivatives
    return energy
