"""Gradients of the terms of an energy in C, and their changes along a tangent vector."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain
from typing import Any, NamedTuple

from coadjoint.files.exports.c_statements import Value, numbers, repeated, runs_of
from coadjoint.program.term_table import LINEAR, Terms

LONGEST_CHAIN = 6
"""Products of a sum that is one expression; a longer sum is a loop."""
LARGEST_POWER = 4
"""Powers that are written as products."""

Numbers = Callable[[str, int], Value]
"""``numbers(field, position)`` is a number of the terms, or the expression of an input."""


class Factor(NamedTuple):
    """A factor of a monomial: a row of the terms, the coordinate of this row, and an exponent."""

    row: int
    coordinate: int
    exponent: int


def rows_of(terms: Terms, k: int) -> range:
    """Return the rows of a term."""
    return range(int(terms.row[k]), int(terms.row[k + 1]))


def gradient(terms: Terms, k: int, number: Numbers, target: Callable[[int], int], out: str) -> list[str]:
    """Return statements that set ``out[target(row)]`` to the rows of term k."""
    if terms.kind[k] == LINEAR:
        return _linear(terms, k, number, target, out)
    lines = repeated(f"{out}[{{row}}] = 0.0;", {"row": list(map(target, rows_of(terms, k)))})
    return lines + _polynomial(terms, k, number, target, out)


def gradient_change(terms: Terms, k: int, number: Numbers, target: Callable[[int], int], out: str) -> list[str]:
    """Return statements that set ``out[target(row)]`` to the changes of the rows of term k along v."""
    if terms.kind[k] == LINEAR:
        return _linear(terms, k, number, target, out, change=True)
    lines = repeated(f"{out}[{{row}}] = 0.0;", {"row": list(map(target, rows_of(terms, k)))})
    return lines + _second_derivatives(terms, k, number, target, out)


def chain_of(products: list[tuple[str, str]], start: str) -> str:
    """Return start + the sum of products, the first one first, each sum rounded once."""
    for a, b in products:
        start = f"coadjoint_fma({a}, {b}, {start})"
    return start


def _linear(
    terms: Terms, k: int, number: Numbers, target: Callable[[int], int], out: str, change: bool = False
) -> list[str]:
    rows, vector = list(rows_of(terms, k)), "v" if change else "x"
    entries = [range(int(terms.entry[row]), int(terms.entry[row + 1])) for row in rows]
    columns, lines = terms.column.tolist(), []
    offset = [0.0 if change else number("offset", row) for row in rows]
    for first, last in runs_of([len(one) for one in entries]):
        length = len(entries[first])
        if length > LONGEST_CHAIN:
            for row in range(first, last):
                weights = [number("weight", e) for e in entries[row]]
                stored = [
                    *numbers("double", "weight", weights),
                    *numbers("coadjoint_index", "column", [columns[e] for e in entries[row]]),
                ]
                add = f"coadjoint_sum({length}, weight, column, {offset[row]}, {vector})"
                lines += ["{", *("    " + line for line in [*stored, f"{out}[{target(rows[row])}] = {add};"]), "}"]
            continue
        found: dict[str, list[Value]] = {"row": [target(row) for row in rows[first:last]], "b": offset[first:last]}
        for e in range(length):
            found[f"c{e}"] = [columns[one[e]] for one in entries[first:last]]
            found[f"w{e}"] = [number("weight", one[e]) for one in entries[first:last]]
        total = chain_of([(f"{{w{e}}}", f"{vector}[{{c{e}}}]") for e in range(length)], "{b}")
        lines += repeated(f"{out}[{{row}}] = {total};", found)
    return lines


def factors_of(terms: Terms, monomial: int) -> list[Factor]:
    """Return the factors of a monomial."""
    each = range(int(terms.factor[monomial]), int(terms.factor[monomial + 1]))
    rows = [int(terms.factor_row[f]) for f in each]
    return [Factor(row, int(terms.target[row]), int(terms.exponent[f])) for row, f in zip(rows, each, strict=True)]


def power(x: str, exponent: int) -> str:
    """Return a power with the bits of repeated multiplication."""
    if exponent > LARGEST_POWER:
        return f"coadjoint_power({x}, {exponent})"
    return x if exponent == 1 else f"({' * '.join([x] * exponent)})"


def _polynomial(terms: Terms, k: int, number: Numbers, target: Callable[[int], int], out: str) -> list[str]:
    """Return statements for the monomials in order, each with all derivatives; neighbours of one form are a loop."""
    monomials = list(range(int(terms.monomial[k]), int(terms.monomial[k + 1])))
    factors, lines = [factors_of(terms, m) for m in monomials], []
    for first, last in runs_of([tuple(f.exponent for f in one) for one in factors]):
        form, found = factors[first], _columns(factors[first:last], target)
        found["c"] = [number("coefficient", m) for m in monomials[first:last]]
        statements = [
            f"{out}[{{r{chosen}}}] += {' * '.join(chain(['{c}'], _derivative(form, chosen)))};"
            for chosen in range(len(form))
        ]
        if statements:
            lines += repeated("\n".join(statements), found)
    return lines


def _derivative(form: list[Factor], chosen: int) -> Iterator[str]:
    for position, factor in enumerate(form):
        x = f"x[{{i{position}}}]"
        if position != chosen:
            yield power(x, factor.exponent)
        elif factor.exponent > 1:
            yield f"({factor.exponent}.0 * {power(x, factor.exponent - 1)})"


def _columns(factors: list[list[Factor]], target: Callable[[int], int]) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for position in range(len(factors[0])):
        found[f"i{position}"] = [one[position].coordinate for one in factors]
        found[f"r{position}"] = [target(one[position].row) for one in factors]
    return found


def _second_derivatives(terms: Terms, k: int, number: Numbers, target: Callable[[int], int], out: str) -> list[str]:
    monomials = list(range(int(terms.monomial[k]), int(terms.monomial[k + 1])))
    factors, lines = [factors_of(terms, m) for m in monomials], []
    for first, last in runs_of([tuple(f.exponent for f in one) for one in factors]):
        form, found = factors[first], _columns(factors[first:last], target)
        found["c"] = [number("coefficient", m) for m in monomials[first:last]]
        statements = []
        for one in range(len(form)):
            for other in range(len(form)):
                if one == other and form[one].exponent < 2:
                    continue
                product = ["{c}"]
                for position, factor in enumerate(form):
                    order = (position == one) + (position == other)
                    scale = factor.exponent * (factor.exponent - 1) if order == 2 else factor.exponent if order else 1
                    product += [f"{scale}.0"] if scale != 1 else []
                    left = factor.exponent - order
                    product += [power(f"x[{{i{position}}}]", left)] if left else []
                statements.append(f"{out}[{{r{one}}}] += {' * '.join(product)} * v[{{i{other}}}];")
        if statements:
            lines += repeated("\n".join(statements), found)
    return lines
