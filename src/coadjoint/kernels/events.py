"""Events as the loops look for them, and what they note of them."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.structures import pointed
from coadjoint.kernels.watching import Watch

ROWS, SPARE = 4, 2**14
"""So many rows may be noted of each step, and beside these."""
STEPS_BACK = 3
"""So many values of each event a loop keeps."""


class EventTables(NamedTuple):
    """What a loop reads and writes for E events; see `source/boundary/tables.hpp`."""

    watch: Watch
    direction: NDArray[np.int64]
    left: NDArray[np.int64]
    limit: NDArray[np.int64]
    before: NDArray[np.float64]
    values: NDArray[np.float64]
    capacity: int
    noted: NDArray[np.int64]
    found: NDArray[np.int64]
    places: NDArray[np.float64]


class Noted(NamedTuple):
    """What the loops have noted, r rows: for each a step of a member in which something may have happened.

    `codes` (r, E) says what, as `Crossing` of the kernels; `states` (r, n) and `groups` (r, d*d) are those before the
    step, and `before` and `after` (r, E) the values of the events.
    """

    members: NDArray[np.int64]
    steps: NDArray[np.int64]
    codes: NDArray[np.int64]
    states: NDArray[np.float64]
    groups: NDArray[np.float64]
    before: NDArray[np.float64]
    after: NDArray[np.float64]

    def in_order_of(self, members: NDArray[np.int64]) -> Noted:
        """Return the rows in the order of other numbers of their members, and of steps."""
        return self._replace(members=members).chosen(np.lexsort((self.steps, members)))

    def chosen(self, places: NDArray[Any]) -> Noted:
        """Return some of the rows, by a mask or by their places."""
        members, steps, codes = self.members[places], self.steps[places], self.codes[places]
        states, groups = self.states[places], self.groups[places]
        return Noted(members, steps, codes, states, groups, self.before[places], self.after[places])


class EventArrays:
    """The arrays that loops look for events with, of all members in the order of the loops.

    Parameters
    ----------
    watch : Watch
        The functions whose zeros are looked for.
    direction : ndarray of int, shape (E,)
        1 where only rising zeros are wanted, -1 for falling ones, 0 for both.
    left : ndarray of int, shape (members, E)
        After so many crossings an event ends the run of a member; 0 where it does not.
    size, square : int
        How many numbers a state and a group element have.
    chunk : int
        A loop takes at most so many steps before `take` is called.

    Attributes
    ----------
    limit : ndarray of int, shape (members,)
        The last step of the run of each member; it may be set.
    """

    def __init__(
        self, watch: Watch, direction: NDArray[np.int64], left: NDArray[np.int64], size: int, square: int, chunk: int
    ) -> None:
        members, count = left.shape
        # A step is noted when it ends, or after the next one, and by a series as often as there are crossings. Memory
        # that is not touched is not taken from the machine.
        capacity = ROWS * members * chunk + SPARE
        self.limit = np.full(members, np.iinfo(np.int64).max)
        self.tables = EventTables(
            watch,
            direction,
            left,
            self.limit,
            np.zeros((members, 2, size + square)),
            np.zeros((members, STEPS_BACK, count)),
            capacity,
            np.zeros(1, dtype=np.int64),
            np.empty((capacity, 2 + count), dtype=np.int64),
            np.empty((capacity, size + square + 2 * count)),
        )
        self._size, self._square, self._count = size, square, count
        self._structure: Any = pointed(self.tables)
        self.address = ctypes.addressof(self._structure)

    @staticmethod
    def bytes_of(members: int, count: int, size: int, square: int) -> tuple[int, int]:
        """Return how many bytes are needed for the members, and for each step of a chunk."""
        width = size + square
        return 8 * members * (2 * width + 4 * count + 1), 8 * ROWS * members * (width + 3 * count + 2)

    def take(self) -> Noted:
        """Return what was noted since the last time, in any order."""
        count, size, width = self._count, self._size, self._size + self._square
        rows = int(self.tables.noted[0])
        if rows > self.tables.capacity:
            raise ValueError(
                f"{rows} crossings were found in the steps of one call; take a smaller step, or fewer events"
            )
        self.tables.noted[0] = 0
        found, places = self.tables.found[:rows].copy(), self.tables.places[:rows].copy()
        return Noted(
            found[:, 0],
            found[:, 1],
            found[:, 2:],
            places[:, :size],
            places[:, size:width],
            places[:, width : width + count],
            places[:, width + count :],
        )

    def copy(self) -> list[NDArray[Any]]:
        """Return what must be put back for the loops to go on from here once more."""
        tables = self.tables
        return [array.copy() for array in (tables.left, tables.limit, tables.before, tables.values)]

    def put_back(self, copies: list[NDArray[Any]]) -> None:
        """Go back to where a copy was made."""
        tables = self.tables
        for array, copied in zip((tables.left, tables.limit, tables.before, tables.values), copies, strict=True):
            array[...] = copied
        tables.noted[0] = 0
