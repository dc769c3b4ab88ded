"""Saving every k-th step and watching every one: the same for all families of schemes."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.library import address, kernels, pointed
from coadjoint.kernels.loop import state_of
from coadjoint.program.terms import Terms

TENTHS = 10
DONE, NOT_CONVERGED, OVERFLOW = 0, 1, 2


class Watch(NamedTuple):
    """The invariants that are followed: I of them, each a constant plus a sum of terms.

    Invariant i has the terms first[i] to first[i + 1]. A positive period[i] marks a multivalued one (a logarithm with
    an angle), which is unwrapped by whole periods along the run. `longest` is the most arguments that a function takes.
    """

    size: int
    terms: Terms
    addresses: NDArray[np.int64]
    first: NDArray[np.uint32]
    constant: NDArray[np.float64]
    period: NDArray[np.float64]
    longest: int


class Saves(NamedTuple):
    """What a run leaves behind, for all `members`: K saved points, I invariants.

    `x` (K, members, n); `group` (K, members, d*d), transposed matrices; `values` (K, members, I); `worst` (members, 10,
    I), the largest deviation in each tenth of the run; `first` and `last` (members, I), the values at the start and at
    the step before.
    """

    members: int
    x: NDArray[np.float64]
    group: NDArray[np.float64]
    values: NDArray[np.float64]
    worst: NDArray[np.float64]
    first: NDArray[np.float64]
    last: NDArray[np.float64]


class Schedule(NamedTuple):
    """Which steps there are, and after which of them something is looked at."""

    t0: float
    h: float
    steps: int
    save_every: int
    watching: bool


class Report(NamedTuple):
    """How each member fares: a status, the step that failed, the last correction of its iteration, and the work done.

    All of shape (members,). `evaluations` counts elementary flows of a program, or evaluations of the vector field.
    """

    status: NDArray[np.int64]
    step: NDArray[np.int64]
    residual: NDArray[np.float64]
    evaluations: NDArray[np.int64]
    iterations: NDArray[np.int64]


def record_start(
    watch: Any,
    saves: Any,
    schedule: Any,
    state: tuple[NDArray[np.float64], ...],
    crew: tuple[int, int] | None = None,
    stride: int = 0,
) -> None:
    """Save the initial state of the members crew[0] to crew[1] - 1 (of all), and what deviations are measured from.

    `state` is that of `coadjoint.kernels.loop.state_of`. With a stride the constants differ by member, from crew[0] on.
    """
    given = [pointed(table) for table in (watch, saves, schedule, state_of(state))]
    first, last = crew or (0, len(state[0]))
    kernels().watch_start(
        *(ctypes.byref(table) for table in given), *(ctypes.c_int64(number) for number in (first, last, stride))
    )


def values_along(watch: Any, points: NDArray[np.float64], times: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Fill out (K, members, I) with functions at the saved points (K, members, n), at K times."""
    x, t = np.ascontiguousarray(points, dtype=np.float64), np.ascontiguousarray(times, dtype=np.float64)
    table = pointed(watch)
    kernels().watch_values(
        ctypes.byref(table), address(x), address(t), *(ctypes.c_int64(size) for size in x.shape), address(out)
    )
