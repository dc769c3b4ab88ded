"""Spectral lines of sampled signals, by windowed least squares in frequencies and amplitudes, and their phase drift."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.phase_drift import ANGLES, MIN_SAMPLES, drift_of_series
from coadjoint.analysis.phase_error import check_same_times, motion_of
from coadjoint.analysis.signals import SampledSignal, sampled
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.short_repr import short
from coadjoint.validation import read_number, read_positive

Floats = NDArray[np.float64]

SEARCH_ITERATIONS = 4  # refinements of all lines after each new one
FINAL_ITERATIONS = 12  # refinements of all lines at the end, which converge quadratically
RESOLUTION_BINS = 2.0  # resolution limit, in bins of 2 pi over the span
NOISE_BINS = 32  # bins on either side of a line whose median power is its noise

WINDOW_POWER = 3  # of the cosine window: side lobes fall like the 7th power
WINDOW_POSITIONS = 96  # positions of the window along the span
WINDOWS_PER_SPAN = 2  # the default width of the window is half of the span
MAIN_LOBE = 8.0 * math.pi  # distance of other lines times the width of the window, at least
NEIGHBOURS = 6  # strongest lines of the exact motion that are compared with that distance
WEAK_NEIGHBOUR = 1.0 / 64.0  # of the line, what a window leaves of others: the drift is wrong by about this fraction
MIN_WINDOW_SAMPLES = 32  # fewer do not separate neighbouring lines


class Lines(NamedTuple):
    """Spectral lines of some members, on times from -1 to 1: mean + Re(sum_k a_k exp(i w_k s)) for a real signal."""

    # Shapes: frequency (members, lines), amplitude (members, lines, channels), mean (members, channels), residual
    # (members, samples, channels), present (members, lines).

    frequency: Floats
    amplitude: NDArray[np.complex128]
    mean: NDArray[Any]
    residual: NDArray[Any]
    present: NDArray[np.bool_]


def hann(s: Floats, power: int) -> Floats:
    """Return the window (1 + cos(pi s))^power at times s from -1 to 1, normalized to sum one.

    >>> hann(np.linspace(-1.0, 1.0, 5), 1)
    array([0.  , 0.25, 0.5 , 0.25, 0.  ])
    """
    weight = np.cos(0.5 * math.pi * s) ** (2 * power)
    weight[np.abs(s) >= 1.0] = 0.0
    return np.asarray(weight / weight.sum())


def find_lines(s: Floats, values: NDArray[Any], count: int, power: int) -> Lines:
    """Find the strongest lines of signals (members, samples, channels) one by one, then refine them together."""
    weight = hann(s, power)
    members, _, channels = values.shape
    lines = Lines(
        np.zeros((members, 0)),
        np.zeros((members, 0, channels), dtype=np.complex128),
        mean := np.einsum("s,msc->mc", weight, values),
        values - mean[:, None],
        np.zeros((members, 0), dtype=np.bool_),
    )
    for _ in range(count):
        start, height = _highest_peak(s, lines, weight)
        frequency = np.concatenate([lines.frequency, start[:, None]], axis=1)
        strongest = np.max(np.linalg.norm(lines.amplitude, axis=2), axis=1, initial=0.0)
        largest = np.maximum(strongest, height) + np.linalg.norm(lines.mean, axis=1)
        # Rounding of the arguments of the sines, and of the samples.
        floor = 8.0 * UNIT_ROUNDOFF * (1.0 + np.max(np.abs(frequency), axis=1)) * largest
        present = np.concatenate([lines.present, (height > floor)[:, None]], axis=1)
        if not np.any(present[:, -1]):
            break
        lines = refine_lines(s, values, frequency, present, weight, SEARCH_ITERATIONS)
    return refine_lines(s, values, lines.frequency, lines.present, weight, FINAL_ITERATIONS)


def refine_lines(
    s: Floats, values: NDArray[Any], frequency: Floats, present: NDArray[np.bool_], weight: Floats, iterations: int
) -> Lines:
    """Refine frequencies (members, lines) in `present` by Gauss-Newton steps with eliminated amplitudes."""
    # With columns B = (1, cos w_k s, sin w_k s), or (1, exp(i w_k s)), the derivatives by w_k lie in the span of s B: a
    # step needs only the Gram matrix of (B, s B) and its products with the residual.
    w = frequency.copy()
    bin_width, last, count = math.pi, math.inf, w.shape[1]
    for _ in range(iterations):
        columns, gram, amplitude, _, residual = _fitted(s, values, w, weight)
        moments = np.einsum("msa,msc->mac", columns.conj() * weight[:, None], residual)
        inner = columns.shape[2] // 2 + 1  # columns of B; the columns s B follow, without s itself
        eliminated = np.linalg.solve(gram[:, :inner, :inner], gram[:, :inner])
        schur = gram - np.swapaxes(eliminated.conj(), 1, 2) @ gram[:, :inner]
        reduced = moments - np.swapaxes(eliminated.conj(), 1, 2) @ moments[:, :inner]
        schur, reduced = schur[:, inner:, inner:], reduced[:, inner:]
        slopes = _slopes(amplitude, real=not np.iscomplexobj(values))
        matrix = np.einsum("mkac,mab,mlbc->mkl", slopes.conj(), schur, slopes, optimize=True).real
        rhs = np.einsum("mkac,mac->mk", slopes.conj(), reduced).real
        matrix = np.where(present[:, :, None] & present[:, None], matrix, np.eye(count))
        curvature = np.einsum("mkk->mk", matrix)
        # Of a line without any, only rounding is left.
        least = UNIT_ROUNDOFF**2 * curvature.max(axis=1, keepdims=True, initial=0.0) + np.finfo(float).tiny
        size = np.sqrt(np.maximum(curvature, least))
        scaled = matrix / size[:, :, None] / size[:, None] + UNIT_ROUNDOFF * np.eye(count)
        change = np.linalg.solve(scaled, (np.where(present, rhs, 0.0) / size)[..., None])[..., 0] / size
        change = np.where(present, np.clip(change, -0.5 * bin_width, 0.5 * bin_width), 0.0)
        w += change
        largest = float(np.max(np.abs(change) / (1.0 + np.abs(w)), initial=0.0))
        if largest <= UNIT_ROUNDOFF or (largest >= last and largest < 2.0**-36):
            break
        last = largest
    _, _, amplitude, mean, residual = _fitted(s, values, w, weight)
    return Lines(w, amplitude, mean, residual, present)


def frequency_uncertainty(lines: Lines, s: Floats, power: int) -> Floats:
    """Return the standard error of each frequency due to noise near its line, shape (members, lines)."""
    # The noise is the median power of the residual near the line, insensitive to further lines, without the bins
    # at the line, from which the fit has removed noise; for white noise the error is unbiased.
    weight = hann(s, power)
    real = not np.iscomplexobj(lines.residual)
    spectrum = _spectrum(lines.residual, weight)
    bins = _bins(len(s), real)
    at_line = (power + 1) / 2 * math.pi
    count = max(1, min(2 * NOISE_BINS + 1, spectrum.shape[1] - power - 2))
    distance = np.abs(bins - lines.frequency[..., None])
    distance = np.where(distance < at_line, np.inf, distance)
    near = np.argpartition(distance, count - 1, axis=2)[..., :count]
    power_near = np.abs(spectrum[np.arange(len(near))[:, None, None], near]) ** 2  # (members, lines, bins, channels)
    variance = np.median(power_near, axis=2) / math.log(2.0) / np.sum(weight**2)
    intensity = np.abs(lines.amplitude) ** 2
    total = np.sum(intensity, axis=2)
    spread = np.sum(weight**2 * s**2) / np.sum(weight * s**2) ** 2 * (2.0 if real else 0.5)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(spread * np.sum(intensity * variance, axis=2)) / total)


def _fitted(
    s: Floats, values: NDArray[Any], w: Floats, weight: Floats
) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.complex128], NDArray[Any], NDArray[Any]]:
    """Return columns, Gram matrix, amplitudes, mean and residual of the least-squares fit at frequencies w."""
    exponentials = np.exp(1j * s[:, None] * w[:, None, :])
    real = not np.iscomplexobj(values)
    waves = np.concatenate([exponentials.real, exponentials.imag], axis=2) if real else exponentials
    constant = np.ones((len(w), len(s), 1))
    columns = np.concatenate([constant, waves, s[:, None] * waves], axis=2)
    model = columns[..., : waves.shape[2] + 1]
    weighted = columns.conj() * weight[:, None]
    gram = np.swapaxes(weighted, 1, 2) @ columns
    inner = gram[:, : model.shape[2], : model.shape[2]]
    products = np.swapaxes(weighted[..., : model.shape[2]], 1, 2)
    coefficients = np.linalg.solve(inner, products @ values)
    # Iterative refinement, so that weak lines are as accurate as strong ones.
    coefficients = coefficients + np.linalg.solve(inner, products @ (values - model @ coefficients))
    k = w.shape[1]
    of_waves = coefficients[:, 1:]
    amplitude = of_waves[:, :k] - 1j * of_waves[:, k:] if real else of_waves
    return columns, gram, np.asarray(amplitude, complex), coefficients[:, 0], values - model @ coefficients


def _slopes(amplitude: NDArray[np.complex128], real: bool) -> NDArray[Any]:
    """Return the derivatives of the model by frequency in terms of s B, shape (members, lines, columns, channels)."""
    identity = np.eye(amplitude.shape[1])[None, :, :, None]
    if not real:
        return 1j * identity * amplitude[:, :, None]
    cosine, sine = amplitude.real[:, :, None], -amplitude.imag[:, :, None]
    return np.concatenate([identity * sine, -identity * cosine], axis=2)


def _spectrum(values: NDArray[Any], weight: Floats) -> NDArray[np.complex128]:
    weighted = values * weight[:, None]
    return np.asarray(np.fft.fft(weighted, axis=1) if np.iscomplexobj(values) else np.fft.rfft(weighted, axis=1))


def _bins(samples: int, real: bool) -> Floats:
    """Return the angular frequencies of the FFT bins; the spacing of the samples on [-1, 1] is 2 / (samples - 1)."""
    frequencies = np.fft.rfftfreq(samples) if real else np.fft.fftfreq(samples)
    return np.asarray(math.pi * (samples - 1) * frequencies)


def _highest_peak(s: Floats, lines: Lines, weight: Floats) -> tuple[Floats, Floats]:
    """Return frequency and amplitude of the highest peak of the residual outside the known lines."""
    real = not np.iscomplexobj(lines.residual)
    power = np.sum(np.abs(_spectrum(lines.residual, weight)) ** 2, axis=2)
    bins = _bins(len(s), real)
    top = math.pi * (len(s) - 1) / 2
    at_edge = np.abs(bins) > top - RESOLUTION_BINS * math.pi
    distance = np.abs(bins - np.concatenate([lines.frequency, np.zeros((len(power), 1))], axis=1)[..., None])
    # Negative, so that a peak of zero residual is also away from the constant and the known lines.
    power = np.where(at_edge | np.any(distance < RESOLUTION_BINS * math.pi, axis=1), -1.0, power)
    peak = np.argmax(power, axis=1)
    rows = np.arange(len(power))
    middle, left, right = (np.maximum(power[rows, (peak + d) % power.shape[1]], 1e-300) for d in (0, -1, 1))
    # The vertex of a parabola through three logarithms.
    below, above = np.log(left / middle), np.log(right / middle)
    curvature = below + above
    shift = np.where(curvature < 0.0, 0.5 * (below - above) / np.where(curvature < 0.0, curvature, -1.0), 0.0)
    spacing = bins[1] - bins[0]
    height = np.sqrt(middle) * (2.0 if real else 1.0)
    return bins[peak] + np.clip(shift, -0.5, 0.5) * spacing, np.where(middle > 1e-300, height, 0.0)


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
        Width of the demodulation window in units of time; half of the span by default. Other lines must be more than
        8 pi / width away, those that are 10, 1000 and 10^5 times as large 9, 14 and 26 pi / width.

    Returns
    -------
    PhaseDrift or list of PhaseDrift
        The lead in radians at the window centres; positive is early. A list for an ensemble.

    Raises
    ------
    ValueError
        The reference has other saved times, the window does not fit, the signal has no such line, or the window does
        not separate it from another one.
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
        _check_separated(run.t, exact, w, duration, float(np.sqrt(np.mean(np.sum(np.abs(second) ** 2, axis=1)))))
        drifts.append(drift_of_series(middles, np.copysign(1.0, w) * np.unwrap(np.angle(products)), ANGLES))
    return drifts if run.members else drifts[0]


def _check_separated(t: Floats, exact: NDArray[Any], w: float, width: float, own: float) -> None:
    """Raise ValueError if a window of this width does not separate the line at w from another one, or the mean."""
    s, half = np.linspace(-1.0, 1.0, len(t)), 0.5 * (t[-1] - t[0])
    count = min(NEIGHBOURS, len(t) // (8 * (WINDOW_POWER + 1)))
    lines = find_lines(s, exact[None], count, WINDOW_POWER)
    frequency, size = lines.frequency[0] / half, np.linalg.norm(lines.amplitude[0], axis=1)
    real, resolved = not np.iscomplexobj(exact), min(math.pi / abs(half), 0.5 * abs(w))
    if real:
        frequency, size = np.append(frequency, -frequency), 0.5 * np.append(size, size)
    ratio = np.concatenate([size, [np.linalg.norm(lines.mean[0]), own * real]]) / max(own, np.finfo(float).tiny)
    distance = np.abs(np.append(frequency, [0.0, -w]) - w)
    others = (distance > resolved) & (ratio > WEAK_NEIGHBOUR)
    if np.all(distance > resolved):  # no line of the exact motion is followed: only the mirror image is known
        others[:-1] = False
    # Side lobes at m bins are below 3!^2 / pi (m^2 - 3^2)^(-7/2).
    bins = np.sqrt(9.0 + (36.0 / math.pi * ratio / WEAK_NEIGHBOUR) ** (2.0 / 7.0))
    needed = np.where(others, np.maximum(MAIN_LOBE, 2.0 * math.pi * bins) / np.where(others, distance, 1.0), 0.0)
    k = int(np.argmax(needed))
    if width < needed[k] * (1.0 - 1e-9):
        raise ValueError(
            f"another line, {ratio[k]:.2g} times as large, is {distance[k]:.4g} from the frequency {w:g}, and a window "
            f"of {width:.6g} does not separate them; give a width of at least {needed[k]:.4g}, or a run of at least "
            "twice that"
        )


def demodulated(
    t: Floats, values: NDArray[Any], w: float, weight: Floats, starts: NDArray[np.int64]
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
