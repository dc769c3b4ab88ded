"""The plan of a run: everything that does not depend on its state, made once for many runs."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cached_property
from typing import Any

from coadjoint import memory
from coadjoint.kernels.loop import Layout, MemberBatch
from coadjoint.kernels.tables.recording import schedule_of
from coadjoint.memory import UNCHECKED_BYTES, format_bytes
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.loops.loops import Loops
from coadjoint.runs.results.memory_solution import MAX_STATE_NUMBERS
from coadjoint.runs.times import Times
from coadjoint.short_repr import short

BYTES_PER_NUMBER = 8  # of float64
BYTES_PER_POINT = 24  # time, number and observed quantities


class Plan:
    """System, scheme, loops and times of runs whose group elements have one shape; immutable.

    The calls of the loops in `rounds` run one after the other, and those of a round concurrently. `shared` are fields
    of all solutions; `is_short` means one call in the calling thread, from the momenta alone, with a small state.
    """

    def __init__(
        self,
        system: Any,
        method: Method,
        loops: Loops,
        times: Times,
        groups: tuple[int, ...],
        watching: bool = False,
        workers: int = 1,
        inside: int = 1,
    ) -> None:
        self.system, self.base, self.method, self.loops, self.times = system, system, method, loops, times
        self.groups = groups
        self.watching, self.workers, self.inside = watching, workers, inside  # threads, and those that share a member
        self.events = 0  # address of the event tables
        members, square = groups[0], groups[1] ** 2
        self.layout = loops.layout(members, times.points, square)
        check_run_memory(self.layout, times, members)
        self.rounds = loops.rounds(members, workers)
        special = loops.rows or loops.measured or loops.order is not None or loops.accounts or square
        small = self.layout.state.size <= MAX_STATE_NUMBERS
        self.is_short = small and workers == 1 and not special and len(self.rounds) == len(self.rounds[0]) == 1
        self.shared: dict[str, Any] = {
            "method": method,
            "watched": watching,
            "_given_system": system,
            "_base": system,
            "_times": times,
            "_layout": self.layout,
            "_saved_points": times.points,
            "_names": loops.names,
            "_accounts": loops.accounts,
            "_corrected_groups": loops.corrected_groups,
        }
        self._set_schedule()

    def _set_schedule(self) -> None:
        t0, h, steps, save_every, passed, marks, *_ = self.times
        self.schedule = schedule_of(t0, h, steps, save_every, self.watching, passed, marks, self.events, self.inside)

    @cached_property
    def whole_run(self) -> Callable[[Any], int]:
        """The function that takes all steps of a run that `is_short`; see `MemberBatch.whole_run`."""
        schedule = ctypes.create_string_buffer(self.schedule, len(self.schedule))
        return self.rounds[0][0].whole_run(self.layout, schedule)

    def with_times(self, times: Times) -> Plan:
        """Return the plan of the same runs for other times."""
        options = self.groups, self.watching, self.workers, self.inside
        plan = Plan(self.system, self.method, self.loops, times, *options)
        plan.base = plan.shared["_base"] = self.base
        return plan.with_events(self.events) if self.events else plan

    def at_times(self, times: Times) -> Plan | None:
        """Return the plan for other times, with the same arrays and loops; None if these differ."""
        same = times.h == self.times.h and times.points == self.layout.extent.points
        if not same or times.marks is not None or self.times.marks is not None:
            return None
        plan = self._copy()
        plan.times, plan.shared = times, {**self.shared, "_times": times}
        plan._set_schedule()
        return plan

    def with_events(self, events: int) -> Plan:
        """Return the plan of the same runs with the event tables at an address."""
        plan = self._copy()
        plan.events = events
        plan._set_schedule()
        return plan

    def with_rounds(self, rounds: list[list[MemberBatch]]) -> Plan:
        """Return the plan with other calls of the loops."""
        plan = self._copy()
        plan.rounds = rounds
        return plan

    def with_loops(self, loops: Loops, system: Any) -> Plan:
        """Return the plan of another system, for loops that differ in the numbers in their tables only."""
        plan = self._copy()
        plan.system, plan.loops, plan.rounds = system, loops, loops.rounds(self.groups[0], self.workers)
        plan.shared = {**self.shared, "_given_system": system}
        plan.is_short = self.is_short and len(plan.rounds) == len(plan.rounds[0]) == 1
        return plan

    def _copy(self) -> Plan:
        plan: Plan = object.__new__(Plan)
        plan.__dict__ = {**self.__dict__}
        plan.__dict__.pop("whole_run", None)
        return plan


def bytes_of_run(layout: Layout, times: Times) -> int:
    """Estimate the memory of a run's arrays, in bytes."""
    return BYTES_PER_NUMBER * (layout.saved.size + layout.state.size) + BYTES_PER_POINT * times.points


def check_run_memory(layout: Layout, times: Times, members: int) -> None:
    """Raise ValueError if a run's arrays exceed the free memory; suggest a `save_every` that fits, if any."""
    required = bytes_of_run(layout, times)
    if required <= UNCHECKED_BYTES:
        return
    free = memory.available()
    if required <= free:
        return
    bytes_per_point = BYTES_PER_NUMBER * (layout.saved.size // times.points) + BYTES_PER_POINT
    points = (free - (required - bytes_per_point * times.points)) // bytes_per_point
    # The start and the end are always saved.
    every = -(-times.steps // (points - 1)) if points >= 2 else 0
    reduction = f"give save_every={every} or more" if times.marks is None else "give fewer times in t_eval"
    advice = reduction if every else "run fewer members at a time"
    raise ValueError(
        f"{short(times.points)} saved points of {members} member{'s' if members > 1 else ''} need about "
        f"{format_bytes(required)}; this machine has {format_bytes(free)} free; {advice}"
    )
