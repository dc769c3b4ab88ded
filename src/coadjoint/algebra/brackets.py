"""Brackets as mappings, and as text with any names of basis elements, "[e1, e3] = 2 e1 - e2": parser and formatter."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from coadjoint.algebra.constants import Triples, read_basis
from coadjoint.algebra.exact.numbers import NUMBER, PLAIN_NUMBER, TOO_LARGE, parse_number, quotient
from coadjoint.short_repr import short, short_rest
from coadjoint.validation import is_integer

MAX_QUOTED = 60  # letters of a bracket in a message
MAX_EXAMINED_CONSTANTS = 20_000
"""Number of constants examined by `format_brackets`; an algebra may have millions."""

Brackets = dict[tuple[int, int], dict[int, float]]
Names = dict[int, dict[str, int]]
"""Length, the longest first -> names of basis elements of this length, with their indices."""

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


def parse_brackets(dim: int, brackets: Any, basis: Sequence[str] | None = None) -> list[tuple[Any, Any, Any, Any]]:
    """Convert ``{(i, j): {k: c}}``, where basis names may replace indices, or lines of text to rows (i, j, k, c)."""
    # An empty bracket is kept: the pair commutes, which contradicts a nonzero bracket in the opposite order.
    if isinstance(brackets, list | tuple) and brackets and all(isinstance(line, str) for line in brackets):
        brackets = _parse_lines(brackets, read_basis(basis, dim))
    if not isinstance(brackets, Mapping):
        raise TypeError(
            f"brackets must be a mapping {{(i, j): {{k: c}}}}, or lines such as '[e1, e2] = e3', not "
            f"{type(brackets).__name__}"
        )
    rows: list[tuple[Any, Any, Any, Any]] = []
    for pair, components in brackets.items():
        if not (isinstance(pair, tuple) and len(pair) == 2):
            raise TypeError(f"each key of brackets must be a pair of indices (i, j), not {short(pair)}")
        if not isinstance(components, Mapping):
            raise TypeError(f"bracket {short(pair)} must be a mapping {{k: c}}, not {short(components)}")
        rows.extend((*pair, k, c) for k, c in (components or {0: 0.0}).items())
    if any(isinstance(entry, str) for row in rows for entry in row[:3]):
        names = read_basis(basis, dim)
        rows = [(*(_basis_index(entry, names) for entry in row[:3]), row[3]) for row in rows]
    numbers = [entry for row in rows for entry in row[:3] if is_integer(entry)]
    if numbers and min(numbers) == 1 and max(numbers) == dim:
        raise ValueError(f"brackets use indices from 0, and these go from 1 to {dim}; subtract 1 from each")
    for row in rows:
        for name, entry in zip("ijk", row[:3], strict=True):
            if is_integer(entry) and not 0 <= entry < dim:
                pair, wrong = f"({row[0]}, {row[1]})", f"{name} = {short(entry)}"
                raise ValueError(f"bracket {pair} has the index {wrong}; give indices from 0 to {dim - 1}")
    return rows


def _basis_index(argument: Any, names: Sequence[str]) -> Any:
    if not isinstance(argument, str):
        return argument
    if argument not in names:
        raise ValueError(
            f"brackets name {short(argument)}, which is not in the basis {short(tuple(names))}; give basis="
        )
    return names.index(argument)


def _parse_lines(lines: Sequence[str], basis: Sequence[str]) -> Brackets:
    """Parse lines ``"[e1, e3] = 2 e1 - e2"``, one per noncommuting pair, to ``{(i, j): {k: c}}``."""
    # By length, so that the time does not grow with the number of names; e12 is not read as e1 followed by 2.
    names: Names = {length: {} for length in sorted(set(map(len, basis)), reverse=True)}
    for k, name in reversed(list(enumerate(basis))):
        names[len(name)][name] = k
    result: Brackets = {}
    for line in lines:
        pair = _parse_pair(line, names)
        if pair is None:
            raise ValueError(
                f"{short(line, MAX_QUOTED)} is not a bracket of {_format_names(basis)}; "
                f"write [{basis[0][:MAX_QUOTED]}, {basis[-1][:MAX_QUOTED]}] = 2 {basis[0][:MAX_QUOTED]}"
            )
        i, j, end = pair
        if (i, j) in result or (j, i) in result:
            first, second = (short(basis[k], MAX_QUOTED)[1:-1] for k in (i, j))
            raise ValueError(f"the bracket of {first} and {second} is given twice; give each pair once")
        try:
            result[i, j] = _parse_sum(line, end, names, basis)
        except OverflowError:
            raise ValueError(f"{short(line, MAX_QUOTED)} has a number that {TOO_LARGE}") from None
    return result


def names_in(lines: Sequence[str]) -> tuple[str, ...]:
    """Return the names in bracket lines in order of first appearance."""
    names: dict[str, None] = {}
    for line in lines:
        if not isinstance(line, str):
            raise TypeError(f"a bracket is {short(line, MAX_QUOTED)}; it must be a line such as '[h, e] = 2 e'")
        names.update(dict.fromkeys(re.findall(r"[^\W\d]\w*", line)))
    if not names:
        raise ValueError("there are no brackets; write lines such as '[h, e] = 2 e'")
    return tuple(names)


def _names_at(names: Names, text: str, position: int) -> Iterator[tuple[int, int]]:
    """Yield the basis elements whose names begin at a position, with the ends of their names, longest first."""
    for length, numbers in names.items():
        k = numbers.get(text[position : position + length])
        if k is not None:
            yield k, position + length


def _parse_pair(line: str, names: Names) -> tuple[int, int, int] | None:
    """Return the two elements in the bracket on the left, and the start of the right side."""
    opened = _OPENED.match(line)
    for i, end in _names_at(names, line, opened.end()) if opened else ():
        between = _BETWEEN.match(line, end)
        for j, last in _names_at(names, line, between.end()) if between else ():
            closed = _CLOSED.match(line, last)
            if closed is not None:
                return i, j, closed.end()
    return None


def _parse_term(line: str, position: int, names: Names) -> tuple[re.Match[str], int, int] | None:
    """Parse the term at a position: sign and number, its element, and the start of the next term."""
    for factor in _FACTORS:
        match = factor.match(line, position)
        for k, end in _names_at(names, line, match.end()) if match else ():
            if match is not None and not _WORD.match(line, end):
                space = _SPACE.match(line, end)
                return match, k, space.end() if space else end
    return None


def _parse_sum(line: str, position: int, names: Names, basis: Sequence[str]) -> dict[int, float]:
    if line[position : position + MAX_QUOTED].strip() == "0" and line[position:].strip() == "0":
        return {}
    result: dict[int, float] = {}
    first = True
    while first or position < len(line):
        term = _parse_term(line, position, names)
        if term is None or not (first or term[0]["sign"]):
            where = short_rest(line[position:], MAX_QUOTED)
            raise ValueError(
                f"{short(line, MAX_QUOTED)} cannot be parsed {where}; write a sum of {_format_names(basis)}, "
                f"each with a number before it, such as 2 {basis[0][:MAX_QUOTED]}"
            )
        factor, k, position = term
        denominator = parse_number(factor["below"] or "1")
        if denominator == 0:
            raise ValueError(f"{short(line, MAX_QUOTED)} divides by zero")
        size = float(quotient(parse_number(factor["above"] or "1"), denominator))
        total = result.get(k, 0.0) + (-size if factor["sign"] == "-" else size)
        if not math.isfinite(total):
            raise OverflowError
        result[k] = total
        first = False
    return result


def _format_names(basis: Sequence[str]) -> str:
    shown = [name[:MAX_QUOTED] for name in (basis if len(basis) <= 6 else (basis[0], basis[1], basis[-1]))]
    return ", ".join(shown) if len(basis) <= 6 else f"{shown[0]}, {shown[1]}, ..., {shown[2]}"


def format_brackets(triples: Triples, basis: Sequence[str], max_count: int) -> list[str]:
    """Format the first `max_count` nonzero brackets."""
    texts: dict[tuple[int, int], str] = {}
    columns = (column[:MAX_EXAMINED_CONSTANTS].tolist() for column in triples)
    for i, j, k, c in zip(*columns, strict=True):
        if (i, j) not in texts and len(texts) == max_count:
            break
        before = texts.get((i, j), "")
        sign = ("-" if c < 0 else "") if not before else (" - " if c < 0 else " + ")
        size = f"{abs(c):.6g}"
        texts[i, j] = f"{before}{sign}{'' if size == '1' else size + ' '}{basis[k]}"
    return [f"[{basis[i]}, {basis[j]}] = {text}" for (i, j), text in texts.items()]


def count_of_brackets(triples: Triples) -> int:
    """Return the number of pairs of basis elements that do not commute."""
    i, j = triples.i, triples.j
    return 0 if not len(i) else 1 + int(((i[1:] != i[:-1]) | (j[1:] != j[:-1])).sum())
