"""Compiled loops of runs with tangent vectors, for one system or for each member of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop, MemberBatch
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.batch_loops import in_rounds
from coadjoint.runs.batch_rows import MemberTables
from coadjoint.runs.loops import Loops, SystemLoops, as_rows
from coadjoint.runs.shifted_attitude import uncorrected_groups
from coadjoint.systems.system_checks import System


def energy_loops(systems: Sequence[System], method: Method, h: float, prepared: Sequence[CompiledLoop | None]) -> Loops:
    """Return loops that track the energy only, for one system or one for each member.

    `prepared` are those of `Method.tangent_loop`; None uses the loop without tangent vectors.
    """
    found = [SystemLoops(one, method, h, None, {}, own) for one, own in zip(systems, prepared, strict=True)]
    return found[0] if len(found) == 1 else IndividualLoops(found)


class IndividualLoops(Loops):
    """Loops of members with individual tables, one crew for each member."""

    corrected_groups = staticmethod(uncorrected_groups)

    def __init__(self, members: Sequence[SystemLoops]) -> None:
        self._members = members
        self.names, self.size, self.memory = members[0].names, members[0].size, members[0].memory

    def rounds(self, members: int, workers: int) -> list[list[MemberBatch]]:
        """Return rounds of crews of one member each."""
        return in_rounds([own.member_batch(m, m + 1, m) for m, own in enumerate(self._members)], workers)

    def pieces(self, watch: Any = None) -> MemberTables:
        """Return the tables of each member."""
        return [(own.pieces(watch)[0][0], np.array([m])) for m, own in enumerate(self._members)]

    def raised(self) -> BaseException | None:
        """Return the exception that a user's function raised in the loop of any member."""
        return next((error for own in self._members if (error := own.raised())), None)

    def initial_groups(self, groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the group elements unchanged; none are computed."""
        return as_rows(groups)
