"""First-fit grouping: each item joins the first group in which it has no conflict."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.program.graph_layers import layers
from coadjoint.program.sparse_rows import order_by, starts_of

BITS = 64
# Number of masks held in memory at once.
MAX_BATCH_ITEMS = 1 << 22

Masks = NDArray[np.uint64]


def first_fit(count: int, first: Integers, second: Integers) -> Integers:
    """Assign the items 0 ... count - 1 to groups by first fit; return the group of each, shape (count,).

    The pairs in conflict have first < second. Groups are numbered in the order in which they are opened.
    """
    masks = _masks(count, first, second, np.ones((count, 1), dtype=bool))[:, 0]
    word = np.argmax(masks != 0, axis=1)
    return BITS * word + np.bitwise_count(masks[np.arange(count), word] - np.uint64(1)).astype(np.int64)


def count_groups(count: int, first: Integers, second: Integers, present: NDArray[np.bool_]) -> Integers:
    """Count the groups of `first_fit` for subsets of the items, for many cases at once.

    `present` has shape (count, cases); the pairs in conflict have first < second.
    """
    at_once = max(1, MAX_BATCH_ITEMS // max(count, 1))
    found = [np.zeros(0, dtype=np.int64)]
    for begin in range(0, present.shape[1], at_once):
        masks = _masks(count, first, second, present[:, begin : begin + at_once])
        used = np.bitwise_or.reduce(masks, axis=0)
        found.append(np.bitwise_count(used).sum(axis=1).astype(np.int64))
    return np.concatenate(found)


def _masks(count: int, first: Integers, second: Integers, present: NDArray[np.bool_]) -> Masks:
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
        own = members[low:high]
        taken = np.zeros((len(own), *masks.shape[1:]), dtype=np.uint64)
        if low:  # the first layer has no predecessors
            _, places = expand(start[own], start[own + 1])
            taken = np.bitwise_or.reduceat(masks[earlier[places]], starts_of(start[own + 1] - start[own])[:-1], axis=0)
        if np.any(np.all(taken == ~np.uint64(0), axis=2)):
            masks, taken = (np.concatenate([m, np.zeros_like(m[..., :1])], axis=2) for m in (masks, taken))
        lowest = ~taken & (taken + np.uint64(1))
        lowest[..., 1:] &= -np.cumprod(taken == ~np.uint64(0), axis=2, dtype=np.uint64)[..., :-1]
        # the bit is in the first word that is not full
        masks[own] = np.where(present[own][..., None], lowest, np.uint64(0))
    return masks
