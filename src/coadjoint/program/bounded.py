"""Arrays of pairs of floats with bounds of their errors, for exact decisions and correct rounding in NumPy.

All operations are elementwise, so that a result does not depend on the other entries of an array. References: Dekker
1971; Joldes, Muller, Popescu, ACM TOMS 44 (2017).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF

Floats = NDArray[np.float64]
Masks = NDArray[np.bool_]

SPLITTER = 2.0**27 + 1.0
SMALLEST_PRODUCT = 2.0**-960  # of smaller products the low part is not exact
SMALLEST_FACTOR = 2.0**-300  # of products of three that are exact
UNDERFLOW = 2.0**-1060
SLACK = 1.0 + 2.0**-30  # for the rounding of bounds
LARGEST_RELATIVE_ERROR = 2.0**-20  # of divisors


def two_sum(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return the rounded sum and its error."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _fast_two_sum(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return the rounded sum and its error, for abs(a) >= abs(b)."""
    total = a + b
    return total, b - (total - a)


def two_product(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return the rounded product and its error."""
    (a1, a2), (b1, b2) = (_halves(factor) for factor in (a, b))
    product = a * b
    return product, ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2


def _halves(a: Floats) -> tuple[Floats, Floats]:
    scaled = SPLITTER * a
    high = scaled - (scaled - a)
    return high, a - high


@dataclass(frozen=True, slots=True)
class Bounded:
    """Numbers ``high + low`` with abs(low) <= half a unit in the last place of high, each known to within `error`.

    An error of zero is exact. Overflow gives NaN, with which no comparison is certain.
    """

    high: Floats
    low: Floats
    error: Floats

    @classmethod
    def of(cls, values: Any) -> Bounded:
        """Return floats as exact numbers."""
        high = np.asarray(values, dtype=np.float64)
        return cls(high, np.zeros_like(high), np.zeros_like(high))

    def __getitem__(self, index: Any) -> Bounded:
        return Bounded(self.high[index], self.low[index], self.error[index])

    def __setitem__(self, index: Any, other: Bounded) -> None:
        self.high[index], self.low[index], self.error[index] = other.high, other.low, other.error

    def copy(self) -> Bounded:
        """Return a copy whose entries can be set."""
        return Bounded(self.high.copy(), self.low.copy(), self.error.copy())

    def scaled(self, factor: Any) -> Bounded:
        """Return the product with powers of two, of either sign."""
        return Bounded(self.high * factor, self.low * factor, self.error * np.abs(factor))

    def _scales(self) -> Masks:
        """Return which numbers are powers of two, products with which are exact."""
        return np.asarray((np.abs(np.frexp(self.high)[0]) == 0.5) & (self.low == 0.0))

    def __add__(self, other: Bounded) -> Bounded:
        total, first = two_sum(self.high, other.high)
        lows, second = two_sum(self.low, other.low)
        middle, lost = two_sum(first, lows)
        high, rest = two_sum(total, middle)
        low, more = two_sum(rest, second)
        return Bounded(*two_sum(high, low), self.error + other.error + np.abs(lost) + np.abs(more))

    def __sub__(self, other: Bounded) -> Bounded:
        return self + other.scaled(-1.0)

    def __mul__(self, other: Bounded) -> Bounded:
        product, rest = two_product(self.high, other.high)
        first, second = self.high * other.low, self.low * other.high
        low = rest + (first + second)
        error = self.error * np.abs(other.high) + other.error * np.abs(self.high) + self.error * other.error
        plain = (self.low == 0.0) & (other.low == 0.0)
        if not plain.all():
            plain = plain | self._scales() | other._scales()
        rounding = 4.0 * UNIT_ROUNDOFF * (np.abs(first) + np.abs(second) + np.abs(low))
        error = error * SLACK + np.where(plain, 0.0, rounding)
        small = (np.abs(product) < SMALLEST_PRODUCT) & (self.high != 0.0) & (other.high != 0.0)
        return Bounded(*_fast_two_sum(product, low), error + np.where(small, UNDERFLOW, 0.0))

    def __truediv__(self, other: Bounded) -> Bounded:
        exact = np.zeros_like(other.high + self.high)
        divisor = Bounded(other.high, other.low, exact)
        first = self.high / other.high
        rest = Bounded(self.high, self.low, exact) - Bounded.of(first) * divisor
        second = rest.high / other.high
        rest = rest - Bounded.of(second) * divisor
        third = rest.high / other.high
        high, low = _fast_two_sum(first, second)
        low, lost = two_sum(low, third)
        size = np.abs(other.high)
        # The last quotient is rounded, and leaves a remainder, unless the division ends.
        remainder = 4.0 * UNIT_ROUNDOFF * np.abs(rest.high) + np.abs(rest.low) + rest.error
        given = self.error + np.abs(first) * other.error
        error = np.abs(lost) + (remainder + given) / size * SLACK
        error = np.where(other.error < LARGEST_RELATIVE_ERROR * size, error, np.inf)
        small = (np.abs(first) < SMALLEST_PRODUCT) & (self.high != 0.0)
        return Bounded(*_fast_two_sum(high, low), error + np.where(small, UNDERFLOW, 0.0))

    def __abs__(self) -> Bounded:
        return self.scaled(np.where(self.high < 0.0, -1.0, 1.0))

    def signs(self) -> tuple[NDArray[Any], Masks]:
        """Return the signs, and whether they are certain."""
        certain = (np.abs(self.high + self.low) > SLACK * self.error) | ((self.high == 0.0) & (self.error == 0.0))
        return np.sign(self.high), certain

    def signs_of_difference(self, other: Bounded) -> tuple[NDArray[Any], Masks]:
        """Return the signs of self - other, and whether they are certain; mostly by their high parts."""
        difference = self.high - other.high
        bound = 4.0 * UNIT_ROUNDOFF * (np.abs(self.high) + np.abs(other.high)) + SLACK * (self.error + other.error)
        certain = np.abs(difference) > bound
        return (np.sign(difference), certain) if certain.all() else (self - other).signs()

    def rounded(self) -> tuple[Floats, Masks]:
        """Return the nearest floats, and whether they are certain."""
        bound = np.where(self.error == 0.0, 0.0, SLACK * self.error + 4.0 * UNIT_ROUNDOFF * np.abs(self.low))
        ends = [self.high + (self.low + sign * bound) for sign in (-1.0, 1.0)]
        return self.high, (ends[0] == self.high) & (ends[1] == self.high)


def distilled(terms: list[Floats]) -> list[Floats]:
    """Return floats with the same sum, of which each is little more than the rounding of those behind it."""
    parts = list(terms)
    for _ in range(3):
        for k in range(1, len(parts)):
            parts[k], parts[k - 1] = two_sum(parts[k - 1], parts[k])
    return parts


def sum_of(terms: list[Floats]) -> Bounded:
    """Return the sum of floats, of which no more is rounded than the result."""
    *others, last = distilled(terms)
    result = Bounded.of(last)
    for part in others[::-1]:
        result = result + Bounded.of(part)
    return result


def determinant_terms(entries: Sequence[Sequence[list[Floats]]]) -> list[Floats]:
    """Return floats whose sum is the determinant of up to three rows, whose entries are sums of floats, none small."""
    if len(entries) == 1:
        return entries[0][0]
    terms = []
    for k, parts in enumerate(entries[0]):
        minor = determinant_terms([[*row[:k], *row[k + 1 :]] for row in entries[1:]])
        terms += [p for part in parts for one in minor for p in two_product(part * (-1.0) ** k, one)]
    return terms
