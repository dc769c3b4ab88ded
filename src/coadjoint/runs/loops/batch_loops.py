"""Compiled loops of a batch; members with tables that differ only in constants share one set of tables."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import NamedArrays
from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import CompiledLoop, MemberBatch
from coadjoint.methods.protocol.automatic_choices import split_jointly
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.loops.loops import Loops, as_rows, unit_row
from coadjoint.runs.loops.rows import MemberTables, Tables, split_members
from coadjoint.runs.loops.shifted_attitude import ShiftCorrection, uncorrected_groups
from coadjoint.runs.start import Representation, Start
from coadjoint.runs.times import Times
from coadjoint.systems.batch import Batch

if TYPE_CHECKING:
    from coadjoint.kernels.tables.compiled import CompiledTables

BATCHES_PER_ROUND = 8
"""Per thread. An interrupt waits until the round ends; each batch costs a call from Python."""


def in_rounds(member_batches: list[MemberBatch], workers: int) -> list[list[MemberBatch]]:
    """Split member batches into rounds of `BATCHES_PER_ROUND` per thread."""
    size = BATCHES_PER_ROUND * workers
    return [member_batches[a : a + size] for a in range(0, len(member_batches), size)]


class Group(NamedTuple):
    """Members with tables of one structure; `members` are their indices in the batch, ascending.

    `tables` and `watch` are those of the first member, with each array of constants (count,) widened to (count,
    stride); without a stride all members share them.
    """

    members: NDArray[np.int64]
    loop: str
    tables: Any
    watch: Any
    stride: int


class BatchLoops(Loops):
    """Loops of a batch; the tables of a member are those of its run alone.

    `representations` holds an array (n, d, d), "coadjoint" or None for each member; h is negative for backward runs.
    """

    def __init__(self, batch: Batch, method: Method, h: float, representations: Sequence[Representation]) -> None:
        from coadjoint.kernels.tables.invariants import balance_tables, watch_tables

        split_jointly(method, batch.distinct)
        names = list(batch[0].casimirs)
        prepared: list[CompiledLoop] = []
        watches: list[CompiledTables] = []
        firsts = np.unique(batch.owners, return_index=True)[1].tolist()
        of_systems = [representations[m] for m in firsts]
        for m, system, representation in zip(firsts, batch.distinct, of_systems, strict=True):
            try:
                prepared.append(method.loop(system, h, representation))
            except (TypeError, ValueError) as error:
                raise type(error)(f"member {m} of the batch: {error}") from error
            casimirs = system.casimirs
            tracked, accounts = {name: casimirs[name] for name in names}, prepared[-1].accounts
            watches.append(balance_tables(system, tracked, accounts) if accounts else watch_tables(system, tracked))
        shift_corrections = [
            ShiftCorrection(system, loop.shift, representation) if loop.shift and representation is not None else None
            for system, loop, representation in zip(batch.distinct, prepared, of_systems, strict=True)
        ]
        # The noise of a member is that of its row.
        self._in_order = any(force.random for system in batch.distinct for force in getattr(system, "forces", ()))
        self._set_up(batch.dim, ["energy", *names], prepared, watches, shift_corrections, batch.owners)

    def _set_up(
        self,
        dim: int,
        names: list[str],
        prepared: list[CompiledLoop],
        watches: list[CompiledTables],
        shift_corrections: list[ShiftCorrection | None],
        owners: NDArray[np.int64],
    ) -> None:
        self.groups = groups_of(prepared, [watch.tables for watch in watches], owners, self._in_order)
        members = np.concatenate([group.members for group in self.groups])
        self.order = None if np.array_equal(members, np.arange(len(members))) else members
        self._shift_corrections = shift_corrections
        self.corrected_groups = (
            partial(corrected_groups_each, shift_corrections, owners) if any(shift_corrections) else uncorrected_groups
        )
        self._prepared, self._watches, self._owners = prepared, watches, owners
        self._first = np.cumsum([0] + [len(group.members) for group in self.groups])
        self.names, self._dim = names, dim
        self.accounts = prepared[0].accounts
        self.size, self.memory = dim + len(self.accounts), max(loop.memory for loop in prepared)

    def selected(self, members: NDArray[np.int64]) -> BatchLoops:
        """Return the loops of these members, from the tables already built."""
        loops = object.__new__(BatchLoops)
        loops._in_order = self._in_order
        chosen, owners = np.unique(self._owners[members], return_inverse=True)
        loops._set_up(
            self._dim,
            self.names,
            [self._prepared[k] for k in chosen],
            [self._watches[k] for k in chosen],
            [self._shift_corrections[k] for k in chosen],
            owners,
        )
        return loops

    @property
    def is_picklable(self) -> bool:
        """Whether the loops can be pickled: all addresses in their tables are those of functions."""
        from coadjoint.kernels.pickling import is_picklable, loop_is_picklable

        return all(map(loop_is_picklable, self._prepared)) and all(
            is_picklable(watch.keepalive) for watch in self._watches
        )

    def __getstate__(self) -> dict[str, Any]:
        """Return the tables of the members in a form that can be pickled."""
        from coadjoint.kernels.pickling import picklable_loop, picklable_tables

        loops, watches = (
            [picklable_loop(loop) for loop in self._prepared],
            [picklable_tables(*watch) for watch in self._watches],
        )
        return {
            "dim": self._dim,
            "names": self.names,
            "loops": loops,
            "watches": watches,
            "shift_corrections": self._shift_corrections,
            "owners": self._owners,
            "in_order": self._in_order,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        from coadjoint.kernels.pickling import restored_loop, restored_tables

        loops, watches = (
            [restored_loop(stored) for stored in state["loops"]],
            [restored_tables(stored) for stored in state["watches"]],
        )
        self._in_order = state["in_order"]
        self._set_up(state["dim"], state["names"], loops, watches, state["shift_corrections"], state["owners"])

    def rounds(self, members: int, workers: int) -> list[list[MemberBatch]]:
        """Return rounds of member batches, each within one group and from a lane boundary."""
        member_batches: list[MemberBatch] = []
        for group, (first, last) in zip(self.groups, pairwise(self._first.tolist()), strict=True):
            for bounds in split_members(first, last, workers, limit("MOST_LANES")):
                member_batches.append(MemberBatch(group.loop, group.tables, group.watch, *bounds, group.stride, first))
        return in_rounds(member_batches, workers)

    def member_tables(self, watch: Any = None) -> MemberTables:
        """Return the tables and the members of each group."""
        return [
            (Tables(group.loop, group.tables, watch or group.watch, group.stride), group.members)
            for group in self.groups
        ]

    def raised(self) -> BaseException | None:
        """Return and clear the exception raised by a user function in the loop of any member."""
        return next((error for loop in self._prepared if (error := loop.raised())), None)

    @property
    def shift_corrections(self) -> Sequence[ShiftCorrection]:
        """Corrections of the members with a shifted Hamiltonian."""
        return [correction for correction in self._shift_corrections if correction is not None]

    def shift_correction_of(self, member: int) -> ShiftCorrection | None:
        return self._shift_corrections[self._owners[member]]

    def initial_groups(self, groups: NDArray[np.float64]) -> NDArray[np.float64]:
        rows, shifted = np.array(as_rows(groups)), [correction is not None for correction in self._shift_corrections]
        rows[np.array(shifted)[self._owners]] = unit_row(groups.shape[-1])
        return rows


def corrected_groups_each(
    shift_corrections: Sequence[ShiftCorrection | None],
    owners: NDArray[np.int64],
    start: Start,
    times: Times,
    saved: NamedArrays,
    points: int,
) -> NDArray[np.float64]:
    """Return the group elements (points, members, d, d), each corrected for the shift of its member's H."""
    groups, address = np.array(uncorrected_groups(start, times, saved, points), order="C"), saved.address_of("group")
    edges = [0, *(np.flatnonzero(np.diff(owners)) + 1).tolist(), len(owners)]
    for first, last in pairwise(edges):
        correction = shift_corrections[owners[first]]
        if correction is not None and points:
            correction.fill(groups, start, times, address, first, last)
    return groups


