"""Times of a run: a whole number of steps, in the direction of the span, and output times among them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF, in_standard_mode
from coadjoint.short_repr import distinct, short
from coadjoint.validation import are_finite, read_integer, read_number, read_numbers

TIME_ROUNDING = 16 * UNIT_ROUNDOFF
"""Rounding of one time, relative to the largest: 8 units in the last place."""
STEP_SHARE = 0.01
"""Largest accumulated rounding of times, in steps."""
ULP_TOLERANCE = 4
"""Times this close to a step, in units in the last place of the larger end of the span, are at the step."""


def accumulated_rounding(count: float, first: float, last: float, step: float) -> float:
    """Return the largest rounding of `count` times between two ends, each of which may be a sum of steps.

    Times such as ``np.cumsum([0.1] * 300)`` have a rounding error per term, relative to the largest time; their sum
    counts up to a hundredth of a step, a single one always.

    >>> accumulated_rounding(1, 0.0, 30.0, 0.1) < 1e-13 < 1e-11 < accumulated_rounding(300, 0.0, 30.0, 0.1)
    True
    """
    # Not of the step, beside which a short span would count as rounding.
    one = TIME_ROUNDING * max(abs(first), abs(last), abs(last - first))
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
    @in_standard_mode
    def end(self) -> float:
        return self.t0 + self.steps * self.h

    @property
    def total_points(self) -> int:
        return -(-self.steps // self.save_every) + 1 if self.marks is None else len(self.marks)

    @property
    def points(self) -> int:
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
    @in_standard_mode
    def saved_times(self) -> NDArray[np.float64]:
        return self.at(self.saved) if self.between is None else self.between

    def at(self, numbers: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.asarray(self.t0 + numbers * self.h, dtype=np.float64)


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
    if not is_divided(ends, size):
        count = max(1, math.floor(quotient))
        raise ValueError(
            f"step {size!r} does not divide the time {abs(span)!r}; "
            f"the nearest steps that do are {abs(span) / (count + 1)!r} and {abs(span) / count!r}"
        )
    if steps and math.ulp(max(abs(first), abs(last))) > size / 4:
        raise ValueError(
            f"step {size!r} is too small beside the times {list(ends)}: neighbouring times would be the same number; "
            "shift t_span towards zero"
        )
    return Times(first, math.copysign(size, span), steps, min(every, max(1, steps)))


def is_divided(ends: tuple[float, float], size: float) -> bool:
    """Return whether the time between validated ends is a whole number of steps, up to rounding."""
    first, last = ends
    quotient = abs(last - first) / size
    return abs(quotient - round(quotient)) <= accumulated_rounding(round(quotient), first / size, last / size, 1.0)


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
    ends = t_span
    if type(t_span) is not tuple:
        numbers = read_numbers(t_span, "t_span")
        ends = numbers.tolist() if numbers.ndim == 1 else []
    if len(ends) != 2:
        raise ValueError(
            f"t_span is {short(t_span)}; it must be two numbers, the start and the end; save_every or t_eval choose "
            "the saved times"
        )
    return read_number(ends[0], "the start of t_span"), read_number(ends[1], "the end of t_span")


class OutputTimes(NamedTuple):
    """Output times, with the number of the step at or before each and the remaining time `length` after it."""

    t: NDArray[np.float64]
    number: NDArray[np.int64]
    length: NDArray[np.float64]

    @property
    def marks(self) -> NDArray[np.int64]:
        """Numbers of the steps from which the output times are reached, and 0."""
        return np.union1d(self.number, 0)

    @property
    def ends(self) -> NDArray[np.int64]:
        """For each output time, the number of the step, whole or partial, that ends there."""
        return self.number + (self.length != 0.0)


def output_times_of(t_eval: Any, times: Times, save_every: Any = 1, whole_steps: bool = False) -> OutputTimes:
    """Validate `t_eval`, (k,), sorted in the direction of the run and in its span, and locate it among the steps."""
    if save_every != 1:
        raise ValueError("the run was given save_every and t_eval; give only one of them")
    values = read_numbers(t_eval, "t_eval")
    if values.ndim != 1 or not len(values):
        raise ValueError(f"t_eval has the shape {values.shape}; it must be a row of times, at least one")
    if not are_finite(values):
        raise ValueError("t_eval contains NaN or infinity; every time must be finite")
    t = np.array(values, dtype=np.float64)
    forward = times.h > 0.0
    unsorted = np.flatnonzero(t[1:] < t[:-1] if forward else t[1:] > t[:-1])
    if len(unsorted):
        k = int(unsorted[0]) + 1
        raise ValueError(
            "t_eval[{}] is {} and comes after {}; times must be sorted in the direction of t_span".format(
                k, *distinct(t[k], t[k - 1])
            )
        )
    beyond = accumulated_rounding(max(len(t), times.steps + 1), times.t0, times.end, abs(times.h))
    low, high = (times.t0, times.end) if forward else (times.end, times.t0)
    outside = np.flatnonzero((t < low - beyond) | (t > high + beyond))
    if len(outside):
        k = int(outside[0])
        found, first, last = distinct(t[k], times.t0, times.end)
        raise ValueError(f"t_eval[{k}] is {found}; it must lie within t_span, from {first} to {last}")
    tolerance = beyond
    if not whole_steps:
        tolerance = ULP_TOLERANCE * np.spacing(max(abs(times.t0), abs(times.end)))
    steps = np.clip((t - times.t0) / times.h, 0, times.steps)
    nearest = np.rint(steps).astype(np.int64)
    at_step = (np.abs(t - times.at(nearest)) <= tolerance) | (t < low) | (t > high)
    before = np.minimum(np.floor(steps).astype(np.int64), max(times.steps - 1, 0))
    # Division may round up to a whole number from just below.
    early = (t - times.at(before)) * (1.0 if forward else -1.0) < 0.0
    number = np.where(at_step, nearest, before - early)
    return OutputTimes(t, number, np.where(at_step, 0.0, t - times.at(number)))
