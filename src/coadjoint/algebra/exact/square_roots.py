"""Sums of rational multiples of square roots, as exact numbers."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache
from typing import Any

from coadjoint.algebra.exact.elimination import Number
from coadjoint.algebra.exact.numbers import rounded
from coadjoint.algebra.exact.ranks import as_fraction
from coadjoint.rounding import UNIT_ROUNDOFF

MAX_RADICALS = 8  # square roots that are independent over the rationals, such as 1, sqrt(2), sqrt(3), sqrt(6)
MAX_SQUARE = 10**4  # numerator and denominator of the square of a float that is recognized as a square root
ROOT_ERROR = 4.0 * UNIT_ROUNDOFF  # of such a float: a root, a quotient and a product are rounded
ROOT_BITS = 512  # of square roots: far more than products of matrices lose

Roots = dict[int, Number]
"""The factors of square roots of numbers without square factors."""


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
