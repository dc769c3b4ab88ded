"""Phase drift of one spectral line of a motion, by windowed demodulation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.phase_drift import ANGLES, MIN_SAMPLES, drift_of_series
from coadjoint.analysis.reference_motion import check_same_times, motion_of
from coadjoint.analysis.signals import SampledSignal, sampled
from coadjoint.analysis.spectral_lines import hann
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.short_repr import short
from coadjoint.validation import read_number, read_positive

WINDOW_POWER = 3  # of the cosine window: side lobes fall like the 7th power
WINDOW_POSITIONS = 96  # positions of the window along the span
WINDOWS_PER_SPAN = 8  # the default width of the window is 1/8 of the span
MIN_WINDOW_SAMPLES = 32  # fewer do not separate neighbouring lines


@suggest_keywords
def line_drift(
    solution: Any, frequency: float, reference: Any = None, signal: Any = None, width: float | None = None
) -> Any:
    """Return the phase drift of one frequency of a run, relative to the same line of the exact motion.

    Choose it for quasi-periodic motions, which have a phase error in each of their angles; `phase_drift` gives the
    average lead of the state.

    Parameters
    ----------
    solution : Solution
        A run with equidistant saved points.
    frequency : float
        Frequency of the line in radians per unit of time, from `frequencies` of the exact motion.
    reference : Solution or callable, optional
        A more accurate run with the same saved times, or a function of times (k,) that returns states (k, n); None is
        the closed form of the system.
    signal : None, int, str or callable
        As for `frequencies`: a component, or a function of the states. Names require a run as the reference.
    width : float, optional
        Width of the demodulation window in units of time; an eighth of the span by default. Other lines must be more
        than 8 pi / width away.

    Returns
    -------
    PhaseDrift or list of PhaseDrift
        The lead in radians at the window centres; positive is early. A list for an ensemble.

    Raises
    ------
    ValueError
        The reference has other saved times, the window does not fit, or the signal has no such line.
    TypeError
        No closed form is known, and no reference is given.

    Notes
    -----
    Both signals are multiplied by exp(-i w t) and averaged under the Hann window (1 + cos)^3; the angle between the
    averages, unwrapped, is the lead.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> sol = co.integrate(body, (1.0, 0.2, 0.5), (0, 1000), 0.1, co.Splitting(order=2), save_every=5)
    >>> w = co.frequencies(sol, count=1).frequency[0]
    >>> bool(abs(line_drift(sol, w).slope / w / co.phase_drift(sol).slope - 1) < 1e-3)
    True
    """
    check_solution(solution)
    w = read_number(frequency, "frequency")
    if w == 0.0:
        raise ValueError("frequency is 0.0; a constant has no phase; give another frequency")
    run = sampled(solution, signal, MIN_WINDOW_SAMPLES + MIN_SAMPLES)
    reference_values = _reference_signal(solution, run, reference, signal)
    span = abs(run.t[-1] - run.t[0])
    duration = span / WINDOWS_PER_SPAN if width is None else read_positive(width, "width")
    samples = int(round(duration / span * (len(run.t) - 1))) + 1
    if not MIN_WINDOW_SAMPLES <= samples <= len(run.t) - MIN_SAMPLES:
        raise ValueError(
            f"the window takes {samples} of {len(run.t)} samples; it must take at least {MIN_WINDOW_SAMPLES} and leave "
            f"{MIN_SAMPLES}, so save more often, or give another width"
        )
    starts = np.unique(np.linspace(0, len(run.t) - samples, WINDOW_POSITIONS).round().astype(np.int64))
    weight = hann(np.linspace(-1.0, 1.0, samples), WINDOW_POWER)
    middles = run.t[starts] + 0.5 * (run.t[samples - 1] - run.t[0])
    drifts = []
    for computed, exact in zip(run.values, reference_values, strict=True):
        first, second = (demodulated(run.t, values, w, weight, starts) for values in (computed, exact))
        products = np.sum(first * second.conj(), axis=1)
        size = float(np.sqrt(np.mean(np.abs(exact) ** 2)))
        if float(np.min(np.abs(products))) <= (2.0**-40 * size) ** 2:
            raise ValueError(f"the signal has no line at the frequency {w:g}; take one that frequencies() finds")
        drifts.append(drift_of_series(middles, np.copysign(1.0, w) * np.unwrap(np.angle(products)), ANGLES))
    return drifts if run.members else drifts[0]


def demodulated(
    t: NDArray[np.float64], values: NDArray[Any], w: float, weight: NDArray[np.float64], starts: NDArray[np.int64]
) -> NDArray[np.complex128]:
    """Return the complex amplitude of a line in each window, (windows, channels); half of it for a real signal."""
    slow = values * np.exp(-1j * w * t)[:, None]
    return np.array([weight @ slow[first : first + len(weight)] for first in starts])


def _reference_signal(solution: Solution, run: SampledSignal, reference: Any, signal: Any) -> NDArray[Any]:
    """Return the signal of the reference motion at the same times, for each member."""
    if isinstance(reference, Solution):
        other = sampled(reference, signal, 2)
        check_same_times(other.t, run.t)
        if other.values.shape[2] != run.values.shape[2] or len(other.values) not in (1, len(run.values)):
            raise ValueError("the reference has other members or coordinates than the run")
        return np.broadcast_to(other.values, run.values.shape)
    if isinstance(signal, str) or (signal is not None and np.ndim(signal)):
        raise TypeError(f"signal is {short(signal)}; without a run for the reference give a component or a function")
    signals = []
    for member in range(len(run.values)):
        x0 = solution.x0[member] if run.members else solution.x0
        system = solution.system.of_member(member)
        start = solution.t_span[0] if reference is None else 0.0
        states = motion_of(system, reference, x0)(run.t - start)
        values = states if signal is None else signal(states) if callable(signal) else states[:, signal]
        signals.append(np.asarray(values).reshape(len(run.t), -1))
    return np.array(signals)
