"""Checks of the order and of the convergence to an independent reference."""

from __future__ import annotations

import math

import numpy as np

from coadjoint.analysis.certificates.certificate import Row, verdict
from coadjoint.analysis.checks.reference import motion
from coadjoint.analysis.checks.slope import FLOOR_FACTOR, Slope, slope
from coadjoint.analysis.checks.study import ERROR_RATIO, LARGE_ERROR, Study
from coadjoint.analysis.checks.subject import Subject
from coadjoint.errors import IntegrationError
from coadjoint.rounding import UNIT_ROUNDOFF

MAX_SINGLE_STEPS = 12
# A slope with a larger uncertainty does not distinguish neighbouring orders. For high orders the uncertainty may be a
# fraction of the order.
MAX_UNCERTAINTY, MAX_RELATIVE_UNCERTAINTY = 0.4, 1.0 / 10.0
ORDER_TOLERANCE, RELATIVE_ORDER_TOLERANCE = 0.5, 1.0 / 16.0
# Orders are integers; a margin of 1/4 allows for higher terms of the error, which the uncertainty omits.
MARGIN = 0.25
# The error may exceed the estimate from the last change of the step by this factor. If steps are halved, errors of
# half the declared order exceed it by at most 1 + 2^(p/2). Those of the first steps exceed it by their next term.
ERROR_FACTOR = 6.0
LIMIT_ROW = "limit of small steps"


def convergence_rows(subject: Subject, found: Study | None) -> list[Row]:
    """Return the rows on the order and on the limit of small steps, from the study (None without a reference)."""
    p = subject.claims.order
    declared = "nothing" if p is None else str(p)
    converges = "nothing" if p is None else "converges"
    if found is None or subject.at_equilibrium:
        why = "no reference: the motion is too fast for the step, or leaves the range of float64"
        why = "every state rests" if subject.at_equilibrium else why
        return [
            Row(key, what, said, "-", verdict(p is not None, None), claimed=p is not None, reason=why)
            for key, what, said in (("order", "order", declared), ("reference", LIMIT_ROW, converges))
        ]
    evidence = {
        "steps": np.array(found.steps),
        "errors": np.array(found.errors),
        "round-off": np.array(found.floors),
        "span": found.span,
    }
    return [_order_row(subject, found, declared, evidence), _reference_row(subject, found, p, converges, evidence)]


def _is_uncertain(fitted: Slope) -> bool:
    return fitted.uncertainty > max(MAX_UNCERTAINTY, MAX_RELATIVE_UNCERTAINTY * fitted.value)


def _single_steps(subject: Subject, found: Study) -> Slope | None:
    """Return the order from errors of single steps (their slope less one), since few steps of a high order fit into the
    span.
    """
    p, size = subject.claims.order or 4, float(np.linalg.norm(subject.states)) or 1.0
    largest = found.coarse_step(math.copysign(subject.span_time, subject.h))
    steps, errors, floors = [], [], []
    for k in range(MAX_SINGLE_STEPS):
        h = largest / ERROR_RATIO ** (k / (p + 1))
        reference = motion(subject.system, subject.states, h)
        if reference is None:
            continue
        try:
            after = subject.step(subject.states, h)
        except IntegrationError:
            continue
        rounding = UNIT_ROUNDOFF * (8 + 2 * math.sqrt(subject.evaluations)) + subject.noise / size
        steps.append(abs(h))
        errors.append(float(np.linalg.norm(after - reference.states)) / size)
        floors.append(2 * reference.error + rounding)
        if errors[-1] < FLOOR_FACTOR * floors[-1]:
            break
    fitted = slope(steps, errors, floors)
    return None if fitted is None else fitted._replace(value=fitted.value - 1.0)


