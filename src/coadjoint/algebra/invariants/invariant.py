"""Invariants that are not polynomials: Python functions, rational functions, logarithms and angles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import exact_number, rounded
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import function_name, short
from coadjoint.validation import read_number

HOLD, QUOTIENT, LOGARITHM, ANGLE, SINH, SINH_SQUARED, COSH = 0, 1, 2, 3, 4, 5, 6
MAX_PERIOD_DENOMINATOR = 1000  # of the ratio of two angles with a common period

Number = int | Fraction


@suggest_keywords
@dataclass(frozen=True, repr=False)
class Invariant:
    """A function of the state that the motion preserves, given as a Python function.

    Choose it for Casimirs and integrals that are not polynomials; `Polynomial` is faster for polynomials.

    Parameters
    ----------
    value : callable
        Pure function of the state x, an array of shape (n,), that returns a number. Written with `math` functions of
        the coordinates it can be compiled.
    gradient : callable, optional
        Function of x that returns the gradient, shape (n,).
    period : float, optional
        Positive for a multivalued function (a logarithm with an angle): `value` is known up to multiples of `period`
        and is unwrapped along a run. Zero (the default) for a single-valued one.

    Raises
    ------
    TypeError
        `value` or `gradient` cannot be called, or `period` is not a number.
    ValueError
        `period` is negative or not finite.

    Examples
    --------
    >>> ratio = Invariant(lambda x: x[1] / x[0])
    >>> ratio([2.0, 3.0, 1.0])
    1.5
    """

    value: Callable[[Any], Any]
    gradient: Callable[[Any], Any] | None = None
    period: float = 0.0

    def __post_init__(self) -> None:
        if not callable(self.value):
            raise TypeError(f"value of an Invariant must be a function of x, not {short(self.value)}")
        if self.gradient is not None and not callable(self.gradient):
            raise TypeError(f"gradient of an Invariant must be a function of x or None, not {short(self.gradient)}")
        period = read_number(self.period, "period of an Invariant")
        if period < 0.0:
            raise ValueError(f"period of an Invariant is {period!r}; it must not be negative")
        object.__setattr__(self, "period", period)

    _term_count: ClassVar[int] = 1

    @property
    def _written_names(self) -> tuple[str, ...] | None:
        """Those of its function."""
        return getattr(self.value, "_written_names", None)

    def _transformed(self, change: Callable[[Polynomial], Polynomial], restricted: bool = False) -> Any:
        """Return None: in other coordinates a function of the user is not known."""
        return None

    def named(self, names: Sequence[str]) -> Invariant:
        """Return the invariant unchanged: its text has no names of coordinates."""
        return self

    def gradient_and_size(self, x: Any) -> tuple[NDArray[Any], NDArray[Any], int]:
        """Return the gradient, its absolute values, and a bound of the operations: twenty bits may be lost."""
        assert self.gradient is not None
        gradient = np.asarray(self.gradient(x), dtype=np.float64)
        return gradient, np.abs(gradient), 2**20

    def __call__(self, x: Any) -> Any:
        """Return the value at the state x, shape (n,), or the values at states of the shape (..., n)."""
        if np.ndim(x) < 2:
            return self.value(x)
        states = np.asarray(x)
        values = np.array([self.value(row) for row in states.reshape(-1, states.shape[-1])])
        return values.reshape(states.shape[:-1])

    def __repr__(self) -> str:
        period = f", period={self.period:g}" if self.period else ""
        return f"{type(self).__name__}({function_name(self.value)}{period})"


class Forms(NamedTuple):
    """A formula as flat arrays for the kernels: a `LogarithmicSum`, or a sum with hyperbolic functions."""

    # Form f is the sum over m in first[f]:first[f + 1] of coefficient[m] * prod of x[coordinate[q]], q in
    # begin[m]:begin[m + 1]. The role HOLD stores the first polynomial of the next form, which is the second one:
    # weight * sinh(second)/first (SINH), weight * (sinh(second)/first)^2 (SINH_SQUARED), weight * cosh(second) (COSH).

    size: int
    role: NDArray[np.int64]
    weight: NDArray[np.float64]
    first: NDArray[np.int64]
    coefficient: NDArray[np.float64]
    begin: NDArray[np.int64]
    coordinate: NDArray[np.int64]


class InvariantTerm(NamedTuple):
    """A term: weight * first/second (QUOTIENT), weight * log|second|, or weight * atan2(first, second) (ANGLE)."""

    kind: int
    weight: Number
    first: Polynomial
    second: Polynomial


@dataclass(frozen=True)
class LogarithmicSum:
    """A function sum of w p/q + sum of w log|p| + sum of w atan2(p, q) with polynomials p, q and numbers w, not 0."""

    dim: int
    terms: tuple[InvariantTerm, ...]

    def __str__(self) -> str:
        return " + ".join(_format_term(term) for term in self.terms).replace("+ -", "- ") or "0"

    @classmethod
    def quotient(cls, numerator: Polynomial, denominator: Polynomial) -> LogarithmicSum:
        return cls(numerator.dim, (InvariantTerm(QUOTIENT, 1, numerator, denominator),) if numerator.monomials else ())

    @classmethod
    def logarithm(cls, p: Polynomial) -> LogarithmicSum:
        return cls(p.dim, (InvariantTerm(LOGARITHM, 1, p, p),))

    @classmethod
    def angle(cls, sine: Polynomial, cosine: Polynomial) -> LogarithmicSum:
        """Return atan2(sine, cosine): an angle, defined up to multiples of 2 pi."""
        return cls(sine.dim, (InvariantTerm(ANGLE, 1, sine, cosine),))

    def __add__(self, other: LogarithmicSum | Polynomial) -> LogarithmicSum:
        if isinstance(other, Polynomial):
            other = LogarithmicSum.quotient(other, Polynomial({(0,) * self.dim: 1}))
        return LogarithmicSum(self.dim, self.terms + other.terms)

    __radd__ = __add__

    def __neg__(self) -> LogarithmicSum:
        return self * -1

    def __mul__(self, factor: float | Number) -> LogarithmicSum:
        weight = exact_number(factor)
        scaled = (term._replace(weight=term.weight * weight) for term in self.terms)
        return LogarithmicSum(self.dim, tuple(term for term in scaled if term.weight != 0))

    def transformed(self, change: Callable[[Polynomial], Polynomial]) -> LogarithmicSum:
        """Return the same function in other coordinates: `change` maps each polynomial."""
        terms = tuple(term._replace(first=change(term.first), second=change(term.second)) for term in self.terms)
        return LogarithmicSum(terms[0].first.dim if terms else self.dim, terms)

    @property
    def period(self) -> float | None:
        """Period of the multivalued function; 0 for a single-valued one, None if its values at a point are dense."""
        weights = [abs(Fraction(term.weight)) for term in self.terms if term.kind == ANGLE]
        if not weights:
            return 0.0
        multiples: list[Fraction] = []
        for weight in weights:
            ratio = weight / weights[0]
            simple = ratio.limit_denominator(MAX_PERIOD_DENOMINATOR)
            if float(simple) != float(ratio):
                return None
            multiples.append(simple)
        common = math.lcm(*(multiple.denominator for multiple in multiples))
        shared = math.gcd(*(int(multiple * common) for multiple in multiples))
        return 2.0 * math.pi * rounded(weights[0]) * shared / common

    def gradient(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the gradient at x, shape (n,): exact for Fractions, with ZeroDivisionError where undefined."""
        slope = np.zeros(self.dim, dtype=x.dtype)
        for kind, exact, first, second in self.terms:
            weight = exact if x.dtype == object else float(exact)
            q, dq = second(x), second.gradient(x)
            if kind == LOGARITHM:
                slope = slope + dq * weight / q
            else:
                p, dp = first(x), first.gradient(x)
                size = q * q if kind == QUOTIENT else p * p + q * q
                slope = slope + (dp * q - dq * p) * weight / size
        return slope

    def invariant(self) -> LogarithmicInvariant:
        """Convert to an `Invariant` of floats for Numba, NaN where undefined; ValueError without a period."""
        if self.period is None:
            raise ValueError("the angles of this sum have no common period; give them weights in a simple ratio")
        forms = self.forms()
        value, gradient = _functions(forms, self.dim)
        value.kernel_forms = forms  # which the kernels evaluate without compiling it
        return LogarithmicInvariant(value, gradient, self.period, self)

    def forms(self) -> Forms:
        """Return the flat arrays for the kernels, with rounded coefficients."""
        forms: list[tuple[int, float, Polynomial]] = []
        for kind, weight, first, second in self.terms:
            if kind != LOGARITHM:
                forms.append((HOLD, 0.0, first))
            forms.append((kind, rounded(weight), second))
        monomials = [list(p.monomials.items()) for _, _, p in forms]
        products = [[k for k, power in enumerate(e) for _ in range(power)] for part in monomials for e, _ in part]
        return Forms(
            len(forms),
            np.array([kind for kind, _, _ in forms], dtype=np.int64),
            np.array([w for _, w, _ in forms], dtype=np.float64),
            np.cumsum([0] + [len(part) for part in monomials], dtype=np.int64),
            np.array([float(c) for part in monomials for _, c in part], dtype=np.float64),
            np.cumsum([0] + [len(product) for product in products], dtype=np.int64),
            np.array([k for product in products for k in product], dtype=np.int64),
        )


