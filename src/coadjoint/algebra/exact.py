"""Floats as the whole and rational numbers that they are."""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

TOO_LARGE = "is too large for float64, or has too many digits"


def exact_number(value: int | float | Fraction) -> int | Fraction:
    """Return a finite number exactly, as int where it is whole, else as Fraction.

    Products with Fraction or mpmath numbers then keep their exactness or their precision.

    Examples
    --------
    >>> exact_number(2.0), exact_number(0.5), exact_number(3)
    (2, Fraction(1, 2), 3)
    """
    if isinstance(value, float):
        return int(value) if value.is_integer() else Fraction(value)
    return value


def rounded(value: int | float | Fraction) -> float:
    """Return a number in float64, or refuse one that is too large for it.

    Examples
    --------
    >>> rounded(Fraction(1, 2))
    0.5
    """
    try:
        return float(value)
    except OverflowError:
        raise ValueError("a constant of the new algebra is too large for float64; take smaller numbers") from None


def exact_numbers(values: Iterable[int | float | Fraction]) -> NDArray[Any]:
    """Return an object array of exact numbers.

    Examples
    --------
    >>> exact_numbers([1.0, 0.25])
    array([1, Fraction(1, 4)], dtype=object)
    """
    exact = [exact_number(value) for value in values]
    result = np.empty(len(exact), dtype=object)
    result[:] = exact
    return result


def fits(value: int | float | Fraction) -> bool:
    """Say whether a number is finite in float64 and, where it is exact, has so many digits as one can work with.

    Examples
    --------
    >>> fits(10**308), fits(10**309), fits(float("inf")), fits(Fraction(1, 10**2000))
    (True, False, False, False)
    """
    try:
        return math.isfinite(value) and not (isinstance(value, Fraction) and value.denominator.bit_length() > 4096)
    except OverflowError:
        return False
