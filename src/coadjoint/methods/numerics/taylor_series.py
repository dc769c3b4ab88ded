"""Taylor series of a motion in NumPy: the reference for ``taylor_variable.cpp`` and ``steps/step_length.hpp``.

`near_log2`, `near_power_of_two` and `logarithm_of_step` repeat their formulas: library functions choose other steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import reduce
from operator import add
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.long_operations import note_progress
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.lie_poisson import LiePoissonSystem

DECIDING_TERMS = 4  # number of last and of middle terms that determine the length
LN2 = 0.6931471805599453  # literal, so that no bit depends on a library
NO_LIMIT = 900.0  # binary logarithm of the largest length
MAX_STEPS = 1_000_000  # steps of a plain step in Python, some minutes
TOO_MANY_STEPS_MESSAGE = "or more than 2^24 of its own steps would lie in one step of the run: give a smaller step"
"""End of the messages about steps that become too short; the limit is that of the kernels."""
TOO_SHORT_MESSAGE = (
    "the motion becomes so fast that steps no longer change the time: it blows up, or nearly so; "
    + TOO_MANY_STEPS_MESSAGE
)


class PowerSeries:
    """The series sum_k coefficients[k] t^k of any number type; results have the terms known of both operands."""

    __slots__ = ("coefficients",)

    def __init__(self, coefficients: Iterable[Any]) -> None:
        self.coefficients = list(coefficients)

    @classmethod
    def from_coefficients(cls, coefficients: Iterable[Any]) -> Self:
        result = cls.__new__(cls)
        result.coefficients = list(coefficients)
        return result

    @classmethod
    def _number(cls, value: Any) -> Any:
        """Return a constant as a number for the coefficients, or None if it is not one."""
        return value

    def __add__(self, other: Any) -> Self:
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
        a = self.coefficients
        if not isinstance(other, PowerSeries):
            number = self._number(other)
            return NotImplemented if number is None else self.from_coefficients(c * number for c in a)
        b = other.coefficients

        def products(k: int) -> list[Any]:
            return [a[j] * b[k - j] for j in range(max(0, k + 1 - len(b)), min(k + 1, len(a)))]

        return self.from_coefficients(reduce(add, products(k) or [0 * a[0]]) for k in range(self._known(other)))

    def __pow__(self, exponent: Any) -> Self | int:
        if isinstance(exponent, bool) or int(exponent) != exponent or exponent < 0:
            raise TypeError(f"the exponent of a power series is {exponent!r}; give an integer of at least 0")
        result: Any = 1
        for _ in range(int(exponent)):
            result = self * result
        return result

    def __pos__(self) -> Self:
        return self

    def __neg__(self) -> Self:
        return self * -1

    def __sub__(self, other: Any) -> Self:
        return self + other * -1

    def __rsub__(self, other: Any) -> Self:
        return self * -1 + other

    def __truediv__(self, other: Any) -> Self:
        return self.from_coefficients(c / other for c in self.coefficients)

    __radd__, __rmul__ = __add__, __mul__


class Dual:
    """A number with its derivative, an array; supports sums and products with dual and plain numbers."""

    __array_ufunc__ = None

    def __init__(self, value: Any, derivative: NDArray[Any]) -> None:
        self.value, self.derivative = value, derivative

    def __add__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.derivative + other.derivative)
        return Dual(self.value + other, self.derivative)

    def __mul__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value * other.value, self.value * other.derivative + other.value * self.derivative)
        if isinstance(other, Fraction) and self.derivative.dtype == np.float64:
            other = float(other)  # the conversion that Python makes in products with a float
        return Dual(self.value * other, other * self.derivative)

    def __truediv__(self, other: Any) -> Dual:
        return Dual(self.value / other, self.derivative / other)

    __radd__, __rmul__ = __add__, __mul__


def expand(field: Callable[[NDArray[Any]], NDArray[Any]], x: NDArray[Any], h: Any, order: int) -> list[NDArray[Any]]:
    """Return x_1 h, ..., x_p h^p of x' = field(x), a field of sums and products, by x_(k+1) = f_k / (k + 1)."""
    terms = [x]
    for k in range(order):
        # The number of products up to a power grows like its square.
        note_progress(f"the power {k + 1} of {order} of a series", (k / order) ** 3)
        series = np.empty(len(x), dtype=object)
        series[:] = [PowerSeries([term[i] for term in terms]) for i in range(len(x))]
        slopes = np.empty(len(x), dtype=object)
        slopes[:] = [f.coefficients[k] if isinstance(f, PowerSeries) else x[0] * 0 for f in field(series)]
        terms.append(slopes * h / (k + 1))
    return terms[1:]


def near_log2(a: float) -> float:
    """Return the binary logarithm of a positive number, within 2e-5; -1022 for zero."""
    if a < 2.0**-1022:
        return -1022.0
    half, exponent = math.frexp(a)
    z = (2.0 * half - 1.0) / (2.0 * half + 1.0)
    zz = z * z
    series = 2.885390081777927 + zz * (0.9617966939259757 + zz * (0.5770780163555854 + zz * 0.41219858311113244))
    return float(exponent - 1) + z * series


