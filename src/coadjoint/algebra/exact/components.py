"""Connected components of sparse relations: blocks of a matrix, direct summands of an algebra."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact.sparse_sums import CHUNK, Integers, groups


def connected(size: int, first: NDArray[Any], second: NDArray[Any]) -> Integers:
    """Label each of `size` nodes with the smallest node connected to it by the edges (first[m], second[m])."""
    label = np.arange(size, dtype=np.int64)
    while True:
        joined = label.copy()
        apart = np.zeros(len(first), dtype=bool)
        for begin in range(0, len(first), CHUNK):
            chunk = slice(begin, begin + CHUNK)
            low, high = label[first[chunk]], label[second[chunk]]
            apart[chunk] = low != high
            if not apart[chunk].all():
                low, high = low[apart[chunk]], high[apart[chunk]]
            np.minimum.at(joined, np.maximum(low, high), np.minimum(low, high))
        if not apart.all():
            first, second = first[apart], second[apart]
        while not np.array_equal(joined, joined[joined]):
            joined = joined[joined]
        if np.array_equal(joined, label):
            return label
        label = joined


def strongly_connected(size: int, first: NDArray[Any], second: NDArray[Any]) -> Integers:
    """Label each of `size` nodes with the smallest node of its strongly connected component (edges first -> second)."""
    # Pairs connected both ways are joined first, which leaves little of most algebras to the search.
    both = np.isin(first * size + second, second * size + first)
    label = connected(size, first[both], second[both])
    first, second = label[first], label[second]
    left = first != second
    edges = np.unique(first[left] * size + second[left])
    pairs = [(node, root) for node, root in _roots(edges // size, edges % size) if node != root]
    if not pairs:
        return label
    nodes, roots = np.array(pairs).T
    return connected(size, np.concatenate([np.arange(size), nodes]), np.concatenate([label, roots]))


def _roots(first: Integers, second: Integers) -> Iterator[tuple[int, int]]:
    """Yield each node of the edges with one node of its strong component, the same for all of it (Tarjan 1972)."""
    after: dict[int, list[int]] = {}
    for start, end in zip(first.tolist(), second.tolist(), strict=True):
        after.setdefault(start, []).append(end)
        after.setdefault(end, [])
    number: dict[int, int] = {}
    lowest: dict[int, int] = {}
    waiting: list[int] = []
    done: set[int] = set()
    for start in after:
        path = [] if start in number else [(start, iter(after[start]))]
        while path:
            node, following = path[-1]
            if node not in number:
                number[node] = lowest[node] = len(number)
                waiting.append(node)
            for end in following:
                if end not in number:
                    path.append((end, iter(after[end])))
                    break
                if end not in done:
                    lowest[node] = min(lowest[node], lowest[end])
            else:
                path.pop()
                if path:
                    lowest[path[-1][0]] = min(lowest[path[-1][0]], lowest[node])
                if lowest[node] == number[node]:
                    while node not in done:
                        done.add(waiting[-1])
                        yield waiting.pop(), node


def parts(label: Integers) -> Iterator[Integers]:
    """Yield the sorted members of each component, in the order of their smallest member."""
    order, starts = groups(label)
    stops = np.append(starts[1:], order.size)
    yield from (order[start:stop] for start, stop in zip(starts, stops, strict=True))


def positions(label: Integers) -> Integers:
    """Return the position of each node among the sorted members of its component."""
    order, starts = groups(label)
    result = np.empty_like(order)
    result[order] = np.arange(order.size) - np.repeat(starts, np.diff(np.append(starts, order.size)))
    return result


def parts_and_rows(label: Integers, nodes: Integers) -> Iterator[tuple[Integers, Integers]]:
    """Yield the sorted members of each component, and the rows whose nodes are among them, in order."""
    order, _ = groups(label[nodes])
    owner, smallest = label[nodes][order], np.flatnonzero(label == np.arange(label.size))
    begins, ends = np.searchsorted(owner, smallest), np.searchsorted(owner, smallest, side="right")
    for members, begin, end in zip(parts(label), begins, ends, strict=True):
        yield members, order[begin:end]


def summands(triples: Triples, dim: int) -> Iterator[tuple[Integers, Triples]]:
    """Yield the direct summands visible in the basis: sorted coordinates, and their constants renumbered from 0.

    Coordinates are connected if one nonzero constant involves both. Casimirs of a direct sum are generated by those of
    its summands, and its rank is the sum of theirs.

    Examples
    --------
    >>> two = Triples(*np.array([[0, 1], [2, 3], [2, 3]]), np.ones(2))
    >>> [(where.tolist(), constants.k.tolist()) for where, constants in summands(two, 4)]
    [([0, 2], [1]), ([1, 3], [1])]
    """
    i, j, k, _ = triples
    label = connected(dim, np.concatenate([i, i]), np.concatenate([j, k]))
    position = positions(label)
    for members, rows in parts_and_rows(label, i):
        yield members, Triples(position[i[rows]], position[j[rows]], position[k[rows]], triples.c[rows])
