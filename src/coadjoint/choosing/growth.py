"""How do errors grow beyond the window that a pilot has seen?"""

from __future__ import annotations

import math
from typing import NamedTuple

# Faster than t^2.5 from quarter to half to whole is taken for exponential.
EXPONENTIAL = 2.0**2.5
# So much growth in the last half alone, after slower growth, is the beginning of exponential growth.
BURST = 16.0


class Growth(NamedTuple):
    """The largest errors of the second halves of a quarter, a half and the whole of a window.

    Examples
    --------
    An error that grows linearly, 10 windows on, and one that grows tenfold in each quarter of a window:

    >>> Growth(0.25, 0.5, 1.0).factor(11.0)
    11.0
    >>> round(Growth(1.0, 10.0, 1000.0).factor(2.0))
    10000
    """

    quarter: float
    half: float
    whole: float

    def factor(self, windows: float, least: float = 1.0) -> float:
        """Return how many times larger the error is after so many windows than after one.

        Linear (the growth of integrable motion, also where an oscillation hides it in the window), unless both
        doublings of time show a faster power, the lower of which is then used; exponential where both are faster than
        t^2.5, or the last one much faster.

        Parameters
        ----------
        windows : float
            The time, in windows; at least 1.
        least : float
            The lowest power of time that is believed: 1 for schemes that are symmetric or Poisson maps, else 2, since
            what they lose of integrals sets in unseen and then shifts phases ever faster.

        Returns
        -------
        float
            At least 1; infinite where it overflows.
        """
        if windows <= 1.0 or self.whole == 0.0:
            return 1.0
        late, early = _ratio(self.whole, self.half), _ratio(self.half, self.quarter)
        slowest = min(late, early)
        if slowest > EXPONENTIAL or (late > BURST and math.sqrt(late * early) > EXPONENTIAL):
            # Both together are the growth in three quarters of a window.
            exponent = math.log(late * early) / 0.75 * (windows - 1.0)
            return math.exp(exponent) if exponent < 700.0 else math.inf
        return windows ** max(least, math.log2(slowest) if slowest > 0.0 else 0.0)


def _ratio(late: float, early: float) -> float:
    return late / early if early > 0.0 else 1.0
