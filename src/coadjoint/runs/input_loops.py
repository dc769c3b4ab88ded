"""Compiled loops of a run with inputs: built once; each call writes its inputs into copies of their tables."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.input_tables import InputsNotLocated, InputTables
from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import MemberBatch
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.batch_loops import in_rounds
from coadjoint.runs.batch_rows import MemberTables, Tables, split_members
from coadjoint.runs.inputs import Inputs
from coadjoint.runs.loops import ExecutionPlan, Loops, SystemLoops, values_of_watch
from coadjoint.runs.start import Representation

Floats = NDArray[np.float64]


class InputLoops:
    """Loops for any values of the inputs of a settled scheme; h is negative for backward runs.

    `representation` is an array (n, d, d), "coadjoint" or None. ValueError: the scheme takes no inputs for this system.
    """

    def __init__(self, inputs: Inputs, method: Method, h: float, representation: Representation) -> None:
        random_values = inputs.random_values()
        self.base, other = (
            SystemLoops(inputs.system_at(values), method, h, representation) for values in random_values
        )
        try:
            self.tables = InputTables(
                (self.base.prepared, other.prepared), (self.base.watch, other.watch), random_values
            )
        except InputsNotLocated as reason:
            raise ValueError(f"{method} takes no inputs for {inputs.system.name}: {reason}") from None

    def build_all(self) -> None:
        """Build everything that is otherwise built lazily."""
        self.base.build_all()

    def at(self, values: Floats) -> Loops:
        """Return the loops of one call, from the values of `Inputs.read`, (m,) or (members, m)."""
        try:
            return CallLoops(self, values)
        except OverflowError:
            raise ValueError(
                "the linear term is too large: a completed square overflows; give smaller inputs"
            ) from None


class CallLoops(Loops):
    """Loops of one call, with its inputs in their tables."""

    def __init__(self, input_loops: InputLoops, values: Floats) -> None:
        base, tables = input_loops.base, input_loops.tables
        self._base, self._stride = base, 0
        self.names, self.accounts, self.corrected_groups = base.names, base.accounts, base.corrected_groups
        self.size, self.memory, self.block = base.size, base.memory, base.block
        if values.ndim == 1:
            self._call_tables = [tables.shared(values)]
        elif tables.separate_tables:
            self._call_tables = [tables.shared(own) for own in values]
        else:
            *given, self._stride = tables.each(values)
            self._call_tables = [tuple(given)]

    def plan(self, members: int, points: int, square: int, workers: int) -> ExecutionPlan:
        """Return the plan of the run; its layout, and crews that share tables, are cached from the last call."""
        known = self._base.plan(members, points, square, workers)
        if len(self._call_tables) == 1 and not self._stride:
            rounds = [
                [member_batch.with_tables(*self._call_tables[0]) for member_batch in member_batches]
                for member_batches in known.rounds
            ]
        else:
            rounds = self.rounds(members, workers)
        return ExecutionPlan(known.key, known.layout, rounds)

    def rounds(self, members: int, workers: int) -> list[list[MemberBatch]]:
        """Return the crews of members with individual inputs, in common or in separate tables."""
        loop = self._base.prepared.name
        if self._stride:
            places = split_members(0, members, workers, limit("LARGEST_CROWD"))
            return [[MemberBatch(loop, *self._call_tables[0], *own, self._stride) for own in places]]
        return in_rounds(
            [MemberBatch(loop, *own, m, m + 1, base=m) for m, own in enumerate(self._call_tables)], workers
        )

    def pieces(self, watch: Any = None) -> MemberTables:
        """Return the tables of all members, or those of each member."""
        loop = self._base.prepared.name
        if len(self._call_tables) == 1:
            return [(Tables(loop, self._call_tables[0][0], watch or self._call_tables[0][1], self._stride), None)]
        return [(Tables(loop, own[0], watch or own[1]), np.array([m])) for m, own in enumerate(self._call_tables)]

    def values_at(self, state: Floats, t: float, last: Floats) -> Floats:
        return values_of_watch(self._call_tables[0][1], self._base.period, state, t, last)  # inputs change no period

    def raised(self) -> BaseException | None:
        """Return the exception that a user's function raised in the loop."""
        return self._base.raised()

    def initial_groups(self, groups: Floats) -> Floats:
        return self._base.initial_groups(groups)
