"""Assignment of rows, each belonging to a member, to slots of crews."""

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
    """The row in each slot, and the crews of all slots.

    A slot that is not `own` pads a lane, and holds a copy of another row.
    """

    rows: Integers
    own: NDArray[np.bool_]
    member_batches: list[MemberBatch]


class Tables(NamedTuple):
    """A loop and its tables; with a stride, each member has a column of constants."""

    loop: str
    tables: Any
    watch: Any
    stride: int = 0

    def rows(self, columns: Integers, workers: int, block: int, begin: int = 0) -> Rows:
        """Return rows (m,) with these columns of constants, or in the given order without a stride.

        Slots count from `begin`. Without a stride there is a crew for each worker, and `block` rows go side by side.
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
        # Crews begin at blocks of columns; a block holds one row of each column at a time.
        block = limit("LARGEST_CROWD")
        wide = self.stride // block
        order = np.argsort(columns, kind="stable")
        ascending = columns[order]
        turn = np.arange(len(order)) - np.searchsorted(ascending, ascending)
        keys, some, piece = np.unique(turn * wide + ascending // block, return_index=True, return_inverse=True)
        rows, own = np.repeat(order[some], block), np.zeros(len(keys) * block, dtype=bool)
        places = piece * block + ascending % block
        rows[places], own[places] = order, True
        member_batches, cuts = [], np.flatnonzero((np.diff(keys) != 1) | (keys[1:] % wide == 0)) + 1
        for one, other in pairwise([0, *cuts.tolist(), len(keys)]):
            first, column = begin + one * block, int(keys[one]) % wide * block
            last = begin + int(np.flatnonzero(own[: other * block])[-1]) + 1
            member_batches.append(MemberBatch(*self[:3], first, last, self.stride, first - column))
        return Rows(rows, own, member_batches)


MemberTables = Sequence[tuple[Tables, Integers | None]]
"""Tables, and the members that share them, ascending, one column each; None: all members, in the same columns."""


def rows_of_pieces(pieces: MemberTables, owners: Integers, workers: int, block: int) -> Rows:
    """Return rows of members with different tables, piece after piece; `owners` (m,) holds the member of each row."""
    found: list[Rows] = []
    begin = 0
    for tables, members in pieces:
        if members is None:
            return tables.rows(owners, workers, block)
        numbers = np.flatnonzero(np.isin(owners, members))
        if len(numbers):
            own = tables.rows(np.searchsorted(members, owners[numbers]), workers, block, begin)
            found.append(own._replace(rows=numbers[own.rows]))
            begin += len(own.rows)
    rows, filled = (np.concatenate([piece[k] for piece in found]) for k in range(2))
    return Rows(rows, filled, [member_batch for piece in found for member_batch in piece.member_batches])


def split_members(first: int, last: int, workers: int, block: int) -> list[tuple[int, int]]:
    """Split the members first to last - 1 into crews, one for each worker, that begin at multiples of `block`.

    Examples
    --------
    >>> split_members(0, 100, 2, 32)
    [(0, 64), (64, 100)]
    """
    blocks = -(-(last - first) // block)
    edges = pairwise(min(last, first + blocks * w // workers * block) for w in range(workers + 1))
    return [(one, other) for one, other in edges if one < other]
