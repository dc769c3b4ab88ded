"""Derivative of a step in the most accurate way available: formula, complex step, multiprecision, or differences."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.checks.subject import Subject
from coadjoint.errors import IntegrationError
from coadjoint.methods.protocol.step_derivatives import AGREEMENT, derivative_of

Floats = NDArray[np.float64]

DIFFERENCE_FLOOR = 1e-9
DIGITS = 40


class Tangent(NamedTuple):
    """The derivative P (n, n) of a step at a state, d step_i / d x_j, and the way it was computed.

    `by` is "formula", "complex step", "multiprecision" or "differences".
    """

    P: Floats
    by: str

    @property
    def exact(self) -> bool:
        """Whether the derivative is accurate to round-off."""
        return self.by != "differences"


def tangent(subject: Subject, x: Floats, h: float) -> Tangent:
    """Return the derivative of a step of length h at x, from time 0."""
    method, system = subject.method, subject.system
    try:
        by = method.tangent_by(system, x, 0.0, h)
        P = np.asarray(method.tangent(system, x, 0.0, h)[1], dtype=np.float64)
    except TypeError:
        # The system lacks a derivative; differentiate the step itself.
        by, P = _differences(subject, x, h)
    if by == "differences":
        # A step that rounds to float64 internally is detected by the disagreement of both derivatives.
        precise = _multiprecision_differences(subject, x, h)
        size = 1.0 + float(np.linalg.norm(P))
        if precise is not None and np.max(np.abs(precise - P)) <= AGREEMENT * size:
            return Tangent(precise, "multiprecision")
    return Tangent(P, by)


def _differences(subject: Subject, x: Floats, h: float) -> tuple[str, Floats]:
    def step(y: Any) -> Any:
        if np.iscomplexobj(y):
            return subject.method.step(subject.system, y, 0.0, h)
        return subject.run(np.asarray(y, dtype=np.float64), h, 1).x[-1]

    found = derivative_of(step, x)
    return found.by, found.derivative


def _multiprecision_differences(subject: Subject, x: Floats, h: float) -> Floats | None:
    """Return central differences in 40 digits, or None if the step does not accept mpmath numbers."""
    try:
        import mpmath
    except ImportError:
        return None
    with mpmath.workdps(DIGITS):
        point = np.array([mpmath.mpf(float(v)) for v in x])
        length, size = mpmath.mpf(h), float(np.max(np.abs(x))) or 1.0
        # The truncation error is 1e-26, the cancellation error 1e-27.
        small = mpmath.mpf(10) ** -13 * size
        columns = []
        try:
            for j in range(len(x)):
                sides = []
                for side in (1, -1):
                    moved = point.copy()
                    moved[j] += side * small
                    after = np.asarray(subject.method.step(subject.system, moved, mpmath.mpf(0), length))
                    if not all(isinstance(value, mpmath.mpf) for value in after.ravel()):
                        return None
                    sides.append(after)
                columns.append([float(value) for value in (sides[0] - sides[1]) / (2 * small)])
        except (TypeError, ValueError, AttributeError, ArithmeticError, IntegrationError):
            return None
        return np.array(columns).T
