"""The compiled loops of a batch: members whose tables differ in their constants alone share one set of tables."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.base import FlowMethod, Method
from coadjoint.program.decompose import decompose_all
from coadjoint.runs.loops import Crew, Work, start_of_loop, unshifted_groups
from coadjoint.runs.prepare import Prepared, loop_of
from coadjoint.runs.start import Representation, Start
from coadjoint.systems.batch import Batch
from coadjoint.systems.lie_poisson import LiePoissonSystem

# So many members to a worker in a round: an interrupt waits for them, and each of them costs a call from Python.
MEMBERS_IN_A_ROUND = 8


class Group(NamedTuple):
    """Members with tables of one structure: `members` are their places in the batch, ascending.

    `tables` and `watch` are those of the first, with each array of constants (count,) become (count, members).
    """

    members: NDArray[np.int64]
    advance: Callable[..., None]
    tables: Any
    watch: Any


class BatchLoops:
    """A batch: each member has the tables that it has alone.

    Parameters
    ----------
    batch : Batch
        What moves.
    method : Method
        The scheme.
    h : float
        Step, negative for backward.
    representations : sequence of (ndarray of shape (n, d, d), "coadjoint", or None)
        What the group element of each member is carried in.
    """

    def __init__(self, batch: Batch, method: Method, h: float, representations: Sequence[Representation]) -> None:
        from coadjoint.kernels.tables import watch_tables
        from coadjoint.kernels.watching import record_start

        if isinstance(method, FlowMethod) and method.parts == "auto":
            # Quicker together; what cannot be split is refused below, where the member can be named.
            with suppress(ValueError):
                decompose_all([system for system in batch if isinstance(system, LiePoissonSystem)])
        names = list(batch[0].casimirs)
        prepared, watches = [], []
        for m, (system, representation) in enumerate(zip(batch, representations, strict=True)):
            try:
                prepared.append(loop_of(system, method, h, representation))
            except (TypeError, ValueError) as error:
                raise type(error)(f"member {m} of the batch: {error}") from error
            casimirs = system.casimirs
            watches.append(watch_tables(system, {name: casimirs[name] for name in names}))
        self.groups = groups_of(prepared, [watch.tables for watch in watches])
        members = np.concatenate([group.members for group in self.groups])
        self.order = None if len(self.groups) == 1 else members
        self._batch, self._representations = batch, representations
        self._shifts = [found.shift for found in prepared]
        self._keep = ([found.keep for found in prepared], [watch.keep for watch in watches])
        self._first = np.cumsum([0] + [len(group.members) for group in self.groups])
        self._record_start = record_start

    def work(self, crew: Crew) -> Work:
        """Return what advances a crew of one member."""
        from coadjoint.kernels.varied_tables import picked

        group, column = self._place(crew[0])
        return Work(group.advance, picked(group.tables, column), picked(group.watch, column))

    def _place(self, member: int) -> tuple[Group, int]:
        number = int(np.searchsorted(self._first, member, side="right")) - 1
        return self.groups[number], member - int(self._first[number])

    def record_start(self, saves: Any, schedule: Any, momenta: NDArray[Any], groups: NDArray[Any]) -> None:
        """Save the initial states, and the values that deviations are measured from."""
        from coadjoint.kernels.varied_tables import picked

        for m in range(len(momenta)):
            group, column = self._place(m)
            # The first saved point of one member is contiguous, and a run of one.
            own = slice(m, m + 1)
            first = saves._replace(
                members=1,
                x=saves.x[:1, own],
                group=saves.group[:1, own],
                values=saves.values[:1, own],
                worst=saves.worst[own],
                first=saves.first[own],
                last=saves.last[own],
            )
            self._record_start(picked(group.watch, column), first, schedule, momenta[own], groups[own])

    def rounds(self, members: int, workers: int) -> list[list[Crew]]:
        """Return rounds of crews of one member each."""
        size = MEMBERS_IN_A_ROUND * workers
        return [[(m, m + 1) for m in range(a, min(a + size, members))] for a in range(0, members, size)]

    def started(self, groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the group elements that the loops start from."""
        return np.array([start_of_loop(shift, own) for shift, own in zip(self._shifts, groups, strict=True)])

    def turned(self, start: Start, elapsed: NDArray[np.float64], groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the group elements of the run from those of the loops."""
        result = np.empty_like(groups)
        for m, (system, shift) in enumerate(zip(self._batch, self._shifts, strict=True)):
            own = slice(m, m + 1)
            alone = Start(start.momenta[own], start.groups[own], self._representations[m], start.single)
            result[:, own] = unshifted_groups(system, shift, alone, elapsed, groups[:, own])
        return result


def groups_of(prepared: Sequence[Prepared], watches: Sequence[Any]) -> list[Group]:
    """Put members together whose tables differ in their constants alone.

    Parameters
    ----------
    prepared : sequence of Prepared
        The loop and tables of each member.
    watches : sequence of Watch
        The invariants of each.

    Returns
    -------
    list of Group
        In the order of their first members.

    Examples
    --------
    >>> import coadjoint as co
    >>> from coadjoint.kernels.tables import watch_tables
    >>> bodies = [co.systems.rigid_body(inertia=(1, 2, third)) for third in (2.5, 2.75, 2.875)]
    >>> own = [loop_of(body, co.GaussLegendre(2), 0.1, None) for body in bodies]
    >>> [group.members.tolist() for group in groups_of(own, [watch_tables(b, b.casimirs).tables for b in bodies])]
    [[0, 1, 2]]
    """
    from coadjoint.kernels.varied_tables import stacked, structure_of

    found: dict[Hashable, list[int]] = {}
    for m, (own, watch) in enumerate(zip(prepared, watches, strict=True)):
        found.setdefault((own.advance, structure_of(own.tables), structure_of(watch)), []).append(m)
    return [
        Group(
            np.array(members, dtype=np.int64),
            prepared[members[0]].advance,
            stacked([prepared[m].tables for m in members]),
            stacked([watches[m] for m in members]),
        )
        for members in found.values()
    ]
