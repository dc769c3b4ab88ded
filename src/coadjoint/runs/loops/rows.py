"""Assignment of rows, each of one member, to the slots of member batches."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import MemberBatch

Integers = NDArray[np.int64]


class Rows(NamedTuple):
    """The row in each slot, and the member batches of all slots.

    Slots that are not `filled` pad lanes with copies of other rows.
    """

    rows: Integers
    filled: NDArray[np.bool_]
    member_batches: list[MemberBatch]


class Tables(NamedTuple):
    """A loop and its tables; with a stride, each member has a column of constants."""

    loop: str
    tables: Any
    watch: Any
    stride: int = 0

    def rows(self, columns: Integers, workers: int, block: int, begin: int = 0) -> Rows:
        """Return rows (m,) for these columns of constants, in the given order without a stride.

        Slots count from `begin`. Without a stride, each worker has a batch, in which `block` rows go side by side.
        """
        if self.stride:
            return self._in_columns(columns, begin)
        count = len(columns)
        member_batches = [
            MemberBatch(*self[:3], first, last, base=first)
            for first, last in split_members(begin, begin + count, workers, block)
        ]
        return Rows(np.arange(count), np.ones(count, dtype=bool), member_batches)

    def _in_columns(self, columns: Integers, begin: int) -> Rows:
        # Batches begin at blocks of columns; a block holds one row of each column at a time.
        block = limit("MOST_LANES")
        column_blocks = self.stride // block
        order = np.argsort(columns, kind="stable")
        ascending = columns[order]
        occurrence = np.arange(len(order)) - np.searchsorted(ascending, ascending)
        keys, first_rows, positions = np.unique(
            occurrence * column_blocks + ascending // block, return_index=True, return_inverse=True
        )
        rows, filled = np.repeat(order[first_rows], block), np.zeros(len(keys) * block, dtype=bool)
        slots = positions * block + ascending % block
        rows[slots], filled[slots] = order, True
        member_batches, cuts = [], np.flatnonzero((np.diff(keys) != 1) | (keys[1:] % column_blocks == 0)) + 1
        for low, high in pairwise([0, *cuts.tolist(), len(keys)]):
            first, column = begin + low * block, int(keys[low]) % column_blocks * block
            last = begin + int(np.flatnonzero(filled[: high * block])[-1]) + 1
            member_batches.append(MemberBatch(*self[:3], first, last, self.stride, first - column))
        return Rows(rows, filled, member_batches)


MemberTables = Sequence[tuple[Tables, Integers | None]]
"""Tables, and the members that share them, ascending, one column each; None: all members share the same columns."""


def rows_of_member_tables(member_tables: MemberTables, owners: Integers, workers: int, block: int) -> Rows:
    """Return rows of members with different tables, one after the other; `owners` (m,) holds the member of each row."""
    parts: list[Rows] = []
    begin = 0
    for tables, members in member_tables:
        if members is None:
            return tables.rows(owners, workers, block)
        selected = np.flatnonzero(np.isin(owners, members))
        if len(selected):
            part = tables.rows(np.searchsorted(members, owners[selected]), workers, block, begin)
            parts.append(part._replace(rows=selected[part.rows]))
            begin += len(part.rows)
    rows, filled = (np.concatenate([part[k] for part in parts]) for k in range(2))
    return Rows(rows, filled, [member_batch for part in parts for member_batch in part.member_batches])


def split_members(first: int, last: int, workers: int, block: int) -> list[tuple[int, int]]:
    """Split the members first to last - 1 into ranges, one for each worker, that begin at multiples of `block`.

    Examples
    --------
    >>> split_members(0, 100, 2, 32)
    [(0, 64), (64, 100)]
    """
    blocks = -(-(last - first) // block)
    edges = pairwise(min(last, first + blocks * w // workers * block) for w in range(workers + 1))
    return [(low, high) for low, high in edges if low < high]
