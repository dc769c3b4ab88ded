"""Convergence of a scheme: errors for several numbers of steps, their order, and their limit for small steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.certificates.certificate import Row, checked
from coadjoint.analysis.certificates.reference import Motion, motion
from coadjoint.analysis.certificates.subject import Subject
from coadjoint.analysis.powers import FLOOR_FACTOR, OrderFit, fit_order
from coadjoint.errors import IntegrationError
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.measured_steps import error_by_comparison

Floats = NDArray[np.float64]

# Span in natural times: long enough to sample the motion, short enough not to amplify errors.
NATURAL_TIMES = 2.0
SPANS_TRIED = 4
"""Number of spans, each half of the previous one, that are tried until the motion has a reference."""
# Larger relative errors are outside the asymptotic range.
ROUGH_ERROR = 0.05
MAX_STEPS_COMPILED, MAX_STEPS_PYTHON = 512, 128
"""Upper limits on steps over the span for compiled and other steps, unless the given step needs more."""
MAX_GIVEN_STEPS = 4096  # over the span, if the given step is short
FIRST_STEPS = 64  # over the span, from which halvings and doublings start
MAX_TRIALS = 16  # halvings and doublings, each way
TIME_LIMIT = 3.0
"""Approximate time limit of the study if steps are expensive."""
# Ratio of consecutive errors of the study at high order; at low order the step is halved.
ERROR_RATIO = 16.0

MAX_SINGLE_STEPS = 12  # lengths, halved each time: down to 1/4096 of the largest
# A slope with a larger uncertainty does not distinguish neighbouring orders. For high orders the uncertainty may be a
# fraction of the order.
MAX_UNCERTAINTY, MAX_RELATIVE_UNCERTAINTY = 0.4, 1.0 / 10.0
ORDER_TOLERANCE, RELATIVE_ORDER_TOLERANCE = 0.5, 1.0 / 16.0
# Orders are integers; a margin of 1/4 allows for higher terms of the error, which the uncertainty omits.
MARGIN = 0.25
# Largest ratio of the error to its estimate from the last change of the step. If steps are halved, errors of half the
# declared order exceed the estimate by at most 1 + 2^(p/2).
ERROR_FACTOR = 6.0
SHORTER = 2.0  # factor by which own steps are shorter for the limit
LIMIT_ROW = "limit of small steps"


@dataclass(frozen=True)
class Study:
    """Errors at the end of a signed span for increasing numbers of steps; `given` is that of the given step, or 0."""

    span: float
    counts: list[int]
    ends: list[Floats]
    errors: list[float]
    floors: list[float]
    reference: Motion
    given: int
    failed: list[str]

    @property
    def steps(self) -> list[float]:
        return [abs(self.span) / count for count in self.counts]

    @property
    def order(self) -> OrderFit | None:
        """The order of the errors that are below `ROUGH_ERROR` and above round-off."""
        inside = [k for k, error in enumerate(self.errors) if error < ROUGH_ERROR]
        return measured_order(*([values[k] for k in inside] for values in (self.steps, self.errors, self.floors)))

    def coarse_step(self, h: float) -> float:
        """Return the largest step at which the scheme still approximates the motion; at least the given one."""
        accurate = [self.span / n for n, error in zip(self.counts, self.errors, strict=True) if error < ROUGH_ERROR / 5]
        largest = accurate[0] if accurate else h
        return largest if abs(largest) > 1.01 * abs(h) else h


def measured_order(steps: Sequence[float], errors: Sequence[float], floors: Sequence[float]) -> OrderFit | None:
    """Fit an order; None if fewer than three errors are above round-off."""
    try:
        return fit_order(steps, errors, FLOOR_FACTOR * np.array(floors))
    except ValueError:
        return None


def order_of_defects(largest: float, count: int, measure: Callable[[float], tuple[float, float]]) -> OrderFit | None:
    """Fit the order of a defect; `measure` maps each of `count` signed steps to the defect and its round-off."""
    points = []
    for k in range(count):
        h = largest / 2.0 ** (k / 2)
        try:
            points.append((abs(h), *measure(h)))
        except (IntegrationError, TypeError, ValueError):
            continue
    return measured_order(*zip(*points, strict=True)) if points else None


def study(subject: Subject) -> Study | None:
    """Run the scheme over a span with the given step, then with smaller and larger ones; None without a reference."""
    p = subject.order
    finest = MAX_STEPS_COMPILED if subject.compiled else MAX_STEPS_PYTHON
    # All runs together take about twice the steps of the longest.
    limit = subject.affordable(TIME_LIMIT / 2)
    max_given, default, finest = min(MAX_GIVEN_STEPS, limit), min(FIRST_STEPS, max(1, limit // 4)), min(finest, limit)
    for halving in range(SPANS_TRIED):
        duration = NATURAL_TIMES / 2.0**halving * subject.span_time
        # For a tiny given step the order is measured with larger steps, for a huge one with smaller steps.
        given = round(min(duration / abs(subject.h), 2.0 * MAX_GIVEN_STEPS))
        given = given if halving else max(1, given)
        given = 0 if given > max_given else given
        span, first = (given * subject.h, given) if given else (math.copysign(duration, subject.h), default)
        reference = motion(subject.system, subject.states, span, subject.norm)
        if reference is not None:
            break
    else:
        return None
    ratio = min(2.0, ERROR_RATIO ** (1.0 / p)) if p else math.sqrt(2.0)
    result = Study(span, [], [], [], [], reference, given, [])
    size = float(subject.norm(reference.states)) or 1.0

    def run(count: int) -> bool:
        if count in result.counts:
            return True
        try:
            end = subject.run(subject.states, span / count, count).x[-1]
        except IntegrationError as error:
            result.failed.append(f"{count} steps: {error}")
            return False
        index = int(np.searchsorted(result.counts, count))
        rounding = UNIT_ROUNDOFF * (8 + 2 * math.sqrt(count * subject.evaluations)) + subject.noise * count / size
        result.counts.insert(index, count)
        result.ends.insert(index, end)
        result.errors.insert(index, float(subject.norm(end - reference.states)) / size)
        result.floors.insert(index, 2 * reference.error + rounding)
        return True

    def above_floor(count: int) -> bool:
        k = result.counts.index(count)
        return result.errors[k] > FLOOR_FACTOR * result.floors[k]

    # First larger steps until errors are above round-off, then smaller ones down to round-off, then larger ones up to
    # `ROUGH_ERROR`.
    succeeded = run(first)
    while succeeded and first > 1 and not above_floor(first):
        first = max(1, first // 2)
        succeeded = run(first)
    count = first
    for _ in range(MAX_TRIALS):
        if count in result.counts and not above_floor(count):
            break
        count = max(count + 1, math.ceil(count * ratio))
        if count > min(max(finest, 4 * first), limit):
            break
        run(count)
    count = first
    for _ in range(MAX_TRIALS):
        if count == 1 or (result.errors and result.errors[0] > ROUGH_ERROR):
            break
        count = min(count - 1, math.floor(count / ratio))
        if not run(count):
            break
    return result if result.counts else None


def convergence_rows(subject: Subject, study: Study | None) -> list[Row]:
    """Return the rows on the order and on the limit of small steps, from the study (None without a reference)."""
    p = subject.order
    declared_order = "nothing" if p is None else str(p)
    declared_limit = "converges"
    if study is None or subject.at_equilibrium:
        reason = "no reference: the motion is too fast for the step, or leaves the range of float64"
        reason = "every state rests" if subject.at_equilibrium else reason
        return [
            checked(key, what, declared, claimed, None, reason=reason)
            for key, what, declared, claimed in (
                ("order", "order", declared_order, p is not None),
                ("reference", LIMIT_ROW, declared_limit, True),
            )
        ]
    evidence = {
        "steps": np.array(study.steps),
        "errors": np.array(study.errors),
        "round-off": np.array(study.floors),
        "span": study.span,
    }
    return [
        _order_row(subject, study, declared_order, evidence),
        _reference_row(subject, study, p, declared_limit, evidence),
    ]


def _is_uncertain(fitted: OrderFit) -> bool:
    return fitted.uncertainty > max(MAX_UNCERTAINTY, MAX_RELATIVE_UNCERTAINTY * fitted.order)


def _single_steps(subject: Subject, study: Study) -> OrderFit | None:
    """Return the order from errors of single steps, their slope minus one, for high orders with few steps in a span."""
    p, size = subject.order or 4, float(subject.norm(subject.states)) or 1.0
    largest = study.coarse_step(math.copysign(subject.span_time, subject.h))
    steps, errors, floors = [], [], []
    for k in range(MAX_SINGLE_STEPS):
        h = largest / ERROR_RATIO ** (k / (p + 1))
        reference = motion(subject.system, subject.states, h, subject.norm)
        if reference is None:
            continue
        try:
            after = subject.step(subject.states, h)
        except IntegrationError:
            continue
        rounding = UNIT_ROUNDOFF * (8 + 2 * math.sqrt(subject.evaluations)) + subject.noise / size
        steps.append(abs(h))
        errors.append(float(subject.norm(after - reference.states)) / size)
        floors.append(2 * reference.error + rounding)
        if errors[-1] < FLOOR_FACTOR * floors[-1]:
            break
    fitted = measured_order(steps, errors, floors)
    return None if fitted is None else fitted._replace(order=fitted.order - 1.0)


def _order_row(subject: Subject, study: Study, declared: str, evidence: dict[str, object]) -> Row:
    p = subject.order
    holds: bool | None = None
    fitted, reason, of = study.order, "", "over a span"
    if fitted is None or fitted.uncertainty > MAX_UNCERTAINTY:
        single = _single_steps(subject, study)
        if single is not None and (fitted is None or single.uncertainty < fitted.uncertainty):
            fitted, of = single, "of single steps"
    if fitted is None:
        measured = "-"
        reason = "fewer than three errors between 5 % and round-off; take another step"
        if not any(error > FLOOR_FACTOR * floor for error, floor in zip(study.errors, study.floors, strict=True)):
            holds, measured, reason = True, f"no error above round-off at any step up to {study.steps[0]:.3g}", ""
        elif min(study.errors) > ROUGH_ERROR:
            holds, measured = False, f"errors of {min(study.errors):.1g} and more at every step"
            reason = study.failed[-1] if study.failed else ""
    else:
        uncertain, least = _is_uncertain(fitted), 0.5 if p is None else p
        measured = f"{fitted}, by errors {of}, steps from {fitted.steps[0]:.3g} to {fitted.steps[-1]:.3g}"
        if fitted.order + (2.0 if uncertain else 1.0) * fitted.uncertainty < least - MARGIN:
            holds = None if fitted.steepening > MAX_UNCERTAINTY else False
            reason = "" if holds is False else "errors fall ever faster; take a smaller step"
        elif uncertain or fitted.order < least - max(ORDER_TOLERANCE, RELATIVE_ORDER_TOLERANCE * least):
            reason = "the slope has not settled; take a smaller step"
        else:
            holds = True
            if p is not None and fitted.order - fitted.uncertainty > p + 0.5:
                reason = "higher than declared on this motion"
        evidence = {
            **evidence,
            "fitted steps": fitted.steps,
            "fitted errors": fitted.errors,
            "fitted of": of,
        }
    return checked(
        "order",
        "order",
        declared,
        p is not None,
        holds,
        measured,
        value=None if fitted is None else fitted.order,
        bound=None if p is None else float(p),
        source="declared; the slope may be lower by 1/4 and its uncertainty" if p is not None else "",
        reason=reason,
        evidence={**evidence, "uncertainty": math.inf if fitted is None else fitted.uncertainty},
    )


def _reference_row(subject: Subject, study: Study, p: int | None, declared: str, evidence: dict[str, object]) -> Row:
    """Return the row on the limit of small steps, which every scheme must pass; it detects wrong speeds."""
    last, bound = study.errors[-1], FLOOR_FACTOR * study.floors[-1]
    size = float(subject.norm(study.reference.states)) or 1.0
    shorter = _by_shorter_own_steps(subject, study)
    if shorter is not None:
        end, left = shorter
        last = float(subject.norm(end - study.reference.states)) / size
        bound += allowed_error(float(subject.norm(end - study.ends[-1])) / size, left)
    elif len(study.counts) > 1:
        change = float(subject.norm(study.ends[-1] - study.ends[-2])) / size
        bound += allowed_error(change, (study.counts[-2] / study.counts[-1]) ** (p or 1))
    holds: bool | None = last <= bound
    reason = study.reference.contradiction
    if holds and last > ROUGH_ERROR:
        holds, reason = False, "no step came near the motion"
    if study.given in study.counts:
        error = study.errors[study.counts.index(study.given)]
        measured = f"error {error:.2g} at the given step after t = {study.span:.3g}, "
        measured += f"{last:.2g} at {study.steps[-1]:.3g}" if shorter is None else f"{last:.2g} by shorter steps"
    else:
        error = last
        measured = f"error {last:.2g} at the step {study.steps[-1]:.3g} after t = {study.span:.3g}"
        reason = reason or next(iter(study.failed), "the given step is below all of these")
    return checked(
        "reference",
        LIMIT_ROW,
        declared,
        True,
        holds,
        f"{measured}, against {study.reference.by}",
        value=last,
        bound=bound,
        source="6 times the error that the last change of the step implies, and round-off",
        reason=reason,
        evidence={**evidence, "error at the given step": error, "error of the reference": study.reference.error},
    )


def _by_shorter_own_steps(subject: Subject, study: Study) -> tuple[NDArray[np.float64], float] | None:
    """Return the end by shorter steps of a scheme that chooses them, and the fraction of the error left; else None."""
    finer = subject.method.finer(study.counts[-1], SHORTER)
    if finer is None:
        return None
    with_shorter = replace(subject, method=finer.method)
    try:
        end = with_shorter.run(subject.states, study.span / finer.steps, finer.steps).x[-1]
    except IntegrationError:
        return None
    return end, finer.left


def allowed_error(change: float, left: float) -> float:
    """Return the allowed error of a result, with the fraction `left` of the error of another, from their difference."""
    return ERROR_FACTOR * left * float(error_by_comparison(change, left))
