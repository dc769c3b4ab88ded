"""Number types of the reference interpreter: conversion, arrays, round-off and elementary functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF

Number = Callable[[Any], Any]


def convert(number: Number, value: Any) -> Any:
    """Convert a float, integer, fraction or decimal string to a number type, with one rounding at most."""
    if number is not float and isinstance(value, Fraction):
        return number(value.numerator) / number(value.denominator)
    if number is not float and isinstance(value, np.generic):
        return number(value.item())
    return number(value)


def array_of(number: Number, values: Iterable[Any]) -> NDArray[Any]:
    """Return a float64 array for float, and an object array (exact or multiprecision) for other number types."""
    if number is float:
        sequence = values if isinstance(values, np.ndarray) else list(values)
        return np.ascontiguousarray(sequence, dtype=np.float64)
    items = [convert(number, value) for value in values]
    result = np.empty(len(items), dtype=object)
    result[:] = items
    return result


def full_precision(value: Any) -> Any:
    """Return a whole number or one of single precision as a float, so that fractions of it are not rounded more."""
    return float(value) if np.asarray(value).dtype.kind in "biuf" else value


def is_exact(number: Number) -> bool:
    """Test whether a number type is exact: fractions, and power series with exact coefficients."""
    one = number(1)
    return isinstance(one, Fraction) or getattr(one, "exact", False) is True


def roundoff(number: Number) -> Any:
    """Return the unit round-off of a number type: half the distance from 1 to the next number."""
    if number is float:
        return UNIT_ROUNDOFF
    if is_exact(number):
        return Fraction(0)
    u = one = number(1)
    while one + u / 2 != one:
        u = u / 2
    return u / 2


def precision_of(number: Number) -> int | None:
    """Return the current precision of a number type in bits, on which cached numbers depend; None if it is fixed."""
    return None if number is float else getattr(getattr(type(number(1)), "context", None), "prec", None)


def elementary(number: Number) -> Any:
    """Return the module of elementary functions of a number type: `math` for float, for mpmath its own context."""
    if number is float:
        return math
    context: Any = getattr(type(number(1)), "context", None)
    if context is None:
        raise TypeError(f"the number type {type(number(1)).__name__} is not supported; use float or mpmath numbers")
    return context
