"""The compiled loops over steps: one way of calling them for all families of schemes."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.library import address, kernels, pointed


class State(NamedTuple):
    """Where all members are: momenta (members, size) and transposed group elements (members, square), each followed by
    what compensated sums owe, and what a scheme remembers from step to step, `memory` (members, remembered).
    """

    size: int
    square: int
    remembered: int
    momenta: NDArray[np.float64]
    errors: NDArray[np.float64]
    groups: NDArray[np.float64]
    group_errors: NDArray[np.float64]
    memory: NDArray[np.float64]


def state_of(state: tuple[NDArray[np.float64], ...]) -> State:
    """Return the arrays of a run, (momentum, its compensation, group, its compensation, memory), as a table."""
    momenta, _, groups, _, memory = state
    return State(momenta.shape[1], groups.shape[1], memory.shape[1], *state)


def take_steps(
    loop: str,
    tables: Any,
    watch: Any,
    saves: Any,
    schedule: Any,
    state: tuple[NDArray[np.float64], ...],
    crew: NDArray[np.int64],
    k0: int,
    k1: int,
    report: Any,
    stride: int = 0,
    base: int = 0,
) -> None:
    """Take the steps k0 + 1 to k1 for the members crew[0] to crew[1] - 1, by a loop of the library.

    Parameters
    ----------
    loop : str
        Its name in the library.
    tables, watch, saves, schedule, report : NamedTuple
        Tables, as they are or `pointed`.
    state : tuple of five arrays
        See `state_of`; all are changed in place.
    crew : (2,) array
        The members.
    k0, k1 : int
        The steps.
    stride : int
        With it the constants of the tables differ by member: `stride` of them side by side, where there was one. They
        are read in whole lanes, 32 at most: the last must be followed by as many.
    base : int
        The member that the first of them belong to.
    """
    members = np.arange(base, int(crew[1]))
    given = [pointed(table) for table in (tables, watch, saves, schedule, state_of(state))]
    reported = pointed(report)
    getattr(kernels(), loop)(
        *(ctypes.byref(table) for table in given),
        address(members),
        *(ctypes.c_int64(number) for number in (int(crew[0]) - base, int(crew[1]) - base, k0, k1)),
        ctypes.byref(reported),
        ctypes.c_int64(stride),
    )


def widest_crowd() -> int:
    """Return the dimension up to which the loops advance members side by side."""
    return int(kernels().widest_crowd())
