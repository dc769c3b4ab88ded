"""Saving every k-th step and watching every one: the same for all families of schemes."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.compiling import compiled, inlined
from coadjoint.kernels.pointers import pointed, shifted
from coadjoint.kernels.terms import value
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


@inlined
def finite(size: int, x: Any) -> bool:
    """Return whether every component is finite: 0 times it is 0."""
    total = 0.0
    for i in range(size):
        total += 0.0 * x[i]
    return total == 0.0


@inlined
def slot_of(schedule: Schedule, k: int) -> int:
    """Return the place of step k among the saved points, or -1."""
    if k % schedule.save_every == 0:
        return k // schedule.save_every
    if k == schedule.steps:
        return k // schedule.save_every + 1
    return -1


@inlined
def value_of(watch: Watch, i: int, x: Any, t: float, room: Any) -> float:
    """Return invariant i at x; `room` has watch.longest + 1 places."""
    total = watch.constant[i]
    for term in range(watch.first[i], watch.first[i + 1]):
        total += value(watch.terms, watch.addresses, term, x, t, room)
    return total


@inlined
def record(
    watch: Watch,
    saves: Saves,
    schedule: Schedule,
    member: int,
    k: int,
    slot: int,
    size: int,
    x: Any,
    square: int,
    group: Any,
    room: Any,
) -> None:
    """Note the deviations of the invariants at the finished state of step k, and save it where it has a slot.

    `watch` and `saves` come as pointers, `x` and `group` have `size` and `square` components, `room` watch.longest + 1
    places.
    """
    t = schedule.t0 + k * schedule.h
    tenth = (k - 1) * TENTHS // schedule.steps if k > 0 else 0
    for i in range(watch.size):
        now = value_of(watch, i, x, t, room)
        place = member * watch.size + i
        if k == 0:
            saves.first[place] = now
        elif watch.period[i] > 0.0:
            now += watch.period[i] * math.floor((saves.last[place] - now) / watch.period[i] + 0.5)
        saves.last[place] = now
        deviation = abs(now - saves.first[place])
        bin = (member * TENTHS + tenth) * watch.size + i
        if not deviation <= saves.worst[bin]:
            saves.worst[bin] = deviation
        if slot >= 0:
            saves.values[(slot * saves.members + member) * watch.size + i] = now
    if slot >= 0:
        here = slot * saves.members + member
        for i in range(size):
            saves.x[here * size + i] = x[i]
        for i in range(square):
            saves.group[here * square + i] = group[i]


@compiled
def record_start(watch: Watch, saves: Saves, schedule: Schedule, momenta: Any, groups: Any) -> None:
    """Save the initial state of every member, and the values that deviations are measured from."""
    room = np.empty(watch.longest + 1)
    size, square = momenta.shape[1], groups.shape[1]
    watch_at, saves_at, x, group = pointed((watch, saves, momenta, groups))
    for member in range(momenta.shape[0]):
        record(
            watch_at,
            saves_at,
            schedule,
            member,
            0,
            0,
            size,
            shifted(x, member * size),
            square,
            shifted(group, member * square),
            pointed(room),
        )


@compiled
def values_along(watch: Watch, points: Any, times: Any, out: Any) -> None:
    """Fill out (K, members, I) with functions at the saved points (K, members, n)."""
    room = np.empty(watch.longest + 1)
    count, members, size = points.shape
    watch_at, x, values = pointed((watch, points, out))
    for slot in range(count):
        for member in range(members):
            here = slot * members + member
            for i in range(watch.size):
                values[here * watch.size + i] = value_of(
                    watch_at, i, shifted(x, here * size), times[slot], pointed(room)
                )
