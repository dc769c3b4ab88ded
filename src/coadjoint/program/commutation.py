"""Commutation of coordinates, and of parts, of a system; joining of commuting parts into few, by first fit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import CHUNK, Floats, Integers, chunks, connected, expand, groups
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.parts.part import Parts
from coadjoint.program.sparse_rows import MAX_PATTERN_SIZE, Pattern, layers, order_by, run_starts, run_sums, starts_of
from coadjoint.rounding import UNIT_ROUNDOFF

Pairs = tuple[Integers, Integers]
Masks = NDArray[np.uint64]

# Largest number of entries of a dense lookup table of forms.
MAX_TABLE_SIZE = 1 << 22
# A bracket of two forms counts as zero below this relative size (round-off of its products).
BRACKET_ROUNDOFF = 16 * UNIT_ROUNDOFF
# Cost of sorting one product, in multiplications of a dense matrix product.
COST_RATIO = 32
# Above this number parts are joined in the given order only; lattices have thousands, in a good order.
MAX_REORDERED = 64
WORD_BITS = 64  # of a mask, one for each group
# Number of masks held in memory at once.
MAX_BATCH_ITEMS = 1 << 22


def first_noncommuting(algebra: LieAlgebra, coordinates: Iterable[int]) -> tuple[int, int] | None:
    """Return two of the coordinates whose basis elements do not commute, or None."""
    inside = np.zeros(algebra.dim, dtype=bool)
    inside[list(coordinates)] = True
    i, j, _, _ = algebra.triples
    clash = np.flatnonzero(inside[i] & inside[j])
    return (int(i[clash[0]]), int(j[clash[0]])) if clash.size else None


def noncommuting(algebra: LieAlgebra, first: Integers, second: Integers) -> NDArray[np.bool_]:
    """Test for pairs of coordinates whether they do not commute."""
    i, j, _, _ = algebra.triples
    size = algebra.dim
    return np.isin(first * size + second, i * size + j)


def ideals(algebra: LieAlgebra) -> Pairs:
    """Return the smallest sets of coordinates that commute with all others: the set of each, and its number in it."""
    if algebra._copied is not None:
        return np.divmod(np.arange(algebra.dim), algebra._copied[0].dim)
    i, j, _, _ = algebra.triples
    label = connected(algebra.dim, i, j)
    order = np.argsort(label, kind="stable")
    size = np.bincount(label, minlength=algebra.dim)
    number = np.empty_like(order)
    number[order] = np.arange(algebra.dim) - (np.cumsum(size) - size)[label[order]]
    return label, number


def has_noncommuting(algebra: LieAlgebra, label: Integers) -> NDArray[np.bool_]:
    """Test for each label (all >= 0) whether two coordinates with this label do not commute."""
    noncommuting = np.zeros(int(label.max(initial=-1)) + 1, dtype=bool)
    for i, j in _noncommuting(algebra):
        first_label = label[i]
        noncommuting[first_label[(first_label == label[j]) & (first_label >= 0)]] = True
    return noncommuting


def _noncommuting(algebra: LieAlgebra) -> Iterator[tuple[Any, Any]]:
    """Yield indices of coordinates that do not commute: arrays, or for copies of an algebra slices."""
    if algebra._copied is None:
        yield algebra.triples[:2]
        return
    summand, _ = algebra._copied
    for i, j in zip(summand.triples.i.tolist(), summand.triples.j.tolist(), strict=True):
        yield slice(i, None, summand.dim), slice(j, None, summand.dim)


def coupled_pairs(algebra: LieAlgebra, parts: Parts) -> Pairs:
    """Return the pairs of parts (first <= second) with noncommuting coordinates, even if the forms commute."""
    if max(len(parts.offset), algebra.dim) > MAX_PATTERN_SIZE:
        return _find_coupled_pairs(algebra, parts)
    columns = (parts.forms.start, parts.forms.coordinate, parts.angle)
    return _cached_coupled_pairs(Pattern((algebra, parts), *columns, *algebra.neighbours()))


def noncommuting_pairs(algebra: LieAlgebra, parts: Parts, coupled_pairs: Pairs) -> Pairs:
    """Select the noncommuting pairs, first < second, from coupled pairs of parts."""
    first, second = coupled_pairs
    distinct = first != second
    first, second = first[distinct], second[distinct]
    has_long_form = np.add.reduceat(np.diff(parts.forms.start) > 1, parts.angle[:-1]) > 0 if len(parts) else np.zeros(0)
    undecided = np.flatnonzero(has_long_form[first] | has_long_form[second])
    if not len(undecided):
        return first, second
    noncommuting = np.ones(len(first), dtype=bool)
    noncommuting[undecided] = ~_forms_commute(algebra, parts, first[undecided], second[undecided])
    return first[noncommuting], second[noncommuting]


def _find_coupled_pairs(algebra: LieAlgebra, parts: Parts) -> Pairs:
    count, size = len(parts), algebra.dim
    part, coordinate = parts.part_of_angle[parts.forms.owner], parts.forms.coordinate
    part_count = np.bincount(coordinate, minlength=size)
    owner_pairs = (count + 1) ** 2
    if part_count.max(initial=0) <= 1 and owner_pairs <= MAX_TABLE_SIZE:
        owner = np.full(size, count)  # coordinates of no part
        owner[coordinate] = part
        pairs = sum(
            np.bincount(owner[i] * (count + 1) + owner[j], minlength=owner_pairs) for i, j in _noncommuting(algebra)
        )
        coupled = (np.asarray(pairs) > 0).reshape(count + 1, count + 1)[:count, :count]
        first, second = np.nonzero(np.triu(coupled | coupled.T))
        return first.astype(np.int64), second.astype(np.int64)
    i, j, _, _ = algebra.triples
    begins = run_starts(i, j)
    i, j = i[begins], j[begins]
    part, by_part = _without_repeats(part, coordinate)
    part_count = np.bincount(by_part, minlength=size)
    order = order_by(by_part)
    start, part_by_coordinate = starts_of(part_count), part[order]
    if int(part_count[i] @ part_count[j]) > count * (count + 1) // 2:
        if max(count, size) ** 2 <= MAX_TABLE_SIZE:
            # Counts of coordinate pairs; float32 suffices, since only zero or nonzero matters.
            incidence = np.zeros((count, size), dtype=np.float32)
            noncommuting = np.zeros((size, size), dtype=np.float32)
            incidence[part, by_part], noncommuting[i, j], noncommuting[j, i] = 1.0, 1.0, 1.0
            first, second = np.nonzero(np.triu(incidence @ noncommuting @ incidence.T))
            return first.astype(np.int64), second.astype(np.int64)
        coupled = np.zeros((count, count), dtype=bool)
        for pair in chunks(np.arange(len(i)), part_count[i] * part_count[j]):
            part_i, part_j = _pairs(start, part_by_coordinate, i[pair], j[pair])
            coupled[np.minimum(part_i, part_j), np.maximum(part_i, part_j)] = True
        first, second = np.nonzero(coupled)
        return first.astype(np.int64), second.astype(np.int64)
    part_i, part_j = _pairs(start, part_by_coordinate, i, j)
    return _without_repeats(np.minimum(part_i, part_j), np.maximum(part_i, part_j))


def _forms_commute(algebra: LieAlgebra, parts: Parts, first: Integers, second: Integers) -> NDArray[np.bool_]:
    """Test for pairs of parts whether all their forms commute, up to rounding."""
    forms, size = parts.forms, algebra.dim
    pair, f, g = _pairs_of_forms(algebra, parts, first, second)
    values = forms.value.astype(np.float64)
    lookup = _lookup(forms.start, forms.coordinate.astype(np.int64), values, size)
    start, actions = algebra.actions
    cost = np.diff(start)[forms.coordinate]
    costs = np.diff(np.concatenate([[0], np.cumsum(cost)])[forms.start])[f]
    commute = np.ones(len(first), dtype=bool)
    if int(costs.sum()) > CHUNK and len(forms.start) * max(size, len(forms.start)) <= MAX_TABLE_SIZE:
        dense = np.zeros((len(forms.start) - 1, size))
        dense[forms.owner, forms.coordinate] = values
        clash = surely_noncommuting(dense, algebra, f, g, costs)
        commute[pair[clash]] = False
        undecided = commute[pair]
        pair, f, g, costs = pair[undecided], f[undecided], g[undecided], costs[undecided]
    for part in chunks(np.arange(len(f)), costs):
        owner, entry = expand(forms.start[f[part]], forms.start[f[part] + 1])
        i = forms.coordinate[entry].astype(np.int64)
        row, index = expand(start[i], start[i + 1])
        bracket_index = owner[row]
        product = values[entry][row] * actions.c[index] * lookup(g[part][bracket_index], actions.j[index])
        nonzero = product != 0
        bracket_index, k, product = bracket_index[nonzero], actions.k[index][nonzero], product[nonzero]
        order, begins = groups(bracket_index, k)
        if not len(order):
            continue
        marks = np.zeros(len(order), dtype=bool)
        marks[begins] = True
        bracket, bound = run_sums(product[order], marks), run_sums(np.abs(product[order]), marks)
        clashing = np.abs(bracket) > BRACKET_ROUNDOFF * bound
        commute[pair[part][bracket_index[order[begins]][clashing]]] = False
    return commute


def _pairs_of_forms(
    algebra: LieAlgebra, parts: Parts, first: Integers, second: Integers
) -> tuple[Integers, Integers, Integers]:
    """Return the pairs of forms of pairs of parts, with its number; if many, only those with coupled coordinates."""
    angle, forms = parts.angle, parts.forms
    count = np.diff(angle)
    start, neighbours = algebra.neighbours()
    coordinate = forms.coordinate.astype(np.int64)
    of_coordinate = np.bincount(coordinate, minlength=algebra.dim)
    met = np.bincount(np.repeat(np.arange(algebra.dim), np.diff(start)), of_coordinate[neighbours], algebra.dim)
    if int(count[first] @ count[second]) <= int(met[coordinate].sum()):
        pair, product_index = expand(np.zeros(len(first), dtype=np.int64), count[first] * count[second])
        f = angle[first[pair]] + product_index // count[second[pair]]
        return pair, f, angle[second[pair]] + product_index % count[second[pair]]
    order = np.argsort(coordinate, kind="stable")
    begin, owner, part = starts_of(of_coordinate), forms.owner, parts.part_of_angle
    codes = first * len(parts) + second
    by_code = np.argsort(codes)
    found = [np.zeros((3, 0), dtype=np.int64)]
    for chunk in chunks(np.arange(len(coordinate)), met[coordinate].astype(np.int64)):
        entry, index = expand(start[coordinate[chunk]], start[coordinate[chunk] + 1])
        match, place = expand(begin[neighbours[index]], begin[neighbours[index] + 1])
        f, g = owner[chunk][entry[match]], owner[order[place]]
        code = part[f] * len(parts) + part[g]
        at = np.minimum(np.searchsorted(codes[by_code], code), len(codes) - 1)
        inside = codes[by_code][at] == code
        found.append(np.unique(np.stack([by_code[at], f, g])[:, inside], axis=1))
    pair, f, g = np.unique(np.concatenate(found, axis=1), axis=1)
    return pair, f, g


@lru_cache(maxsize=1024)
def _cached_coupled_pairs(pattern: Pattern[tuple[LieAlgebra, Parts]]) -> Pairs:
    return _find_coupled_pairs(*pattern.source)


def _lookup(
    start: Integers, coordinate: Integers, value: NDArray[np.float64], size: int
) -> Callable[[Integers, Integers], NDArray[np.float64]]:
    """Return the function of (form, coordinate) with the coefficients of sparse forms; zero if absent."""
    owner = np.repeat(np.arange(len(start) - 1), np.diff(start))
    if (len(start) - 1) * size <= MAX_TABLE_SIZE:
        table = np.zeros((len(start) - 1, size))
        table[owner, coordinate] = value
        return lambda form, at: table[form, at]
    keys, values = owner * size + coordinate, np.append(value, 0.0)

    def of_keys(form: Integers, at: Integers) -> NDArray[np.float64]:
        key = form * size + at
        position = np.searchsorted(keys, key)
        present = keys[np.minimum(position, len(keys) - 1)] == key
        return values[np.where(present, position, -1)]

    return of_keys


def _pairs(start: Integers, part_by_coordinate: Integers, i: Integers, j: Integers) -> Pairs:
    """Return all pairs of a part that contains i and a part that contains j."""
    row, first_entry = expand(start[i], start[i + 1])
    repeat, second_entry = expand(start[j[row]], start[j[row] + 1])
    return part_by_coordinate[first_entry[repeat]], part_by_coordinate[second_entry]


def _without_repeats(first: NDArray[Any], second: NDArray[Any]) -> Pairs:
    order = order_by(first, second)
    first, second = first[order].astype(np.int64), second[order].astype(np.int64)
    begins = run_starts(first, second)
    return first[begins], second[begins]


def surely_noncommuting(
    forms: Floats, algebra: LieAlgebra, first: Integers, second: Integers, costs: Integers
) -> NDArray[np.bool_]:
    """Test pairs of dense forms (forms, n) for a bracket component that is nonzero, by two orders of summation, far
    beyond rounding; others need the sum of all products. `costs` has the number of products in each bracket.
    """
    size = forms.shape[1]
    i, j, k, c = algebra.triples
    order = order_by(k)
    i, j, c = i[order], j[order], c[order]
    count = np.bincount(k, minlength=size)
    start = starts_of(count)
    noncommuting = np.zeros(len(first), dtype=bool)
    undecided = np.arange(len(first))
    # Components with the most products decide the most pairs. A sum of m products has an error below m round-offs.
    for component in np.argsort(-count, kind="stable").tolist():
        entries = slice(start[component], start[component + 1])
        products = 4 * count[component] * len(forms) ** 2
        if not products or COST_RATIO * int(costs[undecided].sum()) < products:
            break
        left, right = c[entries] * forms[:, i[entries]], forms[:, j[entries]]
        half, half_bound = left @ right.T, np.abs(left) @ np.abs(right).T
        bracket, bound = half - half.T, half_bound + half_bound.T
        # Beyond the rounding of the forms, and of the sums of products.
        sure = np.abs(bracket) > (BRACKET_ROUNDOFF + 8 * count[component] * UNIT_ROUNDOFF) * bound
        decided = sure[first[undecided], second[undecided]]
        noncommuting[undecided[decided]] = True
        undecided = undecided[~decided]
    return noncommuting


def few_parts(parts: Parts, algebra: LieAlgebra) -> Parts:
    """Join commuting parts by first fit; if more than two remain, also in orders of most and fewest clashes."""
    if not len(parts):
        return parts
    coupled = coupled_pairs(algebra, parts)
    noncommuting = noncommuting_pairs(algebra, parts, coupled)
    if len(parts) > MAX_PATTERN_SIZE:
        return parts.joined(_few_groups(len(parts), noncommuting, coupled))
    return parts.joined(_cached_groups(len(parts), Pattern((noncommuting, coupled), *noncommuting, *coupled)))


@lru_cache(maxsize=1024)
def _cached_groups(count: int, pairs: Pattern[tuple[Pairs, Pairs]]) -> Integers:
    return _few_groups(count, *pairs.source)


def _few_groups(count: int, noncommuting_pairs: Pairs, coupled_pairs: Pairs) -> Integers:
    best = first_fit(count, *noncommuting_pairs)
    if best.max() > 1 and count <= MAX_REORDERED:
        first, second = coupled_pairs
        number = np.bincount(np.concatenate([first, second[first != second]]), minlength=count)
        for sign in (-1, 1):
            groups = _first_fit_in_order(np.argsort(sign * number, kind="stable"), *noncommuting_pairs)
            best = groups if groups.max() < best.max() else best
    return best


def _first_fit_in_order(order: Integers, first: Integers, second: Integers) -> Integers:
    rank = np.argsort(order)
    low, high = np.minimum(rank[first], rank[second]), np.maximum(rank[first], rank[second])
    groups = first_fit(len(order), low, high)
    return np.asarray(groups[rank])


def first_fit(count: int, first: Integers, second: Integers) -> Integers:
    """Return the group of each item by first fit; the pairs in conflict have first < second."""
    masks = _group_masks(count, first, second, np.ones((count, 1), dtype=bool))[:, 0]
    word = np.argmax(masks != 0, axis=1)
    return WORD_BITS * word + np.bitwise_count(masks[np.arange(count), word] - np.uint64(1)).astype(np.int64)


def count_groups(count: int, first: Integers, second: Integers, present: NDArray[np.bool_]) -> Integers:
    """Count the groups of `first_fit` for subsets of the items, for many cases at once."""
    batch_size = max(1, MAX_BATCH_ITEMS // max(count, 1))
    counts = [np.zeros(0, dtype=np.int64)]
    for begin in range(0, present.shape[1], batch_size):
        masks = _group_masks(count, first, second, present[:, begin : begin + batch_size])
        used = np.bitwise_or.reduce(masks, axis=0)
        counts.append(np.bitwise_count(used).sum(axis=1).astype(np.int64))
    return np.concatenate(counts)


def _group_masks(count: int, first: Integers, second: Integers, present: NDArray[np.bool_]) -> Masks:
    """Return the group of each item in each case as one bit in words, (count, cases, words), or none."""
    layer = layers(count, first, second)
    order = order_by(second)
    start, earlier = starts_of(np.bincount(second, minlength=count)), first[order]
    masks = np.zeros((*present.shape, 1), dtype=np.uint64)
    members = np.argsort(layer, kind="stable")
    ends = starts_of(np.bincount(layer, minlength=1))
    for low, high in pairwise(ends.tolist()):
        items = members[low:high]
        taken = np.zeros((len(items), *masks.shape[1:]), dtype=np.uint64)
        if low:  # the first layer has no predecessors
            _, entries = expand(start[items], start[items + 1])
            taken = np.bitwise_or.reduceat(
                masks[earlier[entries]], starts_of(start[items + 1] - start[items])[:-1], axis=0
            )
        if np.any(np.all(taken == ~np.uint64(0), axis=2)):
            masks, taken = (np.concatenate([m, np.zeros_like(m[..., :1])], axis=2) for m in (masks, taken))
        lowest = ~taken & (taken + np.uint64(1))
        lowest[..., 1:] &= -np.cumprod(taken == ~np.uint64(0), axis=2, dtype=np.uint64)[..., :-1]
        # the bit is in the first word that is not full
        masks[items] = np.where(present[items][..., None], lowest, np.uint64(0))
    return masks
