"""Which times between the saved points does a smooth curve need? Those at which no chord leaves the motion by much."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from coadjoint.pictures.drawn import Drawn
    from coadjoint.runs.solution import Solution

Floats = npt.NDArray[np.float64]

SMOOTH = 1e-3
"""How far the motion may leave a chord, as a part of its range: half a pixel of a picture of 500."""
TURN = 0.14
"""Radians that an attitude may turn from one point to the next: 45 points a turn."""
MOST_BETWEEN = 10_000
"""Points of a curve that is filled: 16 for each column of pixels."""
MOST_NUMBERS = 2**22
"""Numbers of the states that are looked at, 32 MB."""
MOST_SECONDS = 1.5
"""What the states between may take, by this estimate."""
SECONDS = {"stretch": 4e-4, "point": 2e-5, "state": 4e-6}
"""Of looking back, beside the steps: for each saved point, each time, each state of a member."""
SAMPLED = 64
ENOUGH = 16
"""Saved points by which a motion is measured."""
NUDGE = 1e-5
"""How far along its path, as a part of its range, a state is moved to see how the field turns."""


def times_between(drawn: Drawn, looked: Drawn) -> Floats | None:
    """Return the times at which the motion has to be known for a smooth curve, with the saved ones among them.

    Parameters
    ----------
    drawn : Drawn
        The run.
    looked : Drawn
        The same run, or with states between its saved points that are known already: what its motion is measured by.

    Returns
    -------
    ndarray or None
        None where the saved points are enough, or where states between them would be too many or take too long.
    """
    run = drawn.solution
    length = min(_length_of_path(looked), TURN / fastest_turn(looked))
    stretches = np.abs(np.diff(drawn.t))
    total = float(np.sum(np.maximum(1.0, stretches / length)))
    if total > MOST_BETWEEN or total * run.x[0].size > MOST_NUMBERS:
        return None
    parts = np.maximum(1, np.ceil(stretches / length)).astype(np.int64)
    points = int(parts.sum())
    if points == len(stretches) or _seconds(run, int(np.count_nonzero(parts > 1)), points) > MOST_SECONDS:
        return None
    return _divided(drawn.t, parts)


def few_times(drawn: Drawn) -> Floats | None:
    """Return times between saved points that are too few to measure a motion by; None where they are enough.

    They are so many that a motion of a few periods is seen.
    """
    stretches = len(drawn.t) - 1
    if stretches >= ENOUGH or _seconds(drawn.solution, stretches, SAMPLED) > MOST_SECONDS:
        return None
    return _divided(drawn.t, np.full(stretches, -(-SAMPLED // stretches)))


def _divided(t: Floats, parts: npt.NDArray[np.int64]) -> Floats:
    """Return times with each stretch divided into so many parts; the given ones stay as they are to the bit."""
    inside = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(np.repeat(t[:-1], parts) + np.repeat(np.diff(t) / parts, parts) * inside, t[-1])


def _seconds(run: Solution, stretches: int, points: int) -> float:
    members = 1 if run.failed is None else len(run.failed)
    work = run.stats
    # Steps are taken again, and a part of one for each state.
    again = work.seconds * (1.0 + points / max(1, work.steps))
    return again + SECONDS["stretch"] * stretches + (SECONDS["point"] + SECONDS["state"] * members) * points


def _length_of_path(drawn: Drawn) -> float:
    """Return how long a stretch of time may be so that its chord shows the motion: it leaves it by a dt^2 / 8."""
    shortest = np.inf
    sizes = [float(np.linalg.norm(np.ptp(path, axis=0))) for path in drawn.x]
    each = max(2, SAMPLED // len(sizes))
    for m, (path, size) in enumerate(zip(drawn.x, sizes, strict=True)):
        if not size > 0.0:
            continue
        for k in np.linspace(0, len(drawn.t) - 1, min(each, len(drawn.t))).astype(np.int64).tolist():
            turning = _turning(drawn, m, path[k], float(drawn.t[k]), size)
            if turning > 0.0 and np.isfinite(turning):
                shortest = min(shortest, (8.0 * SMOOTH * size / turning) ** 0.5)
    return shortest


def _turning(drawn: Drawn, m: int, x: Floats, t: float, size: float) -> float:
    """Return the second derivative of the motion, from its field a little further on."""
    field = drawn.slope(x, t, m)
    speed = float(np.linalg.norm(field))
    if not speed > 0.0:
        return 0.0
    dt = NUDGE * size / speed
    return float(np.linalg.norm(drawn.slope(x + dt * field, t + dt, m) - field)) / dt


def fastest_turn(drawn: Drawn) -> float:
    """Return how fast the attitude turns, in radians for each unit of time, at its fastest; above zero.

    Parameters
    ----------
    drawn : Drawn
        A run. Without an attitude nothing turns.

    Returns
    -------
    float
    """
    rho: Any = getattr(drawn.family, "representation", None)
    fastest = float(np.finfo(np.float64).tiny)
    if drawn.solution.carried != "representation" or rho is None:
        return fastest
    each = max(2, SAMPLED // len(drawn.x))
    for m, path in enumerate(drawn.x):
        hamiltonian = drawn.system_of(m).hamiltonian
        for k in np.linspace(0, len(drawn.t) - 1, min(each, len(drawn.t))).astype(np.int64).tolist():
            rate = np.tensordot(hamiltonian.gradient(path[k], float(drawn.t[k])), rho, axes=1)
            # A rotation about one axis has two entries of its rate.
            fastest = max(fastest, float(np.linalg.norm(rate[:3, :3] if rate.shape[-1] == 4 else rate)) / 2.0**0.5)
    return fastest
