"""Energies of spins on a graph: the symmetric matrix of couplings, the dipolar energy by FFT, and driving fields."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.coefficients import EnergyCoefficients, encoded
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.repeated_rows import MIN_ROWS, RepeatedRows, shapes_of, starts_of_rows
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.lattices.geometry import CELLS, OPEN_LATTICES, lattice_positions, sizes_of
from coadjoint.systems.user_functions import check_arguments

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


def driving_field(force: Callable[..., Any], sites: int) -> tuple[SplitHamiltonian, bool]:
    """Return ``-sum over sites s of f_s(t) . S_s``, f a function of the time, and whether f is equal at all sites."""
    # Numba compiles `force`, which returns (3,), or (sites, 3). Components along one axis commute.
    check_arguments(force, "field", "t")
    try:
        values = np.asarray(force(0.0), dtype=np.float64)
    except Exception as reason:
        raise TypeError(f"field(0.0) fails ({type(reason).__name__}: {short(str(reason))}); give numbers") from None
    if values.shape not in ((3,), (sites, 3)):
        raise ValueError(f"field(t) has shape {values.shape}; it must return (3,) or ({sites}, 3)")
    if not np.isfinite(values).all():
        raise ValueError("field(0.0) is not finite; give a function with finite values")
    uniform = values.ndim == 1
    pieces = [(range(axis, 3 * sites, 3), _drive(force, axis, sites, uniform)) for axis in range(3)]
    return SplitHamiltonian(pieces), uniform


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


MAX_HESSIAN_SITES = 341  # largest number of spins with second derivatives, which are dense


@dataclass(frozen=True, eq=False)
class DipolarFunction:
    """The dipolar energy of an open lattice, or its derivative of order 1 or 2; the loops call it in Python."""

    # The energy is `strength` times the sum over pairs of ``(S_i . S_j - 3 (S_i . e) (S_j . e)) / r^3``, r in distances
    # of neighbours: a convolution, padded with zeros, with `tensors`, the transforms of (1 - 3 e e) / r^3.

    lattice: str
    sizes: tuple[int, ...]
    strength: float
    order: int
    tensors: npt.NDArray[np.complex128] = field(repr=False)

    called_in_python: ClassVar[bool] = True

    @property
    def __name__(self) -> str:
        return ("dipolar energy", "its gradient", "its second derivatives")[self.order]

    def __call__(self, x: Any, _time: float = 0.0) -> Any:
        """Return the value or the derivative at x, of floats or complex numbers; the loops give the time too."""
        y = np.asarray(x)
        if y.dtype.kind not in "fc":
            raise TypeError(f"the dipolar energy is computed by FFT, of floats or complex numbers, not of {y.dtype}")
        if self.order == 2:
            return self.matrix()
        gradient = self._gradient(np.ascontiguousarray(y.real, dtype=np.float64))
        if y.dtype.kind == "c":
            gradient = gradient + 1j * self._gradient(np.ascontiguousarray(y.imag, dtype=np.float64))
        return gradient if self.order else 0.5 * np.sum(y * gradient)

    def _gradient(self, x: Floats) -> Floats:
        import scipy.fft

        axes, padded = _axes(self.sizes), _padded(self.sizes)
        spins = np.moveaxis(x.reshape(*self.sizes, -1, 3), (-2, -1), (0, 1))
        waves = scipy.fft.rfftn(spins, padded, axes=axes)
        sums = np.einsum("stab...,tb...->sa...", self.tensors, waves, optimize=True)
        inside = (slice(None), slice(None), *map(slice, self.sizes))
        result = scipy.fft.irfftn(sums, padded, axes=axes)[inside]
        return np.asarray(self.strength * np.moveaxis(result, (0, 1), (-2, -1)).reshape(-1))

    def matrix(self) -> Floats:
        """Return the second derivatives, (n, n), by the direct sum."""
        positions = _in_space(lattice_positions(self.lattice, self.sizes))
        r = positions[:, None] - positions
        square = np.sum(r**2, axis=-1) + np.eye(len(r))
        tensors = np.eye(3) - 3.0 * r[..., :, None] * r[..., None, :] / square[..., None, None]
        tensors *= (self.strength * (square**-1.5 - np.eye(len(r))))[..., None, None]
        return np.asarray(np.swapaxes(tensors, 1, 2).reshape(3 * len(r), -1))


def _transformed_tensors(lattice: str, sizes: tuple[int, ...]) -> npt.NDArray[np.complex128]:
    """Return the transforms of (1 - 3 e e) / r^3 between sites of cells, (s, s', 3, 3, padded axes)."""
    import scipy.fft

    edges, sites = (_in_space(part) for part in CELLS[lattice][:2])
    # Index k of an axis is the displacement k, or k - size where that is negative.
    steps = [np.fft.fftfreq(size, 1.0 / size) for size in _padded(sizes)]
    cells = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1) @ edges
    r = cells + (sites[:, None] - sites).reshape(len(sites), len(sites), *(1,) * len(steps), 3)
    square = np.sum(r**2, axis=-1)
    with np.errstate(divide="ignore"):
        inverse = np.where(square > 0.25, square**-1.5, 0.0)
    axes = np.where(square > 0.25, square, 1.0)
    tensors = (np.eye(3) - 3.0 * r[..., :, None] * r[..., None, :] / axes[..., None, None]) * inverse[..., None, None]
    return np.asarray(scipy.fft.rfftn(np.moveaxis(tensors, (-2, -1), (2, 3)), axes=_axes(sizes)))


def _padded(sizes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the sizes of the axes with zeros, so that the ends do not meet."""
    import scipy.fft

    return tuple(scipy.fft.next_fast_len(2 * size - 1, real=True) for size in sizes)


def _axes(sizes: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(range(-len(sizes), 0))


def dipolar_energy(lattice: str, shape: Any, periodic: Any, strength: float) -> Hamiltonian:
    """Return the dipolar energy of the spins of an open lattice by name; ValueError for any other."""
    if lattice not in OPEN_LATTICES:
        raise ValueError(
            f"dipolar is given for the lattice {short(lattice)}, whose sites have no positions; take one of "
            f"{', '.join(OPEN_LATTICES)}"
        )
    if np.any(periodic):
        raise ValueError(
            "dipolar is given for a periodic lattice; dipoles are summed over the sites of an open one, with "
            "periodic=False"
        )
    sizes, cell = sizes_of(shape), len(CELLS[lattice].sites)
    tensors = _transformed_tensors(lattice, sizes)
    derivatives: list[Callable[..., Any]] = [
        DipolarFunction(lattice, sizes, strength, order, tensors) for order in range(3)
    ]
    dense = cell * math.prod(sizes) <= MAX_HESSIAN_SITES
    return Hamiltonian(*derivatives[: 3 if dense else 2])


def _in_space(vectors: Any) -> Floats:
    """Return vectors of one to three components with three."""
    array = np.asarray(vectors, dtype=np.float64)
    return np.pad(array, ((0, 0), (0, 3 - array.shape[1])))
