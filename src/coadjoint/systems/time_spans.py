"""Spans of time in which functions are known, such as those of sampled orbits, and of forces that call them."""

from __future__ import annotations

import types
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import lru_cache
from math import inf
from typing import Any, NoReturn

from coadjoint.algebra.invariants.sampled_checks import SAMPLE_TIME
from coadjoint.rounding import UNIT_ROUNDOFF

Span = tuple[float, float]

ALWAYS: Span = (-inf, inf)
SLACK = 64 * UNIT_ROUNDOFF
"""Rounding of times at the ends of a span, relative to the larger one."""
OUTSIDE = "outside of the span in which the orbit is known"
MAX_FUNCTIONS = 1000  # that are followed; those of a force are about ten


def known_in(function: Callable[..., Any], span: Span) -> Any:
    """Return a function of the time with the span in which it is known, which it and its callers refuse to leave."""
    function.time_span = span  # type: ignore[attr-defined]
    return function


def slack_of(span: Span) -> float:
    """Return the rounding of times in a span."""
    return SLACK * max(abs(span[0]), abs(span[1]))


def refuse_time(t: Any, first: Any, last: Any) -> NoReturn:
    """Raise ValueError for a time outside of a span; compiled code has another one, without numbers in its text."""
    raise ValueError(f"t = {t:.10g} is {OUTSIDE}, from t = {first:.10g} to {last:.10g}")


def limited(function: Callable[..., Any], span: Span) -> Any:
    """Return a function of the time that raises a ValueError outside of a span."""
    (first, last), slack = span, slack_of(span)

    def within(t: Any) -> Any:
        if not (first - slack <= t <= last + slack):
            refuse_time(t, first, last)
        return function(t)

    return known_in(within, span)


@lru_cache(maxsize=1024)
def _span_of(held: Any) -> Span:
    first, last = ALWAYS
    for span in _spans_in(held):
        first, last = max(first, span[0]), min(last, span[1])
    return first, last


def time_span_of(value: Any) -> Span:
    """Return the span in which a function, also within other ones that it calls, or a force is known."""
    try:
        return _span_of(value)
    except TypeError:  # without a hash
        return _span_of.__wrapped__(value)


def _spans_in(value: Any) -> Iterator[Span]:
    pending, seen = [value], set[int]()
    while pending and len(seen) < MAX_FUNCTIONS:
        one = pending.pop()
        one = getattr(one, "py_func", one)
        if id(one) in seen:
            continue
        seen.add(id(one))
        span = getattr(one, "time_span", None)
        if isinstance(span, tuple):
            yield span
        elif isinstance(one, types.FunctionType):
            pending += _read_by(one)
        elif is_dataclass(one) and not isinstance(one, type):
            pending += [getattr(one, field.name) for field in fields(one)]


def _read_by(function: types.FunctionType) -> list[Any]:
    """Return the functions and orbits in the closure and in the globals of a function."""
    found: list[Any] = [function.__globals__.get(name) for name in function.__code__.co_names]
    for cell in function.__closure__ or ():
        try:
            found.append(cell.cell_contents)
        except ValueError:  # empty
            continue
    plain = [getattr(one, "py_func", one) for one in found]
    return [
        one for one in plain if isinstance(one, types.FunctionType) or isinstance(getattr(one, "time_span", 0), tuple)
    ]


def sample_time_of(*values: Any) -> float:
    """Return a time at which functions are checked: one of the spans in which all of them are known."""
    first, last = ALWAYS
    for value in values:
        span = time_span_of(value)
        first, last = max(first, span[0]), min(last, span[1])
    return SAMPLE_TIME if first <= SAMPLE_TIME <= last else 0.5 * (first + last)


def check_span(what: str, value: Any, begin: float, end: float) -> None:
    """Raise ValueError if a force is needed at times at which it is not known."""
    span = time_span_of(value)
    early, late, slack = min(begin, end), max(begin, end), slack_of(span)
    if early < span[0] - slack or late > span[1] + slack:
        raise ValueError(
            f"{what} is known from t = {span[0]:.10g} to {span[1]:.10g}, and the run needs it from {early:.10g} to "
            f"{late:.10g}; give a t_span within, or an orbit or a log of a longer span"
        )
