"""Members of an ensemble packed into lanes of vector instructions, and their time stepping in threads."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from ctypes import c_int64
from dataclasses import replace
from itertools import pairwise
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import codes, limit
from coadjoint.kernels.loop import NEVER_STOPPED, CompiledLoop, Layout, MemberBatch, NamedArrays
from coadjoint.kernels.tables.compiled import as_structure, stacked
from coadjoint.kernels.tables.writable import WritableTables, side_by_side
from coadjoint.methods.protocol.method import Method

if TYPE_CHECKING:
    from coadjoint.kernels.tables.compiled import CompiledTables
    from coadjoint.program.sources import Sources

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
BatchT = TypeVar("BatchT")
Raised = Callable[[], BaseException | None]
"""Function that returns and clears the exception of a user function in the loops, or None."""
Task = tuple[Callable[[], None], "SimpleQueue[None]"]

POLLING_SECONDS = 0.01  # while threads stop

# Threads that wait for work, each by its queue. Daemon threads, since the interpreter would wait for others at exit.
_IDLE: list[SimpleQueue[Task]] = []
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_IDLE.clear)


# The row in each slot, whether it is filled, and the batches of all slots; the others pad lanes with copies.
GroupRows = tuple[Integers, NDArray[np.bool_], list[MemberBatch]]


class Group(NamedTuple):
    """Members of a loop (ascending, None: all) with tables of one structure; with a stride each has its constants."""

    members: Integers | None
    loop: str
    tables: Any
    watch: Any
    stride: int = 0

    def rows(self, columns: Integers, workers: int, block: int, begin: int = 0) -> GroupRows:
        """Return rows (m,) for these columns of constants; slots count from `begin`, and each worker has a batch."""
        if self.stride:
            return self._in_columns(columns, begin)
        count = len(columns)
        member_batches = [
            MemberBatch(*self[1:4], first, last, base=first)
            for first, last in split_members(begin, begin + count, workers, block)
        ]
        return np.arange(count), np.ones(count, dtype=bool), member_batches

    def _in_columns(self, columns: Integers, begin: int) -> GroupRows:
        # Batches begin at blocks of columns; a block holds one row of each column at a time.
        block = limit("MOST_LANES")
        column_blocks = self.stride // block
        order = np.argsort(columns, kind="stable")
        ascending = columns[order]
        occurrence = np.arange(len(order)) - np.searchsorted(ascending, ascending)
        keys, first_rows, positions = np.unique(
            occurrence * column_blocks + ascending // block, return_index=True, return_inverse=True
        )
        rows, filled = np.repeat(order[first_rows], block), np.zeros(len(keys) * block, dtype=bool)
        slots = positions * block + ascending % block
        rows[slots], filled[slots] = order, True
        member_batches, cuts = [], np.flatnonzero((np.diff(keys) != 1) | (keys[1:] % column_blocks == 0)) + 1
        for low, high in pairwise([0, *cuts.tolist(), len(keys)]):
            first, column = begin + low * block, int(keys[low]) % column_blocks * block
            last = begin + high * block - int(np.argmax(filled[(high - 1) * block : high * block][::-1]))
            member_batches.append(MemberBatch(*self[1:4], first, last, self.stride, first - column))
        return rows, filled, member_batches


def rows_of_groups(groups: Sequence[Group], owners: Integers, workers: int, block: int) -> GroupRows:
    """Return rows of members in groups, one group after the other; `owners` (m,) holds the member of each row."""
    parts: list[GroupRows] = []
    begin = 0
    for group in groups:
        if group.members is None:
            return group.rows(owners, workers, block)
        selected = np.flatnonzero(np.isin(owners, group.members))
        if len(selected):
            columns = np.searchsorted(group.members, owners[selected])
            rows, filled, member_batches = group.rows(columns, workers, block, begin)
            parts.append((selected[rows], filled, member_batches))
            begin += len(rows)
    rows, filled = (np.concatenate([part[k] for part in parts]) for k in range(2))
    return rows, filled, [member_batch for *_, batches in parts for member_batch in batches]


def batches_of_groups(groups: Sequence[Group], members: int, workers: int, block: int) -> list[MemberBatch]:
    """Return member batches, each of one group, for the members in the order of the groups."""
    batches: list[MemberBatch] = []
    first = 0
    for group in groups:
        last = members if group.members is None else first + len(group.members)
        side_by_side = limit("MOST_LANES") if group.stride else block
        for bounds in split_members(first, last, workers, side_by_side):
            batches.append(MemberBatch(*group[1:4], *bounds, group.stride, first))
        first = last
    return batches


def individual_groups(members: Iterable[tuple[str, Any, Any]]) -> list[Group]:
    """Return a group for each member, from its loop and the tables of the loop and of its watch."""
    return [
        Group(np.array([m]), loop, as_structure(tables), as_structure(watch))
        for m, (loop, tables, watch) in enumerate(members)
    ]


def split_members(first: int, last: int, workers: int, block: int) -> list[tuple[int, int]]:
    """Split the members first to last - 1 into a range for each worker; they begin at multiples of `block`."""
    blocks = -(-(last - first) // block)
    edges = pairwise(min(last, first + blocks * w // workers * block) for w in range(workers + 1))
    return [(low, high) for low, high in edges if low < high]


class Columns:
    """Systems with tables that differ in some sources: `values` (systems, sources) of these `numbers`."""

    def __init__(
        self, numbers: Integers, values: Floats, first: Floats, recorded: Sequence[Sources] = (), owners: Any = ()
    ) -> None:
        self.numbers, self.values, self._first, self._recorded = numbers, values, first, recorded
        self._owners = owners  # of functions whose addresses are among the values
        self._writable: tuple[Any, WritableTables] | None = None

    def take(self, columns: Integers) -> Columns:
        chosen = Columns(self.numbers, self.values[columns], self._first, self._recorded, self._owners)
        chosen._writable = self._writable
        return chosen

    def tables(self, loop: CompiledTables, watch: CompiledTables) -> WritableTables:
        """Return the tables of all systems, from a loop and its watch at any step; raise `NotWritable`."""
        if self._writable is None or self._writable[0] is not loop.tables:
            of_loop, of_watch = self._recorded = self._recorded or (loop.sources(), watch.sources())
            own = replace(loop, sources=lambda: of_loop), replace(watch, sources=lambda: of_watch)
            self._writable = loop.tables, self.written_from(*own, self._first)
        return self._writable[1]

    def written_from(self, loop: CompiledTables, watch: CompiledTables, first: Floats) -> WritableTables:
        """Return the tables of all systems, from others of the system that has the values `first`."""
        return WritableTables(loop, watch, {source: k for k, source in enumerate(self.numbers.tolist())}, first)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the columns without the tables, which contain addresses."""
        return Columns, (self.numbers, self.values, self._first, self._recorded)


