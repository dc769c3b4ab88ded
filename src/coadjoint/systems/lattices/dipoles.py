"""The dipolar energy of spins on cells by FFT: open lattices, and periodic ones and films by Ewald's sums."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple, Self, cast

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.monomials import Coefficient
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import read_point
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.summable import Summable
from coadjoint.systems.hamiltonians.terms import FunctionTerm, Term
from coadjoint.systems.lattices.geometry import CELLS, OPEN_LATTICES, sizes_of

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MAX_HESSIAN_SITES = 341  # largest number of spins with second derivatives, which are dense
OF_STATES = "CommutatorFree(4), whose states stay pure, or GaussLegendre(2), which conserves the energy"
EXPONENT = 38.0  # beyond which exp(-x) is below round-off of the sums


class DipolarCells(NamedTuple):
    """Cells of dipoles: edges (axes, 3) and sites (s, 3) in space, cells along each axis, which of them repeat.

    `moments` (s,) multiply the spins of each site of a cell, `occupied` are the numbers of the sites that have a spin,
    None for all, and `factors` multiply single spins; None for 1.
    """

    edges: Floats
    sites: Floats
    sizes: tuple[int, ...]
    periodic: tuple[bool, ...]
    moments: Floats
    occupied: Integers | None = None
    factors: Floats | None = None

    @property
    def axes(self) -> tuple[int, ...]:
        return tuple(range(-len(self.sizes), 0))

    @property
    def padded(self) -> tuple[int, ...]:
        """The sizes of the axes, with zeros behind open ones, so that the ends do not meet."""
        import scipy.fft

        return tuple(
            size if closed else scipy.fft.next_fast_len(2 * size - 1, real=True)
            for size, closed in zip(self.sizes, self.periodic, strict=True)
        )

    def tensors(self) -> npt.NDArray[np.complex128]:
        """Return the transforms of m m' (1 - 3 e e) / r^3 between sites of cells, (s, s', 3, 3, padded axes)."""
        count = len(self.sites) ** 2 * 9 * math.prod(self.padded)
        check_available_memory(24 * count, "dipolar tensors of all pairs of sites of cells")
        pairs = (self.moments[:, None] * self.moments)[(..., *(None,) * (2 + len(self.sizes)))]
        of_kind = _periodic_tensors if all(self.periodic) else _film_tensors if any(self.periodic) else _open_tensors
        return np.asarray(pairs * of_kind(self))


@dataclass(frozen=True, eq=False)
class DipolarFunction:
    """The dipolar energy of spins on cells, or its derivative of order 1 or 2.

    The loops have the energy and the gradient as tables of `tensors`, and call second derivatives in Python.
    """

    # The energy is `strength` times the sum over pairs of ``m m' (S_i . S_j - 3 (S_i . e) (S_j . e)) / r^3``: a
    # convolution with `tensors`, those of the cells.

    cells: DipolarCells
    strength: float
    order: int
    tensors: npt.NDArray[np.complex128] = field(repr=False)

    called_in_python: ClassVar[bool] = True
    other_schemes: str = "GaussLegendre(1), which conserves the energy, or SphericalMidpoint, which is a Poisson map"

    @property
    def not_split(self) -> str:
        """Why splittings refuse it, and what to take."""
        why = "its dipoles couple every spin to all others, in fields that FFTs compute for all at once"
        return f"{why}; take {self.other_schemes}"

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

        sizes, axes, occupied, factors = self.cells.sizes, self.cells.axes, self.cells.occupied, self.cells.factors
        padded = self.cells.padded
        if factors is not None:
            x = (x.reshape(-1, 3) * factors[:, None]).ravel()
        if occupied is not None:
            given, x = x.reshape(-1, 3), np.zeros(3 * len(self.cells.sites) * math.prod(sizes))
            x.reshape(-1, 3)[occupied] = given
        spins = np.moveaxis(x.reshape(*sizes, -1, 3), (-2, -1), (0, 1))
        waves = scipy.fft.rfftn(spins, padded, axes=axes)
        sums = np.einsum("stab...,tb...->sa...", self.tensors, waves, optimize=True)
        inside = (slice(None), slice(None), *map(slice, sizes))
        result = scipy.fft.irfftn(sums, padded, axes=axes)[inside]
        rows = np.moveaxis(result, (0, 1), (-2, -1)).reshape(-1)
        if occupied is not None:
            rows = rows.reshape(-1, 3)[occupied].ravel()
        if factors is not None:
            rows = (rows.reshape(-1, 3) * factors[:, None]).ravel()
        return np.asarray(self.strength * rows)

    def matrix(self) -> Floats:
        """Return the second derivatives, (n, n), by the direct sum, or of periodic cells by the transforms."""
        edges, sites, sizes, periodic, moments, occupied, factors = self.cells
        cells = np.indices(sizes).reshape(len(sizes), -1).T
        here = np.arange(len(cells) * len(sites)) if occupied is None else occupied
        cell, site = cells[here // len(sites)], here % len(sites)
        if any(periodic):
            import scipy.fft

            padded = self.cells.padded
            values = scipy.fft.irfftn(self.tensors, padded, axes=self.cells.axes)
            steps = np.moveaxis((cell[:, None] - cell) % np.array(padded), -1, 0)
            tensors = self.strength * values[(site[:, None], site, slice(None), slice(None), *steps)]
        else:
            positions = cell @ edges + sites[site]
            r = positions[:, None] - positions
            square = np.sum(r**2, axis=-1) + np.eye(len(r))
            tensors = np.eye(3) - 3.0 * r[..., :, None] * r[..., None, :] / square[..., None, None]
            strengths = self.strength * (square**-1.5 - np.eye(len(r))) * (moments[site][:, None] * moments[site])
            tensors *= strengths[..., None, None]
        if factors is not None:
            tensors = tensors * (factors[:, None] * factors)[..., None, None]
        return np.asarray(np.swapaxes(tensors, 1, 2).reshape(3 * len(here), -1))


def _open_tensors(cells: DipolarCells) -> npt.NDArray[np.complex128]:
    import scipy.fft

    edges, sites = cells.edges, cells.sites
    # Index k of an axis is the displacement k, or k - size where that is negative.
    steps = [np.fft.fftfreq(size, 1.0 / size) for size in cells.padded]
    offsets = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1)
    apart = np.all(np.abs(offsets) < cells.sizes, axis=-1)
    own = ~np.any(offsets, axis=-1) & np.eye(len(sites), dtype=bool)[(..., *(None,) * len(steps))]
    r = offsets @ edges + (sites[:, None] - sites).reshape(len(sites), len(sites), *(1,) * len(steps), 3)
    square = np.where(own, 1.0, np.sum(r**2, axis=-1))
    inverse = np.where(own | ~apart, 0.0, square**-1.5)
    tensors = (np.eye(3) - 3.0 * r[..., :, None] * r[..., None, :] / square[..., None, None]) * inverse[..., None, None]
    return np.asarray(scipy.fft.rfftn(np.moveaxis(tensors, (-2, -1), (2, 3)), axes=cells.axes))


def _near_tensors(cells: DipolarCells, alpha: float) -> Floats:
    """Return the sum in space of Ewald's sums, (padded axes, s, s', 3, 3), with what a dipole has of itself."""
    from scipy.special import erfc

    edges, sites, sizes = cells.edges, cells.sites, cells.padded
    count, inverse = len(sites), np.linalg.inv(edges)
    steps = sites[:, None] - sites
    reach = math.sqrt(EXPONENT) / alpha
    near = np.zeros((*sizes, count, count, 3, 3))
    within = steps @ inverse
    spans = [
        range(math.floor(-bound - high), math.ceil(bound - low) + 1)
        for bound, low, high in zip(
            reach * np.sqrt((inverse**2).sum(axis=0)), within.min(axis=(0, 1)), within.max(axis=(0, 1)), strict=True
        )
    ]
    spans = [
        span if closed else range(max(span.start, 1 - size), min(span.stop, size))
        for span, size, closed in zip(spans, cells.sizes, cells.periodic, strict=True)
    ]
    for offset in itertools.product(*spans):
        r = steps + np.array(offset) @ edges
        square = np.sum(r**2, axis=-1)
        own = np.eye(count, dtype=bool) if not any(offset) else np.zeros((count, count), dtype=bool)
        square[own] = 1.0
        distance = np.sqrt(square)
        gauss = 2.0 * alpha / math.sqrt(math.pi) * np.exp(-(alpha**2) * square)
        even = erfc(alpha * distance) / distance**3 + gauss / square
        odd = (3.0 * even + 2.0 * alpha**2 * gauss) / square
        tensor = even[..., None, None] * np.eye(3) - odd[..., None, None] * r[..., :, None] * r[..., None, :]
        tensor[own] = -4.0 * alpha**3 / (3.0 * math.sqrt(math.pi)) * np.eye(3)
        near[tuple(np.array(offset) % np.array(sizes))] += tensor
    return near


def _film_tensors(cells: DipolarCells) -> npt.NDArray[np.complex128]:
    """Return Ewald's sums of cells that repeat along two axes, in space, of a film without others above or below."""
    import scipy.fft
    from scipy.special import erfc, erfcx

    (first, second), (open_axis,) = (
        [axis for axis, closed in enumerate(cells.periodic) if closed is flag] for flag in (True, False)
    )
    a, b = cells.edges[first], cells.edges[second]
    across = np.cross(a, b)
    area = math.sqrt(float((across**2).sum()))
    normal = across / area
    reciprocal = 2.0 * math.pi * np.stack([np.cross(b, normal), np.cross(normal, a)]) / area
    alpha = math.sqrt(math.pi / area)
    near = _near_tensors(cells, alpha)
    # Far: the sum over reciprocal vectors k of the plane, for each distance of layers.
    layers = np.fft.fftfreq(cells.padded[open_axis], 1.0 / cells.padded[open_axis])
    r = (cells.sites[:, None] - cells.sites)[:, :, None] + layers[:, None] * cells.edges[open_axis]
    z = r @ normal  # (s, s', layers)
    waves = [np.fft.fftfreq(cells.sizes[axis]) for axis in (first, second)]
    cell_waves = np.stack(np.meshgrid(*waves, indexing="ij"), axis=-1)
    bound = 2.0 * alpha * math.sqrt(EXPONENT)
    reaches = [math.ceil(bound * float(np.sqrt((edge**2).sum())) / (2.0 * math.pi) + 0.5) for edge in (a, b)]
    gauss = np.exp(-((alpha * z) ** 2))
    far = np.zeros((*cell_waves.shape[:2], *z.shape, 3, 3), dtype=np.complex128)

    def half(k: Floats, side: float) -> Floats:
        """Return exp(side k z) erfc(k / (2 alpha) + side alpha z), which is finite."""
        u = k / (2.0 * alpha) + side * alpha * z
        beside = np.exp(-((k / (2.0 * alpha)) ** 2)) * gauss * erfcx(np.maximum(u, 0.0))
        return np.where(u >= 0.0, beside, np.exp(np.minimum(side * k * z, 0.0)) * erfc(np.minimum(u, 0.0)))

    for whole in itertools.product(*(range(-n, n + 1) for n in reaches)):
        vectors = (cell_waves + np.array(whole)) @ reciprocal
        k = np.sqrt(np.sum(vectors**2, axis=-1))[..., None, None, None]
        if k.min() > bound:
            continue
        above, below = half(k, 1.0), half(k, -1.0)
        falling = 4.0 * alpha / math.sqrt(math.pi) * np.exp(-((k / (2.0 * alpha)) ** 2)) * gauss
        along = vectors[..., None, None, None, :] / np.where(k > 0.0, k, 1.0)[..., None]
        straight = normal * np.ones_like(along)
        # Second derivatives of pi / (area k) exp(i k . r) (above + below).
        mixed = along[..., :, None] * straight[..., None, :]
        second_derivatives = -(k * (above + below))[..., None, None] * (along[..., :, None] * along[..., None, :])
        second_derivatives = second_derivatives + 1j * (k * (above - below))[..., None, None] * (
            mixed + np.swapaxes(mixed, -1, -2)
        )
        second_derivatives += (k * (above + below) - falling)[..., None, None] * (normal[:, None] * normal)
        phase = np.exp(1j * np.tensordot(vectors, r, axes=(-1, -1)))
        far -= math.pi / area * phase[..., None, None] * second_derivatives
    # The transform divides by the number of cells in the plane, of which the whole area is that of all.
    in_space = scipy.fft.ifftn(far, axes=(0, 1)).real
    in_space = np.moveaxis(in_space, (0, 1, 4, 2, 3), (first, second, open_axis, 3, 4))
    total = near + in_space
    # Layers that are further apart than any two of the film.
    total[(slice(None),) * open_axis + (np.abs(layers) >= cells.sizes[open_axis],)] = 0.0
    return np.asarray(scipy.fft.rfftn(np.moveaxis(total, (-4, -3, -2, -1), (0, 1, 2, 3)), axes=cells.axes))


