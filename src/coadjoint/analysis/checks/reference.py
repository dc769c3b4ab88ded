"""Reference motions for certificates, by a closed form or an independent integration (DOP853) of the vector field."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.checks.norm import Norm
from coadjoint.long_operations import note_progress
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

# The smallest tolerance that DOP853 accepts, and a larger one; the difference of the two runs estimates the error.
FINE_TOLERANCE, COARSE_TOLERANCE = 2.3e-14, 1e-12
# The error of DOP853 per unit of time is proportional to the tolerance, so that of the finer run is 1/43 of the
# difference; 1/8 is assumed.
ERROR_SHARE = 0.125
MAX_STEPS = 1500  # of each of the two runs; some seconds in Python
# Largest relative difference of a closed form from the integrated field; beyond it, one of them is wrong.
CLOSED_FORM_TOLERANCE = 1e-8


class Motion(NamedTuple):
    """States (k, n) after a time, with their relative error; `contradiction` if a closed form contradicts the field."""

    states: Floats
    error: float
    by: str
    contradiction: str = ""


def motion(system: System, x: Floats, t: float, norm: Norm | None = None) -> Motion | None:
    """Return the states after time t from states x (k, n) at time 0; t is negative for backward.

    The error is in `norm`; None is that of the states. The result is None if the motion leaves the range of float64 or
    takes more than `MAX_STEPS` steps. It is cached.
    """
    return _motion(system, x.tobytes(), x.shape, t, Norm.of(system, x) if norm is None else norm)


@lru_cache(maxsize=64)
def _motion(system: System, start: bytes, shape: tuple[int, int], t: float, norm: Norm) -> Motion | None:
    x = np.frombuffer(start).reshape(shape)
    pairs = [
        (_integrated(system, y, t, norm, FINE_TOLERANCE), _integrated(system, y, t, norm, COARSE_TOLERANCE)) for y in x
    ]
    if any(fine is None or coarse is None for fine, coarse in pairs):
        return None
    fine, coarse = (np.array([pair[k] for pair in pairs]) for k in (0, 1))
    size = float(norm(fine)) or 1.0
    error = ERROR_SHARE * float(norm(fine - coarse)) / size + 16 * UNIT_ROUNDOFF
    integrated = Motion(fine, error, "DOP853 on the vector field")
    closed, half = _closed_form(system, x, t), _closed_form(system, x, t / 2)
    two_halves = None if half is None else _closed_form(system, half, t / 2)
    if closed is None or two_halves is None:
        return integrated
    # Two half steps estimate the rounding of the closed form.
    rounding = 2 * float(norm(two_halves - closed)) / size + 16 * UNIT_ROUNDOFF
    difference = float(norm(closed - fine)) / size
    if difference > CLOSED_FORM_TOLERANCE:
        return integrated._replace(
            contradiction=f"the closed form of {system.name} is off the vector field by {difference:.1g}"
        )
    return Motion(closed, rounding, "the closed form")


def _closed_form(system: System, x: Floats, t: float) -> Floats | None:
    if system.closed_form is None:
        return None
    try:
        return np.array([system.exact(y, t) for y in x], dtype=np.float64)
    except (ValueError, ArithmeticError):
        return None  # outside the domain of the closed form


def _integrated(system: System, x: Floats, t: float, norm: Norm, tolerance: float) -> Floats | None:
    from scipy.integrate import DOP853

    if t == 0.0:
        return x
    shape = x.shape

    def field(time: float, y: Floats) -> Floats:
        return np.asarray(system.vector_field(y.reshape(shape), time), dtype=np.float64).ravel()

    size = float(np.max(np.abs(norm.scaled(x)))) or 1.0
    atol: Any = norm.unscaled(np.full(x.shape, 0.1 * tolerance * size)).ravel()
    try:
        solver = DOP853(field, 0.0, x.ravel(), t, rtol=tolerance, atol=atol)
        for _ in range(MAX_STEPS):
            note_progress("the motion by an independent code")
            solver.step()
            if solver.status != "running":
                break
    except (ValueError, ArithmeticError):
        return None
    if solver.status != "finished" or not np.isfinite(solver.y).all():
        return None
    return np.asarray(solver.y.reshape(shape))


def natural_time(system: System, x: Floats) -> float:
    """Return the time in which the state, a group, or its velocity changes by its own size; 0 at an equilibrium."""
    velocity = np.asarray(system.vector_field(x, 0.0), dtype=np.float64)
    norm = Norm.of(system, x[None])
    speed, size = float(norm(velocity)), float(norm(x))
    groups = CoordinateGroups(system)
    pairs = zip([speed, *groups.norms(velocity).tolist()], [size, *groups.norms(x).tolist()], strict=True)
    rates = [fast / extent for fast, extent in pairs if extent > 0.0 and fast > 64 * UNIT_ROUNDOFF * extent]
    if not rates:
        return 0.0
    dt = 2.0**-20 * size / speed
    change = np.asarray(system.vector_field(x + dt * velocity, 0.0), dtype=np.float64) - velocity
    rates.append(float(norm(change)) / (dt * speed))
    fastest = max((rate for rate in rates if np.isfinite(rate)), default=0.0)
    return 1.0 / fastest if fastest else 0.0
