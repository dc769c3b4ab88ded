"""Number types of the reference interpreter: float64 arrays, or object arrays of exact or multiprecision numbers."""

from __future__ import annotations

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
    """Return a float64 array for float, and an object array for other number types."""
    if number is float:
        given = values if isinstance(values, np.ndarray) else list(values)
        return np.ascontiguousarray(given, dtype=np.float64)
    items = [convert(number, value) for value in values]
    result = np.empty(len(items), dtype=object)
    result[:] = items
    return result


def roundoff(number: Number) -> Any:
    """Return the unit round-off of a number type: half the distance from 1 to the next number."""
    one = number(1)
    if number is float:
        return UNIT_ROUNDOFF
    if isinstance(one, Fraction) or getattr(one, "exact", False) is True:
        return Fraction(0)
    u = one
    while one + u / 2 != one:
        u = u / 2
    return u / 2
