"""Steps as truncated power series with exact polynomials in the state as coefficients, also of Runge-Kutta methods."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from numbers import Rational
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import rational
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.long_operations import note_progress
from coadjoint.methods.numerics.solvers import Coefficients, StageProblem
from coadjoint.methods.numerics.taylor_series import PowerSeries
from coadjoint.methods.protocol.method import is_short
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.system import System

NODE = "c"
"""Symbol for the node of a stage; the equations of a collocation method are the same at each node."""

DIGITS = 50  # decimal digits of irrational coefficients: those published, and more than any float keeps


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
        return cls.from_coefficients([polynomial, *[cls.ring.zero] * (cls.count - 1)])

    @classmethod
    def step(cls) -> Self:
        zero = cls.ring.zero
        return cls.from_coefficients([zero, zero + 1, *[zero] * (cls.count - 2)][: cls.count])

    @classmethod
    def _number(cls, value: Any) -> Exact | None:
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, Rational | float):
            return rational(value)
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


class StagesOfCollocation:
    """All stages of a `StageProblem` at once: X(c) = x + int_0^c L, modulo the polynomial whose roots are the nodes."""

    # Expressions equal at all nodes are computed once, and are rational although the nodes are not.

    def __init__(self, nodes: Sequence[Fraction], system: System, x: NDArray[Any], h: FormalNumber) -> None:
        self.system, self.x, self.h, ring = system, x, h, h.ring
        self._node = ring.dim + ring.symbols.index(NODE)
        node = ring.symbol_elements[NODE]
        self._modulus = ring.zero
        for power, coefficient in enumerate(nodes):
            self._modulus += rational(coefficient) * node**power

    def start(self) -> NDArray[Any]:
        return self.x[None]

    def fields(self, points: NDArray[Any]) -> NDArray[Any]:
        return self._reduced(self.system.vector_field(points[0])) * self.h

    def gradients(self, points: NDArray[Any]) -> NDArray[Any]:
        return self._reduced(self.system.hamiltonian.gradient(points[0], 0.0))

    def products(self, momenta: NDArray[Any], gradients: NDArray[Any]) -> NDArray[Any]:
        return self._reduced(self.system.structure_matrix(momenta[0]) @ gradients[0]) * (self.h * self.system.sign)

    def points(self, slopes: NDArray[Any]) -> NDArray[Any]:
        return self.x + self._reduced(self._mapped(slopes[0], lambda term: term.integral(self._node)))

    def end(self, slopes: NDArray[Any]) -> NDArray[Any]:
        return self.x + self._mapped(slopes[0], lambda term: term.integral(self._node).subs({NODE: 1}))

    def _reduced(self, values: Any) -> NDArray[Any]:
        """Return the remainders modulo the polynomial of the nodes, as those of the only stage."""
        return self._mapped(vector(map(type(self.h), values)), lambda term: divmod(term, self._modulus)[1])[None]

    @staticmethod
    def _mapped(values: NDArray[Any], function: Callable[[Any], Any]) -> NDArray[Any]:
        return vector(type(value).from_coefficients(map(function, value.coefficients)) for value in values)


def formal_end(stages: StageProblem | StagesOfCollocation, solver: str, iterations: int, count: int) -> NDArray[Any]:
    """Return the end of a step, by `count` powers of h, with slopes computed by `solver`, a key of `SOLVERS`."""
    # Explicit and implicit stages are treated alike: each pass through the equations gains a power of h.
    if solver in ("explicit", "implicit"):
        return stages.end(_converged_slopes(stages, stages.fields, count))
    frozen = stages.start()
    for _ in range(iterations):
        frozen = stages.points(stages.fields(frozen))
    if solver == "iterated":
        return stages.end(stages.fields(frozen))
    if solver == "structure":
        return stages.end(_converged_slopes(stages, lambda X: stages.products(frozen, stages.gradients(X)), count))
    gradients = stages.gradients(frozen)
    return stages.end(_converged_slopes(stages, lambda X: stages.products(X, gradients), count))


def _converged_slopes(
    stages: StageProblem | StagesOfCollocation, slopes_at: Callable[[NDArray[Any]], NDArray[Any]], count: int
) -> NDArray[Any]:
    """Return the slopes at the solution of X = x + h A L(X); each pass is exact in one more power of h."""
    points = vector(value.cut(1) for value in stages.start().ravel()).reshape(stages.start().shape)
    slopes = slopes_at(points)
    for _ in range(count):
        points = stages.points(slopes)
        slopes = slopes_at(points)
    return slopes


def rational_tableau(coefficients: Callable[..., Coefficients]) -> tuple[Coefficients, float]:
    """Return a tableau in fractions, and their relative error: 0 if the tableau is rational."""
    from mpmath import mp, workdps

    with workdps(DIGITS):
        for number in (Fraction, mp.mpf):
            try:
                tableau = Coefficients(*coefficients(number))
            except (TypeError, ValueError, ArithmeticError):
                continue
            break
        else:
            tableau = Coefficients(*coefficients())
        entries = [Fraction(fraction_of(value)) for part in tableau for value in np.ravel(part)]
        fractions = Coefficients(
            *(vector(map(fraction_of, np.ravel(part))).reshape(np.shape(part)) for part in tableau)
        )
    if all(map(is_short, entries)):
        return fractions, 0.0
    in_mpmath = all(isinstance(value, mp.mpf | Fraction | int) for part in tableau for value in np.ravel(part))
    return fractions, 10.0 ** (2 - DIGITS) if in_mpmath else UNIT_ROUNDOFF


def fraction_of(value: Any) -> Fraction:
    """Return a number of Python, NumPy or mpmath exactly as a fraction."""
    if hasattr(value, "_mpf_"):
        sign, mantissa, exponent, _ = value._mpf_
        return (-1 if sign else 1) * Fraction(int(mantissa)) * Fraction(2) ** exponent
    return Fraction(value.item() if isinstance(value, np.generic) else value)
