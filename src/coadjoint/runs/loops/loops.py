"""Compiled loops of a run, built once for a system and a step, and the assignment of members to their tables."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import Extent, Layout, NamedArrays
from coadjoint.kernels.blas_threads import matrix_rows
from coadjoint.kernels.loop import CompiledLoop, MemberBatch
from coadjoint.memory import RELEASED_SIZE, release_freed_memory
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.loops.rows import MemberTables, Tables, split_members
from coadjoint.runs.loops.shifted_attitude import ShiftCorrection, uncorrected_groups
from coadjoint.runs.start import Representation, Start
from coadjoint.runs.times import Times
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.protocol import unforced_matrix_system
from coadjoint.systems.system_checks import System

UNTRACKED = Quadratic(0.0)
"""Placeholder for an invariant that the loops do not track."""
UNPICKLED = ("prepared", "watch", "_keepalive", "_structures", "_plan")
"""Attributes of `SystemLoops` that contain addresses or derive from them; not pickled."""
GroupCorrection = Callable[[Start, Times, NamedArrays, int], NDArray[np.float64]]


class ExecutionPlan:
    """Array layout and rounds of member batches, shared by runs with equal numbers of members and saved points.

    The batches of a round run concurrently; the rounds run one after the other.
    """

    def __init__(self, key: tuple[int, ...], layout: Layout, rounds: list[list[MemberBatch]]) -> None:
        self.key, self.layout, self.rounds = key, layout, rounds


class Loops(ABC):
    """The compiled loops of a run, and further properties of its system; concurrent runs may share them.

    Attributes
    ----------
    order : ndarray or None
        Permutation of the members within a run; None for the given order.
    names : list of str
        The tracked invariants, the energy first.
    accounts : tuple of (str, str)
        Accumulators behind the coordinates of a state: (force, invariant) pairs whose work is recorded. With accounts,
        each of `names` is also tracked minus the work of the forces.
    size : int
        Numbers of a state: the dimension of the system, and the accounts.
    memory : int
        Numbers per member that persist from step to step.
    rows : int
        Rows of the matrices of a matrix system, else 0.
    measures : bool
        Whether `measure` computes invariants that the loops do not track.
    block : int
        Members with the same tables that are advanced side by side.
    corrected_groups : callable
        ``corrected_groups(start, times, saved, points)`` returns the group elements (points, members, d, d) of the run
        from those saved by the loops. It does not keep the tables of the loops alive.
    """

    order: NDArray[np.int64] | None = None
    names: list[str]
    accounts: tuple[tuple[str, str], ...] = ()
    size: int
    memory: int
    rows: int = 0
    measures: bool = False
    block: int = 1
    corrected_groups: GroupCorrection
    _plan: ExecutionPlan | None = None

    @property
    def tracked(self) -> int:
        """Number of values tracked for each member."""
        return len(self.names) * (2 if self.accounts else 1)

    def plan(self, members: int, points: int, square: int, workers: int) -> ExecutionPlan:
        """Return the plan of a run; the last one is cached."""
        key = (members, points, square, workers)
        plan = self._plan
        if plan is None or plan.key != key:
            extent = Extent(members, points, self.size, square, self.tracked, self.memory)
            plan = self._plan = ExecutionPlan(key, Layout(extent), self.rounds(members, workers))
        return plan

    @abstractmethod
    def rounds(self, members: int, workers: int) -> list[list[MemberBatch]]:
        """Return the rounds of member batches."""

    def at_step(self, h: float) -> Loops | None:
        """Return the loops of another step, by the same tables; None if they have to be built again."""
        return None

    def rounds_among(self, members: NDArray[np.int64], workers: int) -> list[list[MemberBatch]] | None:
        """Return rounds of the given members, ascending, packed side by side; None if not supported."""
        return None

    @abstractmethod
    def member_tables(self, watch: Any = None) -> MemberTables:
        """Return the tables of the members, with another watch if one is given."""

    def attitude_may_overflow(self, start: Start, times: Times) -> bool:
        """Whether `corrected_groups` may return infinite elements although those of the loops are finite."""
        return any(correction.may_overflow(start, times) for correction in self.shift_corrections)

    def build_all(self) -> None:
        """Build everything that would be built lazily."""
        for correction in self.shift_corrections:
            correction.build()

    @property
    def shift_corrections(self) -> Sequence[ShiftCorrection]:
        """Corrections applied by `corrected_groups`, one for each system whose H was shifted by a Casimir."""
        return [self.corrected_groups] if isinstance(self.corrected_groups, ShiftCorrection) else []

    def shift_correction_of(self, member: int) -> ShiftCorrection | None:
        """Return the correction of `corrected_groups` for a member, or None if its H was not shifted."""
        return self.corrected_groups if isinstance(self.corrected_groups, ShiftCorrection) else None

    def corrected_groups_at(
        self, start: Start, members: NDArray[np.int64], elapsed: NDArray[np.float64], loop_groups: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return group elements (m, d, d) of members at times since their starts, from those of the loops (m, d*d)."""
        d = start.groups.shape[1]
        groups = np.array(np.swapaxes(loop_groups.reshape(-1, d, d), 1, 2))
        for row, member in enumerate(members.tolist()):
            correction = self.shift_correction_of(member)
            if correction is not None:
                groups[row] = correction.at(start, member, float(elapsed[row]), loop_groups[row])
        return groups

    def values_at(self, state: NDArray[np.float64], t: float, last: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the invariants of a single-member run at a state; multivalued ones on the branch nearest to `last`."""
        raise TypeError(f"{type(self).__name__} has many members")

    def measure(
        self, times: Times, start: Start, saved: NamedArrays, worst: NDArray[Any], points: NDArray[np.int64]
    ) -> None:
        """Compute the invariants that the loops do not track (matrix systems) at the new saved `points`, in place.

        `worst`, (members, tenths, invariants), holds the largest deviations in each tenth of the run.
        """
        return

    def measured_at(self, states: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the invariants that the loops do not track, of states (m, size) at times (m,), or None."""
        return None

    @property
    def is_picklable(self) -> bool:
        """Whether the loops can be pickled."""
        return False

    @abstractmethod
    def raised(self) -> BaseException | None:
        """Return and clear the exception raised by a user function in a loop, or None."""

    @abstractmethod
    def initial_groups(self, groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the initial group elements of the loops, transposed, (members, d*d), or (d*d,) for all members."""


class SystemLoops(Loops):
    """Loops of one system, with the same tables for every member.

    `casimirs` are the invariants tracked beside the energy (None: all Casimirs); `prepared` replaces the loop of
    `method`; `representation` is an array (n, d, d), "coadjoint" or None; h is negative for backward runs. `compact`
    tables, in which rows that repeat are stored once, are not those of a batch.
    """

    def __init__(
        self,
        system: System,
        method: Method,
        h: float,
        representation: Representation,
        casimirs: Mapping[str, Any] | None = None,
        prepared: CompiledLoop | None = None,
        compact: bool = False,
    ) -> None:
        from coadjoint.kernels.interface import limit
        from coadjoint.kernels.tables.invariants import balance_tables, watch_tables

        tracked = system.casimirs if casimirs is None else casimirs
        loop_of = method._shared_loop if compact else method.loop
        prepared = prepared or loop_of(system, h, representation)
        self.accounts = prepared.accounts
        self.rows = matrix_rows(system)
        self._matrices = unforced_matrix_system(system)
        self.measures = self._matrices is not None
        if self._matrices:
            count = (1 + len(tracked)) * (2 if self.accounts else 1) - 1
            watch = watch_tables(system, dict.fromkeys(map(str, range(count)), UNTRACKED))
        else:
            watch = (
                balance_tables(system, tracked, self.accounts)
                if self.accounts
                else watch_tables(system, tracked, compact)
            )
        self.names = ["energy", *tracked]
        self.size, self.memory = system.dim + len(self.accounts), prepared.memory
        self._shifted = representation is not None and bool(prepared.shift)
        self.corrected_groups = (
            ShiftCorrection(system, prepared.shift, representation) if self._shifted else uncorrected_groups
        )
        self.block = limit("MOST_LANES") if system.dim <= limit("WIDEST") else 1
        self._set_tables(prepared, watch)
        if system.dim > RELEASED_SIZE:
            release_freed_memory()

    def _set_tables(self, prepared: CompiledLoop, watch: Any) -> None:
        from coadjoint.kernels.tables.structures import as_structure

        self._keepalive = watch.keepalive
        self.prepared, self.watch = prepared, watch.tables
        # Converted to C structures once for all plans.
        self._structures = prepared.name, as_structure(prepared.tables), as_structure(watch.tables)

    def at_step(self, h: float) -> SystemLoops | None:
        from coadjoint.kernels.tables.flow import FlowTables, at_step
        from coadjoint.kernels.tables.structures import as_structure

        tables = at_step(self.prepared.tables, h) if isinstance(self.prepared.tables, FlowTables) else None
        if tables is None:
            return None
        loops: SystemLoops = object.__new__(SystemLoops)
        loops.__dict__.update(vars(self), prepared=replace(self.prepared, tables=tables), _plan=None)
        loops._structures = self._structures[0], as_structure(tables), self._structures[2]
        return loops

    @property
    def is_picklable(self) -> bool:
        """Whether the loops can be pickled: all addresses in their tables are those of functions."""
        from coadjoint.kernels.pickling import is_picklable, loop_is_picklable

        return loop_is_picklable(self.prepared) and is_picklable(self._keepalive)

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes, with the tables in a form that can be pickled."""
        from coadjoint.kernels.pickling import picklable_loop, picklable_tables

        picklable = {name: value for name, value in vars(self).items() if name not in UNPICKLED}
        return {**picklable, "tables": (picklable_loop(self.prepared), picklable_tables(self.watch, self._keepalive))}

    def __setstate__(self, state: dict[str, Any]) -> None:
        from coadjoint.kernels.pickling import restored_loop, restored_tables

        loop, watch = state.pop("tables")
        self.__dict__.update(state)
        self._set_tables(restored_loop(loop), restored_tables(watch))

    def rounds(self, members: int, workers: int) -> list[list[MemberBatch]]:
        """Return one round with a batch for each thread; members that advance side by side share a batch."""
        return [[self.member_batch(*bounds) for bounds in split_members(0, members, workers, self.block)]]

    def rounds_among(self, members: NDArray[np.int64], workers: int) -> list[list[MemberBatch]] | None:
        batch = self.member_batch(0, 1)
        return [
            [batch.among(members[slice(*bounds)]) for bounds in split_members(0, len(members), workers, self.block)]
        ]

    def member_tables(self, watch: Any = None) -> MemberTables:
        """Return the tables, which all members share."""
        return [(Tables(*self._structures[:2], watch or self._structures[2]), None)]

    def member_batch(self, first: int, last: int, base: int = 0) -> MemberBatch:
        """Return the batch of the members first to last - 1; `base` as for `MemberBatch`."""
        return MemberBatch(*self._structures, first, last, base=base)

    def measure(
        self, times: Times, start: Start, saved: NamedArrays, worst: NDArray[Any], points: NDArray[np.int64]
    ) -> None:
        """Compute the energy and the invariants of the saved matrices."""
        if self._matrices is None or not len(points):
            return
        first = self._values(start.momenta, times.t0)
        for k in points.tolist():
            number = int(times.saved[k])
            values = saved["values"][k] = self._values(saved["x"][k], float(times.at(times.saved[k])))
            tenth = max(0, number - 1) * worst.shape[1] // max(1, times.steps)
            with np.errstate(invalid="ignore"):  # members may be about to overflow
                worst[:, tenth] = np.fmax(worst[:, tenth], np.abs(values - first))

    def values_at(self, state: NDArray[np.float64], t: float, last: NDArray[np.float64]) -> NDArray[np.float64]:
        if self._matrices is not None:
            return self._values(state[None], t)[0]
        return values_of_watch(self.watch, self.period, state, t, last)

    @property
    def period(self) -> NDArray[np.float64]:
        """Periods of the invariants; 0 for those with one value."""
        return np.asarray(getattr(self.watch, "source", self.watch).period)

    def measured_at(self, states: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the energy and the invariants of matrices."""
        if self._matrices is None:
            return None
        return np.concatenate([self._values(x[None], time) for x, time in zip(states, t.tolist(), strict=True)])

    def _values(self, states: NDArray[np.float64], t: float) -> NDArray[np.float64]:
        system = self._matrices
        assert system is not None
        # States after a failure are NaN; user functions are not called on them.
        finite = np.isfinite(states[:, : system.dim]).all(axis=-1)
        result = np.full((len(states), len(self.names) * (2 if self.accounts else 1)), np.nan)
        W = system.from_vector(states[finite, : system.dim])
        with np.errstate(all="ignore"):
            values = [system.energy(W, t), *system.casimirs_at(W).values()]
        if self.accounts:
            # Minus the work of the forces, from the accounts of a state; the start has none.
            work = {name: np.zeros(len(W)) for name in self.names}
            for (_, name), column in zip(self.accounts, states[finite, system.dim :].T, strict=False):
                work[name] += column
            values += [value - work[name] for value, name in zip(values, self.names, strict=True)]
        result[finite] = np.stack(values, axis=-1)
        return result

    def raised(self) -> BaseException | None:
        """Return and clear the exception raised by a user function in the loop."""
        return self.prepared.raised()

    def initial_groups(self, groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the initial elements; for a shifted run unit elements, which `corrected_groups` replaces."""
        return unit_row(groups.shape[-1]) if self._shifted else as_rows(groups)


def values_of_watch(
    watch: Any, period: NDArray[np.float64], state: NDArray[np.float64], t: float, last: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the invariants of a watch at a state; those with a period > 0 on the branch nearest to `last`."""
    from coadjoint.kernels.tables.recording import values_along

    values = np.empty((1, 1, len(last)))
    values_along(watch, state[None, None], np.array([t]), values)
    with np.errstate(divide="ignore", invalid="ignore"):
        periods = np.where(period > 0.0, np.floor((last - values[0, 0]) / period + 0.5), 0.0)
    return np.asarray(values[0, 0] + period * periods)


@lru_cache(maxsize=8)
def unit_row(size: int) -> NDArray[np.float64]:
    """Return the unit element in the storage of the loops, (d*d,)."""
    return np.eye(size).ravel()


def as_rows(groups: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert group elements (members, d, d) to the storage of the loops: transposed, (members, d*d)."""
    return np.swapaxes(groups, 1, 2).reshape(len(groups), -1)
