"""The loop over steps for programs: flow methods read from their table."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.actions import act
from coadjoint.kernels.arithmetic import rational_angle
from coadjoint.kernels.compiling import compiled, inlined
from coadjoint.kernels.pointers import alive, pointed, shifted
from coadjoint.kernels.terms import gradient_rows, linear_row
from coadjoint.kernels.watching import DONE, OVERFLOW, Report, Saves, Schedule, Watch, finite, record, slot_of
from coadjoint.program.actions import Action
from coadjoint.program.terms import Terms


class FlowTables(NamedTuple):
    """The arrays of a program, the rows' coefficients already multiplied by the step.

    A part has at most `longest` angles; only[p] is the row of a part with a single, linear one, and -1 for the others.
    Rational rotations are marked in the kinds of the actions; bent[p] is 1 where the blocks of a part on the group have
    other frequencies than on the momentum, frequency[row], so that they need the angle itself.
    """

    longest: int
    only: NDArray[np.int64]
    bent: NDArray[np.uint8]
    frequency: NDArray[np.float64]
    part: NDArray[np.uint32]
    tau: NDArray[np.float64]
    moment: NDArray[np.float64]
    section: NDArray[np.uint32]
    share: NDArray[np.uint32]
    terms: Terms
    addresses: NDArray[np.int64]
    state: Action
    group: Action
    compensated: bool


@inlined
def sweep(
    tables: Any,
    first: int,
    last: int,
    x: Any,
    dx: Any,
    group: Any,
    dgroup: Any,
    t: float,
    h: float,
    carry: bool,
    theta: Any,
    room: Any,
) -> None:
    """Apply the rows first to last - 1: angles from the shares, then the action on the momentum and on the group
    element.
    """
    for r in range(first, last):
        part = tables.part[r]
        row = tables.only[part]
        single = row >= 0
        angle = 0.0
        if single:
            angle = linear_row(tables.terms, row, x)
        else:
            low, high = tables.share[part], tables.share[part + 1]
            base = tables.terms.row[low]
            moment = t + tables.moment[r] * h
            for k in range(low, high):
                gradient_rows(tables.terms, tables.addresses, k, x, moment, theta, base, room)
        tau = tables.tau[r]
        act(tables.state, part, tau, single, angle, theta, x, dx, 1, tables.compensated, tables.compensated, room)
        if carry:
            if tables.bent[part]:
                if single:
                    angle = rational_angle(tau * angle, tables.frequency[row])
                else:
                    base = tables.terms.row[tables.share[part]]
                    for place in range(base, tables.terms.row[tables.share[part + 1]]):
                        theta[place - base] = rational_angle(tau * theta[place - base], tables.frequency[place])
                tau = 1.0
            act(tables.group, part, tau, single, angle, theta, group, dgroup, tables.group.size, True, False, room)


@compiled
def advance(
    tables: FlowTables,
    watch: Watch,
    saves: Saves,
    schedule: Schedule,
    state: Any,
    crew: Any,
    k0: int,
    k1: int,
    report: Report,
) -> None:
    """Take the steps k0 + 1 to k1 for the members crew[0] to crew[1] - 1.

    `state` is (momentum, its compensation, group, its compensation), each (members, ...), unfinished between calls: the
    outer flow of a step is merged with the next one, and *finish* acts on a copy.
    """
    size, square = state[0].shape[1], state[2].shape[1]
    lanes = max(1, tables.group.size)
    room = np.empty(3 * max(size, lanes * lanes) + 2 * tables.longest + watch.longest + 1)
    theta, copies = np.empty(tables.longest), np.empty((2, size))
    group_copies = np.empty((2, square))
    at, watch_at, saves_at, report_at = pointed((tables, watch, saves, report))
    x_at, dx_at, group_at, dgroup_at = pointed(state)
    room_at, theta_at, copy, group_copy = pointed((room, theta, copies, group_copies))
    copy_error, group_copy_error = shifted(copy, size), shifted(group_copy, square)
    carry = square > 0
    h = schedule.h
    for member in range(crew[0], crew[1]):
        if report_at.status[member] != DONE:
            continue
        x, dx = shifted(x_at, member * size), shifted(dx_at, member * size)
        group, dgroup = shifted(group_at, member * square), shifted(dgroup_at, member * square)
        for k in range(k0 + 1, k1 + 1):
            t = schedule.t0 + (k - 1) * h
            slot = slot_of(schedule, k)
            look = schedule.watching or slot >= 0
            first = at.section[0 if k == 1 else 1]
            last = at.section[1 if k == 1 else 2]
            report_at.evaluations[member] += last - first
            sweep(at, first, last, x, dx, group, dgroup, t, h, carry, theta_at, room_at)
            if not finite(size, x):
                report_at.status[member] = OVERFLOW
                report_at.step[member] = k
                break
            if look:
                for i in range(size):
                    copy[i], copy_error[i] = x[i], dx[i]
                if slot >= 0:
                    for i in range(square):
                        group_copy[i], group_copy_error[i] = group[i], dgroup[i]
                first, last = at.section[2], at.section[3]
                carried = carry and slot >= 0
                sweep(at, first, last, copy, copy_error, group_copy, group_copy_error, t, h, carried, theta_at, room_at)
                if not finite(size, copy) or (carried and not finite(square, group_copy)):
                    report_at.status[member] = OVERFLOW
                    report_at.step[member] = k
                    break
                record(watch_at, saves_at, schedule, member, k, slot, size, copy, square, group_copy, room_at)
    alive((room, theta, copies, group_copies))
