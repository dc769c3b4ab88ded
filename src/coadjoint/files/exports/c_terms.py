"""Gradients of the terms of an energy in C, and their changes along a tangent vector."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

from coadjoint.files.exports.c_statements import Value, numbers, repeated, runs_of
from coadjoint.program.term_table import LINEAR, Terms

LONGEST_CHAIN = 6
"""Products of a sum that is one expression; a longer sum is a loop."""
LARGEST_POWER = 4
"""Powers that are written as products."""

Numbers = Callable[[str, int], Value]
"""``numbers(field, position)`` is a number of the terms, or the expression of an input."""


def rows_of(terms: Terms, k: int) -> range:
    """Return the rows of a term."""
    return range(int(terms.row[k]), int(terms.row[k + 1]))


def gradient(
    terms: Terms, k: int, number: Numbers, target: Callable[[int], int], out: str, change: bool = False
) -> list[str]:
    """Return statements that set ``out[target(row)]`` to the rows of term k, or with `change` to those along v."""
    if terms.kind[k] == LINEAR:
        return _linear(terms, k, number, target, out, change)
    lines = repeated(f"{out}[{{row}}] = 0.0;", {"row": list(map(target, rows_of(terms, k)))})
    monomials = list(range(int(terms.monomial[k]), int(terms.monomial[k + 1])))
    factors = [factors_of(terms, m) for m in monomials]
    # Monomials in order, each with all derivatives; neighbours of one form are a loop.
    for first, last in runs_of([exponents for _, exponents in factors]):
        exponents, found = factors[first][1], dict[str, list[Any]]()
        for position in range(len(exponents)):
            rows = [one[0][position] for one in factors[first:last]]
            found[f"i{position}"] = [int(terms.target[row]) for row in rows]
            found[f"r{position}"] = list(map(target, rows))
        found["c"] = [number("coefficient", m) for m in monomials[first:last]]
        statements = (_second_derivatives if change else _first_derivatives)(exponents, out)
        if statements:
            lines += repeated("\n".join(statements), found)
    return lines


def chain_of(products: list[tuple[str, str]], start: str) -> str:
    """Return start + the sum of products, the first one first, each sum rounded once."""
    for a, b in products:
        start = f"coadjoint_fma({a}, {b}, {start})"
    return start


def _linear(terms: Terms, k: int, number: Numbers, target: Callable[[int], int], out: str, change: bool) -> list[str]:
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


def factors_of(terms: Terms, monomial: int) -> tuple[list[int], tuple[int, ...]]:
    """Return the factors of a monomial: rows of the terms, and exponents."""
    each = slice(int(terms.factor[monomial]), int(terms.factor[monomial + 1]))
    return terms.factor_row[each].tolist(), tuple(terms.exponent[each].tolist())


def power(x: str, exponent: int) -> str:
    """Return a power with the bits of repeated multiplication."""
    if exponent > LARGEST_POWER:
        return f"coadjoint_power({x}, {exponent})"
    return x if exponent == 1 else f"({' * '.join([x] * exponent)})"


def _first_derivatives(exponents: tuple[int, ...], out: str) -> list[str]:
    def factors(chosen: int) -> Iterator[str]:
        for position, exponent in enumerate(exponents):
            x = f"x[{{i{position}}}]"
            if position != chosen:
                yield power(x, exponent)
            elif exponent > 1:
                yield f"({exponent}.0 * {power(x, exponent - 1)})"

    numbered = range(len(exponents))
    return [f"{out}[{{r{chosen}}}] += {' * '.join(['{c}', *factors(chosen)])};" for chosen in numbered]


def _second_derivatives(exponents: tuple[int, ...], out: str) -> list[str]:
    statements = []
    for one, other in product(range(len(exponents)), repeat=2):
        if one == other and exponents[one] < 2:
            continue
        factors = ["{c}"]
        for position, exponent in enumerate(exponents):
            order = (position == one) + (position == other)
            scale = exponent * (exponent - 1) if order == 2 else exponent if order else 1
            factors += [f"{scale}.0"] if scale != 1 else []
            left = exponent - order
            factors += [power(f"x[{{i{position}}}]", left)] if left else []
        statements.append(f"{out}[{{r{one}}}] += {' * '.join(factors)} * v[{{i{other}}}];")
    return statements
