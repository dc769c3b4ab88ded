"""Signals of runs at equidistant times, and autocorrelation functions of stationary ones with integrated times."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.standard_errors import MIN_FREEDOM, covariances, low_power
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import missing_attitude
from coadjoint.runs.times import accumulated_rounding
from coadjoint.short_repr import short
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import check_finite, read_finite, read_integer, read_numbers, read_positive, to_array

Floats = NDArray[np.float64]

MIN_SAMPLES = 16  # fewer have no window of five integrated times
WINDOW = 5.0  # integrated times in the window


class SampledSignal(NamedTuple):
    """Values (members, k, channels) at equidistant times; `members`, `channels`: whether the argument had the axis."""

    t: NDArray[np.float64]
    values: NDArray[Any]
    members: bool
    channels: bool

    def shaped(self, values: NDArray[Any]) -> Any:
        """Return values (..., channels) without the last axis if the signal has none."""
        if self.channels:
            return values
        return values[..., 0] if values.ndim > 1 else values[0].item()


def sampled(given: Any, signal: Any = None, min_count: int = 2) -> SampledSignal:
    """Return the signal of a run, or samples, at equidistant times; ValueError or TypeError if there are none such.

    >>> sampled([0.0, 0.5, 1.0], [1.0, 2.0, 4.0]).values.shape
    (1, 3, 1)
    """
    from_run = isinstance(given, Solution)
    if from_run:
        t, values, several = given.t, _signal_of_run(given, signal), given.failed is not None
    else:
        t, several = read_finite(given, "t"), False
        if signal is None or isinstance(signal, str) or callable(signal):
            raise TypeError(f"signal is {short(signal)}; with times t, give its samples as an array")
        values = to_array(signal, "signal", "iufc")
        several = values.ndim == 3
    count = _count_equidistant(t, min_count)
    values = values.astype(np.complex128) if values.dtype.kind == "c" else read_numbers(values, "signal")
    shapes = ((2, 3) if several else (1, 2)) if from_run else (1, 2, 3)
    if values.ndim not in shapes or len(values) != len(t):
        expected = (
            f"({len(t)}, members) or ({len(t)}, members, channels)"
            if several
            else f"({len(t)},) or ({len(t)}, channels)"
        )
        raise ValueError(f"signal has the shape {values.shape}; it must be {expected}")
    check_finite(values, "signal")
    channels = values.ndim == (3 if several else 2)
    if not channels:
        values = values[..., None]
    if not several:
        values = values[:, None]
    if 0 in values.shape:
        raise ValueError(f"signal has the shape {values.shape}; it must have at least one member and one channel")
    return SampledSignal(t[:count], np.swapaxes(values[:count], 0, 1), several, channels)


def _signal_of_run(run: Solution, signal: Any) -> NDArray[Any]:
    several = run.failed is not None
    if run.failed is not None and np.any(run.failed):
        raise ValueError(f"member {int(np.argmax(run.failed))} of the run failed; run again without it")
    if signal is None:
        return _flat(run.x, several)
    if isinstance(signal, str):
        if signal == "attitude":
            if run.attitude is None:
                raise ValueError(missing_attitude(run))
            return _flat(run.attitude, several)
        if signal == "energy":
            return run.energy
        if signal not in run.observed:
            known = ", ".join(map(repr, ("attitude", "energy", *run.observed)))
            raise ValueError(f"signal is {short(signal)}; give {known}, or the number of a component")
        return np.asarray(run.observed[signal])
    if callable(signal):
        check_arguments(signal, "signal", "x")
        function: Callable[..., Any] = signal
        return to_array(function(run.x), "what signal(sol.x) returned", "iufc")
    samples = to_array(signal, "signal", "iufc")
    if samples.ndim == 0:
        components = _flat(run.x, several)
        return np.asarray(components[..., read_integer(signal, "signal", 0, components.shape[-1] - 1)])
    return samples


def _flat(values: NDArray[Any], several: bool) -> NDArray[Any]:
    return values.reshape(*values.shape[: 2 if several else 1], -1)


def _count_equidistant(t: NDArray[np.float64], min_count: int) -> int:
    """Return the number of equidistant times; the last time, which may be off the grid, is then not counted."""
    if t.ndim != 1 or len(t) < min_count:
        raise ValueError(f"t has the shape {t.shape}; give at least {min_count} equidistant times, (k,)")
    spacing = (t[-2] - t[0]) / (len(t) - 2) if len(t) > 2 else t[-1] - t[0]
    off = np.abs(t - (t[0] + spacing * np.arange(len(t))))
    rounding = accumulated_rounding(len(t), float(np.min(t)), float(np.max(t)), abs(spacing))
    on_grid = off <= max(64.0 * UNIT_ROUNDOFF * float(np.max(np.abs(t))), rounding)
    count = len(t) - (not on_grid[-1])
    if spacing == 0.0 or not np.all(on_grid[:count]) or count < min_count:
        raise ValueError(f"t is {short(t)}; give at least {min_count} equidistant times")
    return count


@suggest_keywords
@dataclass(frozen=True, eq=False, repr=False)
class Autocorrelation:
    """The autocorrelation of a stationary series, pooled over its members; `autocorrelation` computes it.

    Attributes
    ----------
    t : ndarray, shape (k,)
        Lags, from zero to half of the span.
    values : ndarray, shape (k,) or (k, channels)
        Normalized autocorrelation, one at lag zero; NaN for a constant series.
    time : float or ndarray, shape (channels,)
        Integrated autocorrelation time, the limit of ``dt (1/2 + sum over lags of values)`` for long series; positive.
        NaN if half of the span is shorter than the window.
    error : float or ndarray, shape (channels,)
        Its standard error.
    window : float or ndarray, shape (channels,)
        Half a period of the highest frequency from which the time is extrapolated to zero frequency: correlations that
        last much longer count in full.
    mean : float, complex, or ndarray, shape (channels,)
        Mean over times and members.
    mean_error : float or ndarray, shape (channels,)
        Its standard error. NaN where `time` is, except for five members or more, whose means show it.
    """

    t: Floats
    values: Floats
    time: Any
    error: Any
    window: Any
    mean: Any
    mean_error: Any

    def __repr__(self) -> str:
        if np.ndim(self.time):
            return f"<autocorrelation of {len(self.time)} channels, integrated times up to {np.max(self.time):.4g}>"
        return f"<autocorrelation: integrated time {self.time:.4g} +- {self.error:.1g}>"


@suggest_keywords
def autocorrelation(given: Any, signal: Any = None, window: float = WINDOW) -> Autocorrelation:
    """Return the normalized autocorrelation function of a stationary series, and its integrated time with an error.

    Choose it for relaxation times, and for error bars of averages over correlated samples, which may also anticorrelate
    or oscillate: a series of length T is worth T / (2 tau) independent ones.

    Parameters
    ----------
    given : Solution or (k,) array_like
        A run, or equidistant times, such as the numbers of Monte Carlo sweeps; at least 16.
    signal : optional
        As for `frequencies`: of a run None for all components, the number of a component, ``"energy"``, the name of an
        observable, or a function of the states; samples (k,), (k, channels) or (k, members, channels) with times.
        Members must be realizations of the same process: they share the mean and the variance.
    window : float
        Least window, in integrated times. For functions that decay with several rates take up to 20.

    Returns
    -------
    Autocorrelation

    Raises
    ------
    ValueError, TypeError
        Too few or uneven times, values that do not match them, or the memory does not suffice.

    Notes
    -----
    By FFT, padded with zeros, each lag divided by its number of products. Of complex signals the real part of the
    product with the conjugate. The integrated time is the power at zero frequency over twice the variance: the mean
    over the lowest frequencies, of which there are up to 0.4 k^(2/3) for k samples, each divided by the power there of
    an autoregression relative to that at zero. So no sum over lags has to end, and the time of a series that oscillates
    is positive. Standard errors have Student's factor for the number of frequencies and members, so that two of them
    hold the truth in 95 of 100 cases. In the limit of dense samples the integrated time is the integral of the
    function, the decay time of an exponential.

    References
    ----------
    E. Lazarus, D. Lewis, J. Stock, M. Watson, J. Bus. Econ. Stat. 36, 541 (2018), the frequencies; D. Andrews, J.
    Monahan, Econometrica 60, 953 (1992), the autoregression; M. Thompson, arXiv:1011.0175, a comparison of methods.

    Examples
    --------
    An autoregressive process, whose integrated time is (1 + a) / (1 - a) / 2:

    >>> noise, a = np.random.default_rng(1).normal(size=20000), 0.8
    >>> import scipy.signal
    >>> found = autocorrelation(np.arange(20000), scipy.signal.lfilter([1], [1, -a], noise))
    >>> bool(abs(found.time - 4.5) < 3 * found.error), bool(found.error < 0.4)
    (True, True)
    """
    series = sampled(given, signal, MIN_SAMPLES)
    factor = read_positive(window, "window")
    members, count, channels = series.values.shape
    mean = series.values.mean(axis=(0, 1))
    lags = count // 2 + 1
    sums = np.stack([covariances(series.values[:, :, c] - mean[c]) for c in range(channels)], axis=1)
    covariance = sums[:lags] / (members * (count - np.arange(lags)))[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        values = covariance / np.where(covariance[0] > 0.0, covariance[0], np.nan)
    spacing = abs(float(series.t[-1] - series.t[0])) / (count - 1)
    tau, error, widths, mean_error = np.full((4, channels), np.nan)
    for c in np.flatnonzero(sums[0] > 0.0):
        deviations = series.values[:, :, c] - mean[c]
        found = low_power(deviations, sums[:, c], times=factor)
        time = 0.5 * found.power / covariance[0, c]
        resolved = factor * time <= 0.5 * count
        if resolved:
            squares = np.abs(deviations) ** 2 / covariance[0, c] - 1.0  # whose mean is the error of the variance
            of_variance = low_power(squares, covariances(squares)).power / (members * count)
            relative = math.sqrt(found.spread + of_variance)
            tau[c], error[c], widths[c] = spacing * time, spacing * time * relative, spacing * found.window
        if resolved or members > MIN_FREEDOM:
            mean_error[c] = math.sqrt(found.power / (members * count)) * found.factor
    lag_times = spacing * np.arange(lags)
    columns = (tau, error, widths, mean, mean_error)
    return Autocorrelation(lag_times, *map(series.shaped, (values, *columns)))
