"""How are polynomials and brackets written in a configuration file? A strict reader; nothing is evaluated."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from coadjoint.algebra.polynomial import Polynomial

Number = int | float | Fraction
Brackets = dict[tuple[int, int], dict[int, float]]

_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TOKEN = re.compile(rf"\s*(?:(?P<number>{_NUMBER})|x(?P<variable>\d+)|(?P<sign>[-+*/^()]))")


def _number(text: str) -> Number:
    return int(text) if text.isdigit() else float(text)


def _quotient(above: Number, below: Number) -> Number:
    exact = not isinstance(above, float) and not isinstance(below, float)
    return Fraction(above) / Fraction(below) if exact else float(above) / float(below)


def read_polynomial(given: Any, dim: int) -> Polynomial:
    """Return the polynomial that a file gives, as text or as a list of terms.

    Parameters
    ----------
    given : str or list
        Text such as ``"0.5*x1^2 - x2*x3 + 1/3"``: a sum of products of numbers (whole, decimal, or quotients, which
        stay exact) and powers of x1, x2, ..., the way a `Polynomial` is printed. Or a list of terms
        ``[coefficient, [exponent of x1, exponent of x2, ...]]``.
    dim : int
        Number of coordinates.

    Returns
    -------
    Polynomial

    Raises
    ------
    ValueError, TypeError
        Naming the place in the text, or the term, that is wrong.

    Examples
    --------
    >>> read_polynomial("0.5*x1^2 - x2*x3", 3)
    0.5*x1^2 - x2*x3
    >>> read_polynomial([[0.5, [2, 0, 0]], [-1, [0, 1, 1]]], 3)
    0.5*x1^2 - x2*x3
    """
    if isinstance(given, str):
        return _Reader(given, dim).polynomial()
    if not isinstance(given, list):
        raise TypeError(f"a polynomial is text such as '0.5*x1^2 + x2*x3' or a list of terms, not {given!r}")
    total = Polynomial({}, dim=dim)
    for term in given:
        if not (isinstance(term, list) and len(term) == 2 and isinstance(term[1], list)):
            raise TypeError(f"{term!r} is not a term; write [coefficient, [exponents]], such as [0.5, [2, 0, 0]]")
        if len(term[1]) != dim:
            raise ValueError(f"the term {term!r} has {len(term[1])} exponents; the system has {dim} coordinates")
        total = total + Polynomial({tuple(term[1]): term[0]})
    return total


class _Reader:
    """The text of a polynomial, cut into tokens, and how far it has been read."""

    def __init__(self, text: str, dim: int) -> None:
        self.text, self.dim, self.at = text, dim, 0
        self.tokens: list[re.Match[str]] = []
        end = 0
        while text[end:].strip():
            token = _TOKEN.match(text, end)
            if token is None:
                raise ValueError(f"{text!r} cannot be read from {text[end:].strip()!r} on; {_HOW}")
            self.tokens.append(token)
            end = token.end()

    def _peek(self, kind: str) -> str | None:
        return self.tokens[self.at][kind] if self.at < len(self.tokens) else None

    def _sign(self, allowed: str) -> str | None:
        sign = self._peek("sign")
        if sign is None or sign not in allowed:
            return None
        self.at += 1
        return sign

    def _fail(self) -> ValueError:
        place = self.text[self.tokens[self.at].start() :].strip() if self.at < len(self.tokens) else "its end"
        return ValueError(f"{self.text!r} cannot be read from {place!r} on; {_HOW}")

    def polynomial(self) -> Polynomial:
        sign = self._sign("+-")
        total = self._term(sign)
        while (sign := self._sign("+-")) is not None:
            total = total + self._term(sign)
        if self.at < len(self.tokens):
            raise self._fail()
        return total

    def _term(self, sign: str | None) -> Polynomial:
        coefficient: Number = -1 if sign == "-" else 1
        exponents = [0] * self.dim
        while True:
            variable = self._peek("variable")
            if variable is not None:
                if not 1 <= int(variable) <= self.dim:
                    raise ValueError(f"{self.text!r} has the coordinate x{variable}; there are x1 to x{self.dim}")
                self.at += 1
                exponents[int(variable) - 1] += self._power()
            else:
                coefficient = coefficient * self._constant()
            if self._sign("*") is None:
                return Polynomial({tuple(exponents): coefficient})

    def _power(self) -> int:
        if self._sign("^") is None:
            return 1
        number = self._peek("number")
        if number is None or not number.isdigit():
            raise self._fail()
        self.at += 1
        return int(number)

    def _constant(self) -> Number:
        inside = self._sign("(") is not None
        value = self._plain_number()
        if self._sign("/") is not None:
            below = self._plain_number()
            if below == 0:
                raise ValueError(f"{self.text!r} divides by zero")
            value = _quotient(value, below)
        if inside and self._sign(")") is None:
            raise self._fail()
        return value

    def _plain_number(self) -> Number:
        number = self._peek("number")
        if number is None:
            raise self._fail()
        self.at += 1
        return _number(number)


_HOW = "write sums of products such as 0.5*x1^2 - x2*x3 + 1/3"


def read_brackets(lines: Sequence[str], basis: Sequence[str]) -> Brackets:
    """Return the brackets written as ``"[e1, e3] = 2 e1 - e2"``, one line for each pair that does not commute.

    Parameters
    ----------
    lines : sequence of str
        On the right a sum of basis elements, each with a number before it: ``2``, ``0.5``, ``1/3``; a ``*`` may follow.
    basis : sequence of str
        Names of the basis elements.

    Returns
    -------
    dict
        ``{(i, j): {k: c}}``, indices from 0, as `LieAlgebra.from_brackets` takes it.

    Raises
    ------
    ValueError
        Naming the line that is wrong: not of this form, an unknown basis element, a pair given twice.

    Examples
    --------
    >>> read_brackets(["[e1, e3] = 2 e1 - e2"], ["e1", "e2", "e3"])
    {(0, 2): {0: 2.0, 1: -1.0}}
    """
    # Longest first, so that e12 is not read as e1 followed by 2.
    name = "|".join(re.escape(element) for element in sorted(basis, key=len, reverse=True))
    left = re.compile(rf"\s*\[\s*({name})\s*,\s*({name})\s*\]\s*=\s*")
    term = re.compile(rf"\s*([-+])?\s*(?:({_NUMBER})(?:\s*/\s*({_NUMBER}))?\s*\*?\s*)?({name})(?!\w)\s*")
    result: Brackets = {}
    for line in lines:
        begin = left.match(line)
        if begin is None:
            raise ValueError(
                f"{line!r} is not a bracket of {_listed(basis)}; write [{basis[0]}, {basis[-1]}] = 2 {basis[0]}"
            )
        pair = (basis.index(begin[1]), basis.index(begin[2]))
        if pair in result or pair[::-1] in result:
            raise ValueError(f"the bracket of {begin[1]} and {begin[2]} is given twice; give each pair once")
        result[pair] = _combination(line, begin.end(), term, basis)
    return result


def _combination(line: str, at: int, term: re.Pattern[str], basis: Sequence[str]) -> dict[int, float]:
    if line[at:].strip() == "0":
        return {}
    result: dict[int, float] = {}
    first = True
    while first or at < len(line):
        found = term.match(line, at)
        if found is None or not (first or found[1]):
            raise ValueError(
                f"{line!r} cannot be read from {line[at:].strip() or 'its end'!r} on; "
                f"write a sum of {_listed(basis)}, each with a number before it, such as 2 {basis[0]}"
            )
        sign, above, below, element = found.groups()
        if below is not None and float(below) == 0.0:
            raise ValueError(f"{line!r} divides by zero")
        size = float(_quotient(_number(above or "1"), _number(below or "1")))
        k = basis.index(element)
        result[k] = result.get(k, 0.0) + (-size if sign == "-" else size)
        first, at = False, found.end()
    return result


def _listed(basis: Sequence[str]) -> str:
    return ", ".join(basis) if len(basis) <= 6 else f"{basis[0]}, {basis[1]}, ..., {basis[-1]}"
