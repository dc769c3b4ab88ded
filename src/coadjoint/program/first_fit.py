"""Which things may share a group? First fit: each goes into the first group where it clashes with nothing."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.joins import Integers, expand
from coadjoint.program.layers import layers
from coadjoint.program.sparse_rows import order_by, starts_of

BITS = 64
# Masks held in memory for cases that are tried at once.
ROOM = 1 << 22

Masks = NDArray[np.uint64]


def first_fit(count: int, first: Integers, second: Integers) -> Integers:
    """Put 0, 1, 2, ... into groups, each into the first one without anything that it clashes with.

    Parameters
    ----------
    count : int
        Number of things.
    first, second : integer arrays of equal length
        The pairs that clash, first < second.

    Returns
    -------
    integer array, shape (count,)
        The group of each, from 0, groups in the order in which they were opened.

    Examples
    --------
    >>> first_fit(4, np.array([0, 1, 0]), np.array([1, 2, 2])).tolist()
    [0, 1, 2, 0]
    """
    masks = _masks(count, first, second, np.ones((count, 1), dtype=bool))[:, 0]
    word = np.argmax(masks != 0, axis=1)
    return BITS * word + np.bitwise_count(masks[np.arange(count), word] - np.uint64(1)).astype(np.int64)


def numbers_of_groups(count: int, first: Integers, second: Integers, present: NDArray[np.bool_]) -> Integers:
    """Return how many groups first fit opens where only some of the things are there, for many cases at once.

    Parameters
    ----------
    count : int
        Number of things.
    first, second : integer arrays of equal length
        The pairs that clash, first < second.
    present : ndarray of bool, shape (count, cases)
        What is there.

    Returns
    -------
    integer array, shape (cases,)

    Examples
    --------
    >>> present = np.array([[True, True], [True, False], [True, True]])
    >>> numbers_of_groups(3, np.array([0, 1]), np.array([1, 2]), present).tolist()
    [2, 1]
    """
    at_once = max(1, ROOM // max(count, 1))
    found = [np.zeros(0, dtype=np.int64)]
    for begin in range(0, present.shape[1], at_once):
        masks = _masks(count, first, second, present[:, begin : begin + at_once])
        used = np.bitwise_or.reduce(masks, axis=0)
        found.append(np.bitwise_count(used).sum(axis=1).astype(np.int64))
    return np.concatenate(found)


def _masks(count: int, first: Integers, second: Integers, present: NDArray[np.bool_]) -> Masks:
    """Return the group of each thing in each case as one bit among words, (count, cases, words); no bit if absent.

    Layer after layer: what clashes with nothing that comes before it, then what clashes with those alone, ...
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
        if low:  # in the first layer nothing comes before
            _, places = expand(start[own], start[own + 1])
            taken = np.bitwise_or.reduceat(masks[earlier[places]], starts_of(start[own + 1] - start[own])[:-1], axis=0)
        if np.any(np.all(taken == ~np.uint64(0), axis=2)):
            masks, taken = (np.concatenate([m, np.zeros_like(m[..., :1])], axis=2) for m in (masks, taken))
        lowest = ~taken & (taken + np.uint64(1))
        lowest[..., 1:] &= -np.cumprod(taken == ~np.uint64(0), axis=2, dtype=np.uint64)[..., :-1]
        # the bit is in the first word that is not full
        masks[own] = np.where(present[own][..., None], lowest, np.uint64(0))
    return masks
