"""Modes of fluids on the sphere and the torus as vectors along the diagonals of W."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.systems.matrices.spherical_modes import harmonics
from coadjoint.systems.matrices.torus_modes import representatives

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Numbers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class ModeBasis(ABC):
    """Orthonormal modes of skew-Hermitian matrices (N, N), by diagonals from the main one; the lower half follows."""

    # ``kind`` is the code `ModeKind` of the kernels, ``scale`` the name of the number that measures the scale of a
    # mode.

    N: int

    kind: ClassVar[str]
    scale: ClassVar[str]

    @property
    @abstractmethod
    def diagonals(self) -> int:
        """Number of diagonals with modes."""

    @abstractmethod
    def numbers(self, d: int) -> Numbers:
        """Return the numbers of the modes of a diagonal: degrees l, or n1 mod N."""

    @abstractmethod
    def eigenvalues(self, d: int, numbers: Numbers) -> Floats:
        """Return the eigenvalues of minus the Laplacian."""

    @abstractmethod
    def scales(self, d: int, numbers: Numbers) -> Floats:
        """Return the degrees l, or the wave numbers |n|."""

    @abstractmethod
    def vectors(self, d: int, numbers: Numbers) -> npt.NDArray[Any]:
        """Return modes as rows, along the diagonal."""

    @abstractmethod
    def table(self, chosen: Sequence[Numbers]) -> Floats:
        """Return the table of chosen modes for the kernels, by diagonal; ``matrices/modes.hpp`` describes it."""

    @abstractmethod
    def indices(self, d: int) -> tuple[Numbers, Numbers]:
        """Return the rows and columns of the entries of a diagonal."""

    def coefficients(self, W: npt.NDArray[Any], d: int, numbers: Numbers) -> Complexes:
        """Return the coefficients in W of modes of a diagonal."""
        return np.asarray(np.conj(self.vectors(d, numbers)) @ W[self.indices(d)], dtype=np.complex128)

    def matrix(self, coefficients: Sequence[Complexes], chosen: Sequence[Numbers]) -> Complexes:
        """Return the full matrix of coefficients of chosen modes, by diagonal.

        Real parts on the main diagonal are dropped.
        """
        W = np.zeros((self.N, self.N), dtype=np.complex128)
        for d, (c, numbers) in enumerate(zip(coefficients, chosen, strict=True)):
            if not len(numbers):
                continue
            i, j = self.indices(d)
            entries = c @ self.vectors(d, numbers)
            if d == 0:
                W[i, j] = 1j * entries.imag
                continue
            W[i, j], W[j, i] = entries, -np.conj(entries)
        return W


@dataclass(frozen=True)
class Harmonics(ModeBasis):
    """Modes of the sphere, T_lm of `spherical_modes`, on the diagonal m."""

    kind = "HARMONICS"
    scale = "degree l"

    @property
    def diagonals(self) -> int:
        """Number of diagonals, N."""
        return self.N

    def numbers(self, d: int) -> Numbers:
        return np.arange(max(d, 1), self.N)

    def eigenvalues(self, d: int, numbers: Numbers) -> Floats:
        return np.asarray(numbers * (numbers + 1), dtype=np.float64)

    def scales(self, d: int, numbers: Numbers) -> Floats:
        return np.asarray(numbers, dtype=np.float64)

    def vectors(self, d: int, numbers: Numbers) -> Floats:
        half, n = self._half(d, numbers), self.N - d
        sign = np.where((numbers - d) % 2, -1.0, 1.0)[:, None]
        return np.concatenate([half, (sign * half)[:, : n // 2][:, ::-1]], axis=1)

    def table(self, chosen: Sequence[Numbers]) -> Floats:
        count = sum(len(numbers) * ((self.N - d + 1) // 2) for d, numbers in enumerate(chosen))
        check_available_memory(
            8.0 * count, f"the harmonics of a force on matrices of N = {self.N}", "let it act on fewer degrees"
        )
        table, offset = np.empty(count), 0
        for d, numbers in enumerate(chosen):
            if len(numbers):
                half = self._half(d, numbers).ravel()
                table[offset : offset + half.size] = half
                offset += half.size
        return table

    def indices(self, d: int) -> tuple[Numbers, Numbers]:
        i = np.arange(self.N - d)
        return i, i + d

    def _half(self, d: int, numbers: Numbers) -> Floats:
        return np.asarray(harmonics(self.N, d)[numbers - d])


@dataclass(frozen=True)
class Waves(ModeBasis):
    """Modes of the torus, T_n of `torus_modes`, on the cyclic diagonal n2, numbered by n1 mod N."""

    kind = "WAVES"
    scale = "wave number |n|"

    @property
    def diagonals(self) -> int:
        """Number of diagonals, (N + 1)/2; the others have the conjugate modes."""
        return (self.N + 1) // 2

    def numbers(self, d: int) -> Numbers:
        return np.arange(0 if d else 1, self.N)

    def eigenvalues(self, d: int, numbers: Numbers) -> Floats:
        return np.asarray(representatives(self.N)[numbers] ** 2 + d**2, dtype=np.float64)

    def scales(self, d: int, numbers: Numbers) -> Floats:
        return np.sqrt(self.eigenvalues(d, numbers))

    def vectors(self, d: int, numbers: Numbers) -> Complexes:
        phases = numbers[:, None] * (d + 2 * np.arange(self.N)) % self.N
        return np.asarray(self._circle()[phases] / np.sqrt(self.N))

    def table(self, chosen: Sequence[Numbers]) -> Floats:
        circle = self._circle()
        return np.concatenate([circle.real, circle.imag])

    def indices(self, d: int) -> tuple[Numbers, Numbers]:
        a = np.arange(self.N)
        return a, (a + d) % self.N

    def _circle(self) -> Complexes:
        return np.asarray(np.exp(2j * np.pi * representatives(self.N) / self.N))


LAYERS = ("vorticity", "carried")
"""Fields of a two-layer system: the vorticity, and the field carried by the flow."""


def layer_index(system: Any, layer: str) -> int:
    """Return the index of a layer in a state; raise an error if the system does not have it."""
    if len(system.matrix_shape) == 3:
        return 1 - LAYERS.index(layer)
    if layer != "vorticity":
        raise ValueError(f"layer is {layer!r}; {system.name} has one field, the vorticity")
    return 0


def mode_basis_of(system: Any) -> ModeBasis | None:
    """Return the modes of a matrix system, from its stream; None if its modes are the entries."""
    kind = getattr(getattr(system, "stream", None), "modes", "")
    if not kind or (kind == Harmonics.kind and not system.complex):
        return None
    return {basis.kind: basis for basis in (Waves, Harmonics)}[kind](system.algebra.N)
