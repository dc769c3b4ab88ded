"""The plan of a run, made once for many runs: everything that does not depend on its state; and the state."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint import memory
from coadjoint.kernels.interface import kernel_interface, limit
from coadjoint.kernels.loop import ArrayOffsets, Extent, Layout, MemberBatch, NamedArrays
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

    Calls in a round of `rounds` are concurrent. `shared`: fields of all solutions; `is_short`: one call in this thread,
    from the momenta alone, with a small state.
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
        self.system, self.method, self.loops, self.times = system, method, loops, times
        self.groups = groups
        self.watching, self.workers, self.inside = watching, workers, inside  # threads, and those that share a member
        self.events = 0  # address of the event tables
        members, square = groups[0], groups[1] ** 2
        self.layout = loops.layout(members, times.points, square)
        check_run_memory(self.layout, times, members)
        self.rounds = loops.rounds(members, workers)
        special = loops.rows or loops.matrices is not None or loops.order is not None or loops.work_integrals or square
        small = self.layout.state.size <= MAX_STATE_NUMBERS
        self.is_short = small and workers == 1 and not special and len(self.rounds) == len(self.rounds[0]) == 1
        self.shared: dict[str, Any] = {
            "method": method,
            "watched": watching,
            "_system_of_run": lambda: system,
            "_prepared_system": system,
            "_times": times,
            "_layout": self.layout,
            "_saved_points": times.points,
            "_names": loops.names,
            "_work_integrals": loops.work_integrals,
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
        options = self.groups, self.watching, self.workers, self.inside
        plan = Plan(self.system, self.method, self.loops, times, *options)
        plan.shared["_system_of_run"] = self.shared["_system_of_run"]
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
        plan = self._copy()
        plan.rounds = rounds
        return plan

    def with_loops(self, loops: Loops, system_of_run: Callable[[], Any]) -> Plan:
        """Return the plan of a system made on first use, for loops that differ in the numbers in their tables only."""
        plan = self._copy()
        plan.loops, plan.rounds = loops, loops.rounds(self.groups[0], self.workers)
        plan.shared = {**self.shared, "_system_of_run": system_of_run}
        plan.is_short = self.is_short and loops.order is None and len(plan.rounds) == len(plan.rounds[0]) == 1
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


class State:
    """The state of a run after some steps, compared bitwise; a run resumed from it has the bits of an unbroken one."""

    __slots__ = ("arrays", "number")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, arrays: NamedArrays, number: int = 0) -> None:
        self.arrays, self.number = arrays, number

    @classmethod
    def of_start(cls, layout: Layout, momenta: NDArray[np.float64], groups: Any) -> State:
        """Return the state before the first step, from momenta (members, n) and the group elements of the loops."""
        arrays = NamedArrays(layout.state)
        if layout.extent.size == momenta.shape[1]:
            arrays.numbers[arrays.offsets.slices["momenta"]] = momenta.ravel()
        else:
            # Work integrals follow the coordinates, and start at zero.
            arrays["momenta"][:, : momenta.shape[1]] = momenta
        if layout.extent.square:
            arrays["groups"][:] = groups
        return cls(arrays)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.arrays[name]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, State):
            return NotImplemented
        arrays, other_arrays = self.arrays, other.arrays
        return (
            self.number == other.number
            and arrays.offsets.shapes == other_arrays.offsets.shapes
            and np.array_equal(arrays.numbers.view(np.int64), other_arrays.numbers.view(np.int64))
        )

    def __repr__(self) -> str:
        members = len(self["status"])
        return f"<state of {members} member{'s' if members > 1 else ''} after step {self.number}>"

    def copy(self) -> State:
        return State(self.arrays.copy(), self.number)

    def to_mapping(self) -> dict[str, Any]:
        """Return "version" and "number", and copies of the arrays, by name."""
        arrays = {name: self[name].copy() for name in self.arrays.offsets.shapes}
        return {"version": limit("STATE_VERSION"), "number": self.number, **arrays}

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> State:
        """Restore a state from the mapping of `to_mapping`; ValueError for another version or inconsistent arrays."""
        version, number = (_read_integer(mapping, name) for name in ("version", "number"))
        if version != limit("STATE_VERSION"):
            raise ValueError(
                f"the state of the run is of version {version}, and this library resumes from version "
                f"{limit('STATE_VERSION')}; resume with the library that wrote it"
            )
        if number < 0:
            raise ValueError(f"number of the state is {number}; it must be a whole number from 0 up")
        offsets = _offsets_of(mapping)
        arrays = NamedArrays(offsets)
        for name in offsets.shapes:
            arrays[name][:] = mapping[name]
        return cls(arrays, number)

    def check_fits(self, offsets: ArrayOffsets) -> None:
        """Raise ValueError unless the arrays have these shapes."""
        for name, shape in offsets.shapes.items():
            stored = self.arrays.offsets.shapes[name]
            if stored != shape:
                raise ValueError(
                    f"the state of the run has {name} of shape {stored}, and this run needs {shape}; resume with "
                    "the system, scheme, attitude and members of the original run"
                )


def _read_integer(mapping: Mapping[str, Any], name: str) -> int:
    if name not in mapping:
        raise ValueError(f"the state of a run has no {name}; it must be as to_mapping returns it")
    value = mapping[name]
    if np.ndim(value) != 0 or np.asarray(value).dtype.kind not in "iu":
        raise ValueError(f"{name} of the state is {short(value)}; it must be a whole number")
    return int(value)


def _offsets_of(mapping: Mapping[str, Any]) -> ArrayOffsets:
    """Return the layout of the arrays in one block of memory, with sizes from their shapes."""
    described_arrays = kernel_interface().arrays["state"]
    names = set(mapping) - {"version", "number"}
    if names != set(described_arrays):
        missing, unknown = (
            sorted(names_left) for names_left in (set(described_arrays) - names, names - set(described_arrays))
        )
        raise ValueError(
            f"the state of a run must have the arrays {', '.join(described_arrays)}; "
            f"missing: {', '.join(missing) or 'none'}; unknown: {', '.join(map(short, unknown)) or 'none'}"
        )
    sizes: dict[str, int] = {}
    for name, (_, axes) in described_arrays.items():
        shape = np.shape(mapping[name])
        if len(shape) == len(axes):
            for axis, length in zip(axes, shape, strict=True):
                sizes.setdefault(axis, length)
    extent = Extent(*(sizes.get(axis, 0) for axis in Extent._fields))
    offsets = Layout(extent).state
    for name, shape in offsets.shapes.items():
        values = np.asarray(mapping[name])
        dtype = np.dtype(np.int64 if name in offsets.int64_names else np.float64)
        if values.shape != shape or values.dtype != dtype:
            raise ValueError(
                f"{name} of the state is {values.dtype} of shape {values.shape}; with the other arrays it must be "
                f"{dtype} of shape {shape}"
            )
    return offsets
