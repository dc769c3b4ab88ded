"""Parsers of formulas as text: polynomials, formulas with parameters, and conditions; nothing is executed as Python."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from coadjoint.algebra.exact.numbers import Constant, parse_number, quotient
from coadjoint.algebra.polynomials.formula_parser import Formula, FormulaParser, Number, Power
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import short

_COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}


def parse_polynomial(text: str, dim: int, names: Sequence[str] | None = None) -> Polynomial:
    """Parse a polynomial in the notation in which `Polynomial` is printed, such as ``"0.5*x1^2 - x2*x3 + x1/3"``.

    Powers are ``x1^2`` or ``x1**2``; quotients of integers stay exact; `names` replaces x1, x2, ... A ValueError names
    the place of a syntax error, a degree above 1024, or a number beyond float64.
    """
    parser = _ExpandedPolynomialParser(text, {}, dim, "x")
    parser.names = names
    value = parser.parse()
    return value if isinstance(value, Polynomial) else Polynomial({(0,) * dim: value})


def parse_formula(text: str, parameters: Mapping[str, Number], dim: int, letter: str = "x") -> Formula:
    """Parse a formula with parameters in exact arithmetic; `letter` is that of the coordinates.

    Grammar: sums, products, quotients, whole powers (``**``) of whole numbers, parameters and coordinates, and
    ``log(p)`` = log|p| and ``atan2(p, q)`` of polynomials. Degrees, numbers and numbers of terms are bounded
    (ValueError).

    Examples
    --------
    >>> parse_formula("(a + 1)*x1**2 - x2/2", {"a": 3}, dim=2)
    -(1/2)*x2 + 4*x1^2
    >>> parse_formula("log(x1) - a*x2/x1", {"a": 3}, dim=2).invariant().value([1.0, 2.0])
    -6.0
    """
    return FormulaParser(text, parameters, dim, letter).parse()


def condition_holds(text: str, parameters: Mapping[str, Number]) -> bool:
    """Return whether parameters satisfy a condition: comparisons joined by ``and`` or ``or``."""
    return _ConditionParser(text, parameters, 0, "").parse()


class _ExpandedPolynomialParser(FormulaParser):
    """Parser of expanded polynomials: brackets and quotients contain numbers only."""

    powers = ("^", "**")
    max_characters = math.inf
    names: Sequence[str] | None = None
    notation_help = "write sums of products such as 0.5*x1^2 - x2*x3 + 1/3"

    def coordinate(self, name: str) -> int | None:
        """Return the index of a coordinate, by its name if names were given."""
        if self.names is None:
            return super().coordinate(name)
        if name and name not in self.names:
            raise self.not_allowed(f"has {short(name)}; the coordinates are {', '.join(self.names)}")
        return self.names.index(name) if name else None

    def divisor(self) -> Constant:
        # A factor may be a quotient, and x/2/3 is not x/(2/3).
        divisor = self._any_number() if self.token["number"] else self.factor()
        if isinstance(divisor, Power):
            raise self.not_allowed(f"divides by a coordinate; {self.notation_help}")
        return divisor

    def factor(self) -> Any:
        index = self.coordinate(self.token["name"] or "")
        if index is not None:
            self.next()
            return Power(index, self.whole_number() if self.accept(*self.powers) is not None else 1)
        parenthesized = self.accept("(") is not None
        value = self._any_number()
        if self.accept("/") is not None:
            divisor = self._any_number()
            if divisor == 0:
                raise self.division_by_zero()
            value = quotient(value, divisor)
        if parenthesized:
            self.expect(")")
        return value

    def _any_number(self) -> Constant:
        number = self.token["number"]
        if number is None:
            raise self.syntax_error()
        value = parse_number(number)
        self.next()
        return value


class _ConditionParser(FormulaParser):
    """Parser of conditions on parameters."""

    notation_help = "it must be comparisons of parameters, joined by 'and' or 'or'"

    def parse(self) -> bool:
        holds = [self._conjunction()]
        while self.accept("or") is not None:
            holds.append(self._conjunction())
        if self.token.lastgroup != "end":
            raise self.syntax_error()
        return any(holds)

    def _conjunction(self) -> bool:
        holds = [self._comparison()]
        while self.accept("and") is not None:
            holds.append(self._comparison())
        return all(holds)

    def _comparison(self) -> bool:
        sides, comparisons = [self.sum()], []
        while (comparison := self.accept(*_COMPARISONS)) is not None:
            comparisons.append(comparison)
            sides.append(self.sum())
        if not comparisons:
            raise self.syntax_error()
        return all(_COMPARISONS[sign](*pair) for sign, pair in zip(comparisons, pairwise(sides), strict=True))