def groups_of(
    prepared: Sequence[CompiledLoop],
    watches: Sequence[Any],
    owners: NDArray[np.int64] | None = None,
    in_order: bool = False,
) -> list[Group]:
    """Group members with tables that differ only in constants, in the order of their first members.

    `prepared` and `watches` are those of the distinct systems, and `owners` (members,) the number of that of each
    member. The members of a system with so many that they fill the lanes are a group of their own. With `in_order` a
    group has only members that follow each other.

    Examples
    --------
    >>> import coadjoint as co
    >>> from coadjoint.kernels.tables.invariants import watch_tables
    >>> bodies = [co.systems.rigid_body(inertia=(1, 2, third)) for third in (2.5, 2.75, 2.875)]
    >>> own = [co.GaussLegendre(2).loop(body, 0.1) for body in bodies]
    >>> [group.members.tolist() for group in groups_of(own, [watch_tables(b, b.casimirs).tables for b in bodies])]
    [[0, 1, 2]]
    """
    from coadjoint.kernels.tables.structures import as_structure, stacked, structure_of

    block = limit("MOST_LANES")
    owners = np.arange(len(prepared)) if owners is None else owners
    counts = np.bincount(owners)
    owners_by_structure: dict[Hashable, list[int]] = {}
    for k, (loop, watch) in enumerate(zip(prepared, watches, strict=True)):
        alone = counts[k] >= block
        structure = k if alone else (loop.name, structure_of(loop.tables), structure_of(watch))
        owners_by_structure.setdefault(structure, []).append(k)
    keys = list(owners_by_structure)
    key_of_owner = {k: position for position, key in enumerate(keys) for k in owners_by_structure[key]}
    member_keys = np.array([key_of_owner[k] for k in range(len(prepared))])[owners]
    edges = [0, *(np.flatnonzero(np.diff(member_keys)) + 1).tolist(), len(member_keys)]
    sets = (
        [np.arange(first, last) for first, last in pairwise(edges)]
        if in_order
        else [np.flatnonzero(member_keys == position) for position in range(len(keys))]
    )
    groups = []
    for members in sets:
        key = keys[member_keys[members[0]]]
        loop = prepared[owners_by_structure[key][0]]
        if isinstance(key, int):
            groups.append(Group(members, loop.name, as_structure(loop.tables), as_structure(watches[key]), 0))
            continue
        own = owners[members].tolist()
        tables = as_structure(stacked([prepared[k].tables for k in own]))
        watch = as_structure(stacked([watches[k] for k in own]))
        groups.append(Group(members, loop.name, tables, watch, -(-len(members) // block) * block))
    return sorted(groups, key=lambda group: int(group.members[0]))
