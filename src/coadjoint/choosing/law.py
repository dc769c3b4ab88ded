"""Which schemes need not be tried? The fits of some say about how many steps the others need."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.fitting import WHOLE, Fit
from coadjoint.choosing.growth import Growth
from coadjoint.choosing.pilot import REFERENCE, Trial
from coadjoint.methods.base import Method
from coadjoint.methods.taylor import Taylor

# What a scheme costs at the least is what its kin foretells by this: series, of which that of the nearest order is
# believed, and others. The further the steps of kin were extrapolated, the less they are believed. A series that is
# left out is cheaper by a few per cent, mostly.
NEAR_KIN = 1.2
KIN = 1.6
# Before two series were tried: constant steps are so many times as many as those that follow the motion, to one order.
AS_LOOK, FEW = 1.25, 12.0
# Where no kin was tried: schemes of order p needed no less than a quarter of the steps of the series of order p, where
# they came near to the best. Their iterations of stages took no less than so many rounds, or their order where that is
# less.
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


class Foresight:
    """What the fits so far foretell of the schemes that are left, all with steps that are given to them.

    Parameters
    ----------
    goal_of : callable
        The error at the end that a candidate is to reach.
    look : Fit or None
        What a look at a scheme with steps of its own has shown.
    """

    def __init__(self, goal_of: Callable[[Candidate], float], look: Fit | None) -> None:
        self._goal_of, self._look = goal_of, look
        self._fits: list[Fit] = []
        self._law: Law | None = None

    def learn(self, fit: Fit) -> bool:
        """Take in what one more scheme needs; return whether something is foretold now, and was not before.

        A fit that was given up counts too, unless its error tells nothing.
        """
        if fit.end >= WHOLE:
            return False
        self._fits.append(fit)
        if self._law is not None:
            return False
        self._law = law_of(self._fits)
        return self._law is not None

    def guess(self, candidate: Candidate) -> float | None:
        """Return about how many steps a scheme needs; None where nothing is foretold."""
        if self._law is None:
            return self._guess_by_look(candidate)
        kin = self._kin_of(candidate)
        if kin:
            return self._steps(self._law, candidate, kin[0])
        return self._law.steps(candidate.method.order, self._goal_of(candidate)) / OFTEN_AHEAD

    def _guess_by_look(self, candidate: Candidate) -> float | None:
        """Return about how many steps a series of high order needs, by a look at steps of its own."""
        order = candidate.method.order
        if self._look is None or order < REFERENCE.order or not _is_series(candidate.method):
            return None
        difference = 1.0 / self._look.candidate.method.order - 1.0 / order
        steps = AS_LOOK * self._look.steps * self._goal_of(candidate) ** difference
        # Of few steps one more or less matters.
        return steps if steps > FEW else None

    def least_cost(self, candidate: Candidate) -> float:
        """Return what a scheme costs at the least; 0 where nothing is foretold."""
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
        """Return the series in the order of what they are foretold to cost, then all others as they were."""
        series = [each for each in candidates if _is_series(each.method)]
        return [*sorted(series, key=self.least_cost), *(each for each in candidates if not _is_series(each.method))]

    def _kin_of(self, candidate: Candidate) -> list[Fit]:
        """Return the fits of the same kind of scheme, the nearest order first."""
        method = candidate.method
        kin = [each for each in self._fits if not each.trial.newton and _alike(each.candidate.method, method)]
        return sorted(kin, key=lambda each: abs(each.candidate.method.order - method.order))

    def _steps(self, law: Law, candidate: Candidate, kin: Fit) -> float:
        """Return the steps of a scheme: those of its kin, in the proportion of the law."""
        of_kin = law.steps(kin.candidate.method.order, self._goal_of(kin.candidate))
        return kin.steps * law.steps(candidate.method.order, self._goal_of(candidate)) / of_kin

    def _cost_as(self, law: Law, candidate: Candidate, kin: Fit) -> float:
        """Return what a scheme costs as its kin does, and less where that was extrapolated far."""
        stages = kin.trial.evaluations / max(kin.trial.iterations, 1.0)
        stages *= candidate.method.order / kin.candidate.method.order
        steps = self._steps(law, candidate, kin) / math.sqrt(kin.extrapolated)
        return steps * _cost(candidate, kin.trial.iterations, stages)


def _cost(candidate: Candidate, iterations: float, stages: float) -> float:
    trial = Trial(1, Growth(0.0, 0.0, 0.0), iterations, iterations * stages)
    return candidate.cost(trial) * candidate.share


def law_of(fits: Sequence[Fit]) -> Law | None:
    """Return the law by the first two series that are far enough apart; None where there are none among the fits."""
    series = [each for each in fits if _is_series(each.candidate.method)]
    for other, one in ((a, b) for k, a in enumerate(series) for b in series[:k]):
        if abs(one.candidate.method.order - other.candidate.method.order) >= APART:
            return Law(one, other)
    return None


def _alike(one: Method, other: Method) -> bool:
    """Return whether two schemes differ in their order or their stages alone; of series in anything."""
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
    """Return whether a scheme is a series in steps that are given to it."""
    return isinstance(method, Taylor) and not method.own_steps
