"""Groups of products of coordinates of many small ideals, such as spins, with few groups: covering arrays."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, connected
from coadjoint.program.sparse_rows import starts_of

MAX_CHAIN = 10_000  # nodes, whose colours are exchanged to save one


def groups_of_products(i: Integers, j: Integers, ideal: Integers, axis: Integers) -> Integers:
    """Return a group of each product x_i x_j of two ideals; a group has one coordinate of each ideal at most.

    `ideal` and `axis` are the ideal of each coordinate and its number in it. Ideals have classes, different ones if a
    product of different axes couples them. In each group all ideals of a class have one axis, by the rows of an
    orthogonal array, in which any two classes have all pairs of axes: 9 groups for three axes and up to four classes.
    """
    a, b = axis[i], axis[j]
    mixed = a != b
    label = connected(int(axis.max(initial=0)) + 1, a[mixed], b[mixed])
    classes = vertex_colours(int(ideal.max(initial=0)) + 1, ideal[i[mixed]], ideal[j[mixed]])
    group, count = np.full(len(i), -1), 0
    for one in np.unique(label[a]).tolist():
        chosen, axes = np.flatnonzero(label[a] == one), np.flatnonzero(label == one)
        levels = np.searchsorted(axes, a[chosen]), np.searchsorted(axes, b[chosen])
        columns, shape = (classes[ideal[i[chosen]]], classes[ideal[j[chosen]]]), 2 * (int(classes.max()) + 1, len(axes))
        code = np.ravel_multi_index((columns[0], levels[0], columns[1], levels[1]), shape)
        codes, kind, number = np.unique(code, return_inverse=True, return_counts=True)
        first, at_first, second, at_second = np.unravel_index(codes, shape)
        array = orthogonal_array(*shape[:2])
        covered = (array[:, first] == at_first) & (array[:, second] == at_second)
        row_of_kind = np.full(len(number), -1)
        while np.any(row_of_kind < 0):
            row = int(np.argmax(covered @ np.where(row_of_kind < 0, number, 0)))
            row_of_kind[covered[row] & (row_of_kind < 0)] = count
            count += 1
        group[chosen] = row_of_kind[kind]
    return group


def vertex_colours(count: int, first: Integers, second: Integers) -> Integers:
    """Colour the nodes of a graph in their order, with a new colour if no exchange of two (Kempe 1879) frees one."""
    ends = np.unique(np.stack([np.r_[first, second], np.r_[second, first]]), axis=1)
    start = starts_of(np.bincount(ends[0], minlength=count)).tolist()
    others = [ends[1, a:b].tolist() for a, b in pairwise(start)]
    colour, used = [-1] * count, 0
    for node, near in enumerate(others):
        around = {colour[other] for other in near} - {-1}
        if len(around) == used and not any(
            _exchanged(pair, near, others, colour) for pair in combinations(range(used), 2)
        ):
            used += 1
        around = {colour[other] for other in near}
        colour[node] = next(c for c in range(used) if c not in around)
    return np.array(colour, dtype=np.int64)


def _exchanged(pair: tuple[int, int], near: list[int], others: list[list[int]], colour: list[int]) -> bool:
    """Exchange two colours on the chains from neighbours of the first one, unless they lead to those of the second."""
    chain = {other for other in near if colour[other] == pair[0]}
    ends = {other for other in near if colour[other] == pair[1]}
    stack = list(chain)
    while stack:
        if not chain.isdisjoint(ends) or len(chain) > MAX_CHAIN:
            return False
        fresh = {other for other in others[stack.pop()] if colour[other] in pair} - chain
        chain |= fresh
        stack += sorted(fresh)
    for other in chain:
        colour[other] = sum(pair) - colour[other]
    return True


def orthogonal_array(classes: int, levels: int) -> NDArray[np.int64]:
    """Return rows (k, classes) with all pairs of levels in any two columns, and all levels in each column."""
    if levels == 1:
        return np.zeros((1, classes), dtype=np.int64)
    p = next(n for n in range(levels, 2 * levels) if all(n % d for d in range(2, n)))
    u, v = np.divmod(np.arange(p * p), p)
    lines = np.stack([*((slope * u + v) % p for slope in range(p)), u], axis=1) % levels  # Bose 1938: p + 1 columns
    # Classes beyond p + 1 differ in a digit to this base, each of which has rows of its own.
    digits, rest = [np.arange(classes) % (p + 1)], np.arange(classes) // (p + 1)
    while np.any(rest):
        digits.append(rest % (p + 1))
        rest //= p + 1
    return np.concatenate([lines[:, digit] for digit in digits])
