"""Checks of the order and of the convergence to an independent reference."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.certificates.certificate import Row, verdict
from coadjoint.analysis.checks.reference import motion
from coadjoint.analysis.checks.study import ERROR_RATIO, LARGE_ERROR, Study, measured_order
from coadjoint.analysis.checks.subject import Subject
from coadjoint.analysis.powers import FLOOR_FACTOR, OrderFit, error_by_comparison
from coadjoint.errors import IntegrationError
from coadjoint.rounding import UNIT_ROUNDOFF

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


def convergence_rows(subject: Subject, study: Study | None) -> list[Row]:
    """Return the rows on the order and on the limit of small steps, from the study (None without a reference)."""
    p = subject.claims.order
    declared_order = "nothing" if p is None else str(p)
    declared_limit = "converges"
    if study is None or subject.at_equilibrium:
        reason = "no reference: the motion is too fast for the step, or leaves the range of float64"
        reason = "every state rests" if subject.at_equilibrium else reason
        return [
            Row(key, what, declared, "-", verdict(claimed, None), claimed=claimed, reason=reason)
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
    p, size = subject.claims.order or 4, float(subject.norm(subject.states)) or 1.0
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
    p = subject.claims.order
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
        elif min(study.errors) > LARGE_ERROR:
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
    return Row(
        "order",
        "order",
        declared,
        measured,
        verdict(p is not None, holds),
        claimed=p is not None,
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
    if holds and last > LARGE_ERROR:
        holds, reason = False, "no step came near the motion"
    if study.given in study.counts:
        error = study.errors[study.counts.index(study.given)]
        measured = f"error {error:.2g} at the given step after t = {study.span:.3g}, "
        measured += f"{last:.2g} at {study.steps[-1]:.3g}" if shorter is None else f"{last:.2g} by shorter steps"
    else:
        error = last
        measured = f"error {last:.2g} at the step {study.steps[-1]:.3g} after t = {study.span:.3g}"
        reason = reason or next(iter(study.failed), "the given step is below all of these")
    return Row(
        "reference",
        LIMIT_ROW,
        declared,
        f"{measured}, against {study.reference.by}",
        verdict(True, holds),
        claimed=True,
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
    with_shorter = replace(subject, method=finer.method, _prepared={}, _conditions={}, _tangents={})
    try:
        end = with_shorter.run(subject.states, study.span / finer.steps, finer.steps).x[-1]
    except IntegrationError:
        return None
    return end, finer.left


def allowed_error(change: float, left: float) -> float:
    """Return the allowed error of a result, with the fraction `left` of the error of another, from their difference."""
    return ERROR_FACTOR * left * float(error_by_comparison(change, left))
