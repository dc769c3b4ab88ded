"""Linear fit of a series, with an uncertainty that allows for correlated samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

BLOCKS = (4, 6, 8, 12, 16, 24, 32)  # numbers of blocks; the sums over blocks are assumed to be independent
MIN_MEMORY_EXPONENT = 0.2  # noise without correlation over the span, and oscillations, have smaller exponents
SLOPE_PIECES = 8
SCALES = 64  # blocks, from whose means the growth is computed
MIN_SAMPLES = 16
MIN_PIECE_SAMPLES = 4


class Line(NamedTuple):
    """A straight line fitted to a series by least squares; the intercept is its value at time zero.

    `uncertainty` is the standard error of the slope, allowing for correlated deviations; `deviation` the root mean
    square deviation, `slow_deviation` that of means over 1/64 of the span; `exponent` the power of a piece's length
    with which they grow.
    """

    slope: float
    intercept: float
    uncertainty: float
    deviation: float
    slow_deviation: float
    exponent: float


def straight_line(t: Floats, values: Floats) -> Line:
    """Fit a straight line to a series at ordered times (at least 16), with the growth of the deviations from it.

    Uncertainty: for B blocks of neighbouring samples, deviations r and distances d from the middle time, the sums of
    d r over each block are independent if the blocks are long enough. The slope then has the variance B / (B - 2) *
    sum (block sums)^2 / (sum d^2)^2. The sufficient length is unknown, so the largest of the values for B = 4 to 32
    is taken. If H is below 0.2, deviations are not correlated over the whole span. Otherwise the slopes of q = 8 pieces
    are used, whose errors are q^(1 - H) times that of the whole. In tests on white noise, noise with correlation times
    up to a quarter of the span, random walks and integrated random walks, the true slope is within two uncertainties
    for at least nine of ten series; for oscillations it always is.

    Exponent: bounded deviations (oscillations, noise) do not grow with the length of a piece, H = 0. A random walk has
    H = 1/2, an integrated random walk (Brouwer's phase error) 3/2, a parabola 2. A series is asymptotically linear if
    and only if H < 1.
    """
    middle = t.mean()
    d = t - middle
    spread = float(d @ d)
    slope = float(d @ (values - values.mean())) / spread
    rest = values - values.mean() - slope * d
    parts = d * rest
    worst = 0.0
    for blocks in BLOCKS:
        if len(t) < MIN_PIECE_SAMPLES * blocks:
            break
        sums = np.add.reduceat(parts, _starts(len(t), blocks))
        worst = max(worst, blocks / (blocks - 2) * float(sums @ sums))
    # Effect of rounding of the series on its slope.
    rounding = 2.0**-53 * float(np.max(np.abs(values))) / np.sqrt(spread)
    starts = _starts(len(t), min(SCALES, len(t) // 2))
    sizes = np.diff(np.append(starts, len(t)))
    slow_t, slow = np.add.reduceat(t, starts) / sizes, np.add.reduceat(values, starts) / sizes
    exponent = _exponent(slow_t, slow)
    uncertainty = np.sqrt(worst) / spread
    if exponent > MIN_MEMORY_EXPONENT:
        pieces = min(SLOPE_PIECES, len(slow) // 2)
        uncertainty = max(uncertainty, _spread_of_slopes(slow_t, slow, pieces) * pieces ** (exponent - 1.0))
    return Line(
        slope=slope,
        intercept=float(values.mean() - slope * middle),
        uncertainty=float(np.hypot(uncertainty, rounding)),
        deviation=float(np.sqrt(np.mean(rest**2))),
        slow_deviation=_deviation_from_lines(slow_t, slow, 1),
        exponent=exponent,
    )


def _starts(samples: int, blocks: int) -> NDArray[np.int64]:
    return np.linspace(0, samples, blocks + 1).round().astype(np.int64)[:-1]


def _deviation_from_lines(t: Floats, values: Floats, pieces: int) -> float:
    """Return the root mean square deviation from the least-squares lines of a number of pieces."""
    total = 0.0
    for own_t, own in zip(np.array_split(t, pieces), np.array_split(values, pieces), strict=True):
        d, v = own_t - own_t.mean(), own - own.mean()
        total += float(np.sum((v - d * (d @ v) / (d @ d)) ** 2)) * len(own) / max(1, len(own) - 2)
    return float(np.sqrt(total / len(t)))


def _spread_of_slopes(t: Floats, values: Floats, pieces: int) -> float:
    """Return the standard deviation of the slopes of the pieces of a series."""
    slopes = []
    for own_t, own in zip(np.array_split(t, pieces), np.array_split(values, pieces), strict=True):
        d = own_t - own_t.mean()
        slopes.append(float(d @ own) / float(d @ d))
    return float(np.std(slopes, ddof=1))


def _exponent(t: Floats, values: Floats) -> float:
    pieces = [1]
    while len(t) >= 2 * pieces[-1] * MIN_PIECE_SAMPLES and len(pieces) < 5:
        pieces.append(2 * pieces[-1])
    sizes = np.array([_deviation_from_lines(t, values, count) for count in pieces])
    if len(pieces) < 2 or not np.all(sizes > 0.0):
        return 0.0
    return float(np.polyfit(-np.log(pieces), np.log(sizes), 1)[0])
