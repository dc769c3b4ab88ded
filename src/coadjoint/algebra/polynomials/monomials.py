"""Validation of the exponents and the coefficient of a monomial."""

from __future__ import annotations

from numbers import Rational
from typing import Any

import numpy as np

from coadjoint.algebra.exact.numbers import exact_number, is_finite
from coadjoint.algebra.polynomials.product_sums import Coefficient
from coadjoint.short_repr import short

Exponents = tuple[int, ...]


def read_exponents(argument: Any) -> Exponents:
    """Validate exponents and return them as Python integers."""
    if not isinstance(argument, tuple | list):
        raise TypeError(f"exponents must be a tuple of whole numbers, one for each coordinate, not {short(argument)}")
    if set(map(type, argument)) <= {int} and min(argument, default=0) >= 0:  # fast path for many coordinates
        return tuple(argument)
    for exponent in argument:
        if isinstance(exponent, bool) or not isinstance(exponent, int | np.integer):
            raise TypeError(f"exponents {short(argument)} must be whole numbers; {short(exponent)} is not")
        if exponent < 0:
            raise ValueError(f"exponents {short(argument)} must not be negative")
    return tuple(map(int, argument))


def read_coefficient(value: Any, what: str) -> Coefficient:
    """Validate a coefficient and return it as int, float or Fraction."""
    if isinstance(value, bool) or not isinstance(value, Rational | float | np.floating):
        raise TypeError(f"{what} must be an int, float or Fraction, not {short(value)}")
    number: Coefficient = float(value) if isinstance(value, float | np.floating) else exact_number(value)
    if not is_finite(number):
        raise ValueError(f"{what} is {short(value)}; it must be finite and within float64")
    return number
