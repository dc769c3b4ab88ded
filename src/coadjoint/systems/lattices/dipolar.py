"""The dipolar energy of spins on open lattices, by FFT, as a Hamiltonian."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.lattices.geometry import CELLS, OPEN_LATTICES, lattice_positions, sizes_of

Floats = npt.NDArray[np.float64]

BYTES_PER_POINT = 300  # of the padded lattice, for each pair of sites of a cell, at the peak
MAX_HESSIAN_SITES = 341  # largest number of spins with second derivatives, which are dense


@dataclass(frozen=True, eq=False)
class Dipoles:
    """Sums over dipoles on an open lattice, as convolutions padded with zeros."""

    # `strength` times the sum over pairs of ``(S_i . S_j - 3 (S_i . e) (S_j . e)) / r^3``, r in distances of
    # neighbours.

    lattice: str
    sizes: tuple[int, ...]
    strength: float

    @cached_property
    def kernel(self) -> npt.NDArray[np.complex128]:
        """Transforms of the tensors (1 - 3 e e) / r^3 between sites of cells, (s, s', 3, 3, padded axes)."""
        import scipy.fft

        edges, sites = (_in_space(part) for part in CELLS[self.lattice][:2])
        # Index k of an axis is the displacement k, or k - size where that is negative.
        steps = [np.fft.fftfreq(size, 1.0 / size) for size in self.padded]
        cells = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1) @ edges
        r = cells + (sites[:, None] - sites).reshape(len(sites), len(sites), *(1,) * len(steps), 3)
        square = np.sum(r**2, axis=-1)
        with np.errstate(divide="ignore"):
            inverse = np.where(square > 0.25, square**-1.5, 0.0)
        axes = np.where(square > 0.25, square, 1.0)
        tensors = (np.eye(3) - 3.0 * r[..., :, None] * r[..., None, :] / axes[..., None, None]) * inverse[
            ..., None, None
        ]
        return np.asarray(scipy.fft.rfftn(np.moveaxis(tensors, (-2, -1), (2, 3)), axes=self._axes))

    @cached_property
    def padded(self) -> tuple[int, ...]:
        """Sizes of the axes with zeros, so that the ends do not meet."""
        import scipy.fft

        return tuple(scipy.fft.next_fast_len(2 * size - 1, real=True) for size in self.sizes)

    @property
    def _axes(self) -> tuple[int, ...]:
        return tuple(range(-len(self.sizes), 0))

    def field(self, x: Floats) -> Floats:
        """Return the gradient of the energy, shape (n,)."""
        import scipy.fft

        spins = np.moveaxis(x.reshape(*self.sizes, -1, 3), (-2, -1), (0, 1))
        waves = scipy.fft.rfftn(spins, self.padded, axes=self._axes)
        sums = np.einsum("stab...,tb...->sa...", self.kernel, waves, optimize=True)
        inside = (slice(None), slice(None), *map(slice, self.sizes))
        result = scipy.fft.irfftn(sums, self.padded, axes=self._axes)[inside]
        return np.asarray(self.strength * np.moveaxis(result, (0, 1), (-2, -1)).reshape(-1))

    def matrix(self) -> Floats:
        """Return the second derivatives, (n, n), by the direct sum."""
        positions = _in_space(lattice_positions(self.lattice, self.sizes))
        r = positions[:, None] - positions
        square = np.sum(r**2, axis=-1) + np.eye(len(r))
        tensors = np.eye(3) - 3.0 * r[..., :, None] * r[..., None, :] / square[..., None, None]
        tensors *= (self.strength * (square**-1.5 - np.eye(len(r))))[..., None, None]
        return np.asarray(np.swapaxes(tensors, 1, 2).reshape(3 * len(r), -1))


@dataclass(frozen=True, eq=False)
class DipolarFunction:
    """The dipolar energy, or its derivative of order 1 or 2, as a function of x that the loops call in Python."""

    dipoles: Dipoles
    order: int

    called_in_python: ClassVar[bool] = True

    @property
    def __name__(self) -> str:
        """Name in the representation of the Hamiltonian."""
        return ("dipolar energy", "its gradient", "its second derivatives")[self.order]

    def __call__(self, x: Any, _time: float = 0.0) -> Any:
        """Return the value or the derivative at x, of floats or complex numbers; the loops give the time too."""
        y = np.asarray(x)
        if y.dtype.kind not in "fc":
            raise TypeError(f"the dipolar energy is computed by FFT, of floats or complex numbers, not of {y.dtype}")
        if self.order == 2:
            return self.dipoles.matrix()
        field = self.dipoles.field(np.ascontiguousarray(y.real, dtype=np.float64))
        if y.dtype.kind == "c":
            field = field + 1j * self.dipoles.field(np.ascontiguousarray(y.imag, dtype=np.float64))
        return field if self.order else 0.5 * np.sum(y * field)


def dipolar_energy(lattice: Any, shape: Any, periodic: Any, strength: float) -> Hamiltonian:
    """Return the dipolar energy of the spins of an open lattice by name; ValueError for any other."""
    if not isinstance(lattice, str) or lattice not in OPEN_LATTICES:
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
    points = cell**2 * math.prod(2 * size for size in sizes)
    check_available_memory(
        BYTES_PER_POINT * points, f"the dipolar energy of a {lattice} lattice of {short(shape)} cells"
    )
    dipoles = Dipoles(lattice, sizes, strength)
    derivatives: list[Callable[..., Any]] = [DipolarFunction(dipoles, order) for order in range(3)]
    dense = cell * math.prod(sizes) <= MAX_HESSIAN_SITES
    return Hamiltonian(*derivatives[: 3 if dense else 2])


def _in_space(vectors: Any) -> Floats:
    """Return vectors of one to three components with three."""
    array = np.asarray(vectors, dtype=np.float64)
    return np.pad(array, ((0, 0), (0, 3 - array.shape[1])))
