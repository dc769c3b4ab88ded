"""Times between the saved points at which states are needed so that straight chords look smooth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.evaluation import ignore_overflow

if TYPE_CHECKING:
    from coadjoint.pictures.plot_data import PlottedRun
    from coadjoint.runs.solution import Solution

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
COST_SECONDS = {"stretch": 4e-4, "point": 2e-5, "state": 4e-6}
"""Cost model of intermediate states (s), besides the steps: per saved interval, time, and state of a member."""
SAMPLED = 64
SUFFICIENT_POINTS = 16
"""Number of saved points that suffice to measure a motion."""
DIFFERENCE_STEP = 1e-5
"""Relative displacement along the path for the finite difference of the field."""


def times_between(drawn: PlottedRun, refined_run: PlottedRun) -> Floats | None:
    """Return the times, with the saved ones, at which a smooth curve needs states.

    The motion is measured on `refined_run`, the same run or a refinement of it. None if the saved points suffice, or if
    the states between them would be too many or too expensive.
    """
    run = drawn.solution
    length = min(_length_of_path(refined_run), REFINED_TURN / fastest_turn(refined_run))
    stretches = np.abs(np.diff(drawn.t))
    total = float(np.sum(np.maximum(1.0, stretches / length)))
    if total > MAX_REFINED_POINTS or total * run.x[0].size > MAX_NUMBERS:
        return None
    parts = np.maximum(1, np.ceil(stretches / length)).astype(np.int64)
    points = int(parts.sum())
    if points == len(stretches) or _seconds(run, int(np.count_nonzero(parts > 1)), points) > MAX_SECONDS:
        return None
    return _divided(drawn.t, parts)


def coarse_times(drawn: PlottedRun) -> Floats | None:
    """Return a coarse set of times between the saved points, enough to resolve a motion of a few periods.

    None if the saved points suffice to measure the motion, or if the times are too expensive.
    """
    stretches = len(drawn.t) - 1
    if stretches >= SUFFICIENT_POINTS or _seconds(drawn.solution, stretches, SAMPLED) > MAX_SECONDS:
        return None
    return _divided(drawn.t, np.full(stretches, -(-SAMPLED // stretches)))


def _divided(t: Floats, parts: npt.NDArray[np.int64]) -> Floats:
    """Divide each interval into the given number of parts; the given times are unchanged bitwise."""
    inside = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(np.repeat(t[:-1], parts) + np.repeat(np.diff(t) / parts, parts) * inside, t[-1])


def _seconds(run: Solution, stretches: int, points: int) -> float:
    members = 1 if run.failed is None else len(run.failed)
    work = run.stats
    # The steps are repeated, with a partial step for each state.
    again = work.seconds * (1.0 + points / max(1, work.steps))
    return (
        again + COST_SECONDS["stretch"] * stretches + (COST_SECONDS["point"] + COST_SECONDS["state"] * members) * points
    )


def _length_of_path(drawn: PlottedRun) -> float:
    """Return the longest time interval whose chord is close to the motion: the distance is about a dt^2 / 8."""
    shortest = np.inf
    sizes = [float(np.linalg.norm(np.ptp(path, axis=0))) for path in drawn.x]
    each = max(2, SAMPLED // len(sizes))
    for m, (path, size) in enumerate(zip(drawn.x, sizes, strict=True)):
        if not size > 0.0:
            continue
        for k in np.linspace(0, len(drawn.t) - 1, min(each, len(drawn.t))).astype(np.int64).tolist():
            turning = _curvature(drawn, m, path[k], float(drawn.t[k]), size)
            if turning > 0.0 and np.isfinite(turning):
                shortest = min(shortest, (8.0 * REFINED_TOLERANCE * size / turning) ** 0.5)
    return shortest


def _curvature(drawn: PlottedRun, m: int, x: Floats, t: float, size: float) -> float:
    """Return the size of the second derivative of the motion, by a finite difference of the field."""
    field = drawn.slope(x, t, m)
    speed = float(np.linalg.norm(field))
    if not speed > 0.0:
        return 0.0
    dt = DIFFERENCE_STEP * size / speed
    return float(np.linalg.norm(drawn.slope(x + dt * field, t + dt, m) - field)) / dt


@ignore_overflow
def fastest_turn(drawn: PlottedRun) -> float:
    """Return the largest angular speed of the attitude (radians per unit of time); positive also without attitude."""
    rho: Any = getattr(drawn.family, "representation", None)
    fastest = float(np.finfo(np.float64).tiny)
    if drawn.solution.carried != "representation" or rho is None:
        return fastest
    each = max(2, SAMPLED // len(drawn.x))
    for m, path in enumerate(drawn.x):
        hamiltonian = drawn.system_of(m).hamiltonian
        for k in np.linspace(0, len(drawn.t) - 1, min(each, len(drawn.t))).astype(np.int64).tolist():
            rate = np.tensordot(hamiltonian.gradient(path[k], float(drawn.t[k])), rho, axes=1)
            # The rate of a rotation about one axis has two entries of equal size.
            fastest = max(fastest, float(np.linalg.norm(rate[:3, :3] if rate.shape[-1] == 4 else rate)) / 2.0**0.5)
    return fastest
