"""After which time does a motion return?"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.given import read_finite
from coadjoint.systems.points import QUIET
from coadjoint.wording import short

Floats = NDArray[np.float64]

RELATIVE, ABSOLUTE = 2.5e-14, 1e-16  # of the steps of the integration; scipy takes no smaller relative one
RETURNED = 1e-8  # of the size of the orbit
MOST_CROSSINGS = 64
MOST_STRETCHES = 400
STRETCH = 20.0  # times the size of the state over its speed


class Period(NamedTuple):
    """A periodic motion.

    Parameters
    ----------
    time : float
        After which it returns for the first time.
    misfit : float
        How far from the start it is then, relative to the size of its orbit.
    carried : ndarray, shape (c,)
        What was integrated beside it, after one period.
    """

    time: float
    misfit: float
    carried: Floats


@QUIET
def period(field: Callable[[Floats], Any], x0: ArrayLike, carried: ArrayLike = ()) -> Period:
    """Return the period of the motion x' = f(x) through a state, to about 13 digits.

    Choose it where all motions are periodic, as they are where the coadjoint orbits are surfaces and the energy curve
    is closed: the free rigid body, modified fields of schemes on it, every system of three coordinates with a Casimir.

    Parameters
    ----------
    field : callable
        f of (n + c,): the state and what is carried along; returns the derivative of both.
    x0 : array_like, shape (n,)
        Where it starts.
    carried : array_like, shape (c,), optional
        Further numbers that are integrated beside the state, and need not return.

    Returns
    -------
    Period

    Raises
    ------
    ValueError
        The state is at rest, or does not return.

    Notes
    -----
    Returns to the plane through x0 across the field, by Dormand and Prince's method of order 8 (SciPy).

    Examples
    --------
    >>> circle = period(lambda x: np.array([x[1], -4.0 * x[0]]), (1.0, 0.0))
    >>> round(circle.time / np.pi, 11)
    1.0
    """
    from scipy.integrate import solve_ivp

    start = read_finite(x0, "x0")
    y = np.concatenate([start, read_finite(carried, "carried")])
    if start.ndim != 1 or y.ndim != 1:
        raise ValueError(f"x0 has the shape {start.shape}; it must be one state, (n,)")
    n, size = len(start), float(np.linalg.norm(start))
    first = np.asarray(field(y.copy()), dtype=np.float64)[:n]
    speed = float(np.linalg.norm(first))
    if not np.isfinite(speed) or speed <= 2.0**-40 * float(np.linalg.norm(y)) * 2.0**-40:
        raise ValueError(f"x0 = {short(start.tolist())} is at rest: the field there is {short(first.tolist())}")
    across = first / speed
    scale = np.full(len(y), ABSOLUTE * size)
    scale[n:] = ABSOLUTE

    def plane(_: float, z: Floats) -> float:
        return float(across @ (z[:n] - start))

    plane.direction = 1.0  # type: ignore[attr-defined]

    def run(z: Floats, duration: float, events: Any = None) -> Any:
        found = solve_ivp(lambda _, w: field(w), (0.0, duration), z, "DOP853", rtol=RELATIVE, atol=scale, events=events)
        if not found.success or not np.all(np.isfinite(found.y[:, -1])):
            raise ValueError(f"the motion from x0 = {short(start.tolist())} could not be followed to t = {time + duration:g}")
        return found

    time, reach, nearest, crossings = 0.0, 0.0, np.inf, 0
    for _ in range(MOST_STRETCHES):
        stretch = run(y, STRETCH * size / speed, plane)
        reach = max(reach, float(np.max(np.linalg.norm(stretch.y[:n] - start[:, None], axis=0))))
        for when, there in zip(stretch.t_events[0], stretch.y_events[0], strict=True):
            away = float(np.linalg.norm(there[:n] - start))
            if time + when == 0.0 or reach == 0.0 or away > 1e3 * RETURNED * reach:
                nearest, crossings = min(nearest, away) if time + when > 0.0 else nearest, crossings + 1
                continue
            # The interpolated crossing has fewer digits than the steps; take steps to it, and a last one along the field.
            end = run(y, when).y[:, -1]
            late = float(plane(0.0, end)) / float(across @ np.asarray(field(end.copy()))[:n])
            end = end - late * np.asarray(field(end.copy()))
            misfit = float(np.linalg.norm(end[:n] - start)) / reach
            if misfit <= RETURNED:
                return Period(time + float(when) - late, misfit, end[n:])
        if crossings > MOST_CROSSINGS:
            break
        y, time = stretch.y[:, -1], time + float(stretch.t[-1])
    raise ValueError(
        f"the motion from x0 = {short(start.tolist())} does not return until t = {time:g}: it is not periodic "
        f"(it came back to {nearest:.1e})"
    )
