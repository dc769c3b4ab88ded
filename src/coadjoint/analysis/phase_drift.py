"""Growth of the phase error along a run: slope, uncertainty, and classification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.analysis.phase_error import acts_by_rotations, check_same_times, leads, motion_of, twist
from coadjoint.analysis.powers import fit_power
from coadjoint.analysis.standard_errors import covariances, low_power, student_factor
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.short_repr import short
from coadjoint.shortcuts import shortcut
from coadjoint.validation import read_choice, read_finite, read_numbers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

SIGNIFICANT_UNCERTAINTIES = 4.0  # of a slope that is significant
SLOW_FRACTION = 1.0 / 128.0  # slow deviations below this fraction of the growth of the line count as linear
WANDERING_EXPONENT = 1.0 / 3.0  # between 0 of bounded deviations and 1/2 of a random walk
ANGLES, TIMES = "radians", "time"

MIN_MEMORY_EXPONENT = 0.2  # noise without correlation over the span, and oscillations, have smaller exponents
SLOPE_PIECES = 8  # of the slow part, whose slopes tell a line from a curve
SCALES = 64  # blocks, from whose means the growth is computed
MIN_SAMPLES = 16  # of a line with an uncertainty
MIN_PIECE_SAMPLES = 4  # of a block; fewer have no scatter of their own


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
        return shortcut("draw_result")("phase drift", self)

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
    linear: 2.987...e-05 +- 2e-09 per unit of time, exponent -0.09
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
    return _with_line(times, series, read_choice(unit, "unit", (TIMES, ANGLES)))


def _member_drift(run: Solution, reference: Any, of: str, member: int | None) -> PhaseDrift:
    system = run.system.of_member(member or 0)
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
        check_same_times(reference.t, run.t)
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
    if run.attitude is None or not acts_by_rotations(run.system.of_member(0)):
        raise ValueError(f"{name} has no attitude of a body, 3 x 3; integrate with attitude=True")
    return run.attitude if member is None or run.attitude.ndim == 3 else run.attitude[:, member]


def _with_line(t: Floats, values: Floats, unit: str) -> PhaseDrift:
    """Fit a straight line to a series at ordered times (at least 16), with the growth of the deviations from it."""
    # Uncertainty: that of a slope with deviations of the power at the lowest frequency that is left by the line.
    # If H < 0.2, deviations are not correlated over the whole span. Otherwise the slopes of q = 8 pieces are used,
    # whose errors are q^(1 - H) times that of the whole.
    # Exponent: H = 0 for oscillations and noise, 1/2 for a random walk, 3/2 for an integrated one (Brouwer's phase
    # error), 2 for a parabola. A series is asymptotically linear if and only if H < 1.
    middle = t.mean()
    d = t - middle
    spread = float(d @ d)
    slope = float(d @ (values - values.mean())) / spread
    deviations = values - values.mean() - slope * d
    found = low_power(deviations[None], covariances(deviations[None]), removed=2)
    # Effect of rounding of the series on its slope.
    rounding = 2.0**-53 * float(np.max(np.abs(values))) / np.sqrt(spread)
    starts = _block_starts(len(t), min(SCALES, len(t) // 2))
    sizes = np.diff(np.append(starts, len(t)))
    slow_t, slow = np.add.reduceat(t, starts) / sizes, np.add.reduceat(values, starts) / sizes
    exponent = _growth_exponent(slow_t, slow)
    uncertainty = np.sqrt(found.power / spread) * found.factor
    if exponent > MIN_MEMORY_EXPONENT:
        pieces = min(SLOPE_PIECES, len(slow) // 2)
        scatter = _slope_scatter(slow_t, slow, pieces) * student_factor(pieces - 1)
        uncertainty = max(uncertainty, scatter * pieces ** (exponent - 1.0))
    return PhaseDrift(
        t,
        values,
        unit,
        slope=slope,
        intercept=float(values.mean() - slope * middle),
        uncertainty=float(np.hypot(uncertainty, rounding)),
        deviation=float(np.sqrt(np.mean(deviations**2))),
        slow_deviation=_deviation_from_lines(slow_t, slow, 1),
        exponent=exponent,
    )


def _block_starts(samples: int, blocks: int) -> NDArray[np.int64]:
    return np.linspace(0, samples, blocks + 1).round().astype(np.int64)[:-1]


def _deviation_from_lines(t: Floats, values: Floats, pieces: int) -> float:
    """Return the root mean square deviation from the least-squares lines of a number of pieces."""
    total = 0.0
    for piece_t, piece in zip(np.array_split(t, pieces), np.array_split(values, pieces), strict=True):
        d, v = piece_t - piece_t.mean(), piece - piece.mean()
        total += float(np.sum((v - d * (d @ v) / (d @ d)) ** 2)) * len(piece) / max(1, len(piece) - 2)
    return float(np.sqrt(total / len(t)))


def _slope_scatter(t: Floats, values: Floats, pieces: int) -> float:
    """Return the standard deviation of the slopes of the pieces of a series."""
    slopes = []
    for piece_t, piece in zip(np.array_split(t, pieces), np.array_split(values, pieces), strict=True):
        d = piece_t - piece_t.mean()
        slopes.append(float(d @ piece) / float(d @ d))
    return float(np.std(slopes, ddof=1))


def _growth_exponent(t: Floats, values: Floats) -> float:
    pieces = [1]
    while len(t) >= 2 * pieces[-1] * MIN_PIECE_SAMPLES and len(pieces) < 5:
        pieces.append(2 * pieces[-1])
    sizes = np.array([_deviation_from_lines(t, values, count) for count in pieces])
    if len(pieces) < 2 or not np.all(sizes > 0.0):
        return 0.0
    return fit_power(1.0 / np.array(pieces), sizes)