def _order_row(subject: Subject, found: Study, declared: str, evidence: dict[str, object]) -> Row:
    p = subject.claims.order
    kept: bool | None = None
    fitted, reason, of = found.slope, "", "over a span"
    if fitted is None or fitted.uncertainty > MAX_UNCERTAINTY:
        alone = _single_steps(subject, found)
        if alone is not None and (fitted is None or alone.uncertainty < fitted.uncertainty):
            fitted, of = alone, "of single steps"
    if fitted is None:
        measured = "-"
        reason = "fewer than three errors between 5 % and round-off; take another step"
        if not any(error > FLOOR_FACTOR * floor for error, floor in zip(found.errors, found.floors, strict=True)):
            kept, measured, reason = True, f"no error above round-off at any step up to {found.steps[0]:.3g}", ""
        elif min(found.errors) > LARGE_ERROR:
            kept, measured = False, f"errors of {min(found.errors):.1g} and more at every step"
            reason = found.failed[-1] if found.failed else ""
    else:
        unsure, least = _is_uncertain(fitted), 0.5 if p is None else p
        measured = f"{fitted}, by errors {of}, steps from {fitted.steps[0]:.3g} to {fitted.steps[-1]:.3g}"
        if fitted.value + (2.0 if unsure else 1.0) * fitted.uncertainty < least - MARGIN:
            kept = None if fitted.steepening > MAX_UNCERTAINTY else False
            reason = "" if kept is False else "errors fall ever faster; take a smaller step"
        elif unsure or fitted.value < least - max(ORDER_TOLERANCE, RELATIVE_ORDER_TOLERANCE * least):
            reason = "the slope has not settled; take a smaller step"
        else:
            kept = True
            if p is not None and fitted.value - fitted.uncertainty > p + 0.5:
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
        verdict(p is not None, kept),
        claimed=p is not None,
        value=None if fitted is None else fitted.value,
        bound=None if p is None else float(p),
        source="declared; the slope may be lower by 1/4 and its uncertainty" if p is not None else "",
        reason=reason,
        evidence={**evidence, "uncertainty": math.inf if fitted is None else fitted.uncertainty},
    )


def _reference_row(subject: Subject, found: Study, p: int | None, declared: str, evidence: dict[str, object]) -> Row:
    """Return the row on the limit of small steps; the flow of another speed has another limit."""
    last, bound = found.errors[-1], FLOOR_FACTOR * found.floors[-1]
    size = float(np.linalg.norm(found.reference.states)) or 1.0
    if len(found.counts) > 1:
        change = float(np.linalg.norm(found.ends[-1] - found.ends[-2])) / size
        bound += allowed_error(change, found.counts[-1] / found.counts[-2], p)
    kept: bool | None = last <= bound
    reason = found.reference.contradiction
    if kept and last > LARGE_ERROR:
        kept, reason = False, "no step came near the motion"
    if found.given in found.counts:
        at = found.errors[found.counts.index(found.given)]
        measured = f"error {at:.2g} at the given step after t = {found.span:.3g}, {last:.2g} at {found.steps[-1]:.3g}"
    else:
        at = last
        measured = f"error {last:.2g} at the step {found.steps[-1]:.3g} after t = {found.span:.3g}"
        reason = reason or next(iter(found.failed), "the given step is below all of these")
    return Row(
        "reference",
        LIMIT_ROW,
        declared,
        f"{measured}, against {found.reference.by}",
        verdict(p is not None, kept),
        claimed=p is not None,
        value=last,
        bound=bound,
        source="6 times the error that the last change of the step implies, and round-off",
        reason=reason,
        evidence={**evidence, "error at the given step": at, "error of the reference": found.reference.error},
    )


def allowed_error(change: float, ratio: float, order: int | None) -> float:
    """Return the error at the smaller of two steps that is consistent with the change from the larger one to it.

    6 change / (ratio^order - 1), where ratio > 1 is that of the steps; an undeclared order counts as 1. Without the
    factor 6 this is the error of a scheme whose error is exactly C h^order.
    """
    return ERROR_FACTOR * change / (ratio ** (order or 1) - 1.0)
