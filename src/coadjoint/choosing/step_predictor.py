"""Numbers of steps and costs of schemes not yet tried, predicted from the fits of others."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.fitting import MEANINGLESS_ERROR, StepFit
from coadjoint.choosing.pilot import REFERENCE, PilotErrors, Trial
from coadjoint.methods.protocol.method import Method

# Divisors that make a cost predicted from related schemes a lower bound: for series, predicted from the nearest order,
# and for other schemes. The bound is lower still if the related fit was extrapolated far. Series skipped wrongly are
# mostly cheaper by only a few per cent.
NEAREST_DIVISOR = 1.2
RELATED_DIVISOR = 1.6
# Before two series are fitted: ratio of constant to variable steps at the same order, and the smallest useful estimate.
CONSTANT_STEP_RATIO, MIN_PREDICTED_STEPS = 1.25, 12.0
# Without related schemes: competitive schemes of order p need at least 1 / MAX_ADVANTAGE (typically
# 1 / TYPICAL_ADVANTAGE) of the steps of the series of order p, and at least min(p, MIN_ITERATIONS) iterations.
MAX_ADVANTAGE = 4.0
TYPICAL_ADVANTAGE = 2.5
MIN_ITERATIONS = 10.0
MIN_ORDER_DIFFERENCE = 4  # of two series, so that rounding of their fits hardly moves the model
MIN_ERROR = 2.0**-1000  # relative error in place of zero, of which no logarithm exists


SeriesErrorModel = Callable[[int, float], float]
"""Function of an order and an error that returns the steps of a series."""


class StepPredictor:
    """Cost model of the remaining schemes with constant steps, from the fits so far."""

    def __init__(self, goal_of: Callable[[Candidate], float], first_trial: StepFit | None) -> None:
        self._goal_of, self._first_trial = goal_of, first_trial
        self._fits: list[StepFit] = []
        self._error_model: SeriesErrorModel | None = None

    def add_fit(self, fit: StepFit) -> bool:
        """Add a fit, also an abandoned one; return whether predictions have just become available."""
        if fit.end >= MEANINGLESS_ERROR:
            return False
        self._fits.append(fit)
        if self._error_model is not None:
            return False
        self._error_model = series_error_model(self._fits)
        return self._error_model is not None

    def predict_steps(self, candidate: Candidate) -> float | None:
        """Estimate the number of steps of a scheme; None if there is no estimate yet."""
        if self._error_model is None:
            return self._steps_from_trial(candidate)
        related = self._related_fits(candidate)
        if related:
            return self._steps(self._error_model, candidate, related[0])
        return self._error_model(candidate.method.order, self._goal_of(candidate)) / TYPICAL_ADVANTAGE

    def _steps_from_trial(self, candidate: Candidate) -> float | None:
        """Estimate the steps of a series of high order from a trial with variable steps."""
        order = candidate.method.order
        if self._first_trial is None or order < REFERENCE.order or not _is_series(candidate.method):
            return None
        difference = 1.0 / self._first_trial.candidate.method.order - 1.0 / order
        steps = CONSTANT_STEP_RATIO * self._first_trial.steps * self._goal_of(candidate) ** difference
        # Estimates of few steps are too inaccurate.
        return steps if steps > MIN_PREDICTED_STEPS else None

    def cost_lower_bound(self, candidate: Candidate) -> float:
        """Return a lower bound on the cost of a scheme; 0 if there is no estimate yet."""
        if self._error_model is None:
            return 0.0
        related = self._related_fits(candidate)
        if _is_series(candidate.method):
            return self._related_cost(self._error_model, candidate, related[0]) / NEAREST_DIVISOR
        if related:
            return min(self._related_cost(self._error_model, candidate, each) for each in related) / RELATED_DIVISOR
        order = candidate.method.order
        steps = self._error_model(order, self._goal_of(candidate)) / MAX_ADVANTAGE
        return steps * _step_cost(
            candidate, min(float(order), MIN_ITERATIONS), order / 2
        )  # no tableau of s stages is above 2 s

    def cheapest_first(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Sort the series by predicted cost; other schemes follow in their order."""
        series = [each for each in candidates if _is_series(each.method)]
        return [
            *sorted(series, key=self.cost_lower_bound),
            *(each for each in candidates if not _is_series(each.method)),
        ]

    def _related_fits(self, candidate: Candidate) -> list[StepFit]:
        """Return the fits of related schemes, nearest order first."""
        method = candidate.method
        related = [each for each in self._fits if not each.trial.newton and _related(each.candidate.method, method)]
        return sorted(related, key=lambda each: abs(each.candidate.method.order - method.order))

    def _steps(self, error_model: SeriesErrorModel, candidate: Candidate, related: StepFit) -> float:
        """Predict the steps of a scheme from those of a related one, scaled by the model."""
        related_steps = error_model(related.candidate.method.order, self._goal_of(related.candidate))
        return related.steps * error_model(candidate.method.order, self._goal_of(candidate)) / related_steps

    def _related_cost(self, error_model: SeriesErrorModel, candidate: Candidate, related: StepFit) -> float:
        """Predict the cost of a scheme from a related one; reduced if that was extrapolated far."""
        stages = related.trial.evaluations / max(related.trial.iterations, 1.0)
        stages *= candidate.method.order / related.candidate.method.order
        steps = self._steps(error_model, candidate, related) / math.sqrt(related.extrapolated)
        return steps * _step_cost(candidate, related.trial.iterations, stages)


def _step_cost(candidate: Candidate, iterations: float, stages: float) -> float:
    trial = Trial(1, PilotErrors(0.0, 0.0, 0.0), iterations, iterations * stages)
    return candidate.cost(trial) * candidate.share


def series_error_model(fits: Sequence[StepFit]) -> SeriesErrorModel | None:
    """Fit the error model c (h / r)^p to the first two series with sufficiently different orders; None without them.

    It returns the steps N over the whole span that a series of order p needs for an error:
    ``log N = log(T / r) + (log c - log goal) / p``.
    """
    series = [each for each in fits if _is_series(each.candidate.method)]
    for second, first in ((a, b) for k, a in enumerate(series) for b in series[:k]):
        p, q = first.candidate.method.order, second.candidate.method.order
        if abs(p - q) >= MIN_ORDER_DIFFERENCE:
            at_p, at_q = (
                math.log(fit.steps) + math.log(max(fit.error, MIN_ERROR)) / order
                for fit, order in ((first, p), (second, q))
            )
            amount = (at_p - at_q) / (1.0 / p - 1.0 / q)
            rate = at_p - amount / p
            return lambda order, goal: math.exp(min(rate + (amount - math.log(goal)) / order, 700.0))
    return None


def _related(first: Method, second: Method) -> bool:
    """Test whether two schemes differ only in order or stages (series: in anything)."""
    if _is_series(first) or _is_series(second):
        return _is_series(first) and _is_series(second)
    if type(first) is not type(second) or not is_dataclass(first):
        return False
    for name in ("order", "stages"):
        if any(field.name == name and field.init for field in fields(first)):
            try:
                return bool(replace(first, **{name: getattr(second, name)}) == second)
            except (ValueError, TypeError):
                return False  # the family has no such order
    return False


def _is_series(method: Method) -> bool:
    """Test whether a scheme is a series at constant steps: one that could choose its own steps by an error estimate."""
    return method.takes_tolerance and not method.own_steps