def near_power_of_two(a: float) -> float:
    """Return 2^a for a from -1000 to 1000, with a relative error of 4e-6."""
    integer = round(a)
    r = (a - integer) * LN2
    series = 1.0 + r * (0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0))))
    return math.ldexp(1.0 + r * series, integer)


def logarithm_of_step(sizes: Sequence[float], largest: float, tolerance: float) -> float:
    """Return log2 of a step in units of the time h of the terms; A. Jorba, M. Zou, Exp. Math. 14 (2005), 3.2."""
    # There the last terms are `tolerance * largest`; at most half the radius of convergence, so that decay is kept.
    order = len(sizes)
    last = range(max(1, order + 1 - DECIDING_TERMS), order + 1)
    level, last_size = near_log2(largest), max(sizes[k - 1] for k in last)
    radius = min(
        ((level - near_log2(sizes[k - 1])) * (1.0 / k) for k in last if sizes[k - 1] > 0.0), default=2.0 * NO_LIMIT
    )
    length = min(radius, 2.0 * NO_LIMIT) + near_log2(tolerance) / order
    if order >= 2 * DECIDING_TERMS and last_size > 0.0:
        middle = max(sizes[order // 2 - DECIDING_TERMS : order // 2])
        if middle > 0.0:
            converging = (near_log2(middle) - near_log2(last_size)) * (1.0 / (order - order // 2))
            length = min(length, converging - 1.0)
    return max(min(length, NO_LIMIT), -NO_LIMIT)


def advance_by_own_steps(
    field: Callable[[NDArray[Any]], NDArray[Any]],
    x: NDArray[Any],
    h: Any,
    order: int,
    tolerance: float,
    to_level_set: Callable[[NDArray[Any]], NDArray[Any]],
) -> NDArray[Any]:
    """Return the state after a time h of either sign, in steps chosen from the series, each ending on the level set."""
    elapsed, memory = h * 0, None
    for _ in range(MAX_STEPS):
        terms, scale, length, memory = own_step(field, x, h, order, tolerance, memory)
        remaining = h - elapsed
        if abs(remaining) <= abs(length):
            return to_level_set(x + _sum(terms, remaining / scale))
        x = to_level_set(x + _sum(terms, length / scale))
        elapsed = elapsed + length
        if not abs(length) > UNIT_ROUNDOFF * abs(elapsed):
            break
    raise IntegrationError(TOO_SHORT_MESSAGE, step=1, time=float(elapsed), residual=float(length))


def own_step(
    field: Callable[[NDArray[Any]], NDArray[Any]],
    x: NDArray[Any],
    h: Any,
    order: int,
    tolerance: float,
    memory: tuple[float, float] | None,
) -> tuple[list[NDArray[Any]], float, float, tuple[float, float]]:
    """Return terms of the motion from x, their time unit, the step, and the next memory: (largest state, time unit)."""
    largest, scale = memory or (0.0, _time_of_change(field, x, h))
    largest = max(largest, _size(x))
    terms = expand(field, x, scale, order)
    length = scale * near_power_of_two(logarithm_of_step([_size(term) for term in terms], largest, tolerance))
    if length == 0.0:
        raise IntegrationError(TOO_SHORT_MESSAGE, step=1, time=0.0, residual=0.0)
    return terms, scale, length, (largest, math.copysign(2.0 ** (math.frexp(length)[1] - 1), float(h)))


def _time_of_change(field: Callable[[NDArray[Any]], NDArray[Any]], x: NDArray[Any], h: Any) -> float:
    """Return the approximate time in which the state changes by its own size, a power of two with the sign of h."""
    speed, size = _size(expand(field, x, 1.0, 1)[0]), _size(x)
    return math.copysign(2.0 ** math.floor(near_log2(size) - near_log2(speed)) if speed > 0.0 else 1.0, float(h))


def _sum(terms: Sequence[NDArray[Any]], s: Any) -> NDArray[Any]:
    total = terms[-1] * s
    for term in reversed(terms[:-1]):
        total = (total + term) * s
    return total


def _size(x: NDArray[Any]) -> float:
    return float(np.sum([abs(float(v.value if isinstance(v, Dual) else v)) for v in x]))


def expand_quadratic(
    system: LiePoissonSystem, x: NDArray[np.float64], h: float, order: int
) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Return `expand` with derivatives for x' = L x + Q(x) x / 2, with Jacobian L + Q(x): H is quadratic."""
    linear = system.jacobian(np.zeros(len(x)))
    terms, derivatives, quadratic = [x], [np.eye(len(x))], list[NDArray[np.float64]]()
    for k in range(order):
        note_progress(f"the power {k + 1} of {order} of a series", (k / order) ** 2)
        quadratic.append(system.jacobian(terms[k]) - linear)
        slope, changes = linear @ terms[k], linear @ derivatives[k]
        for Q, y, D in zip(quadratic, reversed(terms), reversed(derivatives), strict=True):
            slope += Q @ y / 2
            changes += Q @ D
        terms.append(slope * h / (k + 1))
        derivatives.append(changes * h / (k + 1))
    return terms[1:], derivatives[1:]
