"""Truncated power series with coefficients of any number type."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from operator import add
from typing import Any, Self


class PowerSeries:
    """The series sum_k coefficients[k] t^k; sums and products have the known coefficients of both operands."""

    __slots__ = ("coefficients",)

    def __init__(self, coefficients: Iterable[Any]) -> None:
        self.coefficients = list(coefficients)

    @classmethod
    def from_coefficients(cls, coefficients: Iterable[Any]) -> Self:
        """Return the series with these coefficients; higher ones are unknown."""
        result = cls.__new__(cls)
        result.coefficients = list(coefficients)
        return result

    @classmethod
    def _number(cls, value: Any) -> Any:
        """Return a constant as a number for the coefficients, or None if it is not one."""
        return value

    def __add__(self, other: Any) -> Self:
        """Return the sum with a series or with a constant."""
        if isinstance(other, PowerSeries):
            return self.from_coefficients(a + b for a, b in zip(self.coefficients, other.coefficients, strict=False))
        number = self._number(other)
        return (
            NotImplemented
            if number is None
            else self.from_coefficients([self.coefficients[0] + number, *self.coefficients[1:]])
        )

    def _known(self, other: Any) -> int:
        """Return the number of coefficients of a product that are known."""
        return min(len(self.coefficients), len(other.coefficients))

    def __mul__(self, other: Any) -> Self:
        """Return the product with a series or with a constant."""
        a = self.coefficients
        if not isinstance(other, PowerSeries):
            number = self._number(other)
            return NotImplemented if number is None else self.from_coefficients(c * number for c in a)
        b = other.coefficients

        def products(k: int) -> list[Any]:
            return [a[j] * b[k - j] for j in range(max(0, k + 1 - len(b)), min(k + 1, len(a)))]

        return self.from_coefficients(reduce(add, products(k) or [0 * a[0]]) for k in range(self._known(other)))

    def __pow__(self, exponent: Any) -> Self | int:
        """Return an integer power."""
        if isinstance(exponent, bool) or int(exponent) != exponent or exponent < 0:
            raise TypeError(f"the exponent of a power series is {exponent!r}; give an integer of at least 0")
        result: Any = 1
        for _ in range(int(exponent)):
            result = self * result
        return result

    def __pos__(self) -> Self:
        return self

    def __neg__(self) -> Self:
        """Return the negative."""
        return self * -1

    def __sub__(self, other: Any) -> Self:
        """Return the difference."""
        return self + other * -1

    def __rsub__(self, other: Any) -> Self:
        """Return the difference of a constant and the series."""
        return self * -1 + other

    def __truediv__(self, other: Any) -> Self:
        """Return the quotient by a constant."""
        return self.from_coefficients(c / other for c in self.coefficients)

    __radd__, __rmul__ = __add__, __mul__
