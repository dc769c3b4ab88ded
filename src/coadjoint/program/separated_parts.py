"""Parts without the products that cancel identically, so that their rounding errors reach no coordinate."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.parts.part import BodyShare, FunctionShare, Parts, PolynomialShare
from coadjoint.program.sparse_rows import starts_of
from coadjoint.systems.vanishing_products import (
    MAX_MONOMIALS,
    Monomial,
    Product,
    commuting_products,
    derivatives_of,
    separated_function,
    vanishing,
)

MAX_COMPARISONS = 1 << 22
"""Number of parts times products above which none is omitted."""


class SeparatedParts(NamedTuple):
    """Parts, and the entries (angle, row, column) of their generators that are omitted, shape (k, 3)."""

    parts: Parts
    omitted: Integers


def separated_parts(algebra: LieAlgebra, parts: Parts, inputs: Collection[int] = ()) -> SeparatedParts:
    """Return parts in which a function has angles for each of the vectors that its gradient is the sum of.

    Products are omitted in rows that no generator of the part reads. The angles of the coordinates `inputs` are given
    numbers later.
    """
    key = frozenset(inputs)
    known = _SEPARATED.setdefault(parts, {})
    if (algebra, key) not in known:
        known[algebra, key] = _separated(algebra, parts, key)
    return known[algebra, key]


# Parts are cached for the lifetime of their system.
_SEPARATED: WeakKeyDictionary[Parts, dict[Any, SeparatedParts]] = WeakKeyDictionary()


def _separated(algebra: LieAlgebra, parts: Parts, inputs: frozenset[int]) -> SeparatedParts:
    products = commuting_products(algebra)
    omitted: list[tuple[int, int, int, int]] = []
    separated: dict[int, FunctionShare] = {}
    if 0 < len(products.row) * len(parts) <= MAX_COMPARISONS:
        for p in range(len(parts)):
            candidates = _candidates(algebra, parts, p, products)
            if candidates:
                functions, entries = _omitted_in_part(parts, p, candidates, inputs)
                separated |= functions
                omitted += entries
    if not omitted:
        return SeparatedParts(parts, np.zeros((0, 3), dtype=np.int64))
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
        {**parts.nonlinear_shares, **separated},
        parts.share,
        parts.timed,
    )
    result.pivots = None if parts.pivots is None else parts.pivots[angles]
    return SeparatedParts(result, np.array([(row[s] + a, i, k) for s, a, i, k in omitted], dtype=np.int64))


def _candidates(algebra: LieAlgebra, parts: Parts, p: int, products: Any) -> dict[int, Product]:
    """Return the products of coordinates of a part in rows that its generators do not read, by their numbers."""
    forms = parts.forms
    first, last = (int(parts.angle[q]) for q in (p, p + 1))
    moved = forms.coordinate[forms.start[first] : forms.start[last]]
    chosen = np.isin(products.state, moved) & np.isin(products.column, moved)
    if not chosen.any():
        return {}
    i, j, k, _ = algebra.triples
    chosen &= ~np.isin(products.row, np.concatenate([k[np.isin(i, moved)], k[np.isin(j, moved)]]))
    return {q: products.at(q) for q in np.flatnonzero(chosen).tolist()}


def _omitted_in_part(
    parts: Parts, p: int, candidates: Mapping[int, Product], inputs: Collection[int]
) -> tuple[dict[int, FunctionShare], list[tuple[int, int, int, int]]]:
    """Return separated functions of a part by share, and omitted entries (share, angle in it, row, column)."""
    functions: dict[int, FunctionShare] = {}
    omitted: list[tuple[int, int, int, int]] = []
    entries: list[tuple[int, int, int, int]] = []
    listed: list[tuple[int, int, list[Monomial], Any]] = []
    for s in range(int(parts.share[p]), int(parts.share[p + 1])):
        angles = range(int(parts.row[s]), int(parts.row[s + 1]))
        share = parts.nonlinear_shares.get(s)
        if isinstance(share, BodyShare):
            continue
        if isinstance(share, FunctionShare):
            index = {int(k): a for a, k in enumerate(share.term.coordinates)}
            found = separated_function(share.term, candidates)
            for copy, numbers in enumerate(found.omitted):
                for q in sorted(numbers):
                    each = candidates[q]
                    omitted.append((s, copy * len(angles) + index[each.column], each.row, each.state))
            functions[s] = replace(share, separated=found.term, copies=len(found.omitted))
            continue
        derivatives = (
            derivatives_of(share.polynomial, range(share.polynomial.dim)) if isinstance(share, PolynomialShare) else {}
        )
        for a, angle in enumerate(angles):
            coordinate, value = _row(parts.forms, angle)
            if len(coordinate) != 1:
                continue
            monomials = derivatives.get(coordinate[0], [])
            if not isinstance(share, PolynomialShare):
                monomials = _linear_monomials(parts, angle, coordinate[0] in inputs)
            for each in candidates.values():
                if each.column == coordinate[0]:
                    entries.append((s, a, each.row, each.state))
                    listed.append((each.row, each.state, monomials, each.constant * value[0]))
    if sum(len(each[2]) for each in listed) <= MAX_MONOMIALS:
        omitted += [entry for entry, zero in zip(entries, vanishing(listed), strict=True) if zero]
    return functions, omitted


def _linear_monomials(parts: Parts, angle: int, given: bool) -> list[Monomial]:
    coordinates, values = _row(parts.weights, angle)
    monomials = [Monomial(None, (k,), value) for k, value in zip(coordinates, values, strict=True)]
    if given or parts.offset[angle] != 0:
        monomials.append(Monomial(("input", angle) if given else None, (), 1 if given else parts.offset[angle]))
    return monomials


def _row(rows: Any, r: int) -> tuple[list[int], list[Any]]:
    entries = slice(int(rows.start[r]), int(rows.start[r + 1]))
    return rows.coordinate[entries].tolist(), rows.value[entries].tolist()