def _periodic_tensors(cells: DipolarCells) -> npt.NDArray[np.complex128]:
    """Return Ewald's sums of periodic cells in space, without a demagnetization field (a surrounding conductor)."""
    import scipy.fft

    edges, sites, sizes = cells.edges, cells.sites, cells.sizes
    inverse = np.linalg.inv(edges)
    volume = 1.0 / abs(float(np.linalg.det(inverse)))
    alpha = math.sqrt(math.pi) / volume ** (1.0 / 3.0)
    steps = sites[:, None] - sites
    near = _near_tensors(cells, alpha)
    found = scipy.fft.rfftn(np.moveaxis(near, (-4, -3, -2, -1), (0, 1, 2, 3)), axes=cells.axes)
    # Far: the sum over reciprocal vectors, of which the mean field of the sample has none.
    reciprocal = 2.0 * math.pi * inverse.T
    bound = 2.0 * alpha * math.sqrt(EXPONENT)
    waves = [np.fft.fftfreq(size) for size in sizes[:-1]] + [np.fft.rfftfreq(sizes[-1])]
    cell_waves = np.stack(np.meshgrid(*waves, indexing="ij"), axis=-1)
    reaches = [math.ceil(bound * float(np.sqrt((edge**2).sum())) / (2.0 * math.pi) + 0.5) for edge in edges]
    for whole in itertools.product(*(range(-n, n + 1) for n in reaches)):
        k = (cell_waves + np.array(whole)) @ reciprocal
        square = np.sum(k**2, axis=-1)
        zero = square == 0.0
        square[zero] = 1.0
        fall = np.exp(-square / (4.0 * alpha**2))
        fall[zero] = 0.0
        if not np.any(fall > 1e-18):
            continue
        size = 4.0 * math.pi / volume * fall / square
        phase = np.exp(1j * np.tensordot(steps, k, axes=(-1, -1)))
        found += phase[:, :, None, None] * (size * np.moveaxis(k[..., :, None] * k[..., None, :], (-2, -1), (0, 1)))
    return np.asarray(found)


