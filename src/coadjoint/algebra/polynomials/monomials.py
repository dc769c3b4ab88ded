"""Validation of the exponents and the coefficient of a monomial."""

from __future__ import annotations

from numbers import Rational
from typing import Any

import numpy as np

from coadjoint.algebra.exact.numbers import exact_number, is_finite
from coadjoint.algebra.polynomials.product_sums import Coefficient
from coadjoint.short_repr import short

Exponents = tuple[int, ...]


def read_exponents(given: Any) -> Exponents:
    """Validate exponents and return them as Python integers."""
    if not isinstance(given, tuple | list):
        raise TypeError(f"exponents must be a tuple of whole numbers, one for each coordinate, not {short(given)}")
    if set(map(type, given)) <= {int} and min(given, default=0) >= 0:  # fast path for many coordinates
        return tuple(given)
    for exponent in given:
        if isinstance(exponent, bool) or not isinstance(exponent, int | np.integer):
            raise TypeError(f"exponents {short(given)} must be whole numbers; {short(exponent)} is not")
        if exponent < 0:
            raise ValueError(f"exponents {short(given)} must not be negative")
    return tuple(map(int, given))


def read_coefficient(value: Any, what: str) -> Coefficient:
    """Validate a coefficient and return it as int, float or Fraction."""
    if isinstance(value, bool) or not isinstance(value, Rational | float | np.floating):
        raise TypeError(f"{what} must be an int, float or Fraction, not {short(value)}")
    number: Coefficient = float(value) if isinstance(value, float | np.floating) else exact_number(value)
    if not is_finite(number):
        raise ValueError(f"{what} is {short(value)}; it must be finite and within float64")
    return number
