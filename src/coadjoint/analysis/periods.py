"""Periods of periodic motions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import record_repr, short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.validation import read_finite

Floats = NDArray[np.float64]

RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE = 2.5e-14, 1e-16  # tolerances of the integration; SciPy's smallest relative one
RETURN_TOLERANCE = 1e-8  # largest distance from the start at a return, relative to the size of the orbit
CROSSING_TOLERANCE = 1e-5  # the same for an interpolated crossing
EQUILIBRIUM_SPEED = 2.0**-40  # speed, relative to the size of the state times the rate of change of the field
MIN_PERIOD = 1e-6  # shortest period, times the rate
SEGMENT_DURATION = 20.0  # duration of one integration, times the rate
MAX_SEGMENTS = 400  # of the search for a return
MAX_CROSSINGS = 64  # of the plane through the start; an orbit that winds more often is not called periodic
MAX_EVALUATIONS = 2**18  # of the field; periods of bodies near a separatrix take up to 2^14


class Period(NamedTuple):
    """A periodic motion.

    Parameters
    ----------
    time : float
        The time of the first return.
    misfit : float
        Distance from the start at that time, relative to the size of the orbit.
    carried : ndarray, shape (c,)
        The additional variables after one period.
    """

    time: float
    misfit: float
    carried: Floats

    def __repr__(self) -> str:
        return record_repr(self)


@suggest_keywords
@ignore_overflow
def period(field: Callable[[Floats], Any], x0: ArrayLike, carried: ArrayLike = ()) -> Period:
    """Return the period of the motion x' = f(x) through a state, to about 13 digits.

    Choose it for motions on coadjoint orbits that are surfaces with closed energy curves: of the free rigid body, of
    modified fields of schemes on it, and of other systems of three coordinates with a Casimir.

    Parameters
    ----------
    field : callable
        The function f of the state followed by the additional variables, (n + c,); returns the derivatives of both.
    x0 : array_like, shape (n,)
        The initial state.
    carried : array_like, shape (c,), optional
        Initial values of additional variables that are integrated with the state and need not return.

    Returns
    -------
    Period

    Raises
    ------
    ValueError
        The state is an equilibrium, or does not return, or the field is not smooth.

    Notes
    -----
    The motion is integrated by the Dormand-Prince method of order 8 (SciPy), until it returns to x0 in the plane
    through x0 normal to the field.

    Examples
    --------
    >>> circle = period(lambda x: np.array([x[1], -4.0 * x[0]]), (1.0, 0.0))
    >>> round(circle.time / np.pi, 11)
    1.0
    """
    start, extra = read_finite(x0, "x0"), read_finite(carried, "carried")
    if start.ndim != 1 or not start.size or extra.ndim != 1:
        raise ValueError(f"x0 has the shape {start.shape}; it must be one state, (n,)")
    motion = _Motion(field, start, extra)
    y, time, reach, crossings = np.concatenate([start, extra]), 0.0, 0.0, 0
    for _ in range(MAX_SEGMENTS):
        segment = motion.run(y, SEGMENT_DURATION / motion.rate, crossings=True)
        reach = max(reach, motion.distance_from_start(segment.y))
        for t, state in zip(segment.t_events[0], segment.y_events[0], strict=True):
            if time + t <= MIN_PERIOD / motion.rate:
                continue  # the start itself
            crossings += 1
            if motion.distance_from_start(state[:, None]) <= CROSSING_TOLERANCE * reach:
                end, late = motion.at_plane(y, float(t))
                misfit = motion.distance_from_start(end[:, None]) / reach
                if misfit <= RETURN_TOLERANCE:
                    return Period(time + float(t) - late, misfit, end[motion.n :])
        y, time = segment.y[:, -1], time + float(segment.t[-1])
        if crossings > MAX_CROSSINGS:
            break
    raise ValueError(f"the motion from x0 = {short(start.tolist())} does not return until t = {time:g}: not periodic")


class _Motion:
    """The motion from an initial state, and the plane through that state normal to the field."""

    def __init__(self, field: Callable[[Floats], Any], start: Floats, extra: Floats) -> None:
        self.n, self.start, self.evaluations = len(start), start, 0
        self.field: Callable[[Floats], Floats] = lambda y: np.asarray(field(y), dtype=np.float64)
        y = np.concatenate([start, extra])
        first = self.field(y.copy())[: self.n]
        speed, size = float(np.linalg.norm(first)), float(np.linalg.norm(start)) or 1.0
        nudge = size * 2.0**-20
        moved = [self.field(y + nudge * row)[: self.n] - first for row in np.eye(len(y))[: self.n]]
        rate = float(np.linalg.norm(moved)) / nudge
        if not np.isfinite(speed + rate):
            raise ValueError(f"the field at x0 = {short(start.tolist())} is {short(first.tolist())}; it must be finite")
        if speed <= EQUILIBRIUM_SPEED * rate * size:
            raise ValueError(f"x0 = {short(start.tolist())} is at rest: the field there is {short(first.tolist())}")
        self.rate, self.normal = max(rate, speed / size), first / speed
        self.tolerance = ABSOLUTE_TOLERANCE * np.where(np.arange(len(y)) < self.n, size, 1.0)

    def distance_from_start(self, states: Floats) -> float:
        """Return the largest distance from the start."""
        return float(np.max(np.linalg.norm(states[: self.n] - self.start[:, None], axis=0)))

    def plane(self, _: float, y: Floats) -> float:
        """Return the signed distance from the plane."""
        return float(self.normal @ (y[: self.n] - self.start))

    def run(self, y: Floats, duration: float, crossings: bool = False) -> Any:
        """Integrate over a duration; with `crossings`, record the upward crossings of the plane."""
        from scipy.integrate import solve_ivp

        def upward(t: float, z: Floats) -> float:
            return self.plane(t, z)

        upward.direction = 1.0  # type: ignore[attr-defined]
        result = solve_ivp(
            self._counted,
            (0.0, duration),
            y,
            "DOP853",
            rtol=RELATIVE_TOLERANCE,
            atol=self.tolerance,
            events=upward if crossings else None,
        )
        if not result.success or not np.all(np.isfinite(result.y[:, -1])):
            raise ValueError(f"the motion from x0 = {short(self.start.tolist())} could not be followed: it diverges")
        return result

    def _counted(self, _: float, z: Floats) -> Floats:
        """Return the field, a bounded number of times; on rounding errors, steps become ever shorter."""
        self.evaluations += 1
        if self.evaluations > MAX_EVALUATIONS:
            raise ValueError(
                f"the motion from x0 = {short(self.start.tolist())} takes more than {MAX_EVALUATIONS} evaluations of "
                "the field: it does not return, or the field is rounding errors or not smooth"
            )
        return self.field(z)

    def at_plane(self, y: Floats, t: float) -> tuple[Floats, float]:
        """Return the state on the plane near a time, and the time since the crossing at the given time."""
        end = self.run(y, t).y[:, -1]
        slope = self.field(end.copy())
        late = self.plane(0.0, end) / float(self.normal @ slope[: self.n])
        return end - late * slope, late
