"""Orders of schemes, measured: errors at a fixed time for several steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.order import OrderFit, fit_order
from coadjoint.methods.base import Method
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.systems.kinds import System

SLOPE_TOLERANCE = 0.2  # what the next term of the error adds to a slope at the steps taken here

# Numbers of steps for slopes. High orders soon meet round-off and take few, large steps. The slopes of low orders
# settle late and take small ones.
LOW_ORDER = (32, 64, 128, 256, 512)
HIGH_ORDER = (12, 16, 24, 32, 48, 64, 96)


class Trial(NamedTuple):
    """A system, its initial state, an end time, and the exact state there."""

    system: System
    x0: npt.NDArray[np.float64]
    end: float
    exact: npt.NDArray[np.float64]


def trial(system: System, x0: npt.ArrayLike, end: float) -> Trial:
    """Return a trial whose exact end comes from the closed form, or else from 8 Gauss stages.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    x0 : array_like, shape (n,)
        Initial state.
    end : float
        Time of comparison.

    Returns
    -------
    Trial
        With an exact state good to a few units of round-off: 8 stages have order 16, and the step is end / 64.
    """
    start = np.array(x0, dtype=np.float64)
    run = integrate(system, start, (0.0, end), end / 64, GaussLegendre(8), save_every=64, watch=False)
    return Trial(system, start, end, run.x[-1])


def roundoff(steps: float, size: float) -> float:
    """Return what round-off can add up to: 8 roundings of 2^-53 in each step, all of one sign.

    Examples
    --------
    >>> roundoff(1000, 1.0) < 1e-12
    True
    """
    return 8 * UNIT_ROUNDOFF * steps * size


def fitted_order(case: Trial, method: Method, counts: Sequence[int] | None = None) -> OrderFit:
    """Return the order of a scheme by the slope of its error at the end of a trial.

    Parameters
    ----------
    case : Trial
        The problem.
    method : Method
        The scheme.
    counts : sequence of int, optional
        Numbers of steps; None chooses them by the order that the scheme declares.

    Returns
    -------
    OrderFit
    """
    numbers = counts or (HIGH_ORDER if method.order > 3 else LOW_ORDER)
    errors = []
    for count in numbers:
        run = integrate(case.system, case.x0, (0.0, case.end), case.end / count, method, save_every=count, watch=False)
        errors.append(float(np.linalg.norm(run.x[-1] - case.exact)))
    floor = [roundoff(count, float(np.linalg.norm(case.x0))) for count in numbers]
    return fit_order([case.end / count for count in numbers], errors, floor)


def fitted_drift(case: Trial, method: Method, invariant: str, counts: Sequence[int] = HIGH_ORDER) -> OrderFit:
    """Return how the largest drift of an invariant on the way to the end depends on the step.

    Parameters
    ----------
    case : Trial
        The problem.
    method : Method
        The scheme.
    invariant : str
        ``"energy"`` or the name of a Casimir.
    counts : sequence of int
        Numbers of steps.

    Returns
    -------
    OrderFit
    """
    drifts, floor = [], []
    for count in counts:
        run = integrate(case.system, case.x0, (0.0, case.end), case.end / count, method, save_every=count)
        drift = run.drift()[invariant]
        drifts.append(float(drift))
        floor.append(roundoff(count, abs(float(drift.initial))))
    return fit_order([case.end / count for count in counts], drifts, floor)


def within(measured: float, expected: float) -> bool:
    """Return whether a slope is the expected order.

    Examples
    --------
    >>> within(1.93, 2), within(2.5, 2)
    (True, False)
    """
    return abs(measured - expected) <= SLOPE_TOLERANCE