class DipolesOfSites(Summable):
    """A dipolar energy of the first three of `width` coordinates of each site."""

    timed = False

    def __init__(self, energy: Hamiltonian, width: int) -> None:
        assert energy.dim is not None
        self.energy, self.width, self.dim = energy, width, energy.dim // 3 * width
        self._where = np.arange(self.dim).reshape(-1, width)[:, :3].ravel()

    def bind(self, n: int) -> DipolesOfSites:
        if n != self.dim:
            raise ValueError(f"the dipolar energy is bound to dimension {self.dim}, not {short(n)}; make a new one")
        return self

    def times(self, factor: Coefficient) -> Self:
        return type(self)(self.energy.times(factor), self.width)

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        return self.energy.value(read_point(x, self.dim)[self._where], t)

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        of_sites = self.energy.gradient(read_point(x, self.dim)[self._where], t)
        found = np.zeros(self.dim, of_sites.dtype)
        found[self._where] = of_sites
        return found

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        found = np.zeros((self.dim, self.dim))
        found[np.ix_(self._where, self._where)] = self.energy.hessian(read_point(x, self.dim)[self._where], t)
        return found

    def terms(self) -> tuple[Term, ...]:
        return tuple(replace(cast(FunctionTerm, one), coordinates=self._where) for one in self.energy.terms())

    def __repr__(self) -> str:
        return f"the {self.energy!r} of {self.dim // self.width} sites"


