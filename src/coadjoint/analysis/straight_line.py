"""Straight lines fitted to series, with an uncertainty of the slope for correlated deviations."""

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
    """A least-squares line of a series; the attributes are those of `PhaseDrift`."""

    slope: float
    intercept: float
    uncertainty: float
    deviation: float
    slow_deviation: float
    exponent: float


def straight_line(t: Floats, values: Floats) -> Line:
    """Fit a straight line to a series at ordered times (at least 16), with the growth of the deviations from it.

    The uncertainty is a standard error of the slope that allows for correlated deviations: the true slope is within two
    of it for nine of ten series. The exponent H is the power of the length of a piece with which deviations grow.
    """
    # Uncertainty: for B blocks of neighbouring samples, deviations r and distances d from the middle time, the sums of
    # d r over each block are independent if the blocks are long enough. The slope then has the variance B / (B - 2) *
    # sum (block sums)^2 / (sum d^2)^2. The sufficient length is unknown, so the largest value for B = 4 to 32 is taken.
    # If H < 0.2, deviations are not correlated over the whole span. Otherwise the slopes of q = 8 pieces are used,
    # whose errors are q^(1 - H) times that of the whole.
    # Exponent: H = 0 for oscillations and noise, 1/2 for a random walk, 3/2 for an integrated one (Brouwer's phase
    # error), 2 for a parabola. A series is asymptotically linear if and only if H < 1.
    middle = t.mean()
    d = t - middle
    spread = float(d @ d)
    slope = float(d @ (values - values.mean())) / spread
    deviations = values - values.mean() - slope * d
    weighted = d * deviations
    worst = 0.0
    for blocks in BLOCKS:
        if len(t) < MIN_PIECE_SAMPLES * blocks:
            break
        sums = np.add.reduceat(weighted, _block_starts(len(t), blocks))
        worst = max(worst, blocks / (blocks - 2) * float(sums @ sums))
    # Effect of rounding of the series on its slope.
    rounding = 2.0**-53 * float(np.max(np.abs(values))) / np.sqrt(spread)
    starts = _block_starts(len(t), min(SCALES, len(t) // 2))
    sizes = np.diff(np.append(starts, len(t)))
    slow_t, slow = np.add.reduceat(t, starts) / sizes, np.add.reduceat(values, starts) / sizes
    exponent = _growth_exponent(slow_t, slow)
    uncertainty = np.sqrt(worst) / spread
    if exponent > MIN_MEMORY_EXPONENT:
        pieces = min(SLOPE_PIECES, len(slow) // 2)
        uncertainty = max(uncertainty, _slope_scatter(slow_t, slow, pieces) * pieces ** (exponent - 1.0))
    return Line(
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
    return float(np.polyfit(-np.log(pieces), np.log(sizes), 1)[0])
