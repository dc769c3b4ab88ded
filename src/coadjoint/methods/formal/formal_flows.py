"""Evaluation of a program in formal power series: each exact flow by its Lie series."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.actions import Action
from coadjoint.program.body_flow import FlowState
from coadjoint.program.interpreter import Interpreter, body_flow_parts
from coadjoint.program.table import Program


class FormalInterpreter(Interpreter):
    """Evaluation of a program with rational constants in formal numbers.

    Angles are constant along their flow, which is therefore exp(sum_a theta_a D_a) x. Angles have no term without h:
    the series ends at the truncation order of formal numbers.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        self._called = body_flow_parts(program)

    def pieces(self, reach: Callable[[], Any]) -> int:
        """Return 1: a power series in h needs no subdivision of the time of a free body."""
        return 1

    def negligible(self, terms: Sequence[FlowState]) -> bool:
        """Return whether the next term has a power of h beyond the truncation."""
        return len(terms) >= type(terms[0].x[0]).count

    def _numbers(self, values: NDArray[Any]) -> NDArray[Any]:
        return values.copy()

    def _rational_angles(self, part: int, theta: list[Any], turned: Any) -> tuple[list[Any], Any]:
        base = int(self.program.terms.row[self.program.share[part]])
        w = self.program.frequency[base : base + len(theta)]
        return [_arctangent(angle, f) if f else angle for angle, f in zip(theta, w, strict=True)], turned

    def act(self, action: Action, part: int, theta: list[Any], vectors: NDArray[Any]) -> None:
        power, k = vectors.copy(), 0
        while k < type(theta[0]).count:
            k += 1
            moved = [theta[a] * self._generator_on(part, a, power) for a in range(len(theta))]
            power = np.add.reduce(moved) / k
            vectors += power


def _arctangent(angle: Any, w: Any) -> Any:
    """Return 2/w atan(w angle/2), the angle of a rational rotation."""
    square = (w * w / 4) * angle * angle
    power, total = angle, angle
    for k in range(1, angle.count):
        power = power * square * -1
        total = total + power / (2 * k + 1)
    return total
