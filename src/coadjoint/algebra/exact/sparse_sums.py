"""Sparse sums of products by sorting: checks of identities without n^3 arrays."""

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
