"""Families of schemes that differ only in their order: one is tried, and then those that it predicts to be cheaper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from functools import partial

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.fitting import MEANINGLESS_ERROR, MIN_GOAL, StepFit, fit, fit_of_own_steps, target_error
from coadjoint.choosing.pilot import Pilot

# Parameters in which the schemes of a family differ.
VARIED = ("order", "stages", "tolerance")
# Least difference of two orders from which others are predicted, so that rounding of their fits hardly matters.
MIN_ORDER_DIFFERENCE = 4


def families(candidates: Sequence[Candidate]) -> list[list[Candidate]]:
    """Group the candidates that differ only in order, stages or tolerance, in the order of the first of each."""
    found = dict[object, list[Candidate]]()
    for candidate in candidates:
        method = candidate.method
        options = repr(method)
        if is_dataclass(method):
            others = [each.name for each in fields(method) if each.init and each.name not in VARIED]
            options = repr([getattr(method, name) for name in others])
        key = type(method), method.own_steps, options
        found.setdefault(key, []).append(candidate)
    return list(found.values())


def fits_of_family(pilot: Pilot, family: Sequence[Candidate], required: float, limit: float) -> list[StepFit]:
    """Return the fits of a family; `limit` is the cost of the cheapest one of other families."""
    if family[0].method.own_steps:
        return [found for each in family if (found := fit_of_own_steps(pilot, each, required)) is not None]
    goal, fits, used = target_error(pilot, required), list[StepFit](), list[StepFit]()
    pending = sorted(family, key=lambda each: each.method.order)
    # Of the orders that are offered, these are rarely far from the best: series of order 16, and eight stages.
    pending.insert(0, pending.pop(2 * len(pending) // 3))
    while pending:
        candidate = pending.pop(0)
        found = fit(pilot, candidate, goal, limit, predicted_steps(candidate, used, goal) if used else None)
        if found is None and limit < math.inf:
            break
        if found is not None:
            fits.append(found)
            limit = min(limit, found.cost)
            if found.end < MEANINGLESS_ERROR:
                used.append(found)
        if used:
            predicted = partial(predicted_cost, fits=used, goal=goal)
            pending = sorted((each for each in pending if predicted(each) < limit), key=predicted)
    return fits


def predicted_steps(candidate: Candidate, fits: Sequence[StepFit], goal: float) -> float:
    """Predict the steps of a scheme from fits of its family."""
    # Errors c (h / r)^p for all orders p: the logarithm of the steps is linear in 1 / p.
    inverse = 1.0 / candidate.method.order
    points = sorted(
        ((1.0 / each.candidate.method.order, _log_steps(each, goal)) for each in fits),
        key=lambda point: abs(point[0] - inverse),
    )
    (at, steps), *others = points
    slope = -math.log(goal)  # if c = 1
    for other, more in others:
        if abs(1.0 / other - 1.0 / at) >= MIN_ORDER_DIFFERENCE:
            slope = max(0.0, (more - steps) / (other - at))
            break
    return math.exp(min(steps + slope * (inverse - at), 700.0))


def _log_steps(fitted: StepFit, goal: float) -> float:
    """Return the logarithm of the number of steps for an error, which need not be whole."""
    ratio = max(fitted.error, MIN_GOAL) / goal
    return math.log(fitted.steps) + math.log(ratio) / fitted.candidate.method.order


def predicted_cost(candidate: Candidate, fits: Sequence[StepFit], goal: float) -> float:
    """Predict the cost of a scheme from fits of its family, with the iterations of the nearest one."""
    order = candidate.method.order
    nearest = min(fits, key=lambda each: abs(each.candidate.method.order - order))
    evaluations = nearest.trial.evaluations * order / nearest.candidate.method.order
    step = candidate.cost(nearest.trial._replace(evaluations=evaluations)) * candidate.share
    return step * predicted_steps(candidate, fits, goal)
