"""Blocks of basis elements that are translates of each other, as in a lattice: classified once for each shape."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.program.block_table import BlockTable, block_table, joined_tables
from coadjoint.program.generators import BasisMatrices
from coadjoint.program.numbers import roundoff
from coadjoint.program.sparse_rows import SparseRows

MIN_REPEATED = 1 << 12  # smallest number of forms that are compared
MAX_ENTRIES = 64  # largest sum of the different numbers of entries of a matrix
MIN_TRANSLATES = 8  # smallest mean number of forms of a shape
HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)


def repeated_block_table(matrices: BasisMatrices, forms: SparseRows) -> BlockTable | None:
    """Return the table of blocks of many forms that are basis elements; None for others, or if few are translates.

    It is bitwise equal to that of all their generators.
    """
    count = len(forms.start) - 1
    units = len(forms.value) == count and bool(np.all(np.diff(forms.start) == 1)) and bool(np.all(forms.value == 1.0))
    if count < MIN_REPEATED or not units:
        return None
    element = forms.coordinate.astype(np.int64)
    found = _shapes(matrices, element)
    if found is None or len(found[1]) * MIN_TRANSLATES > count:
        return None
    shape, leaders = found
    leading = matrices.combinations(SparseRows.units(element[leaders]), float)
    table = joined_tables([block_table(generators, roundoff(float)) for generators in leading])
    first = np.searchsorted(table.angle, np.arange(len(leaders) + 1))
    angle, chosen = expand(first[shape], first[shape + 1])
    blocks = table.take(chosen)
    index = expand(blocks.begin[:-1], blocks.begin[:-1] + blocks.width)[1]
    shift = np.repeat((element - element[leaders][shape])[angle], blocks.width)
    blocks.indices[index] = blocks.indices[index] + shift
    return blocks._replace(angle=angle)


def _shapes(matrices: BasisMatrices, element: Integers) -> tuple[Integers, Integers] | None:
    """Return the shape of each element's matrix, relative to the element, and the first element of each shape."""
    start = matrices.entries[0]
    lengths = np.diff(start)[element]
    shape, leaders = np.zeros(len(element), dtype=np.int64), [np.zeros(0, dtype=np.int64)]
    known = 0
    different = np.flatnonzero(np.bincount(lengths))
    if different.sum() > MAX_ENTRIES:
        return None
    for length in different.tolist():
        members = np.flatnonzero(lengths == length)
        hashed = np.zeros(len(members), dtype=np.uint64)
        for number in _numbers(matrices, element[members], length):
            hashed = (hashed ^ number.view(np.uint64)) * HASH_FACTOR
            hashed ^= hashed >> np.uint64(32)
        _, leader, inverse = np.unique(hashed, return_index=True, return_inverse=True)
        same = (np.array_equal(n, n[leader][inverse]) for n in _numbers(matrices, element[members], length))
        if not all(same):  # different shapes with one hash
            return None
        shape[members] = known + inverse
        leaders.append(members[leader])
        known += len(leader)
    return shape, np.concatenate(leaders)


def _numbers(matrices: BasisMatrices, element: Integers, length: int) -> Iterator[NDArray[Any]]:
    """Yield the rows and columns relative to the element, and the bits of the values, entry after entry."""
    start, rows, columns, values = matrices.entries
    for index in (start[element] + k for k in range(length)):
        yield rows[index] - element
        yield columns[index] - element
        yield values[index].view(np.int64)
