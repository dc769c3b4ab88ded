"""Elementary functions of a number type."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from coadjoint.program.numbers import Number


class Elementary(NamedTuple):
    """Elementary functions of the closed forms, for one number type."""

    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]
    atan: Callable[[Any], Any]
    sinh: Callable[[Any], Any]
    exp: Callable[[Any], Any]
    expm1: Callable[[Any], Any]
    sqrt: Callable[[Any], Any]
    ceil: Callable[[Any], int]


def elementary(number: Number) -> Elementary:
    """Return the elementary functions of a number type: from `math` for float, from its own context for mpmath."""
    if number is float:
        return Elementary(math.sin, math.cos, math.atan, math.sinh, math.exp, math.expm1, math.sqrt, math.ceil)
    context: Any = getattr(type(number(1)), "context", None)
    if context is None:
        raise TypeError(f"the number type {type(number(1)).__name__} is not supported; use float or mpmath numbers")
    return Elementary(
        context.sin,
        context.cos,
        context.atan,
        context.sinh,
        context.exp,
        context.expm1,
        context.sqrt,
        lambda v: int(context.ceil(v)),
    )
