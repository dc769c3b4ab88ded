"""Modes of fluids on the sphere and the torus along the diagonals of W, and the base class of forces on them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.systems.coordinates import rest_of
from coadjoint.systems.forces.base import Force, ForceReader
from coadjoint.systems.matrices.conjugation import units_of
from coadjoint.systems.matrices.spherical_modes import harmonics
from coadjoint.systems.matrices.torus_modes import representatives
from coadjoint.validation import is_integer, read_choice, read_integer

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Numbers = npt.NDArray[np.int64]
PerMode = list[npt.NDArray[Any]]


@dataclass(frozen=True)
class ModeBasis(ABC):
    """Orthonormal modes of skew-Hermitian matrices (N, N), by diagonals from the main one; the lower half follows."""

    # ``kind`` is the code `ModeKind` of the kernels, ``scale`` the name of the number that measures the scale of a
    # mode.

    N: int
    stream: Any = field(default=None, compare=False, repr=False)
    """The stream of the vorticity of the system."""

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
        """Return the matrix of coefficients of modes, by diagonal; real parts on the main diagonal are dropped."""
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


def noise_matrix(
    modes: ModeBasis, numbers: Sequence[Numbers], amplitudes: Sequence[Floats], deviates: Floats, tau: float
) -> Complexes:
    """Return the noise of a time tau from two normal deviates for each mode: amplitudes of |c|, by diagonal."""
    pairs, coefficients, offset = deviates.reshape(-1, 2), [], 0
    for d, amplitude in enumerate(amplitudes):
        real, imaginary = pairs[offset : offset + len(amplitude)].T
        offset += len(amplitude)
        if d == 0 and modes.kind != Waves.kind:
            coefficients.append(1j * np.sqrt(tau) * amplitude * real)
            continue
        # The main diagonal has both waves n and -n.
        multiplicity = 2.0 if d == 0 else 1.0
        coefficients.append(multiplicity * np.sqrt(0.5 * tau) * amplitude * (real + 1j * imaginary))
    return modes.matrix(coefficients, numbers)


LAYERS = ("vorticity", "carried")
"""Fields of a system of two fields: the vorticity, and the field carried by the flow."""
MAX_LAYERS = 64  # of a fluid


def layer_index(system: Any, layer: str | int) -> int:
    """Return the index of a layer in a state; raise an error if the system does not have it."""
    if system.independent_layers:
        count = system.matrix_shape[0]
        if layer in LAYERS or int(layer) >= count:
            raise ValueError(
                f"layer is {layer!r}; {system.name} has the layers 0 to {count - 1}, and a force acts on one of them"
            )
        return int(layer)
    if layer not in LAYERS:
        raise ValueError(f"layer is {layer}, and {system.name} has no layers of a fluid; give one of {LAYERS}")
    if len(system.matrix_shape) == 3:
        return 1 - LAYERS.index(str(layer))
    if layer != "vorticity":
        raise ValueError(f"layer is {layer!r}; {system.name} has one field, the vorticity")
    return 0


def modes_of(system: Any, what: str) -> ModeBasis:
    """Return the modes of a matrix system, from its stream; raise ValueError if its modes are the entries."""
    kind = getattr(getattr(system, "stream", None), "modes", "")
    if not kind or (kind == Harmonics.kind and not system.complex):
        raise ValueError(
            f"{what} acts on the modes of a fluid, such as sphere_euler or torus_euler, which {system.name} does not "
            "have; take LinearDamping"
        )
    return {basis.kind: basis for basis in (Waves, Harmonics)}[kind](system.algebra.N, system.stream)


def read_layer(value: Any, what: str) -> str | int:
    """Validate the name of a field, or the number of a layer."""
    if is_integer(value):
        return read_integer(value, what, 0, MAX_LAYERS - 1)
    return read_choice(value, what, LAYERS)


def layer_vector(system: Any, layer: str | int, W: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the vector of a state with this field, and zero in the others."""
    state = np.zeros(system.matrix_shape, dtype=W.dtype)
    state[layer_index(system, layer) if state.ndim == 3 else ...] = W
    return np.asarray(system.to_vector(state))


class LayerChange(NamedTuple):
    """A matrix of a state that changes by the modes of one that is read, times a weight of each mode, by diagonal."""

    changed: int
    read: int
    weights: PerMode


