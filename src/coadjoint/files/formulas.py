"""How are polynomials and brackets written in a configuration file? A strict reader; nothing is evaluated.

Its time grows with the length of the text alone: what a short text could blow up is bounded, degrees and digits.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

from coadjoint.algebra.expressions import MOST_DIGITS, TOO_LARGE, fits
from coadjoint.algebra.polynomial import MOST_DEGREE, TOO_HIGH, Exponents, Polynomial
from coadjoint.memory import check_room
from coadjoint.wording import short

Number = int | float | Fraction
Brackets = dict[tuple[int, int], dict[int, float]]

_PLAIN = r"(?:\d+\.?\d*|\.\d+)"
_NUMBER = rf"{_PLAIN}(?:[eE][+-]?\d+)?"
_TOKEN = re.compile(rf"\s*(?:(?P<number>{_NUMBER})|x(?P<variable>\d+)|(?P<sign>[-+*/^()]))")
_BLANK = re.compile(r"\s*\Z")

SHOWN = 60
ASKED_EVERY = 1024
BYTES_PER_TERM = 300
BYTES_PER_EXPONENT = 8


def _number(text: str) -> Number:
    if not text.isdigit():
        return float(text)
    if len(text) > MOST_DIGITS:
        raise ValueError(f"a number of {len(text)} digits {TOO_LARGE}")
    return int(text)


def _quotient(above: Number, below: Number) -> Number:
    exact = not isinstance(above, float) and not isinstance(below, float)
    return Fraction(above) / Fraction(below) if exact else _checked(float(_checked(above)) / float(_checked(below)))


def _checked(value: Number) -> Number:
    if not fits(value):
        raise ValueError(f"a number {TOO_LARGE}")
    return value


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
        Naming the place in the text, or the term, that is wrong; a degree above 1024, or a coefficient that float64
        does not hold.

    Examples
    --------
    >>> read_polynomial("0.5*x1^2 - x2*x3", 3)
    0.5*x1^2 - x2*x3
    >>> read_polynomial([[0.5, [2, 0, 0]], [-1, [0, 1, 1]]], 3)
    0.5*x1^2 - x2*x3
    """
    if isinstance(given, str):
        terms: Iterator[tuple[Exponents, Number]] = _Reader(given, dim).terms()
    elif isinstance(given, list):
        terms = _listed_terms(given, dim)
    else:
        raise TypeError(f"a polynomial is text such as '0.5*x1^2 + x2*x3' or a list of terms, not {short(given)}")
    total: dict[Exponents, Number] = {}
    for exponents, coefficient in terms:
        total[exponents] = _checked(total[exponents] + coefficient) if exponents in total else coefficient
        if len(total) % ASKED_EVERY == 0:
            size = len(total) * (BYTES_PER_TERM + BYTES_PER_EXPONENT * dim)
            check_room(2 * size, f"a polynomial of {len(total)} terms or more in {dim} coordinates")
    return Polynomial(total, dim=dim)


def _listed_terms(given: list[Any], dim: int) -> Iterator[tuple[Exponents, Number]]:
    for term in given:
        if not (isinstance(term, list) and len(term) == 2 and isinstance(term[1], list)):
            raise TypeError(f"{short(term)} is not a term; write [coefficient, [exponents]], such as [0.5, [2, 0, 0]]")
        coefficient, exponents = term
        if len(exponents) != dim:
            raise ValueError(f"the term {short(term)} has {len(exponents)} exponents; the system has {dim} coordinates")
        degree = sum(e for e in exponents if type(e) is int)
        if degree > MOST_DEGREE:
            raise _too_high(f"the term {short(term)}", degree)
        if type(coefficient) is int and not fits(coefficient):
            raise ValueError(f"a coefficient {TOO_LARGE}")
        yield from Polynomial({tuple(exponents): coefficient}).monomials.items()


