"""The compiled time stepping of a run: loops with their tables, one for each structure among its members."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import CompiledLoop, Extent, Layout, MemberBatch, NamedArrays, layout_of, matrix_rows
from coadjoint.kernels.tables.compiled import NotWritable, as_structure, structure_of
from coadjoint.kernels.tables.recording import values_along
from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.runs.loops.member_batches import (
    Columns,
    Group,
    batches_of_groups,
    groups_of,
    individual_groups,
    split_members,
)
from coadjoint.runs.results.quantities import invariants_of_matrices
from coadjoint.runs.start import Start, unit_groups
from coadjoint.runs.times import Times
from coadjoint.systems.batch import Batch
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.system import System

if TYPE_CHECKING:
    from coadjoint.kernels.tables.compiled import CompiledTables
    from coadjoint.kernels.tables.writable import WritableTables
    from coadjoint.runs.loops.shifted_attitude import ShiftCorrection
    from coadjoint.systems.system_stacks import SystemStack

UNTRACKED = Quadratic(0.0)
"""Placeholder for an invariant that the loops do not track."""
BATCHES_PER_ROUND = 8
"""Per thread. An interrupt waits until the round ends; each batch costs a call from Python."""
GroupCorrection = Callable[[Start, Times, NamedArrays, int], NDArray[np.float64]]
Floats = NDArray[np.float64]


class Loops:
    """Compiled loops of a run and properties of its system; concurrent runs may share them.

    There is one loop for each distinct system, or for several with `columns`; `owners` (members,) selects it. With
    `in_order` a member keeps its row, which its noise depends on.
    """

    corrected_groups: GroupCorrection

    def __init__(
        self,
        dim: int,
        names: list[str],
        compiled: Sequence[CompiledLoop],
        watches: Sequence[CompiledTables],
        corrections: Sequence[ShiftCorrection | None] = (None,),
        owners: NDArray[np.int64] | None = None,
        in_order: bool = False,
        matrices: Any = None,
        rows: int = 0,
        columns: Sequence[Columns | None] = (),
        numbers: NDArray[np.int64] | None = None,
        corrected: NDArray[np.int64] | None = None,
    ) -> None:
        self._columns, self._numbers = columns, numbers
        self._corrected = owners if corrected is None else corrected
        self.dim, self.names, self.corrections = dim, names, list(corrections)
        self.owners, self.in_order, self.rows = owners, in_order, rows
        self.work_integrals = compiled[0].work_integrals  # behind the coordinates of a state, as (force, invariant)
        # Numbers of a state, and those of a member that persist from step to step.
        self.size, self.memory = dim + len(self.work_integrals), max(loop.memory for loop in compiled)
        self.matrices = matrices  # the system, whose invariants the loops do not track, if states are matrices
        # Members with the same tables that are advanced side by side.
        self.block = limit("MOST_LANES") if dim <= limit("WIDEST") else 1
        self.corrected_groups = uncorrected_groups
        if any(self.corrections):
            from coadjoint.runs.loops.shifted_attitude import corrected_groups_each

            self.corrected_groups = partial(corrected_groups_each, self.corrections, self._corrected)
        self._set_tables(compiled, watches)

    def _set_tables(self, compiled: Sequence[CompiledLoop], watches: Sequence[CompiledTables]) -> None:
        self.compiled, self.watches = list(compiled), list(watches)
        self.order: NDArray[np.int64] | None = None
        if self.owners is None:
            # Converted to C structures once for all runs.
            structures = as_structure(compiled[0].tables), as_structure(watches[0].tables)
            self.groups = [Group(None, compiled[0].name, *structures)]
        else:
            self._structures: dict[int, Hashable] = {}
            columns: Sequence[Columns | None] = self._columns or [None] * len(self.compiled)
            tables = [
                None if one is None else one.tables(loop, watch)
                for one, loop, watch in zip(columns, compiled, watches, strict=True)
            ]
            rows = {k: one.values for k, one in enumerate(columns) if one is not None}
            self._set_groups(self._grouped(tables, rows, self._numbers))
        self._rounds: tuple[tuple[int, int], list[list[MemberBatch]]] | None = None
        self._base: Loops | None = None
        self.writable: tuple[WritableTables, ...] = ()  # of each loop of a run with inputs

    def _set_groups(self, groups: Sequence[Group]) -> None:
        self.groups = list(groups)
        members = np.concatenate([group.members for group in self.groups if group.members is not None])
        self.order = None if np.array_equal(members, np.arange(len(members))) else members

    def _grouped(
        self,
        tables: Sequence[WritableTables | None],
        rows: Mapping[int, Floats],
        numbers: NDArray[np.int64] | None,
    ) -> list[Group]:
        """Return the groups of members that have the row of this number of their loop; see `groups_of`."""
        owners: Any = self.owners
        numbers = np.zeros(len(owners), dtype=np.int64) if numbers is None else numbers
        among = owners, self.in_order, tables, rows, numbers
        return groups_of(self.compiled, self.watches, *among, self._structure)

    def _structure(self, k: int) -> Hashable:
        """Return everything in the tables of a loop except their constants, cached."""
        if k not in self._structures:
            loop, watch = self.compiled[k], self.watches[k]
            self._structures[k] = loop.name, structure_of(loop.tables), structure_of(watch.tables)
        return self._structures[k]

    @property
    def in_columns(self) -> list[NDArray[np.int64]]:
        """The members of each loop that serves several systems of a batch."""
        if self.owners is None or self._numbers is None:
            return []
        found = [np.flatnonzero(self.owners == k) for k, one in enumerate(self._columns) if one is not None]
        return [members for members in found if len(members) > 1]

    def varying(self, k: int) -> tuple[Sequence[int], Floats]:
        """Return the sources in which the systems of a loop differ, and their numbers in the first one."""
        columns = self._columns[k] if self._columns else None
        return ([], np.zeros(0)) if columns is None else (columns.numbers.tolist(), columns.values[0])

    @property
    def columns_of_members(self) -> Columns | None:
        """The coefficients of each member if all have the tables of one loop; None otherwise."""
        if self._numbers is None or len(self.compiled) > 1 or self._columns[0] is None:
            return None
        return self._columns[0].take(self._numbers)

    @property
    def shift_factors(self) -> Floats:
        """The factors of the Casimirs subtracted from H, for each member of a batch with attitudes."""
        shifts = [() if one is None else one.shift for one in self.corrections]
        return np.array([[factor for _, factor in shift] for shift in shifts])[self._corrected]

    @property
    def tracked(self) -> int:
        return len(self.names) * (2 if self.work_integrals else 1)

    @property
    def shares_tables(self) -> bool:
        return self.groups[0].members is None and not self.groups[0].stride

    def layout(self, members: int, points: int, square: int) -> Layout:
        return layout_of(Extent(members, points, self.size, square, self.tracked, self.memory))

    def rounds(self, members: int, workers: int) -> list[list[MemberBatch]]:
        """Return the calls of the loops, in rounds that run one after the other; the last ones are cached."""
        cached = self._rounds
        if cached is not None and cached[0] == (members, workers):
            return cached[1]
        if self._base is not None and self.shares_tables:
            (group,) = self.groups
            rounds = [
                [batch.with_tables(group.tables, group.watch) for batch in batches]
                for batches in self._base.rounds(members, workers)
            ]
        else:
            batches, size = batches_of_groups(self.groups, members, workers, self.block), BATCHES_PER_ROUND * workers
            rounds = [batches[a : a + size] for a in range(0, len(batches), size)]
        self._rounds = (members, workers), rounds
        return rounds

    def rounds_among(self, members: NDArray[np.int64], workers: int) -> list[list[MemberBatch]] | None:
        """Return rounds of the given members, ascending, packed side by side; None if they have own tables."""
        if not self.shares_tables:
            return None
        batch = MemberBatch(*self.groups[0][1:4], 0, 1)
        return [
            [batch.among(members[slice(*bounds)]) for bounds in split_members(0, len(members), workers, self.block)]
        ]

    def _copy(self, **attributes: Any) -> Loops:
        loops: Loops = object.__new__(type(self))
        loops.__dict__ = {**self.__dict__, "_rounds": None, **attributes}
        return loops

    def with_groups(self, groups: Sequence[Group]) -> Loops:
        """Return the loops of the same system with other tables, of the same structure."""
        return self._copy(groups=groups, _base=self)

    def with_values(self, values: Floats) -> Loops:
        """Return the loops of a call with these values of the inputs, (m,) or (members, m)."""
        try:
            if self.owners is not None:
                return self._with_values_of_members(values)
            (tables,), (group,) = self.writable, self.groups
            if values.ndim == 1:
                return self.with_groups([Group(None, group.loop, *tables.shared(values))])
            if not tables.separate_tables:
                return self.with_groups([Group(None, group.loop, *tables.each(values))])
            each = [tables.shared(row) for row in values]
        except OverflowError:
            raise ValueError(
                "the linear term is too large: a completed square overflows; give smaller inputs"
            ) from None
        return self.with_groups(individual_groups((group.loop, *pair) for pair in each))

    def _with_values_of_members(self, values: Floats) -> Loops:
        """Return the loops of a batch with values (members, m), which follow the coefficients of each member."""
        owners: Any = self.owners
        by_loop = np.argsort(owners, kind="stable")
        rows, numbers = dict[int, Floats](), np.empty(len(owners), dtype=np.int64)
        for members in np.split(by_loop, np.flatnonzero(np.diff(owners[by_loop])) + 1):
            k, rest = int(owners[members[0]]), values[members]
            if self._numbers is not None and (own := self._columns[k]) is not None:
                rest = np.concatenate([own.values[self._numbers[members]], rest], axis=1)
            rows[k], numbers[members] = rest, np.arange(len(members))
        changed = self.with_groups([])
        changed._set_groups(self._grouped(self.writable, rows, numbers))
        return changed

    def at_step(self, h: float) -> Loops | None:
        """Return the loops of another step, by the same tables; None if they must be built again."""
        compiled = []
        for loop in self.compiled:
            tables = None if loop.referenced else loop.tables.at_step(h)
            if tables is None:
                return None
            compiled.append(replace(loop, tables=tables))
        changed = self._copy(_base=None)
        changed._set_tables(compiled, self.watches)
        return changed

    def selected(self, members: NDArray[np.int64]) -> Loops:
        """Return the loops of these members of a batch, from the tables already built."""
        assert self.owners is not None and self._corrected is not None
        chosen, owners = np.unique(self.owners[members], return_inverse=True)
        compiled, watches = ([parts[k] for k in chosen] for parts in (self.compiled, self.watches))
        systems, corrected = np.unique(self._corrected[members], return_inverse=True)
        corrections = [self.corrections[k] for k in systems.tolist()]
        columns, numbers = [], self._numbers
        if numbers is not None:
            columns, numbers = [self._columns[k] for k in chosen], numbers[members]
            for k, one in enumerate(columns):
                if one is not None:
                    used, numbers[owners == k] = np.unique(numbers[owners == k], return_inverse=True)
                    columns[k] = one.take(used)
        fields = self.dim, self.names, compiled, watches, corrections, owners, self.in_order
        part = Loops(*fields, columns=columns, numbers=numbers, corrected=corrected)
        part.writable = tuple(self.writable[k] for k in chosen.tolist() if self.writable)
        return part

    def attitude_may_overflow(self, start: Start, times: Times) -> bool:
        """Whether `corrected_groups` may return infinite elements although those of the loops are finite."""
        corrections = [correction for correction in self.corrections if correction]
        if not corrections:
            return False
        return max(corrections, key=lambda correction: correction.most).may_overflow(start, times)

    def build_all(self) -> None:
        for correction in self.corrections:
            if correction is not None:
                correction.build()

    def corrected_groups_at(
        self, start: Start, members: NDArray[np.int64], elapsed: NDArray[np.float64], loop_groups: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return group elements (m, d, d) of members at times since their starts, from those of the loops (m, d*d)."""
        d = start.groups.shape[1]
        groups = np.array(np.swapaxes(loop_groups.reshape(-1, d, d), 1, 2))
        for row, member in enumerate(members.tolist()):
            correction = self.corrections[0 if self._corrected is None else self._corrected[member]]
            if correction is not None:
                groups[row] = correction.at(start, member, float(elapsed[row]), loop_groups[row])
        return groups

    def initial_groups(self, groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the initial elements, transposed (members, d*d) or (d*d,); units for a shifted H."""
        unit = unit_groups(groups.shape[-1]).ravel()
        if self._corrected is None:
            return as_rows(groups) if self.corrections[0] is None else unit
        rows, shifted = np.array(as_rows(groups)), [correction is not None for correction in self.corrections]
        rows[np.array(shifted)[self._corrected]] = unit
        return rows

    def values_of_matrices(self, states: Floats, t: float) -> Floats:
        """Return the invariants of states (m, size) that are matrices."""
        return invariants_of_matrices(self.matrices, self.names, self.work_integrals, states, t)

    def values_at(self, state: NDArray[np.float64], t: float, last: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the invariants of a single-member run at a state; multivalued ones on the branch nearest to `last`."""
        if self.matrices is not None:
            return self.values_of_matrices(state[None], t)[0]
        tables, values = self.watches[0].tables, np.empty((1, 1, len(last)))
        period = np.asarray(getattr(tables, "source", tables).period)  # zero for those with one value
        values_along(self.groups[0].watch, state[None, None], np.array([t]), values)
        with np.errstate(divide="ignore", invalid="ignore"):
            periods = np.where(period > 0.0, np.floor((last - values[0, 0]) / period + 0.5), 0.0)
        return np.asarray(values[0, 0] + period * periods)

    def raised(self) -> BaseException | None:
        """Return and clear the exception raised by a user function in a loop, or None."""
        return next((error for loop in self.compiled if (error := loop.raised())), None)

    @property
    def is_picklable(self) -> bool:
        """Whether the loops can be pickled: without inputs, if all addresses in their tables are those of functions."""
        return not self.writable and all(tables.is_picklable for tables in (*self.compiled, *self.watches))

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes that are not derived from the tables."""
        derived = ("groups", "order", "writable", "_rounds", "_base", "_structures")
        return {name: value for name, value in vars(self).items() if name not in derived}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._set_tables(self.compiled, self.watches)


def loops_of_system(
    system: System,
    method: Method,
    h: float,
    representation: Representation = None,
    casimirs: Mapping[str, Any] | None = None,
    compact: bool = False,
) -> Loops:
    """Return the loops of one system, for any number of members; `compact` tables are not those of a batch."""
    loop = (method._shared_loop if compact else method.loop)(system, h, representation)
    tracked = system.casimirs if casimirs is None else casimirs
    watch = _watch_of(system, loop, tracked, compact)
    correction = _correction_of(system, loop, representation)
    matrices, rows = system.unforced if system.has_matrices else None, matrix_rows(system)
    return Loops(system.dim, ["energy", *tracked], [loop], [watch], [correction], matrices=matrices, rows=rows)


def loops_of_batch(batch: Batch, method: Method, h: float, representations: Sequence[Representation]) -> Loops:
    """Return the loops of a batch, with a representation for each; the tables of a member are those of it alone."""
    names, distinct = list(batch[0].casimirs), batch.distinct
    firsts = np.unique(batch.owners, return_index=True)[1]
    built: list[tuple[CompiledLoop, CompiledTables]] = []
    columns: list[Columns | None] = []
    corrections: list[ShiftCorrection | None] = [None] * len(distinct)
    owner, number = np.full(len(distinct), -1), np.zeros(len(distinct), dtype=np.int64)

    def add(k: int, stack: SystemStack | None = None) -> None:
        system, representation = distinct[k], representations[firsts[k]]
        if built:
            note_progress(f"the loop of system {k + 1} of {len(distinct)}", len(built) / len(distinct))
        try:
            loop = method.loop(system, h, representation)
        except (TypeError, ValueError) as error:
            raise type(error)(f"member {firsts[k]} of the batch: {error}") from error
        watch = _watch_of(system, loop, {name: system.casimirs[name] for name in names})
        built.append((loop, watch))
        columns.append(None)
        owner[k], corrections[k] = len(built) - 1, _correction_of(system, loop, representation)
        if stack is None:
            return
        varying, values = stack.varying()
        found = Columns(varying, values, values[0], owners=stack.owners)
        with suppress(NotWritable):
            found.tables(loop, watch)
            columns[-1] = found
            owner[stack.numbers], number[stack.numbers] = owner[k], np.arange(stack.size)
            if (first := corrections[k]) is not None:
                for m, factors in zip(stack.numbers.tolist(), stack.factors.T.tolist(), strict=True):
                    corrections[m] = first.of_system(distinct[m], factors)

    for stack in method.split_jointly(distinct):
        own: list[Any] = [representations[firsts[k]] for k in stack.numbers.tolist()]
        kept = [k for k, other in enumerate(own) if other is own[0] or np.array_equal(other, own[0])]
        add(int(stack.numbers[0]), stack if len(kept) == stack.size else stack.take(np.array(kept)))
    for k in np.flatnonzero(owner < 0).tolist():
        add(k)
    loops, watches = zip(*built, strict=True)
    rows = batch.owners
    fields = batch.dim, ["energy", *names], loops, watches, corrections, owner[rows], batch.has_noise
    return Loops(*fields, columns=columns, numbers=number[rows], corrected=rows)


def loops_of_members(systems: Sequence[System], compiled: Sequence[CompiledLoop]) -> Loops:
    """Return loops that track the energy only, given for one system or for each member, in a batch of its own."""
    watches = [_watch_of(system, loop, {}) for system, loop in zip(systems, compiled, strict=True)]
    loops = Loops(systems[0].dim, ["energy"], compiled, watches)
    if len(systems) == 1:
        return loops
    pairs = zip(compiled, watches, strict=True)
    return loops.with_groups(individual_groups((loop.name, loop.tables, watch.tables) for loop, watch in pairs))


def _watch_of(system: System, loop: CompiledLoop, tracked: Mapping[str, Any], compact: bool = False) -> CompiledTables:
    """Return the tables of the energy and the tracked invariants, with work integrals also of their balances."""
    from coadjoint.kernels.tables.invariants import balance_tables, watch_tables

    if system.has_matrices:
        count = (1 + len(tracked)) * (2 if loop.work_integrals else 1) - 1
        return watch_tables(system, dict.fromkeys(map(str, range(count)), UNTRACKED))
    if loop.work_integrals:
        return balance_tables(system, tracked, loop.work_integrals)
    return watch_tables(system, tracked, compact)


def _correction_of(system: System, loop: CompiledLoop, representation: Representation) -> ShiftCorrection | None:
    if not loop.shift or representation is None:
        return None
    from coadjoint.runs.loops.shifted_attitude import ShiftCorrection

    return ShiftCorrection(system, loop.shift, representation)


def uncorrected_groups(start: Start, times: Times, saved: NamedArrays, points: int) -> NDArray[np.float64]:
    """Return the group elements (points, members, d, d) saved by the loops, transposed back."""
    return np.swapaxes(saved["group"][:points].reshape(points, *start.groups.shape), 2, 3)


def as_rows(groups: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert group elements (members, d, d) to the storage of the loops: transposed, (members, d*d)."""
    return groups.swapaxes(1, 2).reshape(len(groups), -1)
