"""Parser of brackets such as "[e1, e3] = 2 e1 - e2", for arbitrary names of basis elements."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence

from coadjoint.algebra.exact.numbers import TOO_LARGE
from coadjoint.algebra.polynomials.number_literals import NUMBER, PLAIN_NUMBER, parse_number, quotient
from coadjoint.short_repr import short

MAX_QUOTED = 60

Brackets = dict[tuple[int, int], dict[int, float]]


def parse_brackets(lines: Sequence[str], basis: Sequence[str]) -> Brackets:
    """Parse lines ``"[e1, e3] = 2 e1 - e2"``, one per noncommuting pair, to ``{(i, j): {k: c}}`` with indices from 0.

    Coefficients are ``2``, ``0.5``, ``1/3``, optionally followed by ``*``. A ValueError names the invalid line.
    """
    names = _Names(basis)
    result: Brackets = {}
    for line in lines:
        found = names.pair(line)
        if found is None:
            raise ValueError(
                f"{short(line, MAX_QUOTED)} is not a bracket of {_listed(basis)}; "
                f"write [{basis[0][:MAX_QUOTED]}, {basis[-1][:MAX_QUOTED]}] = 2 {basis[0][:MAX_QUOTED]}"
            )
        i, j, end = found
        if (i, j) in result or (j, i) in result:
            one, other = (short(basis[k], MAX_QUOTED)[1:-1] for k in (i, j))
            raise ValueError(f"the bracket of {one} and {other} is given twice; give each pair once")
        try:
            result[i, j] = _combination(line, end, names, basis)
        except OverflowError:
            raise ValueError(f"{short(line, MAX_QUOTED)} has a number that {TOO_LARGE}") from None
    return result


def names_in(lines: Sequence[str]) -> tuple[str, ...]:
    """Return the names in bracket lines in order of first appearance.

    Examples
    --------
    >>> names_in(["[h, e] = 2 e", "[e, f] = h"])
    ('h', 'e', 'f')
    """
    found: dict[str, None] = {}
    for line in lines:
        if not isinstance(line, str):
            raise TypeError(f"a bracket is {short(line, MAX_QUOTED)}; it must be a line such as '[h, e] = 2 e'")
        found.update(dict.fromkeys(re.findall(r"[^\W\d]\w*", line)))
    if not found:
        raise ValueError("there are no brackets; write lines such as '[h, e] = 2 e'")
    return tuple(found)


class _Names:
    """Tokenizer of basis names, by length: its time does not grow with the number of names."""

    _OPENED, _BETWEEN, _CLOSED = (re.compile(p) for p in (r"\s*\[\s*", r"\s*,\s*", r"\s*\]\s*=\s*"))
    # A name that begins like an exponent may follow a number: the number in 2e1 is 2.
    _FACTORS = tuple(
        re.compile(rf"\s*(?P<sign>[-+])?\s*{number}")
        for number in (
            rf"(?P<above>{NUMBER})(?:\s*/\s*(?P<below>{NUMBER}))?\s*\*?\s*",
            rf"(?P<above>{NUMBER})\s*/\s*(?P<below>{PLAIN_NUMBER})\s*\*?\s*",
            rf"(?P<above>{PLAIN_NUMBER})\s*\*?\s*(?P<below>(?!))?",
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
        """Return the two elements in the bracket on the left, and the start of the right side."""
        opened = self._OPENED.match(line)
        for i, end in self._at(line, opened.end()) if opened else ():
            between = self._BETWEEN.match(line, end)
            for j, last in self._at(line, between.end()) if between else ():
                closed = self._CLOSED.match(line, last)
                if closed is not None:
                    return i, j, closed.end()
        return None

    def term(self, line: str, at: int) -> tuple[re.Match[str], int, int] | None:
        """Parse the term at a position: sign and number, its element, and the start of the next term."""
        for factor in self._FACTORS:
            found = factor.match(line, at)
            for k, end in self._at(line, found.end()) if found else ():
                if found is not None and not self._WORD.match(line, end):
                    space = self._SPACE.match(line, end)
                    return found, k, space.end() if space else end
        return None


def _combination(line: str, at: int, names: _Names, basis: Sequence[str]) -> dict[int, float]:
    if line[at : at + MAX_QUOTED].strip() == "0" and line[at:].strip() == "0":
        return {}
    result: dict[int, float] = {}
    first = True
    while first or at < len(line):
        found = names.term(line, at)
        if found is None or not (first or found[0]["sign"]):
            raise ValueError(
                f"{short(line, MAX_QUOTED)} cannot be read from {short(line[at:].strip() or 'its end', MAX_QUOTED)} "
                f"on; write a sum of {_listed(basis)}, each with a number before it, such as 2 {basis[0][:MAX_QUOTED]}"
            )
        factor, k, at = found
        below = parse_number(factor["below"] or "1")
        if below == 0:
            raise ValueError(f"{short(line, MAX_QUOTED)} divides by zero")
        size = float(quotient(parse_number(factor["above"] or "1"), below))
        total = result.get(k, 0.0) + (-size if factor["sign"] == "-" else size)
        if not math.isfinite(total):
            raise OverflowError
        result[k] = total
        first = False
    return result


def _listed(basis: Sequence[str]) -> str:
    shown = [name[:MAX_QUOTED] for name in (basis if len(basis) <= 6 else (basis[0], basis[1], basis[-1]))]
    return ", ".join(shown) if len(basis) <= 6 else f"{shown[0]}, {shown[1]}, ..., {shown[2]}"
