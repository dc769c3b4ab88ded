"""Arithmetic of Taylor methods: truncated power series in time, and dual numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.long_operations import at


class PowerSeries:
    """The power series sum_k coefficients[k] t^k; sums and products are truncated at the same power.

    Examples
    --------
    >>> (PowerSeries([1, 1, 0]) * PowerSeries([1, -1, 0]) + 2).coefficients
    [3, 0, -1]
    """

    def __init__(self, coefficients: Sequence[Any]) -> None:
        self.coefficients = list(coefficients)

    def __add__(self, other: Any) -> PowerSeries:
        """Return the sum with a series of equal length, or with a constant."""
        if isinstance(other, PowerSeries):
            return PowerSeries([a + b for a, b in zip(self.coefficients, other.coefficients, strict=True)])
        return PowerSeries([self.coefficients[0] + other, *self.coefficients[1:]])

    def __mul__(self, other: Any) -> PowerSeries:
        """Return the product with a series of equal length, or with a constant."""
        a = self.coefficients
        if isinstance(other, PowerSeries):
            b = other.coefficients
            return PowerSeries([sum((a[j] * b[k - j] for j in range(1, k + 1)), a[0] * b[k]) for k in range(len(a))])
        return PowerSeries([c * other for c in a])

    def __pow__(self, exponent: int) -> PowerSeries | int:
        """Return an integer power."""
        result: Any = 1
        for _ in range(exponent):
            result = self * result
        return result

    def __neg__(self) -> PowerSeries:
        """Return the negative."""
        return self * -1

    def __sub__(self, other: Any) -> PowerSeries:
        """Return the difference."""
        return self + other * -1

    def __rsub__(self, other: Any) -> PowerSeries:
        """Return the difference of a constant and the series."""
        return self * -1 + other

    def __truediv__(self, other: Any) -> PowerSeries:
        """Return the quotient by a constant."""
        return PowerSeries([c / other for c in self.coefficients])

    __radd__, __rmul__ = __add__, __mul__


class Dual:
    """A number with its derivative, an array; supports sums and products with dual and plain numbers.

    Examples
    --------
    >>> square = Dual(3.0, np.array([1.0])) * Dual(3.0, np.array([1.0]))
    >>> square.value, square.derivative
    (9.0, array([6.]))
    """

    __array_ufunc__ = None

    def __init__(self, value: Any, derivative: NDArray[Any]) -> None:
        self.value, self.derivative = value, derivative

    def __add__(self, other: Any) -> Dual:
        """Return the sum."""
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.derivative + other.derivative)
        return Dual(self.value + other, self.derivative)

    def __mul__(self, other: Any) -> Dual:
        """Return the product."""
        if isinstance(other, Dual):
            return Dual(self.value * other.value, self.value * other.derivative + other.value * self.derivative)
        if isinstance(other, Fraction) and self.derivative.dtype == np.float64:
            other = float(other)  # the conversion that Python makes in products with a float
        return Dual(self.value * other, other * self.derivative)

    def __truediv__(self, other: Any) -> Dual:
        """Return the quotient by a plain number."""
        return Dual(self.value / other, self.derivative / other)

    __radd__, __rmul__ = __add__, __mul__


def expand(field: Callable[[NDArray[Any]], NDArray[Any]], x: NDArray[Any], h: Any, order: int) -> list[NDArray[Any]]:
    """Return x_1 h, ..., x_p h^p of the motion x' = field(x) from x, by x_(k+1) = f_k / (k + 1).

    The field consists of sums and products; the entries of x are numbers of one type, or `Dual`.
    """
    terms = [x]
    for k in range(order):
        # The number of products up to a power grows like its square.
        at(f"the power {k + 1} of {order} of a series", (k / order) ** 3)
        series = np.empty(len(x), dtype=object)
        series[:] = [PowerSeries([term[i] for term in terms]) for i in range(len(x))]
        slopes = np.empty(len(x), dtype=object)
        slopes[:] = [f.coefficients[k] if isinstance(f, PowerSeries) else x[0] * 0 for f in field(series)]
        terms.append(slopes * h / (k + 1))
    return terms[1:]
