"""Number types of the plain reading: float64 arrays, or object arrays of exact or multiprecision numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF

Number = Callable[[Any], Any]


def convert(number: Number, value: Any) -> Any:
    """Return a float, integer, fraction or decimal string as a number of the wanted type, rounded at most once."""
    if number is not float and isinstance(value, Fraction):
        return number(value.numerator) / number(value.denominator)
    if number is not float and isinstance(value, np.generic):
        return number(value.item())
    return number(value)


def array_of(number: Number, values: Iterable[Any]) -> NDArray[Any]:
    """Return the values as a float64 array, or as an object array for every other number type."""
    if number is float:
        given = values if isinstance(values, np.ndarray) else list(values)
        return np.ascontiguousarray(given, dtype=np.float64)
    items = [convert(number, value) for value in values]
    result = np.empty(len(items), dtype=object)
    result[:] = items
    return result


def roundoff(number: Number) -> Any:
    """Return the unit round-off of a number type: half the gap between 1 and the next number."""
    one = number(1)
    if number is float:
        return UNIT_ROUNDOFF
    if isinstance(one, Fraction) or getattr(one, "exact", False) is True:
        return Fraction(0)
    u = one
    while one + u / 2 != one:
        u = u / 2
    return u / 2
