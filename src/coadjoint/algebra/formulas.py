"""Formulas as text: polynomials, formulas with parameters, and conditions; nothing is run as Python."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from coadjoint.algebra.formula_reader import Formula, Number, Power, Product, Reader
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.algebra.written_numbers import Constant, checked, quotient, read_constant
from coadjoint.wording import short

_COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}


def read_polynomial(text: str, dim: int, names: Sequence[str] | None = None) -> Polynomial:
    """Return the polynomial that a text stands for, the way a `Polynomial` is printed.

    Parameters
    ----------
    text : str
        Such as ``"0.5*x1^2 - x2*x3 + x1/3"``: a sum of products of numbers (whole, decimal, or quotients, which stay
        exact) and powers of x1, x2, ..., written ``x1^2`` or ``x1**2``, divided by numbers.
    dim : int
        Number of coordinates.
    names : sequence of str, optional
        Names of the coordinates, in place of x1, x2, ...

    Returns
    -------
    Polynomial

    Raises
    ------
    ValueError
        Naming the place in the text that is wrong; a degree above 1024, or a number that float64 does not hold.

    Examples
    --------
    >>> read_polynomial("0.5*x1^2 - x2*x3", 3)
    0.5*x1^2 - x2*x3
    """
    reader = _MultipliedOut(text, {}, dim, "x")
    reader.names = names
    value = reader.whole()
    return value if isinstance(value, Polynomial) else Polynomial({(0,) * dim: value})


def read_formula(text: str, parameters: Mapping[str, Number], dim: int, letter: str = "x") -> Formula:
    """Return what a formula with parameters stands for, in exact arithmetic.

    Sums, products, quotients, whole powers (``**``) of whole numbers, parameters and coordinates, and ``log(p)`` =
    log|p| and ``atan2(p, q)`` of polynomials.

    Parameters
    ----------
    text : str
    parameters : mapping of str to int or Fraction
        Their values, by name.
    dim : int
        Number of coordinates.
    letter : str, optional
        The letter of the coordinates: ``"x"`` for x1, x2, ...

    Returns
    -------
    int, Fraction, Polynomial or LogarithmicSum

    Raises
    ------
    ValueError
        The text is not such a formula; or a degree, a number or the number of terms is too large.

    Examples
    --------
    >>> read_formula("(a + 1)*x1**2 - x2/2", {"a": 3}, dim=2)
    -(1/2)*x2 + 4*x1^2
    >>> read_formula("log(x1) - a*x2/x1", {"a": 3}, dim=2).invariant().value([1.0, 2.0])
    -6.0
    """
    return Reader(text, parameters, dim, letter).whole()


def satisfied(text: str, parameters: Mapping[str, Number]) -> bool:
    """Say whether parameters satisfy a condition: comparisons joined by ``and`` or ``or``.

    Raises
    ------
    ValueError
        The text is not such a condition.

    Examples
    --------
    >>> satisfied("a != 0 and -1 < a <= 1", {"a": 1})
    True
    """
    return _Condition(text, parameters, 0, "").whole()


class _MultipliedOut(Reader):
    """The text of a polynomial that is multiplied out: brackets and quotients are of numbers alone."""

    powers = ("^", "**")
    most_letters = math.inf
    names: Sequence[str] | None = None
    how = "write sums of products such as 0.5*x1^2 - x2*x3 + 1/3"

    def coordinate(self, name: str) -> int | None:
        """Return the index of a coordinate, by its name where there are names."""
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
    """The text of a condition on parameters."""

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
