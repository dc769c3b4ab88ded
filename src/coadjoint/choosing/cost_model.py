"""Cost model of schemes not yet tried: numbers of steps predicted from the fits of others."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.fitting import WHOLE, Fit
from coadjoint.choosing.growth import Growth
from coadjoint.choosing.pilot import REFERENCE, Trial
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.taylor import Taylor

# Divisors that make a cost predicted from related schemes a lower bound: for series, predicted from the nearest order,
# and for other schemes. The bound is lower still if the related fit was extrapolated far. Series skipped wrongly are
# mostly cheaper by only a few per cent.
NEAR_KIN = 1.2
KIN = 1.6
# Before two series were tried: ratio of constant to variable steps at the same order, and the smallest useful estimate.
AS_LOOK, FEW = 1.25, 12.0
# Without related schemes: competitive schemes of order p needed at least 1 / AHEAD (typically 1 / OFTEN_AHEAD) of the
# steps of the series of order p, and at least min(p, ROUNDS) iterations of their stages.
AHEAD = 4.0
OFTEN_AHEAD = 2.5
ROUNDS = 10.0
APART = 4
LEAST = 2.0**-1000


class Law:
    """Error model of series, c (h / r)^p, fitted to two of them; predicts the steps of any order.

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


class Foresight:
    """Cost model of the remaining schemes with constant steps, from the fits so far.

    `goal_of` maps a candidate to its target error at the end; `look` is the first trial of a scheme with variable
    steps, or None.
    """

    def __init__(self, goal_of: Callable[[Candidate], float], look: Fit | None) -> None:
        self._goal_of, self._look = goal_of, look
        self._fits: list[Fit] = []
        self._law: Law | None = None

    def learn(self, fit: Fit) -> bool:
        """Add a fit; return whether predictions have just become available.

        A fit that was abandoned counts too, unless its error is meaningless.
        """
        if fit.end >= WHOLE:
            return False
        self._fits.append(fit)
        if self._law is not None:
            return False
        self._law = law_of(self._fits)
        return self._law is not None

    def guess(self, candidate: Candidate) -> float | None:
        """Estimate the number of steps of a scheme; None if there is no estimate yet."""
        if self._law is None:
            return self._guess_by_look(candidate)
        kin = self._kin_of(candidate)
        if kin:
            return self._steps(self._law, candidate, kin[0])
        return self._law.steps(candidate.method.order, self._goal_of(candidate)) / OFTEN_AHEAD

    def _guess_by_look(self, candidate: Candidate) -> float | None:
        """Estimate the steps of a series of high order from a trial with variable steps."""
        order = candidate.method.order
        if self._look is None or order < REFERENCE.order or not _is_series(candidate.method):
            return None
        difference = 1.0 / self._look.candidate.method.order - 1.0 / order
        steps = AS_LOOK * self._look.steps * self._goal_of(candidate) ** difference
        # Estimates of few steps are too inaccurate.
        return steps if steps > FEW else None

    def least_cost(self, candidate: Candidate) -> float:
        """Return a lower bound on the cost of a scheme; 0 if there is no estimate yet."""
        if self._law is None:
            return 0.0
        kin = self._kin_of(candidate)
        if _is_series(candidate.method):
            return self._cost_as(self._law, candidate, kin[0]) / NEAR_KIN
        if kin:
            return min(self._cost_as(self._law, candidate, each) for each in kin) / KIN
        order = candidate.method.order
        steps = self._law.steps(order, self._goal_of(candidate)) / AHEAD
        return steps * _cost(candidate, min(float(order), ROUNDS), order / 2)  # no tableau of s stages is above 2 s

    def cheapest_first(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Sort the series by predicted cost; other schemes follow in their order."""
        series = [each for each in candidates if _is_series(each.method)]
        return [*sorted(series, key=self.least_cost), *(each for each in candidates if not _is_series(each.method))]

    def _kin_of(self, candidate: Candidate) -> list[Fit]:
        """Return the fits of related schemes, nearest order first."""
        method = candidate.method
        kin = [each for each in self._fits if not each.trial.newton and _alike(each.candidate.method, method)]
        return sorted(kin, key=lambda each: abs(each.candidate.method.order - method.order))

    def _steps(self, law: Law, candidate: Candidate, kin: Fit) -> float:
        """Predict the steps of a scheme from those of a related one, scaled by the model."""
        of_kin = law.steps(kin.candidate.method.order, self._goal_of(kin.candidate))
        return kin.steps * law.steps(candidate.method.order, self._goal_of(candidate)) / of_kin

    def _cost_as(self, law: Law, candidate: Candidate, kin: Fit) -> float:
        """Predict the cost of a scheme from a related one; reduced if that was extrapolated far."""
        stages = kin.trial.evaluations / max(kin.trial.iterations, 1.0)
        stages *= candidate.method.order / kin.candidate.method.order
        steps = self._steps(law, candidate, kin) / math.sqrt(kin.extrapolated)
        return steps * _cost(candidate, kin.trial.iterations, stages)


def _cost(candidate: Candidate, iterations: float, stages: float) -> float:
    trial = Trial(1, Growth(0.0, 0.0, 0.0), iterations, iterations * stages)
    return candidate.cost(trial) * candidate.share


def law_of(fits: Sequence[Fit]) -> Law | None:
    """Return the model by the first two series with sufficiently different orders; None if there are none."""
    series = [each for each in fits if _is_series(each.candidate.method)]
    for other, one in ((a, b) for k, a in enumerate(series) for b in series[:k]):
        if abs(one.candidate.method.order - other.candidate.method.order) >= APART:
            return Law(one, other)
    return None


def _alike(one: Method, other: Method) -> bool:
    """Test whether two schemes differ only in order or stages (series: in anything)."""
    if _is_series(one) or _is_series(other):
        return _is_series(one) and _is_series(other)
    if type(one) is not type(other) or not is_dataclass(one):
        return False
    for name in ("order", "stages"):
        if any(field.name == name and field.init for field in fields(one)):
            try:
                return bool(replace(one, **{name: getattr(other, name)}) == other)
            except (ValueError, TypeError):
                return False  # there is no such order of this family
    return False


def _is_series(method: Method) -> bool:
    """Test whether a scheme is a Taylor series with constant steps."""
    return isinstance(method, Taylor) and not method.own_steps
