"""Tables of saved steps and watched invariants, common to all families of schemes."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.library import kernels
from coadjoint.kernels.tables.structures import address, as_structure, packer
from coadjoint.program.term_table import Terms


class Watch(NamedTuple):
    """The watched invariants: I of them, each a constant plus a sum of terms.

    Invariant i has the terms first[i] to first[i + 1]. A positive period[i] marks a multivalued one (a logarithm with
    an angle), which is unwrapped by whole periods along the run. `longest` is the largest number of arguments of a
    function.
    """

    size: int
    terms: Terms
    addresses: NDArray[np.int64]
    first: NDArray[np.uint32]
    constant: NDArray[np.float64]
    period: NDArray[np.float64]
    longest: int


class Schedule(NamedTuple):
    """The steps of a run, and those after which states are saved or invariants computed; `passed` points were saved
    before.

    Saved are the `marked` steps at the address `marks`, ascending; if it is 0, every `save_every`-th step and the last.
    `starts` and `lengths`, if not 0, are addresses of the start and length of the one step of each member.
    `events` is the address of `EventTables`, or 0. `threads` may share the work of one member.
    """

    t0: float
    h: float
    steps: int
    save_every: int
    passed: int
    watching: bool
    marked: int
    marks: int
    starts: int = 0
    lengths: int = 0
    events: int = 0
    threads: int = 1


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
    """Return a `Schedule` as bytes for the loops; the arrays of marks and events must live as long."""
    marked, address_of_marks = (0, 0) if marks is None else (len(marks), marks.ctypes.data)
    return packer(Schedule)(t0, h, steps, save_every, passed, watching, marked, address_of_marks, 0, 0, events, threads)


SCHEDULE_BYTES = len(schedule_of(0.0, 0.0, 0, 1, False))
SINGLE_STEP_MARK = np.array([1], dtype=np.int64)


def partial_step_schedule(starts: NDArray[np.float64], lengths: NDArray[np.float64]) -> bytes:
    """Return a `Schedule` as bytes in which each member takes one step of its own and saves the result.

    The run does not end with this step, so that no energy is computed. The arrays must live as long.
    """
    addresses = (SINGLE_STEP_MARK.ctypes.data, starts.ctypes.data, lengths.ctypes.data)
    return packer(Schedule)(0.0, 0.0, 2, 1, 0, False, 1, *addresses, 0, 1)


def values_along(watch: Any, points: NDArray[np.float64], times: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Fill out (K, members, I) with invariants at the saved points (K, members, n) and K times."""
    x, t = np.ascontiguousarray(points, dtype=np.float64), np.ascontiguousarray(times, dtype=np.float64)
    table = as_structure(watch)
    kernels().watch_values(
        ctypes.byref(table), address(x), address(t), *(ctypes.c_int64(size) for size in x.shape), address(out)
    )