def _too_high(what: str, degree: int) -> ValueError:
    return ValueError(f"{what} has the degree {short(degree)}; there are degrees up to {MOST_DEGREE}; {TOO_HIGH}")


class _Reader:
    """The text of a polynomial, and the token that comes next."""

    def __init__(self, text: str, dim: int) -> None:
        self.text, self.dim, self.end = text, dim, 0
        self._next()

    def _next(self) -> None:
        self.begin = self.end
        self.token = _TOKEN.match(self.text, self.begin)
        if self.token is not None:
            self.end = self.token.end()
        elif not _BLANK.match(self.text, self.begin):
            raise self._fail()

    def _peek(self, kind: str) -> str | None:
        return self.token[kind] if self.token is not None else None

    def _sign(self, allowed: str) -> str | None:
        sign = self._peek("sign")
        if sign is None or sign not in allowed:
            return None
        self._next()
        return sign

    def _fail(self) -> ValueError:
        place = self.text[self.begin :].strip() or "its end"
        return ValueError(f"{short(self.text, SHOWN)} cannot be read from {short(place, SHOWN)} on; {_HOW}")

    def terms(self) -> Iterator[tuple[Exponents, Number]]:
        yield self._term(self._sign("+-"))
        while (sign := self._sign("+-")) is not None:
            yield self._term(sign)
        if self.token is not None:
            raise self._fail()

    def _term(self, sign: str | None) -> tuple[Exponents, Number]:
        coefficient: Number = -1 if sign == "-" else 1
        exponents = [0] * self.dim
        degree = 0
        while True:
            variable = self._peek("variable")
            if variable is not None:
                index = int(variable) if len(variable) <= MOST_DIGITS else 0
                if not 1 <= index <= self.dim:
                    raise ValueError(
                        f"{short(self.text, SHOWN)} has the coordinate x{variable[:20]}; there are x1 to x{self.dim}"
                    )
                self._next()
                power = self._power()
                degree += power
                if degree > MOST_DEGREE:
                    raise _too_high(short(self.text, SHOWN), degree)
                exponents[index - 1] += power
            else:
                coefficient = _checked(coefficient * self._constant())
            if self._sign("*") is None:
                return tuple(exponents), coefficient

    def _power(self) -> int:
        if self._sign("^") is None:
            return 1
        number = self._peek("number")
        if number is None or not number.isdigit():
            raise self._fail()
        self._next()
        return int(_number(number))

    def _constant(self) -> Number:
        inside = self._sign("(") is not None
        value = self._plain_number()
        if self._sign("/") is not None:
            below = self._plain_number()
            if below == 0:
                raise ValueError(f"{short(self.text, SHOWN)} divides by zero")
            value = _quotient(value, below)
        if inside and self._sign(")") is None:
            raise self._fail()
        return value

    def _plain_number(self) -> Number:
        number = self._peek("number")
        if number is None:
            raise self._fail()
        value = _checked(_number(number))
        self._next()
        return value


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
        Naming the line that is wrong: not of this form, an unknown basis element, a pair given twice, a number that
        float64 does not hold.

    Examples
    --------
    >>> read_brackets(["[e1, e3] = 2 e1 - e2"], ["e1", "e2", "e3"])
    {(0, 2): {0: 2.0, 1: -1.0}}
    """
    names = _Names(basis)
    result: Brackets = {}
    for line in lines:
        found = names.pair(line)
        if found is None:
            raise ValueError(
                f"{short(line, SHOWN)} is not a bracket of {_listed(basis)}; "
                f"write [{basis[0][:SHOWN]}, {basis[-1][:SHOWN]}] = 2 {basis[0][:SHOWN]}"
            )
        i, j, end = found
        if (i, j) in result or (j, i) in result:
            one, other = (short(basis[k], SHOWN)[1:-1] for k in (i, j))
            raise ValueError(f"the bracket of {one} and {other} is given twice; give each pair once")
        try:
            result[i, j] = _combination(line, end, names, basis)
        except OverflowError:
            raise ValueError(f"{short(line, SHOWN)} has a number that {TOO_LARGE}") from None
    return result


class _Names:
    """The names of a basis, found in a text by their lengths: the time does not grow with their number."""

    _OPENED, _BETWEEN, _CLOSED = (re.compile(p) for p in (r"\s*\[\s*", r"\s*,\s*", r"\s*\]\s*=\s*"))
    # A number may be followed by a name that begins like an exponent: in 2e1 it is 2.
    _FACTORS = tuple(
        re.compile(rf"\s*(?P<sign>[-+])?\s*{number}")
        for number in (
            rf"(?P<above>{_NUMBER})(?:\s*/\s*(?P<below>{_NUMBER}))?\s*\*?\s*",
            rf"(?P<above>{_NUMBER})\s*/\s*(?P<below>{_PLAIN})\s*\*?\s*",
            rf"(?P<above>{_PLAIN})\s*\*?\s*(?P<below>(?!))?",
            r"(?P<above>(?!))?(?P<below>(?!))?",
        )
    )
    _WORD = re.compile(r"\w")
    _SPACE = re.compile(r"\s*")

    def __init__(self, basis: Sequence[str]) -> None:
        self._index = {name: k for k, name in reversed(list(enumerate(basis)))}
        # Longest first, so that e12 is not read as e1 followed by 2.
        self._lengths = sorted(set(map(len, basis)), reverse=True)

    def _at(self, text: str, place: int) -> Iterator[tuple[int, int]]:
        for length in self._lengths:
            k = self._index.get(text[place : place + length])
            if k is not None and place + length <= len(text):
                yield k, place + length

    def pair(self, line: str) -> tuple[int, int, int] | None:
        """Return the two elements in the bracket on the left, and where the right side begins."""
        opened = self._OPENED.match(line)
        for i, end in self._at(line, opened.end()) if opened else ():
            between = self._BETWEEN.match(line, end)
            for j, last in self._at(line, between.end()) if between else ():
                closed = self._CLOSED.match(line, last)
                if closed is not None:
                    return i, j, closed.end()
        return None

    def term(self, line: str, at: int) -> tuple[re.Match[str], int, int] | None:
        """Return sign and number of the term at a place, its element, and where the next term begins."""
        for factor in self._FACTORS:
            found = factor.match(line, at)
            for k, end in self._at(line, found.end()) if found else ():
                if found is not None and not self._WORD.match(line, end):
                    space = self._SPACE.match(line, end)
                    return found, k, space.end() if space else end
        return None


def _combination(line: str, at: int, names: _Names, basis: Sequence[str]) -> dict[int, float]:
    if line[at : at + SHOWN].strip() == "0" and line[at:].strip() == "0":
        return {}
    result: dict[int, float] = {}
    first = True
    while first or at < len(line):
        found = names.term(line, at)
        if found is None or not (first or found[0]["sign"]):
            raise ValueError(
                f"{short(line, SHOWN)} cannot be read from {short(line[at:].strip() or 'its end', SHOWN)} on; "
                f"write a sum of {_listed(basis)}, each with a number before it, such as 2 {basis[0][:SHOWN]}"
            )
        factor, k, at = found
        below = _checked(_number(factor["below"] or "1"))
        if below == 0:
            raise ValueError(f"{short(line, SHOWN)} divides by zero")
        size = float(_quotient(_checked(_number(factor["above"] or "1")), below))
        total = result.get(k, 0.0) + (-size if factor["sign"] == "-" else size)
        if not math.isfinite(total):
            raise OverflowError
        result[k] = total
        first = False
    return result


def _listed(basis: Sequence[str]) -> str:
    shown = [name[:SHOWN] for name in (basis if len(basis) <= 6 else (basis[0], basis[1], basis[-1]))]
    return ", ".join(shown) if len(basis) <= 6 else f"{shown[0]}, {shown[1]}, ..., {shown[2]}"
