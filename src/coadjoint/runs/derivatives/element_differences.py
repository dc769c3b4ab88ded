"""Group elements of single steps of any scheme, and their derivatives by differences of the compiled step."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.runs.loops.loops import loops_of_system
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.systems.parameter_differences import DISTANCE, NODES, WEIGHTS

Floats = NDArray[np.float64]


class ElementDifferences:
    """The element g of a step from the unit element, A -> A g, and its derivative by the state before the step.

    A step turns by an analytic function of the state, so that differences of order 8 have about thirteen digits. Steps
    have the sign of `h`.
    """

    def __init__(self, method: Method, h: float, representation: Representation) -> None:
        self._method, self._h, self._representation = method, h, representation
        self._steps: dict[int, tuple[Any, PartialSteps]] = {}

    def at(self, system: Any, x: Floats, t: float, h: float) -> Floats:
        """Return the elements (m, d, d) of a step of a system from states (m, n)."""
        if id(system) not in self._steps:
            loops = loops_of_system(system, self._method, self._h, self._representation)
            if any(loops.corrections):
                raise TypeError(f"attitudes by {self._method} have no derivatives; take Splitting or GaussLegendre")
            # The system is stored with its loops: its number is not used for another one.
            self._steps[id(system)] = system, PartialSteps(system, self._method, loops)
        d = system.dim if isinstance(self._representation, str) else self._representation.shape[1]  # type: ignore[union-attr]
        count, units = len(x), np.tile(np.eye(d).ravel(), (len(x), 1))
        owners = np.zeros(count, dtype=np.int64)
        _, groups = self._steps[id(system)][1].take(
            np.ascontiguousarray(x), units, np.full(count, t), np.full(count, h), owners
        )
        return np.swapaxes(groups.reshape(count, d, d), 1, 2)

    def with_derivative(self, system: Any, x: Floats, t: float, h: float) -> tuple[Floats, Floats]:
        """Return the element (d, d) of a step, and its derivative (n, d, d) by the state."""
        distance = DISTANCE * (float(np.max(np.abs(x))) or 1.0)
        moves = distance * np.concatenate([NODES, -NODES])[:, None, None] * np.eye(len(x))
        rows = np.concatenate([x[None], (x + moves).reshape(-1, len(x))])
        elements = self.at(system, rows, t, h)
        moved = elements[1:].reshape(len(moves), len(x), *elements.shape[1:])
        weights = np.concatenate([WEIGHTS, -WEIGHTS]) / distance
        return elements[0], np.tensordot(weights, moved, axes=1)
