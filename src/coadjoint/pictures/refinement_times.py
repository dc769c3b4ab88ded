"""Times between the saved points at which smooth curves need states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coadjoint.runs.results.solution_attributes import member_count
from coadjoint.systems.evaluation import ignore_overflow

if TYPE_CHECKING:
    from coadjoint.pictures.plot_data import PlottedRun
    from coadjoint.runs.results.solution import Solution

Floats = npt.NDArray[np.float64]

REFINED_TOLERANCE = 1e-3
"""Largest distance of the motion from a chord, relative to its range: half a pixel of 500."""
REFINED_TURN = 0.14
"""Largest rotation of an attitude between points (radians): 45 points per turn."""
MAX_REFINED_POINTS = 10_000
"""Largest number of points of a refined curve: 16 per column of pixels."""
MAX_NUMBERS = 2**22
"""Largest number of state entries examined: 32 MB."""
MAX_SECONDS = 1.5
"""Largest estimated time (s) for computing states between the saved ones."""
COST_SECONDS = {"interval": 4e-4, "point": 2e-5, "state": 4e-6}
"""Cost model of intermediate states (s), besides the steps: per saved interval, time, and state of a member."""
SAMPLED = 64  # intervals in which the turning of the path is examined
SUFFICIENT_POINTS = 16
"""Number of saved points that suffice to measure a motion."""
DIFFERENCE_STEP = 1e-5
"""Relative displacement along the path for the finite difference of the field."""


def times_between(drawn: PlottedRun, refined_run: PlottedRun) -> Floats | None:
    """Return the times at which a smooth curve needs states, including the saved ones.

    The motion is measured on `refined_run`, the same run or a refinement of it. None if the saved points suffice, or if
    the states would be too many or too expensive.
    """
    run = drawn.solution
    length = min(_chord_duration(refined_run), REFINED_TURN / fastest_turn(refined_run))
    intervals = np.abs(np.diff(drawn.t))
    total = float(np.sum(np.maximum(1.0, intervals / length)))
    if total > MAX_REFINED_POINTS or total * run.x[0].size > MAX_NUMBERS:
        return None
    parts = np.maximum(1, np.ceil(intervals / length)).astype(np.int64)
    points = int(parts.sum())
    if points == len(intervals) or _seconds(run, int(np.count_nonzero(parts > 1)), points) > MAX_SECONDS:
        return None
    return _divided(drawn.t, parts)


def coarse_times(drawn: PlottedRun) -> Floats | None:
    """Return about 64 times that resolve a motion of a few periods.

    None if the saved points suffice to measure the motion, or if the states are too expensive.
    """
    intervals = len(drawn.t) - 1
    if intervals >= SUFFICIENT_POINTS or _seconds(drawn.solution, intervals, SAMPLED) > MAX_SECONDS:
        return None
    return _divided(drawn.t, np.full(intervals, -(-SAMPLED // intervals)))


def _divided(t: Floats, parts: npt.NDArray[np.int64]) -> Floats:
    """Divide each interval into a number of parts; the times t have the same bits in the result."""
    inside = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(np.repeat(t[:-1], parts) + np.repeat(np.diff(t) / parts, parts) * inside, t[-1])


def _seconds(run: Solution, intervals: int, points: int) -> float:
    """Estimate the time for computing states at `points` times within `intervals` saved intervals."""
    members = member_count(run)
    # The steps are repeated, with a partial step for each state.
    steps = run.stats.seconds * (1.0 + points / max(1, run.stats.steps))
    point = COST_SECONDS["point"] + COST_SECONDS["state"] * members
    return steps + COST_SECONDS["interval"] * intervals + point * points


def _chord_duration(drawn: PlottedRun) -> float:
    """Return the longest time interval with a chord close to the motion: the distance is about |x''| dt^2 / 8."""
    shortest = np.inf
    sizes = [float(np.linalg.norm(np.ptp(path, axis=0))) for path in drawn.x]
    count = max(2, SAMPLED // len(sizes))
    for m, (path, size) in enumerate(zip(drawn.x, sizes, strict=True)):
        if not size > 0.0:
            continue
        for k in np.linspace(0, len(drawn.t) - 1, min(count, len(drawn.t))).astype(np.int64).tolist():
            acceleration = _acceleration(drawn, m, path[k], float(drawn.t[k]), size)
            if acceleration > 0.0 and np.isfinite(acceleration):
                shortest = min(shortest, (8.0 * REFINED_TOLERANCE * size / acceleration) ** 0.5)
    return shortest


def _acceleration(drawn: PlottedRun, m: int, x: Floats, t: float, size: float) -> float:
    """Return the size of the second derivative of the motion, by a finite difference of the field."""
    field = drawn.slope(x, t, m)
    speed = float(np.linalg.norm(field))
    if not speed > 0.0:
        return 0.0
    dt = DIFFERENCE_STEP * size / speed
    return float(np.linalg.norm(drawn.slope(x + dt * field, t + dt, m) - field)) / dt


@ignore_overflow
def fastest_turn(drawn: PlottedRun) -> float:
    """Return the largest angular speed of the attitude, in radians per unit of time; tiny without an attitude."""
    rho: Any = drawn.unforced.representation
    fastest = float(np.finfo(np.float64).tiny)
    if drawn.solution.carried != "representation" or rho is None:
        return fastest
    count = max(2, SAMPLED // len(drawn.x))
    for m, path in enumerate(drawn.x):
        hamiltonian = drawn.system_of(m).hamiltonian
        for k in np.linspace(0, len(drawn.t) - 1, min(count, len(drawn.t))).astype(np.int64).tolist():
            rate = np.tensordot(hamiltonian.gradient(path[k], float(drawn.t[k])), rho, axes=1)
            # The matrix of an angular velocity has each component twice.
            fastest = max(fastest, float(np.linalg.norm(rate[:3, :3] if rate.shape[-1] == 4 else rate)) / 2.0**0.5)
    return fastest