def _format_weight(value: Number) -> str:
    """Format an integer or a simple fraction as it is, and any other number as a float."""
    return str(value) if Fraction(value).denominator <= MAX_PERIOD_DENOMINATOR else repr(rounded(value))


def _format_term(term: InvariantTerm) -> str:
    weight = "" if term.weight == 1 else "-" if term.weight == -1 else f"{_format_weight(term.weight)} "
    if term.kind == QUOTIENT:
        return f"{weight}({term.first!r})/({term.second!r})"
    return (
        f"{weight}log|{term.second!r}|" if term.kind == LOGARITHM else f"{weight}atan2({term.first!r}, {term.second!r})"
    )


@dataclass(frozen=True, repr=False)
class LogarithmicInvariant(Invariant):
    """An `Invariant` that stores its formula, so that it can be rewritten in other coordinates."""

    formula: LogarithmicSum = LogarithmicSum(0, ())

    def __repr__(self) -> str:
        return str(self.formula)

    def __reduce__(self) -> tuple[Any, ...]:
        return LogarithmicSum.invariant, (self.formula,)  # closures cannot be pickled; the formula can

    def _transformed(
        self, change: Callable[[Polynomial], Polynomial], restricted: bool = False
    ) -> LogarithmicInvariant | None:
        """Return the same invariant in other coordinates; None on a subspace, where it may be undefined."""
        return None if restricted else self.formula.transformed(change).invariant()


