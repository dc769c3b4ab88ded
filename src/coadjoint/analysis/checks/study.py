"""Errors at the end of a span for several numbers of steps: as few as tell how they depend on the step."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
# Errors above this relative size say nothing about the order.
LARGE = 0.05
FINEST, FINEST_OF_PYTHON = 512, 128
"""Steps over the span that are not exceeded, of compiled steps and others, unless the given step takes more."""
MOST_GIVEN = 4096
FEW = 64
MOST_TRIALS = 16
SECONDS = 3.0
"""Of all runs, where a step is dear: about so long the study takes."""
# Errors of high order fall by so much from one step of the study to the next. For low orders the step is halved.
FALL = 16.0


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
        The states at the end.
    errors, floors : list of float
        Errors relative to the size of the states, and what rounding may have made of them.
    reference : Motion
    given : int
        The number of steps of the given size; 0 where they are not among these.
    failed : list of str
        The messages of runs that failed.
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
        """The slope of the errors that are neither large nor round-off."""
        inside = [k for k, error in enumerate(self.errors) if error < LARGE]
        return slope(*([values[k] for k in inside] for values in (self.steps, self.errors, self.floors)))

    def telling(self, h: float) -> float:
        """Return the largest step at which the scheme is still near the motion, or the given one if that is larger."""
        near = [self.span / n for n, error in zip(self.counts, self.errors, strict=True) if error < LARGE / 5]
        largest = near[0] if near else h
        return largest if abs(largest) > 1.01 * abs(h) else h


def study(subject: Subject) -> Study | None:
    """Run the scheme over a span with the given step, then with smaller and larger ones, while that is of use.

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
    finest = FINEST if subject.compiled else FINEST_OF_PYTHON
    # All runs of the study together have about twice the steps of the longest.
    most = subject.affordable(SECONDS / 2)
    most_given, few, finest = min(MOST_GIVEN, most), min(FEW, max(1, most // 4)), min(finest, most)
    for halving in range(SHORTER):
        wanted = NATURAL_TIMES / 2.0**halving * subject.span_time
        # Where the given step is tiny, the order is measured with larger ones; where it is huge, with smaller ones.
        given = round(min(wanted / abs(subject.h), 2.0 * MOST_GIVEN))
        given = given if halving else max(1, given)
        given = 0 if given > most_given else given
        span, first = (given * subject.h, given) if given else (math.copysign(wanted, subject.h), few)
        reference = motion(subject.system, subject.states, span)
        if reference is not None:
            break
    else:
        return None
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

    # Where errors are round-off alone, steps grow fast until they are not. Then come finer steps down to round-off, and
    # coarser ones up to large errors.
    known = tried(first)
    while known and first > 1 and not clear(first):
        first = max(1, first // 2)
        known = tried(first)
    count = first
    for _ in range(MOST_TRIALS):
        if count in found.counts and not clear(count):
            break
        count = max(count + 1, math.ceil(count * ratio))
        if count > min(max(finest, 4 * first), most):
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