def groups_of(
    prepared: Sequence[CompiledLoop],
    watches: Sequence[CompiledTables],
    owners: Integers,
    in_order: bool,
    tables: Sequence[WritableTables | None],
    rows: Mapping[int, Floats],
    numbers: Integers,
    structure: Callable[[int], Hashable],
) -> list[Group]:
    """Group members with tables that differ only in constants, in the order of their first members.

    Member m has the loop k = `owners[m]`, of a `structure`, and if that has `tables` the numbers `rows[k][numbers[m]]`.
    """
    # Members that fill the lanes, or whose tables cannot be shared, are a group of their own.
    block = limit("MOST_LANES")
    _, system, counts = np.unique(owners * (numbers.max() + 1) + numbers, return_inverse=True, return_counts=True)
    separate = [
        bool(loop.referenced) if one is None else one.separate_tables
        for one, loop in zip(tables, prepared, strict=True)
    ]
    alone = (counts[system] >= block) | np.array(separate)[owners]
    keys: dict[Hashable, int] = {}
    key = np.zeros(len(prepared), dtype=np.int64)
    for k in np.unique(owners[~alone]).tolist():
        key[k] = keys.setdefault((tables[k] is None, structure(k)), len(keys))
    member_keys = np.where(alone, len(keys) + system, key[owners])
    order = np.arange(len(owners)) if in_order else np.argsort(member_keys, kind="stable")
    cuts = np.flatnonzero(np.diff(member_keys[order])) + 1
    groups = []
    for members in np.split(order, cuts):
        k = int(owners[members[0]])
        loop: Any = prepared[k].tables
        watch, stride = watches[k].tables, 0
        writable = tables[k]
        if writable is not None and alone[members[0]]:
            loop, watch = writable.shared(rows[k][numbers[members[0]]])
        elif writable is not None:
            by_loop = np.argsort(owners[members], kind="stable")
            pieces = np.split(by_loop, np.flatnonzero(np.diff(owners[members[by_loop]])) + 1)
            written = list[tuple[Any, Any, Floats]]()
            for columns in pieces:
                j, own = int(owners[members[columns[0]]]), columns if len(pieces) > 1 else slice(0, len(columns))
                written.append((tables[j], own, rows[j][numbers[members[columns]]]))
            loop, watch, stride = side_by_side(len(members), written)
        elif not alone[members[0]]:
            stride = len(members) + -len(members) % block
            loop, watch = (stacked([one[o].tables for o in owners[members].tolist()]) for one in (prepared, watches))
        groups.append(Group(members, prepared[k].name, as_structure(loop), as_structure(watch), stride))
    return sorted(groups, key=lambda group: int(group.members[0]))  # type: ignore[index]


