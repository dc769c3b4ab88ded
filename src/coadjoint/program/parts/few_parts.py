"""Joining of commuting parts into few parts, by first fit."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.program.commutation import Commutation, Pairs
from coadjoint.program.parts.part import Parts
from coadjoint.program.pattern_cache import MAX_PATTERN_SIZE, Pattern
from coadjoint.program.sparse_rows import layers, order_by, starts_of

# Above this number parts are joined in the given order only; lattices have thousands, in a good order.
MAX_REORDERED = 64
WORD_BITS = 64  # of a mask, one for each group
# Number of masks held in memory at once.
MAX_BATCH_ITEMS = 1 << 22

Masks = NDArray[np.uint64]


def few_parts(parts: Parts, commutation: Commutation) -> Parts:
    """Join commuting parts, both input and result sorted by first coordinate, deterministically.

    First fit in the given order; if more than two groups remain, also in the orders of most and of fewest clashes. Not
    always the minimum, since a minimal clique cover is NP-hard.
    """
    if not len(parts):
        return parts
    coupled_pairs = commutation.coupled_pairs(parts)
    noncommuting_pairs = commutation.noncommuting_pairs(parts, coupled_pairs)
    if len(parts) > MAX_PATTERN_SIZE:
        return parts.joined(_few_groups(len(parts), noncommuting_pairs, coupled_pairs))
    return parts.joined(
        _cached_groups(len(parts), Pattern((noncommuting_pairs, coupled_pairs), *noncommuting_pairs, *coupled_pairs))
    )


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
    """Return the groups of first fit in the given order."""
    rank = np.argsort(order)
    low, high = np.minimum(rank[first], rank[second]), np.maximum(rank[first], rank[second])
    groups = first_fit(len(order), low, high)
    return np.asarray(groups[rank])


def first_fit(count: int, first: Integers, second: Integers) -> Integers:
    """Assign the items 0 ... count - 1 to groups by first fit; return the group of each, shape (count,).

    The pairs in conflict have first < second. Groups are numbered in the order in which they are opened.
    """
    masks = _group_masks(count, first, second, np.ones((count, 1), dtype=bool))[:, 0]
    word = np.argmax(masks != 0, axis=1)
    return WORD_BITS * word + np.bitwise_count(masks[np.arange(count), word] - np.uint64(1)).astype(np.int64)


def count_groups(count: int, first: Integers, second: Integers, present: NDArray[np.bool_]) -> Integers:
    """Count the groups of `first_fit` for subsets of the items, for many cases at once.

    `present` has shape (count, cases); the pairs in conflict have first < second.
    """
    batch_size = max(1, MAX_BATCH_ITEMS // max(count, 1))
    counts = [np.zeros(0, dtype=np.int64)]
    for begin in range(0, present.shape[1], batch_size):
        masks = _group_masks(count, first, second, present[:, begin : begin + batch_size])
        used = np.bitwise_or.reduce(masks, axis=0)
        counts.append(np.bitwise_count(used).sum(axis=1).astype(np.int64))
    return np.concatenate(counts)


def _group_masks(count: int, first: Integers, second: Integers, present: NDArray[np.bool_]) -> Masks:
    """Return the group of each item in each case as one bit in words, (count, cases, words); no bit if absent.

    Computed layer by layer: items without conflict with an earlier item, then those in conflict with the first layer
    only, ...
    """
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
