"""Times of a run: a whole number of steps, in the direction of the span."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.validation import read_integer, read_number, read_numbers

TIME_ROUNDING = 16 * UNIT_ROUNDOFF
"""Rounding of one time, relative to the largest: 8 units in the last place."""
STEP_SHARE = 0.01
"""Largest accumulated rounding of times, in steps."""


def accumulated_rounding(count: float, first: float, last: float, step: float) -> float:
    """Return the largest rounding of one of `count` times between two ends, each of which may be a sum of steps.

    Times such as ``np.cumsum([0.1] * 300)`` have a rounding error for each term, relative to the largest time. The sum
    of these errors counts as rounding up to a hundredth of a step; a single one always does.

    Examples
    --------
    >>> accumulated_rounding(1, 0.0, 30.0, 0.1) < 1e-13 < 1e-11 < accumulated_rounding(300, 0.0, 30.0, 0.1)
    True
    """
    one = TIME_ROUNDING * max(abs(first), abs(last), abs(last - first), step)
    return max(one, min(count * one, STEP_SHARE * step))


class Times(NamedTuple):
    """Start, signed step, number of steps, and the saved steps: every `save_every`-th, or `marks`."""

    # Output times `between` are `elapsed` after the start, and `marks` the steps that end there.

    t0: float
    h: float
    steps: int
    save_every: int
    passed: int = 0
    marks: NDArray[np.int64] | None = None
    between: NDArray[np.float64] | None = None
    elapsed: NDArray[np.float64] | None = None
    max_points: int | None = None

    @property
    def end(self) -> float:
        """Time after the last step."""
        return self.t0 + self.steps * self.h

    @property
    def total_points(self) -> int:
        """Number of saved steps of the whole run."""
        return -(-self.steps // self.save_every) + 1 if self.marks is None else len(self.marks)

    @property
    def points(self) -> int:
        """Number of saved steps in memory."""
        left = self.total_points - self.passed
        return left if self.max_points is None else min(left, self.max_points)

    @property
    def saved(self) -> NDArray[np.int64]:
        """Numbers of the saved steps: the marks, or 0, every save_every-th, and the last."""
        last = self.passed + self.points
        if self.marks is not None:
            return self.marks[self.passed : last]
        return np.minimum(np.arange(self.passed, last) * self.save_every, self.steps)

    @property
    def reach(self) -> int:
        """Last step before the first saved step that exceeds `max_points`."""
        last = self.passed + self.points
        if last == self.total_points:
            return self.steps
        # The last interval may be shorter than save_every steps.
        return (min(last * self.save_every, self.steps) if self.marks is None else int(self.marks[last])) - 1

    def with_saved_steps(self, numbers: Any) -> Times:
        """Return the same times with the given saved steps, ascending, from 0 to `steps`."""
        marks = np.array(numbers)
        integers = marks.ndim == 1 and (marks.dtype.kind in "iu" or not len(marks))
        if not integers or np.any(np.diff(marks) <= 0) or np.any((marks < 0) | (marks > self.steps)):
            raise ValueError(
                f"the steps to be saved are {short(numbers)}; they must be whole numbers from 0 to {self.steps}, "
                "each larger than the one before"
            )
        return self._replace(passed=0, marks=np.ascontiguousarray(marks, dtype=np.int64))

    def refined_times(self, count: int) -> Times:
        """Halve the step until there are at least `count` steps, and save every step."""
        halvings = max(0, math.ceil(math.log2(count / self.steps))) if self.steps else 0
        return Times(self.t0, math.ldexp(self.h, -halvings), self.steps << halvings, 1)

    def after(self, number: int) -> Times:
        """Return the same times with only the saved steps after step `number`."""
        if not 0 <= number <= self.steps:
            raise ValueError(f"the state is that after step {number}; a run of {self.steps} steps cannot resume there")
        if self.marks is not None:
            passed = int(np.searchsorted(self.marks, number, side="right"))
        else:
            passed = self.total_points if number == self.steps else number // self.save_every + 1
        return self._replace(passed=passed)

    @property
    def saved_times(self) -> NDArray[np.float64]:
        """Times of the saved points."""
        return self.at(self.saved) if self.between is None else self.between

    def at(self, numbers: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return t0 + j h."""
        return np.asarray(self.t0 + numbers * self.h, dtype=np.float64)