def _functions(forms: Forms, dim: int) -> tuple[Any, Any]:
    """Return value and gradient as functions; `field/forms.hpp` implements the value in the kernels."""
    count, role, weight, first, coefficient, begin, coordinate = forms

    def value(x: Any) -> Any:
        total, held = 0.0, 0.0
        for f in range(count):
            form = 0.0
            for m in range(first[f], first[f + 1]):
                product = coefficient[m]
                for q in range(begin[m], begin[m + 1]):
                    product *= x[coordinate[q]]
                form += product
            if role[f] == HOLD:
                held = form
            elif form == 0.0 and (role[f] != ANGLE or held == 0.0):
                return math.nan
            elif role[f] == QUOTIENT:
                total += weight[f] * (held / form)
            elif role[f] == LOGARITHM:
                total += weight[f] * math.log(abs(form))
            else:
                total += weight[f] * math.atan2(held, form)
        return float(total)

    def gradient(x: Any) -> Any:
        slope, held_slope, form_slope = np.zeros(dim), np.zeros(dim), np.zeros(dim)
        held = 0.0
        for f in range(count):
            form = 0.0
            form_slope[:] = 0.0
            for m in range(first[f], first[f + 1]):
                product = coefficient[m]
                for q in range(begin[m], begin[m + 1]):
                    product *= x[coordinate[q]]
                    others = coefficient[m]
                    for r in range(begin[m], begin[m + 1]):
                        if r != q:
                            others *= x[coordinate[r]]
                    form_slope[coordinate[q]] += others
                form += product
            if role[f] == HOLD:
                held = form
                held_slope[:] = form_slope
            elif form == 0.0 and (role[f] != ANGLE or held == 0.0):
                return np.full(dim, math.nan)
            elif role[f] == LOGARITHM:
                slope += weight[f] * form_slope / form
            else:
                size = form * form
                if role[f] == ANGLE:
                    size += held * held
                slope += weight[f] * (held_slope * form - form_slope * held) / size
        return slope

    return value, gradient
