"""Convergence study: errors at the end of a span for several numbers of steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.checks.reference import Motion, motion
from coadjoint.analysis.checks.subject import Subject
from coadjoint.analysis.powers import FLOOR_FACTOR, OrderFit, fit_order
from coadjoint.errors import IntegrationError
from coadjoint.rounding import UNIT_ROUNDOFF

Floats = NDArray[np.float64]

# Span in natural times: long enough to sample the motion, short enough not to amplify errors.
NATURAL_TIMES = 2.0
SPANS_TRIED = 4
"""Number of spans, each half of the previous one, that are tried until the motion has a reference."""
# Larger relative errors are outside the asymptotic range.
LARGE_ERROR = 0.05
MAX_STEPS_COMPILED, MAX_STEPS_PYTHON = 512, 128
"""Upper limits on steps over the span for compiled and other steps, unless the given step needs more."""
MAX_GIVEN_STEPS = 4096  # over the span, if the given step is short
FIRST_STEPS = 64  # over the span, from which halvings and doublings start
MAX_TRIALS = 16  # halvings and doublings, each way
TIME_LIMIT = 3.0
"""Approximate time limit of the study if steps are expensive."""
# Ratio of consecutive errors of the study at high order; at low order the step is halved.
ERROR_RATIO = 16.0


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
        """Sizes of the steps."""
        return [abs(self.span) / count for count in self.counts]

    @property
    def order(self) -> OrderFit | None:
        """The order of the errors that are below `LARGE_ERROR` and above round-off."""
        inside = [k for k, error in enumerate(self.errors) if error < LARGE_ERROR]
        return measured_order(*([values[k] for k in inside] for values in (self.steps, self.errors, self.floors)))

    def coarse_step(self, h: float) -> float:
        """Return the largest step at which the scheme still approximates the motion; at least the given one."""
        accurate = [self.span / n for n, error in zip(self.counts, self.errors, strict=True) if error < LARGE_ERROR / 5]
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
    p = subject.claims.order
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
        """Add the run with `count` steps to the study; return whether it succeeded."""
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
    # `LARGE_ERROR`.
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
        if count == 1 or (result.errors and result.errors[0] > LARGE_ERROR):
            break
        count = min(count - 1, math.floor(count / ratio))
        if not run(count):
            break
    return result if result.counts else None
