"""Compiled loops of a run with inputs: built once; each call writes its inputs into copies of their tables."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.input_tables import InputTables, NotPlaced
from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import Crew
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.batch_loops import in_rounds
from coadjoint.runs.batch_rows import Pieces, Tables, shared_out
from coadjoint.runs.inputs import Inputs
from coadjoint.runs.loops import Loops, Plan, SystemLoops, values_of_watch
from coadjoint.runs.start import Representation

Floats = NDArray[np.float64]


class InputLoops:
    """Loops for any values of the inputs of a settled scheme; h is negative for backward runs.

    `representation` is an array (n, d, d), "coadjoint" or None. ValueError: the scheme takes no inputs for this system.
    """

    def __init__(self, inputs: Inputs, method: Method, h: float, representation: Representation) -> None:
        drawn = inputs.drawn()
        self.base, other = (SystemLoops(inputs.system_at(values), method, h, representation) for values in drawn)
        try:
            self.tables = InputTables((self.base.prepared, other.prepared), (self.base.watch, other.watch), drawn)
        except NotPlaced as reason:
            raise ValueError(f"{method} takes no inputs for {inputs.system.name}: {reason}") from None

    def make_all(self) -> None:
        """Build everything that is otherwise built lazily."""
        self.base.make_all()

    def at(self, values: Floats) -> Loops:
        """Return the loops of one call, from the values of `Inputs.read`, (m,) or (members, m)."""
        try:
            return LoopsOfCall(self, values)
        except OverflowError:
            raise ValueError(
                "the linear term is too large: a completed square overflows; give smaller inputs"
            ) from None


class LoopsOfCall(Loops):
    """Loops of one call, with its inputs in their tables."""

    def __init__(self, made: InputLoops, values: Floats) -> None:
        base, tables = made.base, made.tables
        self._base, self._stride = base, 0
        self.names, self.accounts, self.turned = base.names, base.accounts, base.turned
        self.size, self.memory, self.block = base.size, base.memory, base.block
        if values.ndim == 1:
            self._given = [tables.shared(values)]
        elif tables.apart:
            self._given = [tables.shared(own) for own in values]
        else:
            *given, self._stride = tables.each(values)
            self._given = [tuple(given)]

    def plan(self, members: int, points: int, square: int, workers: int) -> Plan:
        """Return the plan of the run; its layout, and crews that share tables, are cached from the last call."""
        known = self._base.plan(members, points, square, workers)
        if len(self._given) == 1 and not self._stride:
            rounds = [[crew.reading(*self._given[0]) for crew in crews] for crews in known.rounds]
        else:
            rounds = self.rounds(members, workers)
        return Plan(known.key, known.layout, rounds)

    def rounds(self, members: int, workers: int) -> list[list[Crew]]:
        """Return the crews of members with individual inputs, in common or in separate tables."""
        loop = self._base.prepared.name
        if self._stride:
            places = shared_out(0, members, workers, limit("LARGEST_CROWD"))
            return [[Crew(loop, *self._given[0], *own, self._stride) for own in places]]
        return in_rounds([Crew(loop, *own, m, m + 1, base=m) for m, own in enumerate(self._given)], workers)

    def pieces(self, watch: Any = None) -> Pieces:
        """Return the tables of all members, or those of each member."""
        loop = self._base.prepared.name
        if len(self._given) == 1:
            return [(Tables(loop, self._given[0][0], watch or self._given[0][1], self._stride), None)]
        return [(Tables(loop, own[0], watch or own[1]), np.array([m])) for m, own in enumerate(self._given)]

    def values_at(self, state: Floats, t: float, last: Floats) -> Floats:
        return values_of_watch(self._given[0][1], self._base.period, state, t, last)  # inputs change no period

    def raised(self) -> BaseException | None:
        """Return the exception that a user's function raised in the loop."""
        return self._base.raised()

    def started(self, groups: Floats) -> Floats:
        return self._base.started(groups)