class ModeRates(Force):
    """A force that acts on each mode separately, ``c' = -rate c``, solved exactly; a complex rate rotates its phase."""

    # c is the mode of the state without that at rest: on a rotating sphere, whose state is the absolute vorticity, of
    # the relative vorticity; in a quasi-geostrophic flow of the potential vorticity without its planetary term; of one
    # layer among several of the relative vorticity, c_k' = -rate zeta_k with zeta_k = -eigenvalue psi_k.

    layer: str | int

    @abstractmethod
    def rates(self, modes: ModeBasis, d: int, numbers: Numbers) -> npt.NDArray[Any]:
        """Return the real or complex rates, (k,), of the modes `numbers`, (k,), of diagonal d."""

    def check(self, system: Any) -> None:
        self._selected_modes(system, modes_of(system, self.label))

    def _selected_modes(self, system: Any, modes: ModeBasis) -> tuple[list[Numbers], PerMode, list[LayerChange]]:
        """Return the numbers of the modes with nonzero rates, and these rates, by diagonal; and the changes."""
        layered, layer = system.independent_layers, self.layer
        if layered and layer == "carried":
            raise ValueError(f"layer is {layer!r}; {system.name} has no carried field; leave layer= out")
        changed = range(system.matrix_shape[0])
        if not layered or is_integer(layer):
            first = layer_index(system, layer)
            changed = range(first, first + 1)
        alone = layered and len(changed) == 1
        if alone and system.stream.couples_modes:
            raise ValueError(
                f"layer is {layer}; {self.label} of one layer acts on its relative vorticity, of which lamb of "
                f"{system.name} couples the degrees; take a coupling by gamma, or leave layer= out"
            )
        numbers, rates, induced = [], [], []
        for d in range(modes.diagonals):
            all_numbers = modes.numbers(d)
            all_rates = self.rates(modes, d, all_numbers)
            if alone:
                # psi_k is the sum of induction q_j, so that q_k relaxes at the rate of its own.
                induction = system.stream.induction(changed[0], modes, d, all_numbers)
                own = induction[changed[0]]
                all_rates = -all_rates * modes.eigenvalues(d, all_numbers) * own
                induced.append((induction / own)[:, all_rates != 0.0])
            numbers.append(all_numbers[all_rates != 0.0])
            rates.append(all_rates[all_rates != 0.0])
        if not alone:
            ones = [np.ones(len(of_diagonal)) for of_diagonal in numbers]
            return numbers, rates, [LayerChange(k, k, ones) for k in changed]
        k = changed[0]
        read = (k, *(j for j in range(system.matrix_shape[0]) if j != k))  # before it is changed
        return numbers, rates, [LayerChange(k, j, [weights[j] for weights in induced]) for j in read]

    def _scale_modes(
        self, system: Any, x: npt.NDArray[Any], factor: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]
    ) -> npt.NDArray[Any]:
        rest = rest_of(system)
        return self._scaled(system, x if rest is None else x - rest, factor)

    def _scaled(
        self, system: Any, x: npt.NDArray[Any], factor: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]
    ) -> npt.NDArray[Any]:
        modes = modes_of(system, self.label)
        selected, rates, changes = self._selected_modes(system, modes)
        state = np.asarray(system.from_vector(x))
        given = state if state.ndim == 3 else state[None]
        given = given if system.buoyancy is None else system.buoyancy.separated(given)
        change = np.zeros_like(given)
        for changed, read, weights in changes:
            coefficients = [
                factor(rate) * weight * modes.coefficients(given[read], d, numbers)
                for d, (numbers, rate, weight) in enumerate(zip(selected, rates, weights, strict=True))
            ]
            change[changed] += modes.matrix(coefficients, selected)
        change = change if system.buoyancy is None else system.buoyancy.joined(change)
        return np.asarray(system.to_vector(change.reshape(state.shape)))

    def field(self, system: Any, x: npt.NDArray[Any], t: Any) -> npt.NDArray[Any]:
        return self._scale_modes(system, x, lambda rate: -rate)

    def flow(self, system: Any, x: npt.NDArray[Any], t: Any, tau: Any) -> npt.NDArray[Any]:
        return np.asarray(x + self._scale_modes(system, x, lambda rate: np.expm1(-tau * rate)))

    def tangent(self, system: Any, x: npt.NDArray[Any], t: float, tau: float) -> npt.NDArray[np.float64]:
        """Return the matrix of the flow, which does not depend on the state; the last ones are cached."""
        return _matrix_of_flow(self, system, tau)

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        modes = modes_of(system, self.label)
        return reader.mode_rates(modes, *self._selected_modes(system, modes), rest_of(system), system.buoyancy)


@lru_cache(maxsize=4)
def _matrix_of_flow(force: ModeRates, system: Any, tau: float) -> npt.NDArray[np.float64]:
    rows = system.to_vector(units_of(system))  # projected: gradients then lie in the algebra
    for row in rows:
        row += force._scaled(system, row, lambda rate: np.expm1(-tau * rate))
    return np.ascontiguousarray(rows.T)
