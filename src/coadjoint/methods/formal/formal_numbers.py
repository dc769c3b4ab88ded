"""Truncated power series in the step with exact polynomials in the state as coefficients."""

from __future__ import annotations

from fractions import Fraction
from numbers import Rational
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import rational
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.long_operations import note_progress
from coadjoint.methods.numerics.power_series import PowerSeries

NODE = "c"
"""Symbol for the node of a stage; the equations of a collocation method are the same at each node."""


class FormalNumber(PowerSeries):
    """A power series in the step over a ring of polynomials, without an order; floats are converted exactly."""

    __slots__ = ()

    ring: ClassVar[ExactPolynomials]
    count: ClassVar[int]
    """Largest number of coefficients."""
    exact: ClassVar[bool] = True

    def __init__(self, value: Any = 0) -> None:
        operand = self._operand(value)
        if operand is None:
            raise TypeError(f"a {type(value).__name__} is not a rational number; formal series need rational numbers")
        self.coefficients = operand.coefficients

    @classmethod
    def constant(cls, polynomial: Exact) -> Self:
        """Return a polynomial that does not depend on the step."""
        return cls.from_coefficients([polynomial, *[cls.ring.zero] * (cls.count - 1)])

    @classmethod
    def step(cls) -> Self:
        """Return the step itself."""
        zero = cls.ring.zero
        return cls.from_coefficients([zero, zero + 1, *[zero] * (cls.count - 2)][: cls.count])

    @classmethod
    def _number(cls, value: Any) -> Exact | None:
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, Rational | float):
            return rational(value if isinstance(value, float) else Fraction(value))
        return None

    @classmethod
    def _operand(cls, value: Any) -> FormalNumber | None:
        if isinstance(value, FormalNumber):
            return value
        number = cls._number(value)
        return None if number is None else cls.constant(cls.ring.zero + number)

    def cut(self, count: int) -> Self:
        """Return the series truncated to this number of coefficients."""
        return self.from_coefficients(self.coefficients[:count])

    @property
    def valuation(self) -> int:
        """The first power with a nonzero coefficient; the number of coefficients if all vanish."""
        return next((k for k, term in enumerate(self.coefficients) if term != 0), len(self.coefficients))

    def _known(self, other: Any) -> int:
        note_progress("products of series in exact polynomials")
        a, b = self.coefficients, other.coefficients
        return min(len(a) + other.valuation, len(b) + self.valuation, self.count)

    def __truediv__(self, other: Any) -> Self:
        """Return the quotient by a series whose constant term is a nonzero number."""
        right = self._operand(other)
        if right is None:
            return NotImplemented
        lead = right.coefficients[0] if right.coefficients else self.ring.zero
        if lead == 0 or not lead.is_constant():
            raise ZeroDivisionError("the divisor of a formal series has a constant term that is zero or not a number")
        inverse = 1 / lead.leading_coefficient()
        coefficients: list[Exact] = []
        for k in range(min(len(self.coefficients), len(right.coefficients))):
            remainder = self.coefficients[k]
            for j in range(1, k + 1):
                remainder = remainder - right.coefficients[j] * coefficients[k - j]
            coefficients.append(remainder * inverse)
        return self.from_coefficients(coefficients)

    def __rtruediv__(self, other: Any) -> FormalNumber:
        left = self._operand(other)
        return NotImplemented if left is None else left / self

    def __abs__(self) -> Any:
        """Return the size of the constant term if it is a number, for pivoting in elimination."""
        lead = self.coefficients[0]
        if not lead.is_constant():
            raise TypeError("a formal series has no absolute value: its constant term is not a number")
        return abs(Fraction(str(lead.leading_coefficient())) if lead != 0 else Fraction(0))

    def __eq__(self, other: object) -> bool:
        right = self._operand(other)
        if right is None:
            return NotImplemented
        return all(a == b for a, b in zip(self.coefficients, right.coefficients, strict=False))

    __hash__ = None  # type: ignore[assignment]


def formal_numbers(ring: ExactPolynomials, count: int) -> type[FormalNumber]:
    """Return the class of formal numbers over a ring with the coefficients of h^0, ..., h^(count - 1).

    Examples
    --------
    >>> from coadjoint.algebra import catalogue
    >>> ring = ExactPolynomials(catalogue.so(3))
    >>> Number = formal_numbers(ring, 3)
    >>> x, h = Number.constant(ring.coordinates[0]), Number.step()
    >>> (x / (1 - h * x)).coefficients
    [x1, x1^2, x1^3]
    """
    return type("FormalNumberHere", (FormalNumber,), {"__slots__": (), "ring": ring, "count": count})


def vector(entries: Any) -> NDArray[Any]:
    """Return formal numbers as an array of objects."""
    listed = list(entries)
    result = np.empty(len(listed), dtype=object)
    result[:] = listed
    return result
