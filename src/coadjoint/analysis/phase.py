"""Phase errors: leads of computed states along the exact motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.reference_motion import Motion, field_along, motion_of
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states
from coadjoint.validation import read_finite

MAX_ITERATIONS = 30  # of Newton's method, which needs some five
FIRST_POINTS = 4  # points with initial guess zero; then the number of points is doubled, by extrapolation


@suggest_keywords
def phase_error(
    system: System, x0: npt.ArrayLike, t: npt.ArrayLike, x: npt.ArrayLike, reference: Any = None
) -> npt.NDArray[np.float64]:
    """Return the signed phase error of computed states: the time by which they are ahead of the exact motion.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system; without a reference it needs a closed form.
    x0 : array_like, shape (n,)
        The state of the closed form at time zero.
    t : array_like, shape (k,)
        Times.
    x : array_like, shape (k, n)
        Computed states.
    reference : callable or Solution, optional
        The reference motion: a function of times (k,) that returns states (k, n), or a run by a more accurate scheme or
        with a smaller step, with saved points dense enough for interpolation. None is the closed form.

    Returns
    -------
    ndarray, shape (k,)
        The lead d for which right(t + d) is the point nearest to x, in units of time; positive is early, negative late.
        NaN if no nearest point is found, or the reference ends too early. For ordered times leads are continued from
        the first one and may exceed a period; otherwise they are less than half a period.

    Raises
    ------
    ValueError
        The states do not match the times, or the saved points of the reference are too far apart.
    TypeError
        No closed form is known.

    Notes
    -----
    Gauss-Newton on ``|x - right(t + d)|^2``: d changes by ``f . (x - y) / |f|^2`` at y = right(t + d), with f the
    vector field there. A motion of several angles has a phase error in each of them, and the lead is an average; see
    `line_drift`.

    Examples
    --------
    >>> import coadjoint as co
    >>> body, t = co.systems.rigid_body(inertia=(1, 2, 3)), np.array([1.0, 2.0])
    >>> early = body.exact((1.0, 2.0, 0.5), t + 0.01)
    >>> phase_error(body, (1.0, 2.0, 0.5), t, early).round(12)
    array([0.01, 0.01])
    """
    check_vector_states(system, "phase errors are available for states that are vectors")
    times, states = read_finite(t, "t"), read_finite(x, "x")
    if times.ndim != 1 or states.shape != (len(times), system.dim):
        raise ValueError(
            f"x has the shape {states.shape}; it must be ({times.size}, {system.dim}), a state for each time"
        )
    return leads(system, motion_of(system, reference, x0), times, states)


@ignore_overflow
def leads(
    system: System, motion_at: Motion, times: npt.NDArray[np.float64], states: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the leads of states relative to a motion, continued if the times are in order; see `phase_error`."""
    ordered = len(times) > FIRST_POINTS and (np.all(np.diff(times) > 0.0) or np.all(np.diff(times) < 0.0))
    if not ordered:
        return _solve_leads(system, motion_at, times, states, np.zeros(len(times)))
    lead = np.full(len(times), np.nan)
    first, last = 0, FIRST_POINTS
    while first < len(times):
        lead[first:last] = _solve_leads(
            system, motion_at, times[first:last], states[first:last], _extrapolated(times, lead, first, last)
        )
        first, last = last, min(2 * last, len(times))
    return lead


def _extrapolated(
    times: npt.NDArray[np.float64], lead: npt.NDArray[np.float64], first: int, last: int
) -> npt.NDArray[np.float64]:
    """Extrapolate the later half of the known leads to the next times, by a least-squares line."""
    known = np.flatnonzero(np.isfinite(lead[:first]))
    known = known[len(known) // 2 :]
    if len(known) < 2:
        return np.zeros(last - first)
    slope, at_zero = np.polyfit(times[known], lead[known], 1)
    return np.asarray(slope * times[first:last] + at_zero)


def _solve_leads(
    system: System,
    motion_at: Motion,
    times: npt.NDArray[np.float64],
    states: npt.NDArray[np.float64],
    lead: npt.NDArray[np.float64],
) -> npt.NDArray[np.float64]:
    change = np.full(len(times), np.inf)
    for _ in range(MAX_ITERATIONS):
        # Points without a state or a lead are evaluated somewhere, and stay without one.
        moments = times + np.where(np.isfinite(lead), lead, 0.0)
        y = motion_at(moments)
        f = field_along(system, y, moments)
        # Off the orbit Gauss-Newton converges linearly, down to the round-off of the exact motion.
        change = np.einsum("ki,ki->k", f, states - y) / np.einsum("ki,ki->k", f, f)
        lead = lead + change
        if np.all(np.isnan(change)) or np.nanmax(np.abs(change)) <= 2.0**-40 * max(1.0, float(np.max(np.abs(times)))):
            break
    settled = np.isfinite(lead) & (np.abs(change) <= 2.0**-20 * np.maximum(1.0, np.abs(times)))
    return np.where(settled, lead, np.nan)
