"""Which schemes need not be tried? Two series of different order say about how many steps the others need."""

from __future__ import annotations

import math
from collections.abc import Sequence

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.fitting import Fit
from coadjoint.choosing.growth import Growth
from coadjoint.choosing.pilot import Trial
from coadjoint.methods.base import Method
from coadjoint.methods.taylor import Taylor

# Of 16 systems at four accuracies, no series of order 8 to 24 needed less than 1 / 1.34 of the steps that those of
# order 8 and 16 foretold, and of order 6 once 1 / 1.5.
NEARLY = 1.35
# Other schemes of order p needed no less than a quarter of the steps of the series of order p, where they came near to
# the best. Their iterations of stages took no less than so many rounds, or their order where that is less.
AHEAD = 4.0
OFTEN_AHEAD = 2.5
ROUNDS = 10.0
APART = 4
LEAST = 2.0**-1000


class Law:
    """The error of series, c (h / r)^p: how many steps a scheme of any order needs, from the fits of two.

    With N steps over the time T, ``log N = log(T / r) + (log c - log goal) / p``.
    """

    def __init__(self, one: Fit, other: Fit) -> None:
        p, q = one.candidate.method.order, other.candidate.method.order
        at_p, at_q = (math.log(fit.steps) + math.log(max(fit.error, LEAST)) / p for fit, p in ((one, p), (other, q)))
        self._amount = (at_p - at_q) / (1.0 / p - 1.0 / q)
        self._rate = at_p - self._amount / p

    def steps(self, order: int, goal: float) -> float:
        """Return the steps over the whole span that a series of this order needs for an error."""
        exponent = self._rate + (self._amount - math.log(goal)) / order
        return math.exp(min(exponent, 700.0))

    def guess(self, candidate: Candidate, goal: float) -> float:
        """Return about how many steps a scheme needs."""
        steps = self.steps(candidate.method.order, goal)
        return steps if _is_series(candidate.method) else steps / OFTEN_AHEAD

    def least_cost(self, candidate: Candidate, goal: float, nearly: float = NEARLY) -> float:
        """Return what a scheme costs at the least that is to reach an error at the end.

        `nearly` says how many times fewer steps a series may need than the law foretells.
        """
        method = candidate.method
        series = _is_series(method)
        steps = self.steps(method.order, goal) / (nearly if series else AHEAD)
        iterations = 1.0 if series else min(float(method.order), ROUNDS)
        # No tableau of s stages has an order above 2 s.
        trial = Trial(1, Growth(0.0, 0.0, 0.0), iterations, iterations * method.order / 2)
        return steps * candidate.cost(trial) * candidate.share


def law_of(found: Sequence[Fit]) -> Law | None:
    """Return the law by two series that are far enough apart; None where there are none among the fits."""
    series = [each for each in found if _is_series(each.candidate.method)]
    if len(series) < 2 or abs(series[0].candidate.method.order - series[1].candidate.method.order) < APART:
        return None
    return Law(series[0], series[1])


def _is_series(method: Method) -> bool:
    """Return whether a scheme is a series in steps that are given to it."""
    return isinstance(method, Taylor) and not method.own_steps
