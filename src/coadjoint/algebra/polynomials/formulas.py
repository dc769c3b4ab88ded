"""Values of formulas: polynomials and sums with logarithms in exact arithmetic, conditions, and numbers at a point."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from coadjoint.algebra.exact.numbers import MAX_DIGITS, Constant, checked, is_finite, quotient, too_large
from coadjoint.algebra.invariants.invariant import LogarithmicSum
from coadjoint.algebra.polynomials.formula_tree import (
    MAX_QUOTED,
    NAME,
    Coordinate,
    FormulaTree,
    factors,
    parse_tree,
    summands,
)
from coadjoint.algebra.polynomials.monomials import Exponents, read_coefficient
from coadjoint.algebra.polynomials.polynomial import MAX_DEGREE, TOO_HIGH, Polynomial
from coadjoint.algebra.polynomials.polynomial_format import coordinate_names
from coadjoint.errors import in_one_line
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short

Number = int | Fraction
Formula = Number | Polynomial | LogarithmicSum

MAX_TERMS = 10_000
"""Terms of one product that is multiplied out."""
MAX_WORK = 1 << 24
"""Products of two terms in a whole formula, each times the number of coordinates and 8."""
MEMORY_CHECK_INTERVAL = 1024  # terms between two memory checks
BYTES_PER_TERM = 300  # key, coefficient and entry of a mapping
BYTES_PER_EXPONENT = 8  # a reference in the key
BITS_OF_CONSTANTS = 1400  # in which functions of numbers are computed, the range of float64 and 300 more

_EXACT_NOTATION = "write whole numbers, names and operations on them, such as a*x1**2 - log(x2)/3"
NOTATION = "write numbers, coordinates, parameters and operations on them, such as 0.5*x1^2 - x2*(x3 + 1)/3"
FUNCTIONS: Mapping[str, tuple[str, str]] = {
    "sin": ("sin", "sin"),
    "cos": ("cos", "cos"),
    "tan": ("tan", "tan"),
    "atan": ("arctan", "atan"),
    "exp": ("exp", "exp"),
    "log": ("log", "log"),
    "sqrt": ("sqrt", "sqrt"),
    "sinh": ("sinh", "sinh"),
    "cosh": ("cosh", "cosh"),
    "tanh": ("tanh", "tanh"),
}
"""Function of formulas -> its names in NumPy and in python-flint."""

_X = re.compile(r"x\d+")
MAX_SHOWN_NAMES = 120  # letters of names in a message
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
    tree = parse_tree(text, coordinates_and_parameters(text, dim, names, parameters), FUNCTIONS, NOTATION)
    value = Expansion(tree, dim).value()
    return value if isinstance(value, Polynomial) else Polynomial({(0,) * dim: value})


def check_syntax(text: str) -> None:
    """Raise the ValueError of a formula that cannot be parsed, whatever its names mean."""
    parse_tree(text, lambda name: Coordinate(0), FUNCTIONS, NOTATION)


def parse_formula(text: str, parameters: Mapping[str, Number], dim: int, letter: str = "x") -> Formula:
    """Parse a formula of the catalogue in exact arithmetic; ``log(p)`` is log|p|; `letter` names coordinates."""
    tree = parse_tree(text, _names_and_parameters(text, dim, letter, parameters), ("log", "atan2"), _EXACT_NOTATION)
    if any(isinstance(symbol, float) for symbol in tree.symbols):
        raise tree.refused(f"has decimals; {_EXACT_NOTATION}")
    return ExactExpansion(tree, dim).value()


def condition_holds(text: str, parameters: Mapping[str, Number]) -> bool:
    """Return whether parameters satisfy a condition: comparisons joined by ``and`` or ``or``."""
    notation = "it must be comparisons of parameters, joined by 'and' or 'or'"
    tree = parse_tree(text, parameters.get, (), notation, conditions=True)
    expansion = ExactExpansion(tree, 0)
    ((_, node),) = tree.terms

    def holds(node: ast.expr) -> bool:
        if isinstance(node, ast.BoolOp):
            parts = [holds(part) for part in node.values]
            return any(parts) if isinstance(node.op, ast.Or) else all(parts)
        if not isinstance(node, ast.Compare):
            raise tree.refused(f"is no condition; {notation}")
        sides = [expansion.of(side) for side in (node.left, *node.comparators)]
        return all(_COMPARISONS[type(sign)](*pair) for sign, pair in zip(node.ops, pairwise(sides), strict=True))

    return holds(node)


def names_in(text: str, dim: int, names: Sequence[str] | None) -> Sequence[str] | None:
    """Return the names of the coordinates if a text has one that is not among x1, x2, ...; otherwise None."""
    if names is None:
        return None
    default, used = coordinate_names(dim), NAME.findall(text)
    index = {name: k for k, name in enumerate(names)}
    place = {name: k for k, name in enumerate(default)}
    if not any(name in index and name not in place for name in used):
        return None
    for name in used:
        if name in index and name in place and index[name] != place[name]:
            raise ValueError(
                f"{short(text)} has {name}, which is the name of coordinate {index[name]} and, in polynomials in "
                f"x1, x2, ..., that of coordinate {place[name]}; give a list of [coefficient, [exponents]]"
            )
    return names


def coordinates_and_parameters(
    text: str, dim: int, names: Sequence[str] | None, parameters: Mapping[str, Any] | None
) -> Callable[[str], Any]:
    """Return the function from the names in a formula to coordinates and numbers; ``pi`` has its usual value."""
    numbers = {} if parameters is None else read_parameters(parameters, names or ())
    if names is None:
        return _names_and_parameters(text, dim, "x", {"pi": math.pi} | numbers)
    places = {name: Coordinate(k) for k, name in reversed(list(enumerate(names)))}

    def value_of(name: str) -> Any:
        if name not in places and name not in numbers and name != "pi":
            raise ValueError(
                f"{short(text, MAX_QUOTED)} has {short(name, MAX_QUOTED)}; the coordinates are "
                f"{in_one_line(', '.join(names), MAX_SHOWN_NAMES)}"
                + (f", and the parameters {in_one_line(', '.join(numbers), MAX_QUOTED)}" if numbers else "")
            )
        return places[name] if name in places else numbers.get(name, math.pi)

    return value_of


def read_parameters(parameters: Mapping[str, Any], names: Sequence[str] = ()) -> dict[str, Constant]:
    """Validate parameters of formulas; a name must be one word, and no coordinate."""
    if not isinstance(parameters, Mapping):
        raise TypeError(f"parameters are {short(parameters)}; give a mapping from names to numbers")
    for name in parameters:
        if not isinstance(name, str) or NAME.fullmatch(name) is None:
            raise ValueError(f"a parameter is named {short(name)}; give a word of letters and digits")
        if name in names or _X.fullmatch(name):
            raise ValueError(f"the parameter {short(name)} has the name of a coordinate; give another one")
    return {name: read_coefficient(value, f"the parameter {name}") for name, value in parameters.items()}


def _names_and_parameters(text: str, dim: int, letter: str, numbers: Mapping[str, Any]) -> Callable[[str], Any]:
    def value_of(name: str) -> Any:
        if name[:1] != letter or not name[1:].isdecimal():
            return numbers.get(name)
        index = int(name[1:]) if len(name) <= MAX_DIGITS else 0
        if not 1 <= index <= dim:
            raise ValueError(
                f"{short(text, MAX_QUOTED)} has the coordinate {name[:20]}; there are {letter}1 to {letter}{dim}"
            )
        return Coordinate(index - 1)

    return value_of


def too_high(what: str, degree: int) -> ValueError:
    """Return the error for a degree beyond the range of float64."""
    return ValueError(f"{what} has the degree {short(degree)}; there are degrees up to {MAX_DEGREE}; {TOO_HIGH}")


def add_term(total: dict[Exponents, Constant], exponents: Exponents, coefficient: Constant) -> None:
    """Add a term to the monomials of a polynomial, in text order, and check the memory as they grow."""
    total[exponents] = checked(total[exponents] + coefficient) if exponents in total else coefficient
    if len(total) % MEMORY_CHECK_INTERVAL == 0:
        size = len(total) * (BYTES_PER_TERM + BYTES_PER_EXPONENT * len(exponents))
        what = f"a polynomial of {len(total)} terms or more in {len(exponents)} coordinates"
        check_available_memory(2 * size, what)


class Monomial(NamedTuple):
    """A number times powers of coordinates."""

    number: Constant
    powers: dict[int, int]

    @property
    def degree(self) -> int:
        """Sum of the powers."""
        return sum(self.powers.values())

    def __neg__(self) -> Monomial:
        return self._replace(number=-self.number)


class Expansion:
    """Value of a formula: a number, or a polynomial that is multiplied out; `NotPolynomial` if it is neither."""

    def __init__(self, tree: FormulaTree, dim: int) -> None:
        self.tree, self.dim = tree, dim
        self._work = 0

    def value(self) -> Any:
        """Return the value of the whole formula."""
        return self._multiplied_out(self._sum(self.tree.terms))

    def of(self, node: ast.expr) -> Any:
        """Return the value of a part of the formula."""
        return self._multiplied_out(self._node(node))

    def _multiplied_out(self, value: Any) -> Any:
        return Polynomial({self._exponents(value): value.number}) if isinstance(value, Monomial) else value

    def _exponents(self, monomial: Monomial) -> Exponents:
        exponents = [0] * self.dim
        for index, power in monomial.powers.items():
            exponents[index] = power
        return tuple(exponents)

    def _node(self, node: ast.expr) -> Any:
        match node:
            case ast.Name():
                symbol = self.tree.symbol(node)
                return Monomial(1, {symbol.index: 1}) if isinstance(symbol, Coordinate) else symbol
            case ast.UnaryOp(op=ast.USub()):
                return -self._node(node.operand)
            case ast.UnaryOp():
                return self._node(node.operand)
            case ast.Call(func=ast.Name() as name):
                return self.call(self.tree.symbol(name), [self.of(argument) for argument in node.args])
            case ast.BinOp(op=ast.Pow()):
                return self._power(self._node(node.left), self.of(node.right))
            case ast.BinOp(op=ast.Mult() | ast.Div()):
                return self._product(node)
        return self._sum(summands(node))

    def _sum(self, signed: Iterable[tuple[int, ast.expr]]) -> Any:
        total: dict[Exponents, Constant] = {}
        constant, rest, is_number = (0,) * self.dim, None, True
        for sign, node in signed:
            value = self._node(node)
            if sign < 0:
                value = -value
            if isinstance(value, LogarithmicSum):
                rest = value if rest is None else rest + value
                continue
            is_number = is_number and not isinstance(value, Monomial | Polynomial)
            if isinstance(value, Monomial):
                add_term(total, self._exponents(value), value.number)
            elif isinstance(value, Polynomial):
                for exponents, coefficient in value.monomials.items():
                    add_term(total, exponents, coefficient)
            else:
                add_term(total, constant, value)
        if rest is None:
            return total[constant] if is_number else Polynomial(total, dim=self.dim)
        return rest + Polynomial(total, dim=self.dim) if total else rest

    def _product(self, node: ast.expr) -> Any:
        number: Constant = 1
        powers: dict[int, int] = {}
        rest: Any = None
        for divides, factor in factors(node):
            value = self._node(factor)
            if divides:
                if isinstance(value, int | float | Fraction):
                    if value == 0:
                        raise self.tree.refused("divides by zero")
                    number = checked(quotient(number, value))
                    continue
                rest = self.quotient(self._joined(number, powers, rest), self._multiplied_out(value))
                number, powers = 1, {}
            elif isinstance(value, Monomial):
                number = checked(number * value.number) if value.number != 1 else number
                for index, power in value.powers.items():
                    powers[index] = powers.get(index, 0) + power
                self._check_size(sum(powers.values()))
            elif isinstance(value, Polynomial | LogarithmicSum):
                rest = value if rest is None else self._times(rest, value)
            else:
                number = checked(number * value)
        return self._joined(number, powers, rest)

    def _joined(self, number: Constant, powers: dict[int, int], rest: Any) -> Any:
        if powers:
            monomial = Monomial(number, powers)
            return monomial if rest is None else self._times(self._multiplied_out(monomial), rest)
        return number if rest is None else rest * number

    def _times(self, left: Any, right: Any) -> Any:
        if isinstance(left, LogarithmicSum) or isinstance(right, LogarithmicSum):
            raise self.tree.refused("multiplies a logarithm, an angle or a quotient by something other than a number")
        terms = len(left.monomials) * len(right.monomials)
        self._check_size(left.degree + right.degree, terms, terms)
        return left * right

    def _check_size(self, degree: int, terms: int = 0, products: int = 0) -> None:
        if degree > MAX_DEGREE:
            raise too_high(short(self.tree.text, MAX_QUOTED), degree)
        self._work += products * (self.dim + 8)
        if terms > MAX_TERMS:
            raise self.tree.refused(f"has about {short(terms)} terms when it is multiplied out, beyond {MAX_TERMS}")
        if self._work > MAX_WORK:
            raise self.tree.refused(f"has more than {MAX_WORK // (self.dim + 8)} products when it is multiplied out")

    def _power(self, base: Any, power: Any) -> Any:
        if isinstance(power, float) and power.is_integer():
            power = int(power)
        if not isinstance(base, Monomial | Polynomial | LogarithmicSum) and not isinstance(
            power, Polynomial | LogarithmicSum
        ):
            return self.power_of_number(base, power)
        if not isinstance(power, int) or power < 0:
            raise self.not_polynomial(
                f"has the power {in_one_line(str(power), MAX_QUOTED)}; powers are whole numbers from 0 up"
            )
        if isinstance(base, LogarithmicSum):
            raise self.tree.refused("has a power of a logarithm, an angle or a quotient")
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

    def quotient(self, numerator: Any, divisor: Any) -> Any:
        """Return a quotient by something other than a number."""
        raise self.not_polynomial("divides by a coordinate, which is no polynomial")

    def call(self, name: str, arguments: list[Any]) -> Any:
        """Return a function of arguments."""
        if len(arguments) != 1:
            raise self.tree.refused(f"has {name} of {len(arguments)} arguments; it takes one")
        if not isinstance(arguments[0], int | float | Fraction):
            raise self.not_polynomial(f"has {name} of a coordinate, which is no polynomial")
        return self._checked(_portable(arguments[0], lambda x: getattr(x, FUNCTIONS[name][1])()), name)

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
        return self._checked(_portable(base, lambda x: x ** _ball(exponent)), "a power")

    def _checked(self, value: float, what: str) -> float:
        if not math.isfinite(value):
            raise self.tree.refused(f"has {what} of a number for which it is not a finite number")
        return value


class ExactExpansion(Expansion):
    """Value of a formula of the catalogue, also with logarithms, angles and quotients; powers are whole numbers."""

    def power_of_number(self, base: Constant, power: Constant) -> Constant:
        if not isinstance(power, int) or power < 0:
            raise self.tree.refused(f"has the power {short(power)}; powers are whole numbers from 0 up")
        return super().power_of_number(base, power)

    def quotient(self, numerator: Any, divisor: Any) -> LogarithmicSum:
        numerator = self._multiplied_out(numerator)
        if not (isinstance(numerator, Polynomial) and isinstance(divisor, Polynomial)):
            raise self.tree.refused(
                "has an unsupported division: a divisor must be a number, or a polynomial below a polynomial"
            )
        return LogarithmicSum.quotient(numerator, divisor)

    def call(self, name: str, arguments: list[Any]) -> LogarithmicSum:
        count = 1 if name == "log" else 2
        if len(arguments) != count or not all(isinstance(argument, Polynomial) for argument in arguments):
            raise self.tree.refused(f"has {name} of something other than {'a polynomial' if count == 1 else 'two'}")
        return LogarithmicSum.logarithm(*arguments) if count == 1 else LogarithmicSum.angle(*arguments)


def _ball(value: Constant) -> Any:
    from flint import arb, fmpq

    exact = Fraction(value)
    return arb(fmpq(exact.numerator, exact.denominator))


def _portable(value: Constant, function: Callable[[Any], Any]) -> float:
    """Return a function of a number, rounded to float64 with the same bits on every machine; NaN where undefined."""
    from flint import ctx

    with ctx.workprec(BITS_OF_CONSTANTS):
        result = function(_ball(value))
        return float(result) if result.is_finite() else math.nan


def value_at(tree: FormulaTree, x: Any) -> Any:
    """Return the value of a formula at x, by arithmetic and functions of NumPy; numbers in it are rounded first."""
    constants = Expansion(tree, 1)

    def of(node: ast.expr) -> Any:
        if not any(isinstance(part, ast.Name) and _is_coordinate(tree, part) for part in ast.walk(node)):
            constant = constants.of(node)
            return constant if isinstance(constant, int) else float(constant)
        match node:
            case ast.Name():
                return x[tree.symbol(node).index]
            case ast.UnaryOp(op=ast.USub()):
                return -of(node.operand)
            case ast.UnaryOp():
                return of(node.operand)
            case ast.Call(func=ast.Name() as function):
                name = tree.symbol(function)
                if len(node.args) != 1:
                    raise tree.refused(f"has {name} of {len(node.args)} arguments; it takes one")
                return getattr(np, FUNCTIONS[name][0])(of(node.args[0]))
            case ast.BinOp(op=ast.Pow()):
                return of(node.left) ** of(node.right)
            case ast.BinOp(op=ast.Add() | ast.Sub()):
                return total(summands(node))
        (_, first), *others = factors(node)
        product = of(first)
        for divides, factor in others:
            value = of(factor)
            if divides and isinstance(value, int | float) and value == 0:
                raise tree.refused("divides by zero")
            product = product / value if divides else product * value
        return product

    def total(signed: Iterable[tuple[int, ast.expr]]) -> Any:
        result: Any = 0
        for sign, node in signed:
            result = result + of(node) if sign > 0 else result - of(node)
        return result

    return total(tree.terms)


def _is_coordinate(tree: FormulaTree, name: ast.Name) -> bool:
    return isinstance(tree.symbol(name), Coordinate)
