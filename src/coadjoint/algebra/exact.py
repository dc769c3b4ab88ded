"""Exact numbers: floats as the whole and rational numbers that they are, and those of python-flint."""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction
from numbers import Rational
from typing import Any

import numpy as np
from numpy.typing import NDArray

TOO_LARGE = "is too large for float64, or has too many digits"


def exact_number(value: Any) -> Any:
    """Return a finite float as the int or the Fraction that it is, and a rational number of any kind as one of Python.

    Products with Fraction or mpmath numbers then keep their exactness or their precision. Any other number is returned
    as it is.

    Examples
    --------
    >>> exact_number(2.0), exact_number(0.5), exact_number(3), exact_number(np.int8(100)) * 2
    (2, Fraction(1, 2), 3, 200)
    """
    if isinstance(value, float):
        return int(value) if value.is_integer() else Fraction(value)
    if isinstance(value, int | Fraction) or not isinstance(value, Rational):
        return value
    return fraction(value)


def fraction(value: Any) -> int | Fraction:
    """Return a rational number, of NumPy or of python-flint for instance, as one of Python.

    Examples
    --------
    >>> fraction(rational(0.25)), fraction(rational(2))
    (Fraction(1, 4), 2)
    """
    above, below = int(value.numerator), int(value.denominator)
    return above if below == 1 else Fraction(above, below)


def rational(value: Any) -> Any:
    """Return a finite number as the rational number that it is, `flint.fmpq`.

    Examples
    --------
    >>> rational(0.5), rational(Fraction(1, 3))
    (1/2, 1/3)
    """
    from flint import fmpq

    exact = Fraction(exact_number(value))
    return fmpq(exact.numerator, exact.denominator)


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


def exact_numbers(values: Iterable[Any]) -> NDArray[Any]:
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


def is_finite(value: int | float | Fraction) -> bool:
    """Say whether a number is finite in float64, exact as it may be.

    Examples
    --------
    >>> is_finite(10**308), is_finite(10**309), is_finite(float("inf")), is_finite(Fraction(1, 10**2000))
    (True, False, False, True)
    """
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def fits(value: int | float | Fraction) -> bool:
    """Say whether a number is finite in float64 and, where it is exact, has so many digits as one would write.

    Examples
    --------
    >>> fits(10**308), fits(Fraction(1, 10**2000))
    (True, False)
    """
    return is_finite(value) and not (isinstance(value, Fraction) and value.denominator.bit_length() > 4096)
