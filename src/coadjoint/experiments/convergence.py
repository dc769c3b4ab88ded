"""Measured orders of schemes: errors at a fixed time for several steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.powers import OrderFit, fit_order
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.protocol.method import Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.systems.system import System

SLOPE_TOLERANCE = 0.2  # contribution of the next error term to a slope at the steps used here

# Numbers of steps for slopes: few, large steps for high orders, which soon reach round-off; small ones for low orders,
# whose slopes converge late.
LOW_ORDER_COUNTS = (32, 64, 128, 256, 512)
HIGH_ORDER_COUNTS = (12, 16, 24, 32, 48, 64, 96)


class ReferenceProblem(NamedTuple):
    """A test problem: system, initial state, end time, and the exact state there."""

    system: System
    x0: npt.NDArray[np.float64]
    end: float
    exact: npt.NDArray[np.float64]


def reference_problem(system: System, x0: npt.ArrayLike, end: float) -> ReferenceProblem:
    """Return a test problem whose exact end state is that of 8 Gauss stages, accurate to a few units of round-off."""
    start = np.array(x0, dtype=np.float64)
    run = integrate(system, start, (0.0, end), end / 64, GaussLegendre(8), save_every=64, watch=False)
    return ReferenceProblem(system, start, end, run.x[-1])


def roundoff(steps: float, size: float) -> float:
    """Return an upper bound of accumulated round-off: 8 roundings of 2^-53 per step, all of one sign.

    Examples
    --------
    >>> roundoff(1000, 1.0) < 1e-12
    True
    """
    return 8 * UNIT_ROUNDOFF * steps * size


def fitted_order(case: ReferenceProblem, method: Method, counts: Sequence[int] | None = None) -> OrderFit:
    """Fit the order of a scheme from its error at the end of a trial; default `counts` follow the declared order."""
    numbers = counts or (HIGH_ORDER_COUNTS if method.order > 3 else LOW_ORDER_COUNTS)
    errors = []
    for count in numbers:
        run = integrate(case.system, case.x0, (0.0, case.end), case.end / count, method, save_every=count, watch=False)
        errors.append(float(np.linalg.norm(run.x[-1] - case.exact)))
    floor = [roundoff(count, float(np.linalg.norm(case.x0))) for count in numbers]
    return fit_order([case.end / count for count in numbers], errors, floor)


def fitted_drift(
    case: ReferenceProblem, method: Method, invariant: str, counts: Sequence[int] = HIGH_ORDER_COUNTS
) -> OrderFit:
    """Fit the order of the largest drift of an invariant ("energy" or a Casimir) along a trial."""
    drifts, floor = [], []
    for count in counts:
        run = integrate(case.system, case.x0, (0.0, case.end), case.end / count, method, save_every=count)
        drift = run.drift(relative=False)[invariant]
        drifts.append(float(drift))
        floor.append(roundoff(count, abs(float(drift.initial))))
    return fit_order([case.end / count for count in counts], drifts, floor)


def within(measured: float, expected: float) -> bool:
    """Return whether a slope agrees with the expected order.

    Examples
    --------
    >>> within(1.93, 2), within(2.5, 2)
    (True, False)
    """
    return abs(measured - expected) <= SLOPE_TOLERANCE
