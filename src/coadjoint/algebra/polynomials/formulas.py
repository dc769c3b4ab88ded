"""Parsers of formulas as text: polynomials, formulas with parameters, and conditions; nothing is executed as Python."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from coadjoint.algebra.polynomials.formula_parser import Formula, Number, Power, Product, Reader
from coadjoint.algebra.polynomials.number_literals import Constant, checked, quotient, read_constant
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


def read_polynomial(text: str, dim: int, names: Sequence[str] | None = None) -> Polynomial:
    """Parse a polynomial in the notation in which `Polynomial` is printed, such as ``"0.5*x1^2 - x2*x3 + x1/3"``.

    Powers are ``x1^2`` or ``x1**2``; quotients of integers stay exact; `names` replaces x1, x2, ... A ValueError names
    the place of a syntax error, a degree above 1024, or a number beyond float64.
    """
    reader = _MultipliedOut(text, {}, dim, "x")
    reader.names = names
    value = reader.whole()
    return value if isinstance(value, Polynomial) else Polynomial({(0,) * dim: value})


def read_formula(text: str, parameters: Mapping[str, Number], dim: int, letter: str = "x") -> Formula:
    """Parse a formula with parameters in exact arithmetic; `letter` is that of the coordinates.

    Grammar: sums, products, quotients, whole powers (``**``) of whole numbers, parameters and coordinates, and
    ``log(p)`` = log|p| and ``atan2(p, q)`` of polynomials. Degrees, numbers and numbers of terms are bounded
    (ValueError).

    Examples
    --------
    >>> read_formula("(a + 1)*x1**2 - x2/2", {"a": 3}, dim=2)
    -(1/2)*x2 + 4*x1^2
    >>> read_formula("log(x1) - a*x2/x1", {"a": 3}, dim=2).invariant().value([1.0, 2.0])
    -6.0
    """
    return Reader(text, parameters, dim, letter).whole()


def satisfied(text: str, parameters: Mapping[str, Number]) -> bool:
    """Return whether parameters satisfy a condition: comparisons joined by ``and`` or ``or``."""
    return _Condition(text, parameters, 0, "").whole()


class _MultipliedOut(Reader):
    """Parser of expanded polynomials: brackets and quotients contain numbers only."""

    powers = ("^", "**")
    most_letters = math.inf
    names: Sequence[str] | None = None
    how = "write sums of products such as 0.5*x1^2 - x2*x3 + 1/3"

    def coordinate(self, name: str) -> int | None:
        """Return the index of a coordinate, by its name if names were given."""
        if self.names is None:
            return super().coordinate(name)
        if name and name not in self.names:
            raise self.refused(f"has {short(name)}; the coordinates are {', '.join(self.names)}")
        return self.names.index(name) if name else None

    def _product(self) -> Product:
        product = Product(self)
        product.multiply(self.factor())
        while (operation := self.take("*", "/")) is not None:
            if operation == "*":
                product.multiply(self.factor())
                continue
            # A factor may be a quotient, and x/2/3 is not x/(2/3).
            below = self._any_number() if self.token["number"] else self.factor()
            if isinstance(below, Power):
                raise self.refused(f"divides by a coordinate; {self.how}")
            if below == 0:
                raise self.divides_by_zero()
            product.number = checked(quotient(product.number, below))
        return product

    def factor(self) -> Any:
        index = self.coordinate(self.token["name"] or "")
        if index is not None:
            self.next()
            return Power(index, self.whole_number() if self.take(*self.powers) is not None else 1)
        inside = self.take("(") is not None
        value = self._any_number()
        if self.take("/") is not None:
            below = self._any_number()
            if below == 0:
                raise self.divides_by_zero()
            value = quotient(value, below)
        if inside:
            self.need(")")
        return value

    def _any_number(self) -> Constant:
        number = self.token["number"]
        if number is None:
            raise self.unread()
        value = read_constant(number)
        self.next()
        return value


class _Condition(Reader):
    """Parser of conditions on parameters."""

    how = "it must be comparisons of parameters, joined by 'and' or 'or'"

    def whole(self) -> bool:
        holds = [self._all()]
        while self.take("or") is not None:
            holds.append(self._all())
        if self.token.lastgroup != "end":
            raise self.unread()
        return any(holds)

    def _all(self) -> bool:
        holds = [self._compared()]
        while self.take("and") is not None:
            holds.append(self._compared())
        return all(holds)

    def _compared(self) -> bool:
        sides, comparisons = [self.sum()], []
        while (comparison := self.take(*_COMPARISONS)) is not None:
            comparisons.append(comparison)
            sides.append(self.sum())
        if not comparisons:
            raise self.unread()
        return all(_COMPARISONS[sign](*pair) for sign, pair in zip(comparisons, pairwise(sides), strict=True))
