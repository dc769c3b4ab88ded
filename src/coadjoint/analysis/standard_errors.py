"""Standard errors from few numbers (Student's factor), of means and slopes of correlated series, and of rates."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ORDINATES = 0.4
"""Ordinates of a spectrum of k samples, over k^(2/3) (Lazarus et al. 2018); as many degrees of freedom."""
MIN_FREEDOM = 4
"""Degrees of freedom of a power, at least: Student's factor is then at most 1.4."""
MAX_ORDER = 10.0
"""Largest order of an autoregression, over the logarithm (base 10) of the number of samples."""
MIN_TIMES = 16
"""Times with which a fall of a rate like log(t)/t is fitted."""
EARLY = 8
"""The first part of the time, one in so many, in which stretches do not grow like log(t) yet."""
FALLING = 3.0
"""Standard errors of the coefficient of such a fall that is significant."""
DIFFERENT = 0.1
"""Probability below which the lower half of the ordinates is larger than the upper one, not by chance."""


def student_factor(freedom: float) -> float:
    """Return the factor of a standard error whose variance is estimated: two of its products hold 95 of 100 cases.

    >>> [round(student_factor(freedom), 2) for freedom in (1, 3, 10, 1000)]
    [6.98, 1.65, 1.14, 1.0]
    """
    from scipy.special import ndtr, stdtrit

    return float(stdtrit(freedom, float(ndtr(2.0)))) / 2.0 if freedom > 0 else math.nan


class LowPower(NamedTuple):
    """Power of a series at low frequencies (sum of its covariances): the mean of k samples has variance power / k.

    `window`: samples in half a period of the highest frequency used; `spread`: variance of the power over its square.
    """

    power: float
    freedom: int
    window: float
    spread: float

    @property
    def factor(self) -> float:
        return student_factor(self.freedom)


def covariances(deviations: NDArray[Any]) -> Floats:
    """Return the sums over members (members, k) and times of products at each lag, member by member to save memory."""
    from scipy.fft import fft, ifft, next_fast_len

    count = deviations.shape[1]
    size = next_fast_len(2 * count)
    total = np.zeros(count)
    for row in deviations:
        total += ifft(np.abs(fft(row, size)) ** 2).real[:count]
    return total


