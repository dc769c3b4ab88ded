"""Do small steps lead to the motion, and at which order? Errors over a fixed time against an independent reference."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.certificate import Row, verdict
from coadjoint.analysis.checks.reference import Motion, motion
from coadjoint.analysis.checks.slope import CLEAR, Slope, slope
from coadjoint.analysis.checks.subject import Subject
from coadjoint.errors import IntegrationError
from coadjoint.rounding import UNIT_ROUNDOFF

Floats = NDArray[np.float64]

# The span, in natural times: long enough for errors to be those of the motion, short enough not to amplify them.
NATURAL_TIMES = 2.0
SHORTER = 4
"""How often the span is halved where the motion cannot be followed over it."""
# Beyond this relative error the order says nothing.
LARGE = 0.05
FINEST, FINEST_OF_PYTHON = 512, 128
"""Steps over the span that are not exceeded, of compiled steps and others, unless the given step takes more."""
MOST_GIVEN = 4096
FEW = 64
MOST_TRIALS = 16
MOST_SINGLE = 12
# Between two steps of the study errors of high order fall by so much, those of low order by a half of the step.
FALL = 16.0
# A slope that is less sure cannot tell an order from its neighbour; high orders are told to a part of them.
UNSURE, UNSURE_PART = 0.4, 1.0 / 10.0
NEAR, NEAR_PART = 0.5, 1.0 / 16.0
# Orders are whole numbers. A quarter of the way to the next is left for what the uncertainty does not see: later terms
# of the error, and their accidents.
MARGIN = 0.25
# How many times the error may exceed what the last change of the step makes of it: errors of half the declared order
# exceed it by 1 + 2^(p/2) at most where steps are halved, and the first steps by their next term.
LIMIT = 6.0
LIMIT_OF_STEPS = "limit of small steps"


@dataclass(frozen=True)
class Study:
    """Errors at the end of a span for several numbers of steps.

    Parameters
    ----------
    span : float
        Its length, negative for backward.
    counts : list of int
        Numbers of steps, increasing.
    ends : list of ndarray, shape (k, n)
        The states there.
    errors, floors : list of float
        Relative to the size of the states; what rounding may have made of them.
    reference : Motion
    given : int
        The number of steps of the given size; 0 where they are not among these.
    failed : list of str
        What was said of numbers of steps that failed.
    """

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
        """Sizes of the steps."""
        return [abs(self.span) / count for count in self.counts]

    @property
    def slope(self) -> Slope | None:
        """Of the errors that are neither large nor rounding."""
        inside = [k for k, error in enumerate(self.errors) if error < LARGE]
        return slope(*([values[k] for k in inside] for values in (self.steps, self.errors, self.floors)))

    def telling(self, h: float) -> float:
        """Return the largest step at which the scheme is still near the motion, or the given one if that is larger."""
        near = [self.span / n for n, error in zip(self.counts, self.errors, strict=True) if error < LARGE / 5]
        largest = near[0] if near else h
        return largest if abs(largest) > 1.01 * abs(h) else h


def study(subject: Subject) -> Study | None:
    """Run the scheme over a span with the given step, then with smaller and larger ones, as long as that tells more.

    Parameters
    ----------
    subject : Subject
        What is looked at.

    Returns
    -------
    Study or None
        None where there is no reference.
    """
    p = subject.claims.order
    for halving in range(SHORTER):
        wanted = NATURAL_TIMES / 2.0**halving * subject.span_time
        # Where the given step is tiny, the order is looked at with larger ones; where it is huge, with smaller ones.
        given = round(wanted / abs(subject.h)) if halving else max(1, round(wanted / abs(subject.h)))
        given = 0 if given > MOST_GIVEN else given
        span, first = (given * subject.h, given) if given else (math.copysign(wanted, subject.h), FEW)
        reference = motion(subject.system, subject.states, span)
        if reference is not None:
            break
    else:
        return None
    finest = FINEST if subject.compiled else FINEST_OF_PYTHON
    ratio = min(2.0, FALL ** (1.0 / p)) if p else math.sqrt(2.0)
    found = Study(span, [], [], [], [], reference, given, [])
    size = float(np.linalg.norm(reference.states)) or 1.0

    def tried(count: int) -> bool:
        if count in found.counts:
            return True
        try:
            end = subject.run(subject.states, span / count, count).x[-1]
        except IntegrationError as error:
            found.failed.append(f"{count} steps: {error}")
            return False
        place = int(np.searchsorted(found.counts, count))
        rounding = UNIT_ROUNDOFF * (8 + 2 * math.sqrt(count * subject.evaluations)) + subject.noise * count / size
        found.counts.insert(place, count)
        found.ends.insert(place, end)
        found.errors.insert(place, float(np.linalg.norm(end - reference.states)) / size)
        found.floors.insert(place, 2 * reference.error + rounding)
        return True

    def clear(count: int) -> bool:
        k = found.counts.index(count)
        return found.errors[k] > CLEAR * found.floors[k]

    # From steps that only round-off tells apart to those whose errors tell, fast; then finer ones down to round-off
    # again, and coarser ones up to large errors.
    known = tried(first)
    while known and first > 1 and not clear(first):
        first = max(1, first // 2)
        known = tried(first)
    count = first
    for _ in range(MOST_TRIALS):
        if count in found.counts and not clear(count):
            break
        count = max(count + 1, math.ceil(count * ratio))
        if count > max(finest, 4 * first):
            break
        tried(count)
    count = first
    for _ in range(MOST_TRIALS):
        if count == 1 or (found.errors and found.errors[0] > LARGE):
            break
        count = min(count - 1, math.floor(count / ratio))
        if not tried(count):
            break
    return found if found.counts else None


def convergence_rows(subject: Subject, found: Study | None) -> list[Row]:
    """Return the rows on the order and on the reference.

    Parameters
    ----------
    subject : Subject
        What is looked at.
    found : Study or None
        From `study`.

    Returns
    -------
    list of Row
    """
    p = subject.claims.order
    declared = "nothing" if p is None else str(p)
    converges = "nothing" if p is None else "converges"
    if found is None or subject.rests:
        why = "no reference: the motion is too fast for the step, or leaves float64"
        why = "every state rests" if subject.rests else why
        return [
            Row(key, what, said, "-", verdict(p is not None, None), claimed=p is not None, reason=why)
            for key, what, said in (("order", "order", declared), ("reference", LIMIT_OF_STEPS, converges))
        ]
    evidence = {
        "steps": np.array(found.steps),
        "errors": np.array(found.errors),
        "round-off": np.array(found.floors),
        "span": found.span,
    }
    return [_order_row(subject, found, declared, evidence), _reference_row(subject, found, p, converges, evidence)]


def _unsure(fitted: Slope) -> bool:
    return fitted.uncertainty > max(UNSURE, UNSURE_PART * fitted.value)


def _single_steps(subject: Subject, found: Study) -> Slope | None:
    """Return the order by the errors of single steps, less one: few steps of a high order fit into the span."""
    p, size = subject.claims.order or 4, float(np.linalg.norm(subject.states)) or 1.0
    largest = found.telling(math.copysign(subject.span_time, subject.h))
    steps, errors, floors = [], [], []
    for k in range(MOST_SINGLE):
        h = largest / FALL ** (k / (p + 1))
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
        if errors[-1] < CLEAR * floors[-1]:
            break
    fitted = slope(steps, errors, floors)
    return None if fitted is None else fitted._replace(value=fitted.value - 1.0)


def _order_row(subject: Subject, found: Study, declared: str, evidence: dict[str, object]) -> Row:
    p = subject.claims.order
    kept: bool | None = None
    fitted, reason, of = found.slope, "", "over a span"
    if fitted is None or fitted.uncertainty > UNSURE:
        alone = _single_steps(subject, found)
        if alone is not None and (fitted is None or alone.uncertainty < fitted.uncertainty):
            fitted, of = alone, "of single steps"
    if fitted is None:
        measured = "-"
        reason = "fewer than three errors between 5 % and round-off; take another step"
        if not any(error > CLEAR * floor for error, floor in zip(found.errors, found.floors, strict=True)):
            kept, measured, reason = True, f"no error above round-off at any step up to {found.steps[0]:.3g}", ""
        elif min(found.errors) > LARGE:
            kept, measured = False, f"errors of {min(found.errors):.1g} and more at every step"
            reason = found.failed[-1] if found.failed else ""
    else:
        unsure, least = _unsure(fitted), 0.5 if p is None else p
        measured = f"{fitted}, by errors {of}, steps from {fitted.steps[0]:.3g} to {fitted.steps[-1]:.3g}"
        if fitted.value + (2.0 if unsure else 1.0) * fitted.uncertainty < least - MARGIN:
            kept = None if fitted.steepening > UNSURE else False
            reason = "" if kept is False else "errors fall ever faster; take a smaller step"
        elif unsure or fitted.value < least - max(NEAR, NEAR_PART * least):
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
    """Return whether small steps lead to the motion; a flow at another speed settles on something else."""
    last, bound = found.errors[-1], CLEAR * found.floors[-1]
    size = float(np.linalg.norm(found.reference.states)) or 1.0
    if len(found.counts) > 1:
        change = float(np.linalg.norm(found.ends[-1] - found.ends[-2])) / size
        bound += allowed(change, found.counts[-1] / found.counts[-2], p)
    kept: bool | None = last <= bound
    reason = found.reference.doubt
    if kept and last > LARGE:
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
        LIMIT_OF_STEPS,
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


def allowed(change: float, ratio: float, order: int | None) -> float:
    """Return the error at the smaller of two steps that the change from the larger one to it allows.

    Parameters
    ----------
    change : float
        The difference of what the two steps lead to.
    ratio : float
        Of the steps, above 1.
    order : int or None
        That is declared; 1 where none is.

    Returns
    -------
    float
        6 times change / (ratio^order - 1), which is the error where it is C h^order alone.

    Examples
    --------
    >>> round(allowed(3e-6, 2.0, 2), 12)
    6e-06
    """
    return LIMIT * change / (ratio ** (order or 1) - 1.0)
