"""Sparse arrays by sorting: sums of products, checks of identities without n^3 arrays, connected components."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF

DEFECT_FACTOR = 64  # an identity holds when its defect is below 64 u times the sum of the absolute products in it
CHUNK = 1 << 21  # products held in memory at a time

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


def groups(*keys: Integers) -> tuple[Integers, Integers]:
    """Sort rows lexicographically by several keys; return the stable permutation and the starts of equal runs."""
    order = np.lexsort(keys[::-1]).astype(np.int64)
    fresh = np.zeros(order.size, dtype=bool)
    fresh[:1] = True
    for key in keys:
        fresh[1:] |= np.diff(key[order]) != 0
    return order, np.flatnonzero(fresh).astype(np.int64)


def distinct(values: NDArray[Any]) -> NDArray[Any]:
    """Return the sorted unique values by sorting, which is faster than hashing for millions of integers."""
    ordered = np.sort(values)
    new = np.ones(ordered.size, dtype=bool)
    np.not_equal(ordered[1:], ordered[:-1], out=new[1:])
    return ordered[new]


def expand(starts: Integers, stops: Integers) -> tuple[Integers, Integers]:
    """Enumerate all pairs (row, position) with starts[row] <= position < stops[row]."""
    counts = stops - starts
    rows = np.repeat(np.arange(counts.size, dtype=np.int64), counts)
    offsets = np.cumsum(counts) - counts
    return rows, np.arange(rows.size, dtype=np.int64) + np.repeat(starts - offsets, counts)


def chunks(labels: Integers, costs: Integers) -> Iterator[slice]:
    """Split rows sorted by label into runs of about `CHUNK` total cost, never within a label."""
    ends = np.append(np.flatnonzero(np.diff(labels)) + 1, labels.size)
    reached = np.cumsum(costs)
    begin, spent = 0, 0
    while begin < labels.size:
        candidates = ends[ends > begin]
        inside = int(np.searchsorted(reached[candidates - 1], spent + CHUNK, side="right"))
        end = int(candidates[max(inside - 1, 0)])
        yield slice(begin, end)
        begin, spent = end, int(reached[end - 1])


def group_max_abs(labels: Integers, values: Floats) -> Floats:
    """Return for each row the largest absolute value among the rows with the same label."""
    _, group = np.unique(labels, return_inverse=True)
    largest = np.zeros(group.max(initial=-1) + 1)
    np.maximum.at(largest, group, np.abs(values))
    return largest[group]


def largest_violation(
    keys: tuple[Integers, ...], factors: tuple[Floats, Floats], sizes: tuple[Floats, Floats]
) -> tuple[int, float] | None:
    """Return (row, defect) of the sum of products of equal keys farthest from zero relative to its sizes, or None."""
    # A sum is zero if below 64 u times the summed products of `sizes`, bounds of the factors with which they were
    # rounded. Mantissas and exponents are separate, so that no product over- or underflows.
    if factors[0].size == 0:
        return None
    order, starts = groups(*keys)
    counts = np.diff(np.append(starts, order.size))
    products, exponents = _product(factors, order)
    bounds, bound_exponents = _product(sizes, order)
    nonzero = np.where(bounds == 0.0, np.iinfo(exponents.dtype).min // 2, bound_exponents)
    largest = np.maximum(np.maximum.reduceat(nonzero, starts), -4096)
    base = np.repeat(largest, counts)
    sums = np.add.reduceat(np.ldexp(products, np.maximum(exponents - base, -4096)), starts)
    allowed = np.add.reduceat(np.ldexp(bounds, np.maximum(bound_exponents - base, -4096)), starts)
    excess = np.abs(sums) - DEFECT_FACTOR * UNIT_ROUNDOFF * allowed
    worst = int(np.argmax(excess))
    if excess[worst] <= 0.0:
        return None
    with np.errstate(over="ignore", under="ignore"):
        return int(order[starts[worst]]), float(np.ldexp(sums[worst], largest[worst]))


def _product(pair: tuple[Floats, Floats], order: Integers) -> tuple[Floats, Integers]:
    """Return mantissas and exponents of the products of two columns."""
    (head, head_exponent), (tail, tail_exponent) = (np.frexp(column[order]) for column in pair)
    return head * tail, head_exponent + tail_exponent


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