def low_power(deviations: NDArray[Any], sums: Floats, removed: int = 1, times: float = 0.0) -> LowPower:
    """Return the power of deviations (members, k) from a common mean (`removed` = 1) or a line (2).

    `sums` are `covariances`; the window is of `times` integrated times, if it can be.
    """
    # Projections on cosines cos(pi j (i + 1/2) / k) are independent, with the power at the frequency pi j / k (E.
    # Lazarus, D. Lewis, J. Stock, M. Watson, J. Bus. Econ. Stat. 36, 541, 2018). An autoregression extrapolates them to
    # the lowest frequency (D. Andrews, J. Monahan, Econometrica 60, 953, 1992): it serves anticorrelated and
    # oscillating series, whose power rises from there. Deviations of members' means belong to the frequency zero.
    from scipy.fft import dct
    from scipy.special import fdtrc

    members, count = deviations.shape
    if not sums[0] > 0.0:
        return LowPower(0.0, MIN_FREEDOM, math.nan, math.nan)
    model = _autoregression(sums, members)
    least = removed
    while members * (least - removed) + (members - 1) * (removed == 1) < MIN_FREEDOM:
        least += 1
    last = max(least, removed + int(ORDINATES * count ** (2.0 / 3.0)))
    rows = [np.abs(_dct(row, dct)[:last]) ** 2 for row in deviations]
    frequencies = np.pi / count * np.arange(last)
    shape = np.abs(np.exp(-1j * np.outer(frequencies, np.arange(len(model)))) @ model) ** 2
    ordinates = np.sum(rows, axis=0) * shape / shape[removed - 1]
    freedom = np.full(last, members)
    freedom[0] = (members - 1) * (removed == 1)
    freedom[1:removed] = 0
    ordinates[freedom == 0] = 0.0
    while True:
        power = float(np.sum(ordinates[:last])) / float(np.sum(freedom[:last]))
        half = max(least, removed + (last - removed) // 2)
        lower, upper = int(np.sum(freedom[:half])), int(np.sum(freedom[half:last]))
        if not upper:
            break
        ratio = np.sum(ordinates[:half]) * upper / max(np.sum(ordinates[half:last]) * lower, np.finfo(float).tiny)
        slow = times * 0.5 * power * (last - removed) > sums[0] / members
        if not slow and fdtrc(lower, upper, ratio) > DIFFERENT:
            break
        last = half
    used = int(np.sum(freedom[:last]))
    # The second term is that of the coefficients (K. Berk, Ann. Stat. 2, 489, 1974).
    spread = 2.0 * student_factor(used) ** 2 / used + 4.0 * (len(model) - 1) / (members * count)
    return LowPower(power, used, count / max(1, last - removed), spread)


def error_of_rate(stretches: Floats, t: Floats, transient: float) -> float:
    """Return the standard error of a growth rate from stretches at times after the transient, or of its limit."""
    spans, growth, rate = np.diff(t), np.diff(stretches), float(stretches[-1] / t[-1])
    count = len(spans)
    if not np.all(np.isfinite(growth)):
        return float("nan")
    late = float(np.max(np.abs(stretches[count // 2 :] / t[count // 2 :] - rate)))
    if count < MIN_TIMES:
        return max(late, float(np.std(growth / spans, ddof=1)) / np.sqrt(count) * student_factor(count - 1))

    def power(values: Floats) -> tuple[float, float]:
        deviations = (values - values.mean())[None]
        found = low_power(deviations, covariances(deviations))
        return found.power, found.factor

    of_mean, factor = power(growth / spans)
    error = np.sqrt(of_mean / count) * factor
    first = count // EARLY
    since = transient + t
    columns = np.stack([spans, np.log(since[1:] / np.maximum(since[:-1], spans[0]))], axis=1)[first:]
    (limit, slope), _, _, _ = np.linalg.lstsq(columns, growth[first:], rcond=None)
    noise, factor = power(growth[first:] - columns @ (limit, slope))
    limit_error, slope_error = np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)) * noise) * factor
    if abs(slope) > FALLING * slope_error:
        error = abs(rate - limit) + limit_error
    else:  # a slope of one, that of vectors that grow like t, may be hidden
        hidden = min(1.0, abs(slope) + slope_error)
        error = max(error, hidden * np.log(since[-1] / max(transient, spans[0])) / t[-1])
    return max(late, float(error))


def _dct(row: NDArray[Any], dct: Any) -> NDArray[Any]:
    """Return the orthonormal cosine transform of real or complex numbers."""
    if np.iscomplexobj(row):
        return np.asarray(dct(row.real, norm="ortho") + 1j * dct(row.imag, norm="ortho"))
    return np.asarray(dct(row, norm="ortho"))


def _autoregression(sums: Floats, members: int) -> Floats:
    """Return the coefficients (1, a1, ...) of noise in terms of a series, by Levinson's recursion and AICc."""
    count = len(sums)
    samples = count * members
    model, rest = np.ones(1), float(sums[0])
    best, least = model, samples * math.log(rest)
    for order in range(1, min(count // 4, int(MAX_ORDER * math.log10(count))) + 1):
        reflection = -float(model @ sums[order:0:-1]) / rest
        model = np.append(model, 0.0)
        model = model + reflection * model[::-1]
        rest *= 1.0 - reflection**2
        if not rest > 2.0**-48 * sums[0]:
            break  # nothing but rounding is left
        criterion = samples * math.log(rest) + 2.0 * order * samples / (samples - order - 2)
        if criterion < least:
            best, least = model, criterion
    return best
