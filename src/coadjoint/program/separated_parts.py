"""Parts without the products that cancel identically, so that their rounding errors reach no coordinate."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.commutation import first_noncommuting
from coadjoint.program.generators import NOTHING_OMITTED
from coadjoint.program.parts.part import GradientShare, Parts
from coadjoint.program.sparse_rows import sparse_row, starts_of
from coadjoint.systems.vanishing_products import (
    MAX_MONOMIALS,
    GradientTerm,
    Product,
    Products,
    cancelling,
    commuting_products,
    derivatives_of,
    divided_gradient,
)

Separated = tuple[Parts, Integers]


def separated_parts(algebra: LieAlgebra, parts: Parts, inputs: Collection[int] = ()) -> Separated:
    """Return parts with angles for each vector of separated gradients, and the omitted (angle, row, column), (k, 3)."""
    key = frozenset(inputs)
    known = _SEPARATED.setdefault(parts, {})
    if (algebra, key) not in known:
        known[algebra, key] = _separated(algebra, parts, key)
    return known[algebra, key]


# Parts are cached for the lifetime of their system.
_SEPARATED: WeakKeyDictionary[Parts, dict[Any, Separated]] = WeakKeyDictionary()


def _separated(algebra: LieAlgebra, parts: Parts, inputs: frozenset[int]) -> Separated:
    products = commuting_products(algebra)
    omitted: list[tuple[int, int, int, int]] = []
    separated: dict[int, GradientShare] = {}
    for p, numbers in _candidates(algebra, parts, products).items():
        functions, entries = _omitted_in_part(parts, p, {q: products.at(q) for q in numbers}, inputs)
        separated |= functions
        omitted += entries
    if not omitted:
        return parts, NOTHING_OMITTED
    copies = np.ones(len(parts.row) - 1, dtype=np.int64)
    for s, share in separated.items():
        copies[s] = share.copies
    sizes = np.diff(parts.row)
    row = starts_of(sizes * copies)
    share_of_copy = np.repeat(np.arange(len(copies)), copies)
    _, angles = expand(parts.row[share_of_copy], parts.row[share_of_copy + 1])
    result = Parts(
        parts.forms.take(angles),
        parts.offset[angles],
        parts.weights.take(angles),
        row,
        {**parts.gradients, **separated},
        parts.share,
        parts.timed,
        parts.source,
        None if parts.pivots is None else parts.pivots[angles],
        parts.bodies,
    )
    return result, np.array([(row[s] + a, i, k) for s, a, i, k in omitted], dtype=np.int64)


def _candidates(algebra: LieAlgebra, parts: Parts, products: Products) -> dict[int, list[int]]:
    """Return by part the products of its coordinates in rows that its generators do not read."""
    n, forms = algebra.dim, parts.forms
    if not len(products.row):
        return {}
    # Parts by coordinate, as sorted pairs.
    pairs = np.unique(forms.coordinate.astype(np.int64) * len(parts) + parts.part_of_angle[forms.owner])
    start = np.searchsorted(pairs, np.arange(n + 1) * len(parts))
    number, index = expand(start[products.column], start[products.column + 1])
    part = pairs[index] % len(parts)
    both = np.isin(products.state[number] * len(parts) + part, pairs)
    number, part = number[both], part[both]
    if len(number) > MAX_MONOMIALS:
        return {}
    i, j, k, _ = algebra.triples
    found: dict[int, list[int]] = {}
    for p in np.unique(part).tolist():
        moved = np.zeros(n, dtype=bool)
        moved[pairs[pairs % len(parts) == p] // len(parts)] = True
        read = np.zeros(n, dtype=bool)
        read[k[moved[i] | moved[j]]] = True
        numbers = number[part == p]
        found[p] = numbers[~read[products.row[numbers]]].tolist()
    return found


def _omitted_in_part(
    parts: Parts, p: int, candidates: Mapping[int, Product], inputs: Collection[int]
) -> tuple[dict[int, GradientShare], list[tuple[int, int, int, int]]]:
    """Return separated functions of a part by share, and omitted entries (share, angle in it, row, column)."""
    functions: dict[int, GradientShare] = {}
    omitted: list[tuple[int, int, int, int]] = []
    shares = range(int(parts.share[p]), int(parts.share[p + 1]))
    for s in shares:
        share = parts.gradients.get(s)
        if share is None or share.term is None:
            continue
        index = {int(k): a for a, k in enumerate(share.term.coordinates)}
        term, omissions = divided_gradient(share.term, candidates)
        for copy, numbers in enumerate(omissions):
            for q in sorted(numbers):
                each = candidates[q]
                omitted.append((s, copy * len(index) + index[each.column], each.row, each.state))
        functions[s] = replace(share, divided=term)
    listed = _of_polynomials(parts, shares, candidates.values(), inputs)
    for (s, a, each, _), number in zip(listed, cancelling([product for *_, product in listed]), strict=True):
        if number >= 0:
            omitted.append((s, a, each.row, each.state))
    return functions, omitted


def _of_polynomials(
    parts: Parts, shares: Iterable[int], candidates: Iterable[Product], inputs: Collection[int]
) -> list[tuple[int, int, Product, tuple[int, int, list[GradientTerm], Any]]]:
    """Return products with angles of polynomials: share, angle, and the monomials of the product; none if too many."""
    by_column: dict[int, list[Product]] = {}
    for each in candidates:
        by_column.setdefault(each.column, []).append(each)
    listed: list[tuple[int, int, Product, tuple[int, int, list[GradientTerm], Any]]] = []
    for s in shares:
        share = parts.gradients.get(s)
        polynomial = share.polynomial if share else None
        if s in parts.bodies or (share and polynomial is None):
            continue
        derivatives = derivatives_of(polynomial, range(polynomial.dim)) if polynomial else {}
        for a, angle in enumerate(range(int(parts.row[s]), int(parts.row[s + 1]))):
            coordinate, value = sparse_row(parts.forms, angle)
            if len(coordinate) != 1 or coordinate[0] not in by_column:
                continue
            monomials = derivatives.get(coordinate[0], [])
            if polynomial is None:
                monomials = _linear_monomials(parts, angle, coordinate[0] in inputs)
            for each in by_column[coordinate[0]]:
                listed.append((s, a, each, (each.row, each.state, monomials, each.constant * value[0])))
    return listed if sum(len(product[2]) for *_, product in listed) <= MAX_MONOMIALS else []


def joined_if_cancelling(algebra: LieAlgebra, parts: Parts) -> Parts:
    """Join parts of which products cancel, as those of p x p / m for an isotropic mass: alone, each moves more."""
    products = commuting_products(algebra)
    if not len(products.row) or len(parts) < 2:
        return parts
    used = np.zeros(algebra.dim, dtype=bool)
    used[parts.forms.coordinate] = True
    chosen = np.flatnonzero(used[products.state] & used[products.column])
    if not 0 < len(chosen) <= MAX_MONOMIALS:
        return parts
    candidates = [products.at(q) for q in chosen.tolist()]
    listed = _of_polynomials(parts, range(len(parts.row) - 1), candidates, ())
    part_of_share = np.repeat(np.arange(len(parts)), np.diff(parts.share)).tolist()
    sets: dict[int, set[int]] = {}
    for (s, *_), number in zip(listed, cancelling([product for *_, product in listed]), strict=True):
        if number >= 0:
            sets.setdefault(number, set()).add(part_of_share[s])
    label = np.arange(len(parts))
    for members in sets.values():
        wanted = np.isin(label, label[list(members)])
        joined = np.isin(parts.part_of_angle[parts.forms.owner], np.flatnonzero(wanted))
        if first_noncommuting(algebra, parts.forms.coordinate[joined].tolist()) is None:
            label[wanted] = label[wanted].min()
    return parts if np.array_equal(label, np.arange(len(parts))) else parts.joined(label)


def _linear_monomials(parts: Parts, angle: int, given: bool) -> list[GradientTerm]:
    coordinates, values = sparse_row(parts.weights, angle)
    monomials: list[GradientTerm] = [(None, (k,), value) for k, value in zip(coordinates, values, strict=True)]
    if given or parts.offset[angle] != 0:
        monomials.append((("input", angle) if given else None, (), 1 if given else parts.offset[angle]))
    return monomials
