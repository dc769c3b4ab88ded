"""Exact conversions between floats, Python integers, fractions and python-flint rationals; number literals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction
from numbers import Rational
from typing import Any

import numpy as np
from numpy.typing import NDArray

Constant = int | float | Fraction

PLAIN_NUMBER = r"(?:\d+\.?\d*|\.\d+)"
NUMBER = rf"{PLAIN_NUMBER}(?:[eE][+-]?\d+)?"
MAX_DIGITS = 400
TOO_LARGE = "is too large for float64, or has too many digits"


def exact_number(value: Any) -> Any:
    """Convert a finite float or any rational number exactly to int or Fraction; return other numbers unchanged."""
    if isinstance(value, float):
        return int(value) if value.is_integer() else Fraction(value)
    if isinstance(value, int | Fraction) or not isinstance(value, Rational):
        return value
    return fraction(value)


def fraction(value: Any) -> int | Fraction:
    """Convert a rational number, such as one of NumPy or python-flint, to int or Fraction."""
    numerator, denominator = int(value.numerator), int(value.denominator)
    return numerator if denominator == 1 else Fraction(numerator, denominator)


def rational(value: Any) -> Any:
    """Convert a finite number exactly to `flint.fmpq`."""
    from flint import fmpq

    exact = Fraction(exact_number(value))
    return fmpq(exact.numerator, exact.denominator)


def rounded(value: int | float | Fraction) -> float:
    """Round a number to float64; raise a ValueError if it overflows."""
    try:
        return float(value)
    except OverflowError:
        raise ValueError("a constant of the new algebra is too large for float64; take smaller numbers") from None


def exact_numbers(values: Iterable[Any]) -> NDArray[Any]:
    """Return an object array of exact numbers."""
    exact = [exact_number(value) for value in values]
    result = np.empty(len(exact), dtype=object)
    result[:] = exact
    return result


def is_finite(value: int | float | Fraction) -> bool:
    """Return whether a number, possibly exact, is finite in float64."""
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def fits(value: int | float | Fraction) -> bool:
    """Return whether a number is finite in float64 and, if exact, has a reasonable number of digits."""
    return is_finite(value) and not (isinstance(value, Fraction) and value.denominator.bit_length() > 4096)


def parse_number(literal: str) -> Constant:
    """Parse a number: int if it consists of digits, else float."""
    if not literal.isdigit():
        return checked(float(literal))
    if len(literal) > MAX_DIGITS:
        raise ValueError(f"a number of {len(literal)} digits {TOO_LARGE}")
    return checked(int(literal))


def quotient(numerator: Constant, denominator: Constant) -> Constant:
    """Return numerator/denominator: exact if both are, else a float.

    Examples
    --------
    >>> quotient(1, 3), quotient(1.0, 4)
    (Fraction(1, 3), 0.25)
    """
    exact = not isinstance(numerator, float) and not isinstance(denominator, float)
    return Fraction(numerator) / Fraction(denominator) if exact else checked(float(numerator) / float(denominator))


def checked(value: Constant) -> Any:
    """Return a number, or raise a ValueError if it is beyond float64."""
    if not fits(value):
        raise too_large()
    return value


def too_large() -> ValueError:
    """Return the error for a number beyond float64."""
    return ValueError(f"a number {TOO_LARGE}")
