"""Convergence study: errors at the end of a span for several numbers of steps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.checks.reference import Motion, motion
from coadjoint.analysis.checks.slope import FLOOR_FACTOR, Slope, slope
from coadjoint.analysis.checks.subject import Subject
from coadjoint.errors import IntegrationError
from coadjoint.rounding import UNIT_ROUNDOFF

Floats = NDArray[np.float64]

# The span in natural times: long enough to sample the motion, short enough not to amplify errors.
NATURAL_TIMES = 2.0
SPANS_TRIED = 4
"""Number of spans tried, each half of the previous one, if the motion has no reference over the longer ones."""
# Larger relative errors are outside the asymptotic range.
LARGE_ERROR = 0.05
MAX_STEPS_COMPILED, MAX_STEPS_PYTHON = 512, 128
"""Upper limits on steps over the span for compiled and other steps, unless the given step needs more."""
MAX_GIVEN_STEPS = 4096
FIRST_STEPS = 64
MAX_TRIALS = 16
TIME_LIMIT = 3.0
"""Approximate time limit of the study if steps are expensive."""
# Ratio of consecutive errors of the study at high order; at low order the step is halved.
ERROR_RATIO = 16.0


@dataclass(frozen=True)
class Study:
    """Errors at the end of a span for several numbers of steps, increasing.

    `ends` are states (k, n); errors are relative to the size of the states, `floors` is their round-off. `given` is the
    number of steps of the given size, 0 if not included; `failed` has the messages of failed runs; the span is signed.
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
        """The slope of the errors that are below `LARGE_ERROR` and above round-off."""
        inside = [k for k, error in enumerate(self.errors) if error < LARGE_ERROR]
        return slope(*([values[k] for k in inside] for values in (self.steps, self.errors, self.floors)))

    def coarse_step(self, h: float) -> float:
        """Return the largest step at which the scheme still approximates the motion; at least the given one."""
        near = [self.span / n for n, error in zip(self.counts, self.errors, strict=True) if error < LARGE_ERROR / 5]
        largest = near[0] if near else h
        return largest if abs(largest) > 1.01 * abs(h) else h


def study(subject: Subject) -> Study | None:
    """Run the scheme over a span with the given step, then with smaller and larger ones; None without a reference."""
    p = subject.claims.order
    finest = MAX_STEPS_COMPILED if subject.compiled else MAX_STEPS_PYTHON
    # All runs together take about twice the steps of the longest.
    most = subject.affordable(TIME_LIMIT / 2)
    most_given, few, finest = min(MAX_GIVEN_STEPS, most), min(FIRST_STEPS, max(1, most // 4)), min(finest, most)
    for halving in range(SPANS_TRIED):
        wanted = NATURAL_TIMES / 2.0**halving * subject.span_time
        # For a tiny given step the order is measured with larger steps, for a huge one with smaller steps.
        given = round(min(wanted / abs(subject.h), 2.0 * MAX_GIVEN_STEPS))
        given = given if halving else max(1, given)
        given = 0 if given > most_given else given
        span, first = (given * subject.h, given) if given else (math.copysign(wanted, subject.h), few)
        reference = motion(subject.system, subject.states, span)
        if reference is not None:
            break
    else:
        return None
    ratio = min(2.0, ERROR_RATIO ** (1.0 / p)) if p else math.sqrt(2.0)
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
        return found.errors[k] > FLOOR_FACTOR * found.floors[k]

    # First steps grow until errors are above round-off; then finer steps down to round-off, coarser ones up to
    # `LARGE_ERROR`.
    known = tried(first)
    while known and first > 1 and not clear(first):
        first = max(1, first // 2)
        known = tried(first)
    count = first
    for _ in range(MAX_TRIALS):
        if count in found.counts and not clear(count):
            break
        count = max(count + 1, math.ceil(count * ratio))
        if count > min(max(finest, 4 * first), most):
            break
        tried(count)
    count = first
    for _ in range(MAX_TRIALS):
        if count == 1 or (found.errors and found.errors[0] > LARGE_ERROR):
            break
        count = min(count - 1, math.floor(count / ratio))
        if not tried(count):
            break
    return found if found.counts else None
