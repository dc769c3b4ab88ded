"""Exact numbers: conversions, number literals, simple fractions, and sums of multiples of square roots."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from fractions import Fraction
from functools import lru_cache
from numbers import Rational
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.validation import read_number

Constant = int | float | Fraction

PLAIN_NUMBER = r"(?:\d+\.?\d*|\.\d+)"
NUMBER = rf"{PLAIN_NUMBER}(?:[eE][+-]?\d+)?"
MAX_DIGITS = 400
TOO_LARGE = "is too large for float64, or has too many digits"
MAX_DENOMINATOR = 10**6
# p/q is accepted if p q <= 2^45. About 0.3 * 2^45 / 2^52 such fractions round to the same float as a random number, so
# one random number in 400 is mistaken for a fraction; the Jacobi identity must then confirm all fractions together.
MAX_FRACTION_PRODUCT = 2**45
MAX_RADICALS = 8  # square roots that are independent over the rationals, such as 1, sqrt(2), sqrt(3), sqrt(6)
MAX_SQUARE = 10**4  # numerator and denominator of the square of a float that is recognized as a square root
ROOT_ERROR = 4.0 * UNIT_ROUNDOFF  # of such a float: a root, a quotient and a product are rounded
ROOT_BITS = 512  # of square roots: far more than products of matrices lose

Roots = dict[int, int | Fraction]
"""The factors of square roots of numbers without square factors."""


def exact_number(value: Any) -> Any:
    """Convert a finite float or any rational number exactly to int or Fraction; return other numbers unchanged."""
    if isinstance(value, float):
        return int(value) if value.is_integer() else Fraction(value)
    if isinstance(value, int | Fraction) or not isinstance(value, Rational):
        return value
    return fraction(value)


def read_exact(value: Any, what: str) -> int | Fraction:
    """Validate a real number and return it exactly."""
    number = read_number(value, what)
    exact: int | Fraction = exact_number(value if isinstance(value, Rational) else number)
    return exact


def fraction(value: Any) -> int | Fraction:
    """Convert a rational number, such as one of NumPy or python-flint, to int or Fraction."""
    numerator, denominator = int(value.numerator), int(value.denominator)
    return numerator if denominator == 1 else Fraction(numerator, denominator)


def rational(value: Any) -> Any:
    """Convert a finite number exactly to `flint.fmpq`."""
    from flint import fmpq

    exact = Fraction(exact_number(value))
    return fmpq(exact.numerator, exact.denominator)


def ball(value: Any) -> Any:
    """Convert a finite number to `flint.arb`, a ball of the current precision."""
    from flint import arb

    return arb(rational(value))


def midpoint(value: Any) -> Fraction:
    """Return the midpoint of a ball exactly."""
    mantissa, exponent = value.mid().man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


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
    if literal.isdigit() and len(literal) <= MAX_DIGITS:
        return checked(int(literal))
    return parse_decimal(literal)


def parse_decimal(literal: str) -> float:
    """Parse a number as a float; ValueError if it has too many digits, is too large, or would be rounded to zero."""
    digits = sum(map(str.isdigit, literal))
    if digits > MAX_DIGITS:
        raise ValueError(f"a number of {digits} digits {TOO_LARGE}")
    value = float(literal)
    if value == 0.0 and any(digit in "123456789" for digit in re.split("[eE]", literal)[0]):
        raise ValueError(f"the number {short(literal, 40)} is too small for float64; write 0, or choose other units")
    return float(checked(value))


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


def as_fraction(value: float) -> Fraction | None:
    """Return the simple fraction that rounds to a float, or None: p/q with q <= 10^6 and p q <= 2^45, or an integer."""
    simple = Fraction(value).limit_denominator(MAX_DENOMINATOR)
    if float(simple) != value:
        return None
    plain = simple.denominator == 1 or abs(simple.numerator) * simple.denominator <= MAX_FRACTION_PRODUCT
    return simple if plain else None


def recognized_roots(parts: list[Any]) -> dict[Any, Roots] | None:
    """Return each number as a rational multiple of a square root; None if one is not recognized."""
    found: dict[Any, Roots] = {}
    radicals = {1}
    for value in set(parts):
        simple = value if isinstance(value, int | Fraction) else as_fraction(value)
        found[value] = {1: simple} if simple is not None else _square_root(value)
        if not found[value]:
            return None
        root = next(iter(found[value]))
        if root not in radicals:
            radicals |= {product_of_roots(root, other)[0] for other in radicals}
            if len(radicals) > MAX_RADICALS:
                return None
    return found


def _square_root(value: float) -> Roots:
    """Return {m: q} if a float is q sqrt(m) to round-off, with a square q^2 m that is a simple fraction; else empty."""
    square = (Fraction(value) ** 2).limit_denominator(MAX_SQUARE)
    if not 0 < square.numerator <= MAX_SQUARE:
        return {}
    product, root, square_free = square.numerator * square.denominator, 1, 1
    for prime in range(2, math.isqrt(product) + 1):
        if prime * prime > product:
            break
        while product % (prime * prime) == 0:
            product, root = product // prime**2, root * prime
        if product % prime == 0:
            product, square_free = product // prime, square_free * prime
    factor = Fraction(root, square.denominator) * (1 if value > 0 else -1)
    roots: Roots = {square_free * product: factor}
    return roots if abs(rounded_sum(roots) - value) <= ROOT_ERROR * abs(value) else {}


@lru_cache(maxsize=4096)
def product_of_roots(a: int, b: int) -> tuple[int, int]:
    """Return (m, s) with sqrt(a) sqrt(b) = s sqrt(m), for numbers without square factors."""
    common = math.gcd(a, b)
    return (a // common) * (b // common), common


def rounded_sum(roots: Roots) -> float:
    """Round a sum of rational multiples of square roots once."""
    if all(root == 1 for root in roots):
        return rounded(roots.get(1, 0))
    total = sum(
        (factor * Fraction(math.isqrt(root << (2 * ROOT_BITS)), 1 << ROOT_BITS) for root, factor in roots.items()),
        start=Fraction(0),
    )
    return rounded(total)
