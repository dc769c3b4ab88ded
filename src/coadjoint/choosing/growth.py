"""Extrapolation of the growth of errors beyond the window of a pilot."""

from __future__ import annotations

import math
from typing import NamedTuple

# Growth faster than t^2.5 in both doublings of time counts as exponential.
EXPONENTIAL_RATIO = 2.0**2.5
# This growth in the last half alone, after slower growth, counts as the onset of exponential growth.
ONSET_RATIO = 16.0


class Growth(NamedTuple):
    """The largest errors of the second halves of a quarter, a half and the whole of a window."""

    quarter: float
    half: float
    whole: float

    def factor(self, windows: float, least: float = 1.0) -> float:
        """Return the ratio (>= 1, or inf) of the error after `windows` >= 1 windows to that after one.

        Linear, unless both doublings of time show a faster power, of which the lower is used; exponential if both are
        faster than t^2.5, or the last one much faster. `least` is the lowest power assumed: 1 for symmetric schemes and
        Poisson maps, else 2, since their slow loss of integrals is invisible at first and then shifts phases
        quadratically.
        """
        if windows <= 1.0 or self.whole == 0.0:
            return 1.0
        late, early = _ratio(self.whole, self.half), _ratio(self.half, self.quarter)
        slowest = min(late, early)
        if slowest > EXPONENTIAL_RATIO or (late > ONSET_RATIO and math.sqrt(late * early) > EXPONENTIAL_RATIO):
            # Their product is the growth over three quarters of a window.
            exponent = math.log(late * early) / 0.75 * (windows - 1.0)
            return math.exp(exponent) if exponent < 700.0 else math.inf
        return windows ** max(least, math.log2(slowest) if slowest > 0.0 else 0.0)


def _ratio(late: float, early: float) -> float:
    return late / early if early > 0.0 else 1.0