class StepDoesNotDivide(ValueError):
    """A span is no whole number of steps."""


def times_of(t_span: Any, step: Any, save_every: Any) -> Times:
    """Validate span, step and `save_every`; h has the sign of the span's direction."""
    ends = span_of(t_span)
    return times_between(ends, read_step(step), save_every)


def times_between(ends: tuple[float, float], size: float, save_every: Any) -> Times:
    """Return the times of a run between validated ends, with a validated step; see `times_of`."""
    unchanged = type(save_every) is int and save_every > 0
    every = save_every if unchanged else read_integer(save_every, "save_every", floats=True)
    first, last = ends
    span = last - first
    if not math.isfinite(span):
        raise ValueError(f"t_span is {list(ends)}; the time between its ends is too large for float64")
    quotient = abs(span) / size
    if not quotient < 2.0**53:
        raise ValueError(f"step {size!r} is too small for the time {abs(span)!r}: the steps could not be counted")
    steps = round(quotient)
    if abs(quotient - steps) > accumulated_rounding(steps, first / size, last / size, 1.0):
        count = max(1, math.floor(quotient))
        raise StepDoesNotDivide(
            f"step {size!r} does not divide the time {abs(span)!r}; "
            f"the nearest steps that do are {abs(span) / (count + 1)!r} and {abs(span) / count!r}"
        )
    if steps and math.ulp(max(abs(first), abs(last))) > size / 4:
        raise ValueError(
            f"step {size!r} is too small beside the times {list(ends)}: neighbouring times would be the same number; "
            "shift t_span towards zero"
        )
    return Times(first, math.copysign(size, span), steps, min(every, max(1, steps)))


class RecentTimes:
    """The times of runs of one step; the last are cached, read and replaced at once, so that threads may share it."""

    def __init__(self, step: float) -> None:
        self._step = step
        self._last: tuple[tuple[float, float], int, Times] | None = None

    def of(self, t_span: Any, save_every: Any) -> Times:
        """Validate span and `save_every`; the times of an unchanged pair are the same object."""
        last = self._last
        if (
            last is not None
            and (t_span is last[0] or is_same_span(t_span, last[0]))
            and (save_every is last[1] or (type(save_every) is int and save_every == last[1]))
        ):
            return last[2]
        times = times_between(span_of(t_span), self._step, save_every)
        if is_unchangeable(t_span) and type(save_every) is int:
            self._last = t_span, save_every, times
        return times


def is_same_span(t_span: Any, last: Any) -> bool:
    """Return whether a span is a tuple of floats with the bits of another one."""
    return (
        type(t_span) is tuple
        and len(t_span) == 2
        and type(t_span[0]) is type(t_span[1]) is float
        and t_span == last
        and math.copysign(1.0, t_span[0]) == math.copysign(1.0, last[0])
    )


def is_unchangeable(t_span: Any) -> bool:
    """Return whether a validated span is a tuple of Python numbers, so that the same object remains the same span."""
    return type(t_span) is tuple and type(t_span[0]) in (float, int) and type(t_span[1]) in (float, int)


def read_step(step: Any) -> float:
    """Validate a step and return it as a positive float."""
    size = read_number(step, "step")
    if size <= 0.0:
        raise ValueError(f"step is {size!r}; it must be positive (the direction comes from t_span)")
    return size


def span_of(t_span: Any) -> tuple[float, float]:
    """Validate t_span and return the start and the end."""
    # Fast path: a tuple is unpacked directly.
    ends = t_span if type(t_span) is tuple else read_numbers(t_span, "t_span").tolist()
    if not isinstance(ends, list | tuple) or len(ends) != 2 or any(isinstance(end, list) for end in ends):
        raise ValueError(
            f"t_span is {short(t_span)}; it must be two numbers, the start and the end; save_every or t_eval choose "
            "the saved times"
        )
    return read_number(ends[0], "the start of t_span"), read_number(ends[1], "the end of t_span")