def dipolar_energy(cells: DipolarCells, strength: float, width: int = 3) -> Any:
    """Return the dipolar energy of the spins on cells, the first three of `width` coordinates of each."""
    tensors = cells.tensors()
    functions = [DipolarFunction(cells, strength, order, tensors) for order in range(3)]
    if width != 3:
        functions = [replace(one, other_schemes=OF_STATES) for one in functions]
    derivatives: list[Callable[..., Any]] = [*functions]
    dense = len(cells.sites) * math.prod(cells.sizes) <= MAX_HESSIAN_SITES
    energy = Hamiltonian(*derivatives[: 3 if dense else 2])
    if width == 3:
        return energy
    every = len(cells.sites) * math.prod(cells.sizes)
    return DipolesOfSites(energy.bind(3 * (every if cells.occupied is None else len(cells.occupied))), width)


def named_cells(lattice: str, shape: Any, periodic: Any) -> DipolarCells:
    """Return the cells of an open lattice by name; ValueError for any other."""
    if lattice not in OPEN_LATTICES:
        raise ValueError(
            f"dipolar is given for the lattice {short(lattice)}, whose sites have no positions; take one of "
            f"{', '.join(OPEN_LATTICES)}"
        )
    if np.any(periodic):
        raise ValueError(
            "dipolar is given for a periodic lattice; dipoles are summed over the sites of an open one, with "
            "periodic=False; co.systems.spins has periodic ones"
        )
    edges, sites = (_in_space(part) for part in CELLS[lattice][:2])
    sizes = sizes_of(shape)
    return DipolarCells(edges, sites, sizes, (False,) * len(sizes), np.ones(len(sites)))


def _in_space(vectors: Any) -> Floats:
    """Return vectors of one to three components with three."""
    array = np.asarray(vectors, dtype=np.float64)
    return np.pad(array, ((0, 0), (0, 3 - array.shape[1])))
