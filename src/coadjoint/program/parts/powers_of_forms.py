"""Monomials of noncommuting coordinates as sums of products of powers of linear forms, which have exact flows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from coadjoint.algebra.exact.numbers import exact_number
from coadjoint.algebra.exact.sparse_sums import connected
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import SparseKey, SparseMonomials, SparsePolynomial
from coadjoint.program.parts.part import GradientShare, Parts
from coadjoint.program.sparse_rows import SparseRows
from coadjoint.rounding import UNIT_ROUNDOFF

MAX_DEGREE = 6
"""Largest degree of a monomial that is taken apart: the powers are larger than it by up to d^d/d!, 65 for degree 6."""

Form = tuple[tuple[int, int], ...]
"""Coordinates with whole coefficients, without a common factor, the first one positive."""
Powers = tuple[tuple[Form, int], ...]
"""Powers of forms that commute with each other."""


def parts_of_powers(algebra: LieAlgebra, monomials: Mapping[SparseKey, Any], dim: int) -> list[Parts]:
    """Return parts that add up to the monomials, each of powers of forms that commute."""
    start, neighbours = (column.tolist() for column in algebra.neighbours())
    first, second, *_ = algebra.triples
    ideal = connected(algebra.dim, first, second)  # by the smallest coordinate of each
    total: dict[Powers, Fraction] = {}
    size: dict[Powers, Fraction] = {}
    for monomial, coefficient in monomials.items():
        for key, factor in _powers_of_monomial(dict(monomial), start, neighbours).items():
            summand = factor * Fraction(exact_number(coefficient))
            total[key] = total.get(key, Fraction(0)) + summand
            size[key] = size.get(key, Fraction(0)) + abs(summand)
    # Coefficients are rounded once each, so that less than this is what cancels.
    kept = [key for key, value in total.items() if abs(value) > 4 * UNIT_ROUNDOFF * size[key]]

    def shape(powers: Powers) -> Any:
        shapes = tuple(tuple((k - int(ideal[k]), c) for k, c in form) for form, _ in powers)
        return max(map(len, shapes)), shapes

    in_floats = any(isinstance(value, float) for value in monomials.values())
    groups: list[dict[int, Form]] = []
    members: list[list[Powers]] = []
    for powers in sorted(kept, key=shape):
        number = next((g for g, group in enumerate(groups) if _fits(powers, group, start, neighbours)), len(groups))
        if number == len(groups):
            groups.append({})
            members.append([])
        groups[number].update((k, form) for form, _ in powers for k, _ in form)
        members[number].append(powers)
    numbers = {key: float(total[key]) if in_floats else total[key] for key in kept}
    return [_part([(key, numbers[key]) for key in chosen], dim) for chosen in members]


def _fits(powers: Powers, group: Mapping[int, Form], start: Sequence[int], neighbours: Sequence[int]) -> bool:
    """Test whether no form of a group but these has their coordinates, or others that do not commute with them."""
    for form, _ in powers:
        for k, _ in form:
            for i in (k, *neighbours[start[k] : start[k + 1]]):
                if group.get(i, form) != form:
                    return False
    return True


def _powers_of_monomial(
    powers: dict[int, int], start: Sequence[int], neighbours: Sequence[int]
) -> dict[Powers, Fraction]:
    """Return a monomial as a sum of products of powers of forms, with their factors."""
    # Coordinates that commute with all others are factors by themselves.
    factors: list[list[int]] = []
    for k in powers:
        joined = [one for one in factors if not {*one}.isdisjoint(neighbours[start[k] : start[k + 1]])]
        factors = [one for one in factors if one not in joined] + [sorted([k, *(i for one in joined for i in one)])]
    found: list[list[tuple[Form, int, Fraction]]] = []
    for one in sorted(factors):
        degree = sum(powers[k] for k in one)
        forms = _polarized(tuple(powers[k] for k in one))
        found.append([(tuple((k, c) for k, c in zip(one, row, strict=True) if c), degree, by) for row, by in forms])
    total: dict[Powers, Fraction] = {}
    for chosen in product(*found):
        total[tuple((form, degree) for form, degree, _ in chosen)] = math.prod(
            (by for *_, by in chosen), start=Fraction(1)
        )
    return total


@lru_cache(maxsize=256)
def _polarized(exponents: tuple[int, ...]) -> tuple[tuple[tuple[int, ...], Fraction], ...]:
    """Return x^a y^b ... as a sum of powers of forms: the polarization identity, with equal forms added."""
    degree = sum(exponents)
    found: dict[tuple[int, ...], Fraction] = {}
    for chosen in product(*(range(e + 1) for e in exponents)):
        row = [e - 2 * i for e, i in zip(exponents, chosen, strict=True)]
        if not any(row):
            continue
        leading = next(c for c in row if c)
        common = math.gcd(*row) * (1 if leading > 0 else -1)
        weight = math.prod(math.comb(e, i) for e, i in zip(exponents, chosen, strict=True))
        factor = Fraction((-1) ** sum(chosen) * weight * common**degree, 2**degree * math.factorial(degree))
        key = tuple(c // common for c in row)
        found[key] = found.get(key, Fraction(0)) + factor
    return tuple((row, by) for row, by in sorted(found.items(), reverse=True) if by)


def _part(terms: Sequence[tuple[Powers, Any]], dim: int) -> Parts:
    """Return the part of a polynomial of commuting forms; its angle by a form is the derivative by one coordinate."""
    forms = {form: min(form, key=lambda entry: abs(entry[1])) for powers, _ in terms for form, _ in powers}
    row_of = {pivot: [(k, c / scale) for k, c in form] for form, (pivot, scale) in forms.items()}
    rest = sorted({k for form in forms for k, _ in form} - row_of.keys())
    coordinates = [*rest, *sorted(row_of)]  # a part begins and ends with a form
    total: SparseMonomials = {}
    for powers, value in terms:
        for monomial in product(*(_expanded(form, degree) for form, degree in powers)):
            key = tuple(sorted(entry for entries, _ in monomial for entry in entries))
            total[key] = total.get(key, 0) + value * math.prod(factor for _, factor in monomial)
    rows = [row_of.get(k, []) for k in coordinates]
    count, ends = len(coordinates), np.array([0, 1])
    return Parts(
        SparseRows.of_lists([[k for k, _ in row] for row in rows], [[c for _, c in row] for row in rows]),
        np.zeros(count),
        SparseRows.empty(count),
        count * ends,
        {0: GradientShare(tuple(coordinates), SparsePolynomial(total, dim))},
        ends,
        np.zeros(1, dtype=bool),
    )


@lru_cache(maxsize=4096)
def _expanded(form: Form, degree: int) -> tuple[tuple[SparseKey, int], ...]:
    """Return the monomials, coordinates with exponents, of a power of a form, with their whole coefficients."""
    found = []
    for exponents in product(range(degree + 1), repeat=len(form)):
        if sum(exponents) == degree:
            factor = math.factorial(degree)
            for (_, c), e in zip(form, exponents, strict=True):
                factor = factor // math.factorial(e) * c**e
            entries = tuple((k, e) for (k, _), e in zip(form, exponents, strict=True) if e)
            found.append((entries, factor))
    return tuple(found)
