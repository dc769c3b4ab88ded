"""Growth of the phase error along a run: slope, uncertainty, and classification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.analysis.fits import MIN_SAMPLES, straight_line
from coadjoint.analysis.phase import leads
from coadjoint.analysis.reference_motion import motion_of
from coadjoint.analysis.rotations import acts_by_rotations, twist
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.short_repr import short
from coadjoint.shortcuts import shortcut
from coadjoint.systems.protocol import member_of
from coadjoint.validation import read_choice, read_finite, read_numbers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

SIGNIFICANT_UNCERTAINTIES = 4.0  # of a slope that is significant
SLOW_FRACTION = 1.0 / 128.0  # slow deviations below this fraction of the growth of the line count as linear
WANDERING_EXPONENT = 1.0 / 3.0  # between 0 of bounded deviations and 1/2 of a random walk
ANGLES, TIMES = "radians", "time"


@dataclass(frozen=True)
class PhaseDrift:
    """A phase error along a run, and the straight line fitted to it.

    Attributes
    ----------
    t, lead : ndarray, shape (k,)
        Times, and the lead of the run.
    unit : str
        Unit of the lead: ``"time"`` or ``"radians"``.
    slope, uncertainty : float
        Lead per unit of time, and its standard error, which allows for correlated deviations.
    intercept : float
        The value of the line at time zero.
    deviation : float
        Root mean square of the deviations from the line.
    slow_deviation : float
        The same for means over 1/64 of the span, in which oscillations average out.
    exponent : float
        Power of time with which the slow deviations grow: 0 for oscillations, 1/2 for a random walk, 3/2 for a phase
        error from unbiased round-off, 2 for a drift of the energy.
    """

    t: Floats
    lead: Floats
    unit: str
    slope: float
    uncertainty: float
    intercept: float
    deviation: float
    slow_deviation: float
    exponent: float

    def __repr__(self) -> str:
        return f"<phase drift {self.slope:.3g} +- {self.uncertainty:.1g}: {self.growth}, {len(self.t)} points>"

    @property
    def growth(self) -> str:
        """``"faster"``, ``"linear"``, ``"wandering"`` or ``"bounded"``, by the criteria of `phase_drift`."""
        line = abs(self.slope) * abs(self.t[-1] - self.t[0])
        if self.exponent >= 1.0 and self.slow_deviation > SLOW_FRACTION * line:
            return "faster"
        if abs(self.slope) > SIGNIFICANT_UNCERTAINTIES * self.uncertainty:
            return "linear"
        return "wandering" if self.exponent > WANDERING_EXPONENT else "bounded"

    def plot(self) -> Figure:
        """Plot the lead with its fitted line, and the deviations from the line.

        Returns
        -------
        matplotlib.figure.Figure
            The figure, neither shown nor saved.
        """
        return shortcut("draw_phase_drift")(self)

    def __str__(self) -> str:
        """Format in one line."""
        per = "rad per unit of time" if self.unit == ANGLES else "per unit of time"
        return f"{self.growth}: {self.slope:.6g} +- {self.uncertainty:.1g} {per}, exponent {self.exponent:.2f}"


@suggest_keywords
def phase_drift(solution: Any, reference: Any = None, of: str = "momentum") -> Any:
    """Return the growth of the phase error of a run relative to the closed form or a reference.

    Choose it to decide whether a phase error is linear, and to extrapolate it to longer times.

    Parameters
    ----------
    solution : Solution
        A run of several periods, with at least 16 saved points.
    reference : callable or Solution, optional
        The reference motion, as for `phase_error`. None is the closed form of the system. For the attitude it must be
        the closed form, or a run from the same initial state with the same saved times.
    of : {"momentum", "attitude"}, optional
        The lead of the momentum on its orbit, in units of time; or the angle in radians by which the attitude of a body
        is ahead in its rotation about the constant momentum in space.

    Returns
    -------
    PhaseDrift or list of PhaseDrift
        A list for an ensemble, one for each member. Points without a lead, such as those beyond the end of the
        reference, are omitted.

    Raises
    ------
    ValueError
        Too few points have a lead, the reference has other saved times, or there is no attitude of a body.
    TypeError
        No closed form is known, and no reference is given.

    Notes
    -----
    A lead is asymptotically linear if its deviations from the line grow more slowly than time, that is, if the
    `exponent` H of the slow deviations is below 1. ``growth`` is the first of these that applies:

    - "faster": H >= 1, and the slow deviations are more than 1/128 of the growth of the line over the run (those of a
      parabola are 1/13 of its line). A scheme that loses energy has H = 2, unbiased round-off H = 3/2.
    - "linear": the slope is more than four uncertainties.
    - "wandering": the slope is not significant, and H > 1/3.
    - "bounded": the slope is not significant, and the lead does not grow.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> method = co.Splitting(order=2, parts="coordinates")
    >>> print(phase_drift(co.integrate(body, (1.0, 0.2, 0.5), (0, 500), 0.1, method, save_every=7)))
    linear: 2.987...e-05 +- 6e-09 per unit of time, exponent -0.09
    """
    check_solution(solution)
    of = read_choice(of, "of", ("momentum", "attitude"))
    several = solution.failed is not None
    members = range(solution.x.shape[1]) if several else [None]
    drifts = [_member_drift(solution, reference, of, member) for member in members]
    return drifts if several else drifts[0]


@suggest_keywords
def drift_of_series(t: ArrayLike, lead: ArrayLike, unit: str = TIMES) -> PhaseDrift:
    """Return the growth of a given phase error.

    Parameters
    ----------
    t : array_like, shape (k,)
        Times in order.
    lead : array_like, shape (k,)
        The lead of the motion; points with NaN are omitted.
    unit : {"time", "radians"}
        Unit of the lead.

    Returns
    -------
    PhaseDrift

    Examples
    --------
    >>> t = np.arange(400) * 0.5
    >>> print(drift_of_series(t, 0.01 * t**2).growth, drift_of_series(t, np.cos(t)).growth)
    faster bounded
    """
    times, series = read_finite(t, "t"), read_numbers(lead, "lead")
    if times.ndim != 1 or series.shape != times.shape:
        raise ValueError(f"t and lead have the shapes {times.shape} and {series.shape}; they must both be (k,)")
    finite = np.isfinite(series)
    times, series = times[finite], series[finite]
    if len(times) < MIN_SAMPLES:
        raise ValueError(f"{len(times)} points have a lead; a drift needs {MIN_SAMPLES}, so save more often")
    if not (np.all(np.diff(times) > 0.0) or np.all(np.diff(times) < 0.0)):
        raise ValueError(f"t is {short(t)}; give times in order")
    line = straight_line(times, series)
    return PhaseDrift(times, series, read_choice(unit, "unit", (TIMES, ANGLES)), **line._asdict())


def _member_drift(run: Solution, reference: Any, of: str, member: int | None) -> PhaseDrift:
    system = member_of(run.system, member or 0)
    # The closed form starts where the run does, also if `t_eval` does not save the start.
    x, x0 = (run.x, run.x0) if member is None else (run.x[:, member], run.x0[member])
    start = run.t_span[0]
    if of == "attitude":
        return drift_of_series(run.t, _precession(run, system, x0, reference, member), ANGLES)
    if reference is None and start != 0.0:
        exact = motion_of(system, None, x0)
        return drift_of_series(run.t, leads(system, lambda t: exact(t - start), run.t, x))
    return drift_of_series(run.t, leads(system, motion_of(system, reference, x0, member), run.t, x))


def _precession(run: Solution, system: Any, x0: Floats, reference: Any, member: int | None) -> Floats:
    attitude = _attitude(run, member, "the run")
    initial = np.asarray(run.attitude0)
    initial = initial if initial.ndim == 2 else initial[member or 0]
    if reference is None:
        exact = np.asarray(system.exact(x0, run.t - run.t_span[0], attitude=initial)[1])
    elif isinstance(reference, Solution):
        exact = _attitude(reference, member, "the reference")
        if not np.array_equal(reference.t, run.t):
            raise ValueError("the reference has other saved times than the run; save both at the same times")
    else:
        raise TypeError(
            f"reference is {short(reference)}; for the attitude give a Solution, or None for the closed form"
        )
    # Members that have ended or failed have no attitude at later times.
    held = np.isfinite(attitude).all(axis=(1, 2)) & np.isfinite(exact).all(axis=(1, 2))
    lead = np.full(len(held), np.nan)
    lead[held] = np.unwrap(twist(attitude[held], exact[held], initial @ x0))
    return lead


def _attitude(run: Solution, member: int | None, name: str) -> Floats:
    if run.attitude is None or not acts_by_rotations(member_of(run.system)):
        raise ValueError(f"{name} has no attitude of a body, 3 x 3; integrate with attitude=True")
    return run.attitude if member is None or run.attitude.ndim == 3 else run.attitude[:, member]