def _start(work: Callable[[], None], done: SimpleQueue[None]) -> None:
    """Call `work`, which must not raise, in an idle thread or a new one, which then reports to `done`."""
    try:
        tasks = _IDLE.pop()
    except IndexError:
        tasks = SimpleQueue()
        threading.Thread(target=_serve, args=(tasks,), daemon=True).start()
    tasks.put((work, done))


def _serve(tasks: SimpleQueue[Task]) -> None:
    while True:
        work, done = tasks.get()
        work()
        del work  # with all that it refers to
        _IDLE.append(tasks)
        done.put(None)


def run_in_threads(
    member_batches: Sequence[MemberBatch],
    arguments: tuple[Layout, bytes, NamedArrays, NamedArrays, int, int],
    raised: Raised,
    workers: int = 1,
) -> int:
    """Advance member batches in threads; return the number of failed members. User exceptions come first."""

    def advance_all() -> int:
        if workers == 1:
            return sum(member_batch.advance(*arguments, NEVER_STOPPED) for member_batch in member_batches)
        stop = c_int64(0)
        return sum_in_threads(
            lambda member_batch: member_batch.advance(*arguments, stop), member_batches, workers, stop
        )

    try:
        failed_count = advance_all()
    except BaseException as error:
        raise_reason(raised, error)
    if failed_count and (reason := raised()) is not None:
        raise reason
    return failed_count


def raise_reason(raised: Raised, error: BaseException) -> NoReturn:
    """Raise what ended a call of the loops, which raised `error`: exceptions of user functions take precedence."""
    reason = raised()
    raise error if reason is None else reason from None


def sum_in_threads(
    advance: Callable[[BatchT], int], member_batches: Sequence[BatchT], workers: int, stop: c_int64
) -> int:
    """Sum the results of `advance` over batches or ranges of members; the first error stops all, and is raised."""
    waiting, lock = list(reversed(member_batches)), threading.Lock()
    advanced: list[None] = []  # an entry for each batch at present
    counts: list[int] = []
    errors: list[BaseException] = []

    def work() -> None:
        try:
            while True:
                with lock:
                    if not waiting:
                        return
                    member_batch = waiting.pop()
                    advanced.append(None)
                try:
                    counts.append(advance(member_batch))
                finally:
                    advanced.pop()
        except BaseException as error:
            errors.append(error)
            waiting.clear()
            stop.value = 1

    done: SimpleQueue[None] = SimpleQueue()
    try:
        threads = min(workers, len(member_batches))
        for _ in range(threads):
            _start(work, done)
        for _ in range(threads):
            done.get()
    except BaseException:
        with lock:
            waiting.clear()
        stop.value = 1
        while advanced:
            with contextlib.suppress(Empty):
                done.get(timeout=POLLING_SECONDS)
        raise
    if errors:
        raise errors[0]
    return sum(counts)


def status_name(status: Any) -> str:
    """Return the name of a status code."""
    return next(name for name, code in codes("Status").items() if code == status)


def failure_text(status: str, method: Method, residual: float, with_forces: bool) -> str:
    """Describe the failure with this status name, for messages."""
    if status in method.failures:
        return method.failures[status]
    if status == "NOT_CONVERGED":
        forces = ", or of a force," if with_forces else ""
        return f"the iteration of {method}{forces} did not converge (last correction {residual:.3g})"
    if status == "TOO_LONG":
        return (
            f"a flow of a part is longer than {limit('MOST_SUBSTEPS')} (its angle times the norm of its generator), or "
            "than 2^30 periods of the momentum of a free body, and flows so long leave few digits of float64"
        )
    if status == "PARALLEL":
        return "a tangent vector lost half of its digits against the others"
    return "a number overflowed"
