"""Values of formulas: polynomials and sums with logarithms in exact arithmetic, and conditions."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

from coadjoint.algebra.exact.numbers import Constant, ball, checked, exact_number, is_finite, quotient, too_large
from coadjoint.algebra.invariants.invariant import LogarithmicSum
from coadjoint.algebra.polynomials.formula_tree import (
    FUNCTIONS,
    MAX_QUOTED,
    NOTATION,
    FormulaTree,
    Monomial,
    coordinates_and_parameters,
    factors,
    names_and_parameters,
    read_dimension,
    summands,
)
from coadjoint.algebra.polynomials.monomials import Exponents
from coadjoint.algebra.polynomials.polynomial import MAX_DEGREE, TOO_HIGH, Polynomial
from coadjoint.errors import in_one_line
from coadjoint.short_repr import short

Number = int | Fraction
Formula = Polynomial | LogarithmicSum

MAX_TERMS = 10_000
"""Terms of one product that is multiplied out."""
MAX_WORK = 1 << 24
"""Products of two terms in a whole formula, each times the number of coordinates and 8."""
BITS_OF_CONSTANTS = 1400  # in which functions of numbers are computed, the range of float64 and 300 more

_EXACT_NOTATION = "write whole numbers, names and operations on them, such as a*x1**2 - log(x2)/3"
_COMPARISONS: Mapping[type, Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}


class NotPolynomial(ValueError):
    """A formula is valid, but not a polynomial."""


def parse_polynomial(
    text: str, dim: int, names: Sequence[str] | None = None, parameters: Mapping[str, Any] | None = None
) -> Polynomial:
    """Parse a polynomial, such as ``"0.5*x1^2 - x2*x3 + x1/3"`` or ``"a*(x1 + x2)**2/2"``, and multiply it out."""
    # Quotients of integers stay exact; products with floats are rounded in the order of the text.
    tree = FormulaTree(text, coordinates_and_parameters(text, dim, names, parameters), FUNCTIONS, NOTATION)
    return Expansion(tree, dim).polynomial()


def read_polynomial(
    text: str, dim: int | None, basis: Sequence[str] | None, parameters: Mapping[str, Any] | None
) -> tuple[Mapping[Exponents, Constant], int]:
    """Parse a polynomial in `dim` coordinates or in those named by `basis`: its monomials, and their dimension."""
    count = read_dimension(text, dim, basis)
    return parse_polynomial(text, count, None if basis is None else tuple(basis), parameters).monomials, count


def parse_formula(text: str, parameters: Mapping[str, Number], dim: int, letter: str = "x") -> Formula:
    """Parse a formula of the catalogue in exact arithmetic; ``log(p)`` is log|p|; `letter` names coordinates."""
    tree = FormulaTree(text, names_and_parameters(text, dim, letter, parameters), ("log", "atan2"), _EXACT_NOTATION)
    if any(isinstance(symbol.number, float) for symbol in tree.symbols.values()):
        raise tree.refused(f"has decimals; {_EXACT_NOTATION}")
    value: Formula = ExactExpansion(tree, dim).value()
    return value


def condition_holds(text: str, parameters: Mapping[str, Number]) -> bool:
    """Return whether parameters satisfy a condition: comparisons joined by ``and`` or ``or``."""
    notation = "it must be comparisons of parameters, joined by 'and' or 'or'"
    values = {name: Monomial(number, {}) for name, number in parameters.items()}
    tree = FormulaTree(text, values.get, (), notation, conditions=True)
    expansion = ExactExpansion(tree, 0)
    ((_, node),) = tree.terms

    def holds(node: ast.expr) -> bool:
        match node:
            case ast.BoolOp(ast.Or(), parts):
                return any([holds(part) for part in parts])
            case ast.BoolOp(ast.And(), parts):
                return all([holds(part) for part in parts])
            case ast.Compare(left, signs, others):
                sides = [expansion.of(side) for side in (left, *others)]
                return all(_COMPARISONS[type(sign)](*pair) for sign, pair in zip(signs, pairwise(sides), strict=True))
        raise tree.refused(f"is no condition; {notation}")

    return holds(node)


def add_term(total: dict[Exponents, Constant], exponents: Exponents, coefficient: Constant) -> None:
    """Add a term to the monomials of a polynomial, in text order."""
    total[exponents] = checked(total[exponents] + coefficient) if exponents in total else coefficient


def number_of(value: Monomial | Polynomial) -> Constant | None:
    """Return the number that a value of a formula is; None if it is none."""
    return value.number if isinstance(value, Monomial) and not value.powers else None


class Expansion:
    """Value of a formula: a number, or a polynomial that is multiplied out; `NotPolynomial` if it is neither."""

    def __init__(self, tree: FormulaTree, dim: int) -> None:
        self.tree, self.dim = tree, dim
        self._work = 0

    def polynomial(self) -> Polynomial:
        """Return the value of the whole formula, a number as a constant polynomial."""
        return self._multiplied_out(self._sum(self.tree.terms))

    def of(self, node: ast.expr) -> Any:
        """Return the value of a part of the formula: a number, or a polynomial."""
        value = self._node(node)
        number = number_of(value)
        return self._multiplied_out(value) if number is None else number

    def _multiplied_out(self, value: Monomial | Polynomial) -> Polynomial:
        return value if isinstance(value, Polynomial) else Polynomial(self._monomials(value))

    def _monomials(self, value: Monomial | Polynomial) -> Mapping[Exponents, Constant]:
        if isinstance(value, Polynomial):
            return value.monomials
        exponents = [0] * self.dim
        for index, power in value.powers.items():
            exponents[index] = power
        return {tuple(exponents): value.number}

    def _node(self, node: ast.expr) -> Monomial | Polynomial:
        match node:
            case ast.Name():
                return self.tree.symbols[node.id]
            case ast.UnaryOp(op=ast.USub()):
                return -self._node(node.operand)
            case ast.UnaryOp():
                return self._node(node.operand)
            case ast.Call(func=ast.Name(id=name)):
                return self.call(name, [self._node(argument) for argument in node.args])
            case ast.BinOp(op=ast.Pow()):
                return self._power(self._node(node.left), self._node(node.right))
            case ast.BinOp(op=ast.Mult() | ast.Div()):
                return self._product(node)
        return self._sum(summands(node))

    def _sum(self, signed: Iterable[tuple[int, ast.expr]]) -> Monomial | Polynomial:
        total: dict[Exponents, Constant] = {}
        is_number = True
        for sign, node in signed:
            value = self._node(node)
            is_number = is_number and number_of(value) is not None
            for exponents, coefficient in self._monomials(value if sign > 0 else -value).items():
                add_term(total, exponents, coefficient)
        return Monomial(total[(0,) * self.dim], {}) if is_number else Polynomial(total, dim=self.dim)

    def _product(self, node: ast.expr) -> Monomial | Polynomial:
        number: Constant = 1
        powers: dict[int, int] = {}
        rest: Polynomial | None = None
        for divides, factor in factors(node):
            value = self._node(factor)
            if divides and (divisor := number_of(value)) is not None:
                if divisor == 0:
                    raise self.tree.refused("divides by zero")
                number = checked(quotient(number, divisor))
            elif divides:
                number, powers = self.quotient(self._joined(number, powers, rest), value)
                rest = None
            elif isinstance(value, Polynomial):
                rest = value if rest is None else self._times(rest, value)
            else:
                number = number if value.powers and value.number == 1 else checked(number * value.number)
                for index, power in value.powers.items():
                    powers[index] = powers.get(index, 0) + power
                self._check_size(sum(powers.values()))
        return self._joined(number, powers, rest)

    def _joined(self, number: Constant, powers: dict[int, int], rest: Polynomial | None) -> Monomial | Polynomial:
        if rest is None:
            return Monomial(number, powers)
        return self._times(self._multiplied_out(Monomial(number, powers)), rest) if powers else rest * number

    def _times(self, left: Polynomial, right: Polynomial) -> Polynomial:
        terms = len(left.monomials) * len(right.monomials)
        self._check_size(left.degree + right.degree, terms, terms)
        return left * right

    def _check_size(self, degree: int, terms: int = 0, products: int = 0) -> None:
        if degree > MAX_DEGREE:
            limit = f"there are degrees up to {MAX_DEGREE}; {TOO_HIGH}"
            raise ValueError(f"{short(self.tree.text, MAX_QUOTED)} has the degree {short(degree)}; {limit}")
        self._work += products * (self.dim + 8)
        if terms > MAX_TERMS:
            raise self.tree.refused(f"has about {short(terms)} terms when it is multiplied out, beyond {MAX_TERMS}")
        if self._work > MAX_WORK:
            raise self.tree.refused(f"has more than {MAX_WORK // (self.dim + 8)} products when it is multiplied out")

    def _power(self, base: Monomial | Polynomial, exponent: Monomial | Polynomial) -> Monomial | Polynomial:
        number, given = number_of(base), number_of(exponent)
        power = exact_number(given)
        if number is not None and given is not None:
            return Monomial(self.power_of_number(number, power), {})
        if not isinstance(power, int) or power < 0:
            shown = in_one_line(str(self._multiplied_out(exponent) if given is None else given), MAX_QUOTED)
            raise self.not_polynomial(f"has the power {shown}; powers are whole numbers from 0 up")
        self._check_size(base.degree * power)
        if isinstance(base, Monomial):
            number = self.power_of_number(base.number, power) if base.number != 1 else 1
            return Monomial(number, {index: e * power for index, e in base.powers.items()})
        terms, half = len(base.monomials), (power + 1) // 2
        if terms > 1 and power < MAX_DEGREE:
            products = math.comb(terms + half - 1, half) ** 2
            self._check_size(0, math.comb(terms + power - 1, power), products if power > 1 else 0)
        return base**power

    def not_polynomial(self, reason: str) -> ValueError:
        """Return the error for a formula that is not a polynomial."""
        return NotPolynomial(str(self.tree.refused(reason)))

    def quotient(self, numerator: Monomial | Polynomial, divisor: Monomial | Polynomial) -> Monomial:
        """Return a quotient by something other than a number."""
        raise self.not_polynomial("divides by a coordinate, which is no polynomial")

    def call(self, name: str, arguments: Sequence[Monomial | Polynomial]) -> Monomial:
        if len(arguments) != 1:
            raise self.tree.refused(f"has {name} of {len(arguments)} arguments; it takes one")
        number = number_of(arguments[0])
        if number is None:
            raise self.not_polynomial(f"has {name} of a coordinate, which is no polynomial")
        return Monomial(self._checked(_portable(number, lambda x: getattr(x, FUNCTIONS[name][1])()), name), {})

    def power_of_number(self, base: Constant, power: Constant) -> Constant:
        """Return a power of a number: exact if possible, otherwise rounded once."""
        if isinstance(power, int):
            if abs(base) not in (0, 1) and abs(power) > MAX_DEGREE:
                raise too_large()
            if base == 0 and power < 0:
                raise self.tree.refused("divides by zero")
            exact = Fraction(base) ** power
            if isinstance(base, float):
                return self._checked(float(exact) if is_finite(exact) else math.inf, "a power")
            return checked(exact.numerator if exact.denominator == 1 else exact)
        exponent = Fraction(power)
        return self._checked(_portable(base, lambda x: x ** ball(exponent)), "a power")

    def _checked(self, value: float, what: str) -> float:
        if not math.isfinite(value):
            raise self.tree.refused(f"has {what} of a number for which it is not a finite number")
        return value


class ExactExpansion(Expansion):
    """Value of a formula of the catalogue, also with logarithms, angles and quotients; powers are whole numbers."""

    # Each logarithm, angle or quotient is a further coordinate until the formula is multiplied out.

    def __init__(self, tree: FormulaTree, dim: int) -> None:
        parts = (part for _, node in tree.terms for part in ast.walk(node))
        super().__init__(tree, dim + sum(isinstance(part, ast.Call | ast.Div) for part in parts))
        self._coordinates, self._functions = dim, list[LogarithmicSum]()

    def value(self) -> Any:
        value = self._sum(self.tree.terms)
        total = LogarithmicSum(self._coordinates, ())
        rest: dict[Exponents, Constant] = {}
        for exponents, coefficient in self._multiplied_out(value).monomials.items():
            if not any(exponents[self._coordinates :]):
                rest[exponents[: self._coordinates]] = coefficient
            elif sum(exponents) > 1:
                reason = "multiplies a logarithm, an angle or a quotient by something other than a number"
                raise self.tree.refused(reason)
            else:
                total = total + self._functions[exponents.index(1) - self._coordinates] * coefficient
        polynomial = Polynomial(rest, dim=self._coordinates)
        return polynomial if not self._functions else total + polynomial if rest else total

    def _function(self, function: LogarithmicSum) -> Monomial:
        self._functions.append(function)
        return Monomial(1, {self._coordinates + len(self._functions) - 1: 1})

    def _of_coordinates(self, values: Iterable[Monomial | Polynomial], reason: str) -> list[Polynomial]:
        """Return polynomials in the coordinates alone; raise an error with a reason for anything else."""
        found = []
        for value in values:
            monomials = self._monomials(value)
            if number_of(value) is not None or any(any(e[self._coordinates :]) for e in monomials):
                raise self.tree.refused(reason)
            found.append(Polynomial({e[: self._coordinates]: c for e, c in monomials.items()}, dim=self._coordinates))
        return found

    def power_of_number(self, base: Constant, power: Constant) -> Constant:
        if not isinstance(power, int) or power < 0:
            raise self.tree.refused(f"has the power {short(power)}; powers are whole numbers from 0 up")
        return super().power_of_number(base, power)

    def quotient(self, numerator: Monomial | Polynomial, divisor: Monomial | Polynomial) -> Monomial:
        reason = "has an unsupported division: a divisor must be a number, or a polynomial below a polynomial"
        return self._function(LogarithmicSum.quotient(*self._of_coordinates([numerator, divisor], reason)))

    def call(self, name: str, arguments: Sequence[Monomial | Polynomial]) -> Monomial:
        count = 1 if name == "log" else 2
        reason = f"has {name} of something other than {'a polynomial' if count == 1 else 'two'}"
        if len(arguments) != count:
            raise self.tree.refused(reason)
        found = self._of_coordinates(arguments, reason)
        return self._function(LogarithmicSum.logarithm(*found) if count == 1 else LogarithmicSum.angle(*found))


def _portable(value: Constant, function: Callable[[Any], Any]) -> float:
    """Return a function of a number, rounded to float64 with the same bits on every machine; NaN where undefined."""
    from flint import ctx

    with ctx.workprec(BITS_OF_CONSTANTS):
        result = function(ball(value))
        return float(result) if result.is_finite() else math.nan
