"""The part of a run that does not depend on its state: array layout, member batches and schedule."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from coadjoint.kernels.tables.recording import schedule_of
from coadjoint.runs.loops.loops import Loops
from coadjoint.runs.memory_estimate import check_run_memory
from coadjoint.runs.results.memory_solution import MAX_STATE_NUMBERS, SHARED
from coadjoint.runs.times import Times


class RunSetup:
    """Everything that runs of the same loops and times share, if their group elements have one shape; immutable.

    `groups` is the shape of the initial group elements, (members, d, d). `workers` threads advance members, and
    `inside` share the work of each. ValueError: too little memory.

    Attributes
    ----------
    schedule : bytes
        The schedule for the loops.
    shared : dict
        Fields of solutions that are the same for all runs.
    is_one_round : bool
        Whether a run is one round of calls of a loop in the calling thread, from the momenta alone, with a small state.
    """

    def __init__(
        self,
        loops: Loops,
        times: Times,
        groups: tuple[int, ...],
        watching: bool = False,
        workers: int = 1,
        inside: int = 1,
    ) -> None:
        self.loops, self.times, self.groups = loops, times, groups
        self.watching, self.workers, self.inside, self.events = watching, workers, inside, 0
        self._extent = groups[0], times.points, groups[1] ** 2
        self.plan = loops.plan(*self._extent, workers)
        check_run_memory(self.plan.layout, times, groups[0])
        self.schedule = schedule_of(*times[:4], watching, *times[4:6], threads=inside)
        shared = watching, times, times.points, loops.names, loops.accounts, loops.corrected_groups, None, None, None
        self.shared: dict[str, Any] = dict(zip(SHARED, shared, strict=True))
        special = loops.rows or loops.measured or loops.order is not None or loops.accounts or groups[1]
        small = self.plan.layout.state.size <= MAX_STATE_NUMBERS
        self.is_one_round = small and workers == 1 and not special and len(self.plan.rounds) == 1
        self._whole_run: Callable[[Any], int] | None = None

    @property
    def whole_run(self) -> Callable[[Any], int]:
        """The function that takes all steps of a run that `is_one_round`; see `MemberBatch.whole_run`."""
        if self._whole_run is None:
            self._whole_run = self.plan.rounds[0][0].whole_run(self.plan.layout, self.schedule)
        return self._whole_run

    def with_times(self, times: Times) -> RunSetup:
        """Return the setup of the same runs for other times."""
        setup = RunSetup(self.loops, times, self.groups, self.watching, self.workers, self.inside)
        return setup.with_events(self.events) if self.events else setup

    def from_start(self, times: Times) -> RunSetup | None:
        """Return the setup for the same steps from another start; None for other steps, or marked ones."""
        if times.marks is not None or self.times.marks is not None or times[1:] != self.times[1:]:
            return None
        setup = self._copy()
        setup.times, setup.shared = times, {**self.shared, "_times": times}
        setup.schedule = schedule_of(*times[:4], self.watching, times.passed, threads=self.inside)
        return setup

    def _copy(self) -> RunSetup:
        setup: RunSetup = object.__new__(RunSetup)
        setup.__dict__.update(self.__dict__, _whole_run=None)
        return setup

    def with_events(self, events: int) -> RunSetup:
        """Return the setup of the same runs with the event tables at an address."""
        setup, times = self._copy(), self.times
        setup.events = events
        setup.schedule = schedule_of(*times[:4], self.watching, *times[4:6], events=events, threads=self.inside)
        return setup

    def with_loops(self, loops: Loops) -> RunSetup:
        """Return the setup for loops that differ in the numbers in their tables only."""
        setup = self._copy()
        setup.loops, setup.plan = loops, loops.plan(*self._extent, self.workers)
        setup.is_one_round = self.is_one_round and len(setup.plan.rounds) == 1
        return setup
