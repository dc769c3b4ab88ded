"""Base classes of forces on the modes of a matrix, each of which has its own rate or noise."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.memory import check_available_memory
from coadjoint.systems.forces.base import Force, ForceReader
from coadjoint.systems.matrices.mode_basis import LAYERS, ModeBasis, Numbers, layer_index, mode_basis_of
from coadjoint.validation import read_choice, read_number

PerMode = list[NDArray[Any]]


def modes_of(system: Any, what: str) -> ModeBasis:
    """Return the modes of a system; raise ValueError if it has none."""
    modes = mode_basis_of(system)
    if modes is None:
        raise ValueError(
            f"{what} acts on the modes of a fluid, such as sphere_euler or torus_euler, which {system.name} does not "
            "have; take LinearDamping"
        )
    return modes


def values_by_scale(
    argument: float | Callable[[Any], Any], scales: NDArray[np.float64], what: str
) -> NDArray[np.float64]:
    """Return a number for each mode: a constant, or a validated function of the degrees or wave numbers."""
    if not callable(argument):
        return np.full(scales.shape, argument)
    values = {scale: read_number(argument(scale), f"{what} at {scale:g}") for scale in np.unique(scales).tolist()}
    return np.array([values[scale] for scale in scales.tolist()])


def read_layer(value: Any, what: str) -> str:
    """Validate the name of a field."""
    return read_choice(value, what, LAYERS)


class OnLayer(Force):
    """A force on the modes of one field, by default the vorticity."""

    layer: str

    def layer_index(self, system: Any) -> int:
        """Return the index of the field in a state."""
        return layer_index(system, self.layer)

    def layer_matrix(self, system: Any, x: NDArray[Any]) -> NDArray[Any]:
        """Return the field of a state."""
        state = system.from_vector(x)
        return np.asarray(state if state.ndim == 2 else state[self.layer_index(system)])

    def layer_vector(self, system: Any, W: NDArray[Any]) -> NDArray[Any]:
        """Return the vector of a state with this field, and zero in the others."""
        state = np.zeros(system.matrix_shape, dtype=W.dtype)
        state[self.layer_index(system) if state.ndim == 3 else ...] = W
        return np.asarray(system.to_vector(state))


class ModeRates(OnLayer):
    """A force that acts on each mode separately, ``c' = -rate c``, solved exactly; a complex rate rotates its phase."""

    # On a rotating sphere, whose state is the absolute vorticity, c is the mode of the relative vorticity.

    @abstractmethod
    def rates(self, modes: ModeBasis, d: int, numbers: Numbers) -> NDArray[Any]:
        """Return the real or complex rates, (k,), of the modes `numbers`, (k,), of diagonal d."""

    def check(self, system: Any) -> None:
        self._selected_modes(modes_of(system, self.label))
        self.layer_index(system)

    def _selected_modes(self, modes: ModeBasis) -> tuple[list[Numbers], PerMode]:
        """Return the numbers of the modes with nonzero rates, and these rates, by diagonal."""
        numbers, rates = [], []
        for d in range(modes.diagonals):
            all_numbers = modes.numbers(d)
            all_rates = self.rates(modes, d, all_numbers)
            numbers.append(all_numbers[all_rates != 0.0])
            rates.append(all_rates[all_rates != 0.0])
        return numbers, rates

    def _scale_modes(
        self, system: Any, x: NDArray[Any], factor: Callable[[NDArray[Any]], NDArray[Any]]
    ) -> NDArray[Any]:
        W = self.layer_matrix(system, x)
        rest = self._rest_state(system)
        return self._scale_matrix(system, W if rest is None else W - rest, factor)

    def _scale_matrix(
        self, system: Any, W: NDArray[Any], factor: Callable[[NDArray[Any]], NDArray[Any]]
    ) -> NDArray[Any]:
        modes = modes_of(system, self.label)
        selected, rates = self._selected_modes(modes)
        coefficients = [
            factor(rate) * modes.coefficients(W, d, numbers)
            for d, (numbers, rate) in enumerate(zip(selected, rates, strict=True))
        ]
        return self.layer_vector(system, modes.matrix(coefficients, selected))

    def _rest_state(self, system: Any) -> NDArray[Any] | None:
        """Return the state at rest in the frame, or None if it is zero."""
        absolute = getattr(system, "absolute", None)
        if absolute is None or self.layer != "vorticity":
            return None
        rest = np.asarray(absolute(np.zeros(system.algebra.shape)))
        return rest if np.any(rest) else None

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        return self._scale_modes(system, x, lambda rate: -rate)

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        return np.asarray(x + self._scale_modes(system, x, lambda rate: np.expm1(-tau * rate)))

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> NDArray[np.float64]:
        """Return the matrix of the flow, which does not depend on the state; the last ones are cached."""
        return _matrix_of_flow(self, system, tau)

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        modes = modes_of(system, self.label)
        rest = self._rest_state(system)
        target = None if rest is None else np.ascontiguousarray(rest).view(np.float64).ravel()
        return reader.mode_rates(modes, *self._selected_modes(modes), target, self.layer_index(system))


@lru_cache(maxsize=4)
def _matrix_of_flow(force: ModeRates, system: Any, tau: float) -> NDArray[np.float64]:
    n = system.dim
    check_available_memory(8 * n**2, f"the derivative of the flow of {force.label}, of dimension {n},")
    # Units are projected: gradients then lie in the algebra.
    rows = system.to_vector(system.algebra.projected(system.from_vector(np.eye(n))))
    for row in rows:
        row += force._scale_matrix(system, force.layer_matrix(system, row), lambda rate: np.expm1(-tau * rate))
    return np.ascontiguousarray(rows.T)
