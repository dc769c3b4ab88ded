"""The loop over steps for step methods: schemes that bring one compiled step of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types
from numba.core.ccallback import CFunc
from numba.core.typing.templates import Signature
from numpy.typing import NDArray

from coadjoint.kernels.compiling import OPTIONS, compiled, stamp
from coadjoint.kernels.field import Field, GroupField
from coadjoint.kernels.pointers import alive, pointed, pointed_type, shifted
from coadjoint.kernels.watching import DONE, OVERFLOW, Report, Saves, Schedule, Watch, finite, record, slot_of
from coadjoint.program.terms import TermTable

RESIDUAL, EVALUATIONS, ITERATIONS, ROOM = range(4)
"""Places in a step's room: what it reports, and where its own room begins."""

UNDEFINED = 3
"""Status of a step that its scheme does not define; the scheme's `failures` says why."""


class StepTables(NamedTuple):
    """What a step reads: the field, the compiled values of the terms of H, the group equation, and coefficients."""

    field: Field
    values: NDArray[np.int64]
    group: GroupField
    integers: NDArray[np.int64]
    numbers: NDArray[np.float64]


class Stepping(NamedTuple):
    """A compiled step with room for `need` numbers, and what it reads; a step of the run is `substeps` of it.

    They have the lengths `fraction`, at the moments `moment`, in units of the step.
    """

    step: Any
    need: int
    substeps: int
    fraction: NDArray[np.float64]
    moment: NDArray[np.float64]
    tables: StepTables


def _tables_type() -> Any:
    typeof: Any = numba.typeof
    none, numbers, addresses = np.zeros(0, dtype=np.uint32), np.zeros(0), np.zeros(0, dtype=np.int64)
    field = Field(0, 1.0, 0, none, none, none, numbers, False, addresses, TermTable().table(), addresses, 1)
    group = GroupField(0, 0, none, none, none, numbers)
    return pointed_type(typeof(StepTables(field, addresses, group, addresses, numbers)))


_NUMBERS = pointed_type(types.float64[::1])
SIGNATURE: Signature = types.int64(
    _tables_type(), _NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS, types.float64, types.float64, _NUMBERS
)


def step_function(function: Callable[..., int]) -> CFunc:
    """Compile the step of a scheme, once for all systems, and keep it on disk.

    Parameters
    ----------
    function : callable
        ``step(tables, x, dx, group, dgroup, t, h, room) -> status``: takes one step of length h from time t, in place.
        `tables` is a `StepTables` of pointers; x and dx are the momentum and its compensation (`kernels.actions.add`),
        group and dgroup the same for the transposed group element. The first places of `room` receive the last
        correction and the numbers of evaluations and iterations; the rest, of the size that the scheme asked for, is
        free.

    Returns
    -------
    CFunc
        To be passed to `advance`.
    """
    step = CFunc(function, (SIGNATURE.args, SIGNATURE.return_type), locals={}, options=OPTIONS)
    step.enable_caching()
    stamp(step)
    step.compile()
    return step


@compiled
def advance(
    tables: Stepping,
    watch: Watch,
    saves: Saves,
    schedule: Schedule,
    state: Any,
    crew: Any,
    k0: int,
    k1: int,
    report: Report,
) -> None:
    """Take the steps k0 + 1 to k1 for the members crew[0] to crew[1] - 1, by the step that the tables bring.

    `state` is (momentum, its compensation, group, its compensation), each (members, ...). Every step starts anew from
    it.
    """
    size, square = state[0].shape[1], state[2].shape[1]
    room, watch_room = np.empty(ROOM + tables.need), np.empty(watch.longest + 1)
    at, watch_at, saves_at, report_at = pointed((tables.tables, watch, saves, report))
    x_at, dx_at, group_at, dgroup_at = pointed(state)
    room_at, watch_room_at = pointed((room, watch_room))
    for member in range(crew[0], crew[1]):
        if report_at.status[member] != DONE:
            continue
        x, dx = shifted(x_at, member * size), shifted(dx_at, member * size)
        group, dgroup = shifted(group_at, member * square), shifted(dgroup_at, member * square)
        for k in range(k0 + 1, k1 + 1):
            start = schedule.t0 + (k - 1) * schedule.h
            status = DONE
            for part in range(tables.substeps):
                t, h = start + tables.moment[part] * schedule.h, tables.fraction[part] * schedule.h
                status = tables.step(at, x, dx, group, dgroup, t, h, room_at)
                report_at.evaluations[member] += np.int64(room[EVALUATIONS])
                report_at.iterations[member] += np.int64(room[ITERATIONS])
                if status != DONE:
                    break
            if status == DONE and not finite(size, x):
                status, room[RESIDUAL] = OVERFLOW, np.nan
            if status != DONE:
                report_at.status[member], report_at.step[member] = status, k
                report_at.residual[member] = room[RESIDUAL]
                break
            slot = slot_of(schedule, k)
            if schedule.watching or slot >= 0:
                record(watch_at, saves_at, schedule, member, k, slot, size, x, square, group, watch_room_at)
    alive((room, watch_room))
