"""Tables of what loops record: saved steps, watched invariants and events, common to all families of schemes."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.library import kernels
from coadjoint.kernels.tables.compiled import address, as_structure, filled, packer
from coadjoint.program.term_table import Terms
from coadjoint.rounding import in_standard_mode

ROWS_PER_STEP, SPARE_ROWS = 4, 2**14
"""Rows that can be recorded: `ROWS_PER_STEP` per step and member, plus `SPARE_ROWS`."""
STEPS_BACK = 3
"""Number of past values of each event that a loop keeps."""
_packed_schedule = packer(
    "Schedule",
    (
        *("t0", "h", "steps", "save_every", "passed", "watching", "marked", "marks"),
        *("starts", "lengths", "numbers", "events", "threads"),
    ),
)
"""Pack a schedule (steps, saved steps, steps with invariants, addresses of own steps and events or 0)."""


class Watch(NamedTuple):
    """The I watched invariants, each a constant plus terms first[i] to first[i + 1].

    A positive period[i] marks a multivalued one (a logarithm with an angle), unwrapped along the run. `longest`: most
    arguments of a function.
    """

    size: int
    terms: Terms
    addresses: NDArray[np.int64]
    first: NDArray[np.uint32]
    constant: NDArray[np.float64]
    period: NDArray[np.float64]
    longest: int


def schedule_of(
    t0: float,
    h: float,
    steps: int,
    save_every: int,
    watching: bool,
    passed: int = 0,
    marks: NDArray[np.int64] | None = None,
    events: int = 0,
    threads: int = 1,
) -> bytes:
    """Return a schedule as bytes for the loops; the arrays of marks and events must live as long."""
    marked, address_of_marks = (0, 0) if marks is None else (len(marks), marks.ctypes.data)
    run = t0, h, steps, save_every, passed, watching
    return _packed_schedule(*run, marked, address_of_marks, 0, 0, 0, events, threads)


SCHEDULE_BYTES = len(schedule_of(0.0, 0.0, 0, 1, False))
SINGLE_STEP_MARK = np.array([1], dtype=np.int64)


def partial_step_schedule(
    starts: NDArray[np.float64], lengths: NDArray[np.float64], numbers: NDArray[np.int64], threads: int
) -> bytes:
    """Return a schedule of one step of its own for each row, without energy; the arrays must live as long."""
    addresses = (SINGLE_STEP_MARK.ctypes.data, *(one.ctypes.data for one in (starts, lengths, numbers)))
    return _packed_schedule(0.0, 0.0, 2, 1, 0, False, 1, *addresses, 0, threads)


@in_standard_mode
def values_along(watch: Any, points: NDArray[np.float64], times: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Fill out (K, members, I) with invariants at the saved points (K, members, n) and K times."""
    x, t = np.ascontiguousarray(points, dtype=np.float64), np.ascontiguousarray(times, dtype=np.float64)
    table = as_structure(watch)
    kernels().watch_values(
        ctypes.byref(table), address(x), address(t), *(ctypes.c_int64(size) for size in x.shape), address(out)
    )


class FlaggedSteps(NamedTuple):
    """Steps of a member with a possible crossing, by row: `Crossing` `codes` (r, E), states and groups before it.

    `before` and `after` (r, E) are the values of the events.
    """

    members: NDArray[np.int64]
    steps: NDArray[np.int64]
    codes: NDArray[np.int64]
    states: NDArray[np.float64]
    groups: NDArray[np.float64]
    before: NDArray[np.float64]
    after: NDArray[np.float64]

    def sorted(self) -> FlaggedSteps:
        return self.select(np.lexsort((self.steps, self.members)))

    def select(self, rows: NDArray[Any]) -> FlaggedSteps:
        return FlaggedSteps(*(array[rows] for array in self))


class EventArrays:
    """Arrays for events: `direction` (E,) 1 rising, -1 falling, 0 both; at most `chunk` steps between `take`s.

    `left` (members, E): crossings until a run ends, 0 for no end.
    """

    def __init__(
        self, watch: Watch, direction: NDArray[np.int64], left: NDArray[np.int64], size: int, square: int, chunk: int
    ) -> None:
        members, count = left.shape
        # A step is recorded at its end or after the next one, by a series once per crossing. Untouched pages of the
        # allocation take no memory.
        capacity = ROWS_PER_STEP * members * chunk + SPARE_ROWS
        self.limit = np.full(members, np.iinfo(np.int64).max)
        before, values = np.zeros((members, 2, size + square)), np.zeros((members, STEPS_BACK, count))
        self._changing = left, self.limit, before, values
        self._capacity, self._recorded = capacity, np.zeros(1, dtype=np.int64)
        self._found = np.empty((capacity, 2 + count), dtype=np.int64)
        self._records = np.empty((capacity, size + square + 2 * count))
        self._size, self._square, self._count = size, square, count
        self._structure: Any = filled(
            "EventTables",
            watch=watch,
            direction=direction,
            left=left,
            limit=self.limit,
            before=before,
            values=values,
            capacity=capacity,
            recorded=self._recorded,
            found=self._found,
            records=self._records,
        )
        self.address = ctypes.addressof(self._structure)

    @staticmethod
    def bytes_per_step(members: int, count: int, size: int, square: int) -> int:
        return 8 * ROWS_PER_STEP * members * (size + square + 3 * count + 2)

    def take(self) -> FlaggedSteps:
        """Return and clear the rows recorded since the last call, in any order."""
        count, size, width = self._count, self._size, self._size + self._square
        rows = int(self._recorded[0])
        if rows > self._capacity:
            raise ValueError(
                f"{rows} crossings were found in the steps of one call; use a smaller step, or fewer events"
            )
        self._recorded[0] = 0
        integers, numbers = self._found[:rows].copy(), self._records[:rows].copy()
        return FlaggedSteps(
            integers[:, 0],
            integers[:, 1],
            integers[:, 2:],
            numbers[:, :size],
            numbers[:, size:width],
            numbers[:, width : width + count],
            numbers[:, width + count :],
        )

    def copy(self) -> list[NDArray[Any]]:
        """Return copies of the arrays that `restore_arrays` restores to repeat the steps from here."""
        return [array.copy() for array in self._changing]

    def restore_arrays(self, copies: list[NDArray[Any]]) -> None:
        for array, copied in zip(self._changing, copies, strict=True):
            array[...] = copied
        self._recorded[0] = 0
