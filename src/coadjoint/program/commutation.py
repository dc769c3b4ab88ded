"""Commutation of coordinates, and of parts, of a system."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import CHUNK, Integers, chunks, expand, groups
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.parts.clashing_forms import BRACKET_ROUNDOFF, surely_noncommuting
from coadjoint.program.parts.part import Parts
from coadjoint.program.pattern_cache import MAX_PATTERN_SIZE, Pattern
from coadjoint.program.sparse_rows import order_by, run_starts, run_sums, starts_of

Pairs = tuple[Integers, Integers]

# Largest number of entries of a dense lookup table of forms.
MAX_TABLE_SIZE = 1 << 22


class Commutation:
    """Commuting coordinates and parts of an algebra."""

    def __init__(self, algebra: LieAlgebra) -> None:
        self._algebra = algebra

    @property
    def pattern(self) -> Pairs:
        """Noncommuting pairs as compressed sparse rows; equal for algebras that differ only in the values of their
        constants.
        """
        return self._algebra.neighbours()

    @property
    def products(self) -> Integers:
        """The number of entries in the generator of each coordinate, shape (n,)."""
        return np.diff(self._algebra.actions[0])

    def first_noncommuting(self, coordinates: Iterable[int]) -> tuple[int, int] | None:
        """Return two of the coordinates whose basis elements do not commute, or None."""
        inside = np.zeros(self._algebra.dim, dtype=bool)
        inside[list(coordinates)] = True
        i, j, _, _ = self._algebra.triples
        clash = np.flatnonzero(inside[i] & inside[j])
        return (int(i[clash[0]]), int(j[clash[0]])) if clash.size else None

    def has_noncommuting(self, label: Integers) -> NDArray[np.bool_]:
        """Test for each label (all >= 0) whether two coordinates with this label do not commute."""
        i, j, _, _ = self._algebra.triples
        found = np.zeros(int(label.max(initial=-1)) + 1, dtype=bool)
        both = label[i]
        found[both[(both == label[j]) & (both >= 0)]] = True
        return found

    def coupled_pairs(self, parts: Parts) -> Pairs:
        """Return the pairs of parts (first <= second) with noncommuting coordinates, even if the forms commute."""
        if max(len(parts.offset), self._algebra.dim) > MAX_PATTERN_SIZE:
            return self._find_coupled_pairs(parts)
        where = (parts.forms.start, parts.forms.coordinate, parts.angle)
        return _cached_coupled_pairs(Pattern((self, parts), *where, *self.pattern))

    def noncommuting_pairs(self, parts: Parts, coupled_pairs: Pairs) -> Pairs:
        """Select the noncommuting pairs from touching pairs of parts, first < second."""
        first, second = coupled_pairs
        apart = first != second
        first, second = first[apart], second[apart]
        several = np.add.reduceat(np.diff(parts.forms.start) > 1, parts.angle[:-1]) > 0 if len(parts) else np.zeros(0)
        open_ = np.flatnonzero(several[first] | several[second])
        if not len(open_):
            return first, second
        settled = np.ones(len(first), dtype=bool)
        settled[open_] = ~self._forms_commute(parts, first[open_], second[open_])
        return first[settled], second[settled]

    def _find_coupled_pairs(self, parts: Parts) -> Pairs:
        count, size = len(parts), self._algebra.dim
        i, j, _, _ = self._algebra.triples
        begins = run_starts(i, j)
        i, j = i[begins], j[begins]
        part, coordinate = _without_repeats(parts.part_of_angle[parts.forms.owner], parts.forms.coordinate)
        order = order_by(coordinate)
        held = np.bincount(coordinate, minlength=size)
        start, holder = starts_of(held), part[order]
        if int(held[i] @ held[j]) > count * (count + 1) // 2:
            if max(count, size) ** 2 <= MAX_TABLE_SIZE:
                # Counts of coordinate pairs; float32 suffices, since only zero or nonzero matters.
                holds, apart = np.zeros((count, size), dtype=np.float32), np.zeros((size, size), dtype=np.float32)
                holds[part, coordinate], apart[i, j], apart[j, i] = 1.0, 1.0, 1.0
                first, second = np.nonzero(np.triu(holds @ apart @ holds.T))
                return first.astype(np.int64), second.astype(np.int64)
            coupled_pairs = np.zeros((count, count), dtype=bool)
            for pair in chunks(np.arange(len(i)), held[i] * held[j]):
                one, other = _pairs(start, holder, i[pair], j[pair])
                coupled_pairs[np.minimum(one, other), np.maximum(one, other)] = True
            first, second = np.nonzero(coupled_pairs)
            return first.astype(np.int64), second.astype(np.int64)
        one, other = _pairs(start, holder, i, j)
        return _without_repeats(np.minimum(one, other), np.maximum(one, other))

    def _forms_commute(self, parts: Parts, first: Integers, second: Integers) -> NDArray[np.bool_]:
        """Test for pairs of parts whether all their forms commute, up to rounding."""
        angle, forms, size = parts.angle, parts.forms, self._algebra.dim
        count = np.diff(angle)
        pair, place = expand(np.zeros(len(first), dtype=np.int64), count[first] * count[second])
        f = angle[first[pair]] + place // count[second[pair]]
        g = angle[second[pair]] + place % count[second[pair]]
        values = forms.value.astype(np.float64)
        lookup = _Lookup(forms.start, forms.coordinate.astype(np.int64), values, size)
        start, every = self._algebra.actions
        cost = np.diff(start)[forms.coordinate]
        costs = np.diff(np.concatenate([[0], np.cumsum(cost)])[forms.start])[f]
        commute = np.ones(len(first), dtype=bool)
        if int(costs.sum()) > CHUNK and len(forms.start) * max(size, len(forms.start)) <= MAX_TABLE_SIZE:
            dense = np.zeros((len(forms.start) - 1, size))
            dense[forms.owner, forms.coordinate] = values
            clash = surely_noncommuting(dense, self._algebra, f, g, costs)
            commute[pair[clash]] = False
            left = commute[pair]
            pair, f, g, costs = pair[left], f[left], g[left], costs[left]
        for part in chunks(np.arange(len(f)), costs):
            own, entry = expand(forms.start[f[part]], forms.start[f[part] + 1])
            i = forms.coordinate[entry].astype(np.int64)
            row, at = expand(start[i], start[i + 1])
            which = own[row]
            product = values[entry][row] * every.c[at] * lookup(g[part][which], every.j[at])
            used = product != 0
            which, k, product = which[used], every.k[at][used], product[used]
            order, begins = groups(which, k)
            if not len(order):
                continue
            marks = np.zeros(len(order), dtype=bool)
            marks[begins] = True
            bracket, bound = run_sums(product[order], marks), run_sums(np.abs(product[order]), marks)
            wrong = np.abs(bracket) > BRACKET_ROUNDOFF * bound
            commute[pair[part][which[order[begins]][wrong]]] = False
        return commute


@lru_cache(maxsize=1024)
def _cached_coupled_pairs(pattern: Pattern[tuple[Commutation, Parts]]) -> Pairs:
    commutation, parts = pattern.source
    return commutation._find_coupled_pairs(parts)


class _Lookup:
    """Coefficient lookup of sparse forms by (form, coordinate); zero if absent."""

    def __init__(self, start: Integers, coordinate: Integers, value: NDArray[np.float64], size: int) -> None:
        owner = np.repeat(np.arange(len(start) - 1), np.diff(start))
        self._size, self._table, self._value = size, None, np.append(value, 0.0)
        if (len(start) - 1) * size <= MAX_TABLE_SIZE:
            self._table = np.zeros((len(start) - 1, size))
            self._table[owner, coordinate] = value
        self._key = owner * size + coordinate

    def __call__(self, form: Integers, coordinate: Integers) -> NDArray[np.float64]:
        if self._table is not None:
            return self._table[form, coordinate]
        key = form * self._size + coordinate
        place = np.searchsorted(self._key, key)
        found = self._key[np.minimum(place, len(self._key) - 1)] == key
        return self._value[np.where(found, place, -1)]


def _pairs(start: Integers, holder: Integers, i: Integers, j: Integers) -> Pairs:
    """Return all pairs of a holder of i and a holder of j."""
    row, one = expand(start[i], start[i + 1])
    again, other = expand(start[j[row]], start[j[row] + 1])
    return holder[one[again]], holder[other]


def _without_repeats(first: NDArray[Any], second: NDArray[Any]) -> Pairs:
    order = order_by(first, second)
    first, second = first[order].astype(np.int64), second[order].astype(np.int64)
    kept = run_starts(first, second)
    return first[kept], second[kept]
