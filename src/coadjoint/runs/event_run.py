"""Runs that look for events: some steps in the loops, then the crossings among them, and so on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.description import codes
from coadjoint.kernels.events import EventArrays, Noted
from coadjoint.memory import check_room
from coadjoint.runs.crossings import Crossings, Failed, WatchedEvents
from coadjoint.runs.events import Ending, Events
from coadjoint.runs.loops import Plan
from coadjoint.runs.parts_of_steps import PartsOfSteps
from coadjoint.runs.progress import progress_bar
from coadjoint.runs.run import Run
from coadjoint.systems.kinds import unforced
from coadjoint.systems.matrices.matrix_system import MatrixSystem

FIRST_CHUNK = 256
MOST_STEPS = 2**16
BYTES_OF_A_CHUNK = 2**28
"""Of memory that is only used where events are found."""


class EventRun:
    """The steps of a run, and its events.

    Parameters
    ----------
    run : Run
        The run, at its start.
    watched : WatchedEvents
        What is looked for.
    parts : PartsOfSteps
        Takes parts of steps of the same scheme.

    Attributes
    ----------
    found : Crossings
        All that were found, ordered by member and time.
    last : ndarray of int, shape (members,)
        The last whole step of each member that counts.
    """

    def __init__(self, run: Run, watched: WatchedEvents, parts: PartsOfSteps) -> None:
        self.run, self.watched, self.parts = run, watched, parts
        members, extent = len(run.start.momenta), run.plan.layout.extent
        count = len(watched.events)
        fixed, each = EventArrays.bytes_of(members, count, extent.size, extent.square)
        chunk = min(run.times.steps, MOST_STEPS, max(1, BYTES_OF_A_CHUNK // each)) + 1
        kept = 16 * run.plan.layout.state.size
        check_room(3 * fixed + kept + each * chunk, f"looking for events of {members} members")
        self._most = max(chunk - 1, 1)
        left = np.tile(watched.until, (members, 1))
        self.arrays = EventArrays(watched.compiled.tables, watched.direction, left, extent.size, extent.square, chunk)
        order = run.loops.order
        self._order = np.arange(members) if order is None else order
        self._seen = np.zeros((members, count), dtype=np.int64)
        self._pieces: list[Crossings] = []
        self._abreast = members
        self._held: Noted | None = None  # what was noted of a step that is not over
        self._failed: dict[int, Failed] = {}
        run.look_for(self.arrays.address)
        self._kept = run.state.copy(), self.arrays.copy()  # before the steps of which nothing is known yet

    @property
    def last(self) -> NDArray[np.int64]:
        """The last whole step of each member that counts."""
        found = np.empty_like(self.arrays.limit)
        found[self._order] = self.arrays.limit
        return np.minimum(found, self.run.state.number)

    def advance(self, progress: bool = False) -> None:
        """Take the steps until all members have ended."""
        run, chunk = self.run, min(FIRST_CHUNK, self._most)
        steps, first = run.times.steps, 0
        with progress_bar(steps, progress) as bar:
            while True:
                until = min(steps, first + chunk)
                self._take(until)
                bar(until - first)
                first = until
                going = np.flatnonzero(run.state["status"] == codes("Status")["DONE"])
                if until == steps or not (len(going) or (self._held is not None and len(self._held.steps))):
                    break
                self._move_up(going)
                chunk = min(4 * chunk, self._most)
        run.close(self.last)
        self._tell()

    def _tell(self) -> None:
        """Give the run its events, and where it is of a single member and was ended, its last point."""
        run, found = self.run, self.found
        attitude = None
        if run.start.representation is not None:
            attitude = run.loops.turned_at(run.start, found.members, found.t - run.times.t0, found.groups)
        states = found.states[:, : run.start.momenta.shape[1]]
        plain = unforced(self.watched.system)
        run.events = Events(
            self.watched.names,
            found.t,
            plain.states(states) if isinstance(plain, MatrixSystem) else states.reshape(-1, *run.start.shape),
            found.which,
            found.members,
            found.direction,
            attitude,
            self.watched.coordinates,
            self.watched.events,
        )
        last = int(self._limits()[0])
        if not run.start.single or last >= run.times.steps or run.wrong:
            return
        points = int(np.searchsorted(run.times.saved, last, side="right"))
        x, t = found.states[-1], float(found.t[-1])
        values = run.loops.values_at(x, t, run.state["last"][0])
        run.ending = Ending(points + 1, last + 1, t, x, values, None if attitude is None else attitude[-1])
        if points < run.times.points:
            # Where times are asked for, all of their steps may have been saved before.
            run.saved["x"][points, 0], run.saved["values"][points, 0] = x, values

    def _move_up(self, going: NDArray[np.int64]) -> None:
        """Let the members that are going fill the lanes, where half of those that did have ended."""
        if not 0 < 2 * len(going) <= self._abreast:
            return
        rounds = self.run.loops.rounds_among(going, self.run.workers)
        if rounds is not None:
            plan = self.run.plan
            self.run.plan, self._abreast = Plan(plan.key, plan.layout, rounds), len(going)

    def _take(self, until: int) -> None:
        """Take the steps to number `until`, and find the events in them."""
        kept = self._kept
        noted = self._noted(until)
        found, failed = self.watched.located(noted, self.parts, self.run.times.t0, self.run.times.h)
        # The same step may have been noted for one event when it ended, and for another after the next one.
        found = found.chosen(np.lexsort((found.which, found.t * np.sign(self.run.times.h), found.members)))
        last = self._count(found)
        for each in failed:
            if each.step - 1 <= last[each.member]:
                last[each.member] = each.step - 1
                self._failed[each.member] = each
        if (last < self._limits()).any():
            # A member has ended or failed within a step before the loops could know: they take these steps again.
            ends = np.minimum(self._limits(), last)
            self.run.state, self._held = kept[0].copy(), None
            self.arrays.put_back(kept[1])
            self.arrays.limit[:] = ends[self._order]
            self._noted(until)
        self._end()

    def _noted(self, until: int) -> Noted:
        """Return what the loops note of the steps to number `until`, which they know after one more."""
        run, rows = self.run, [] if self._held is None else [self._held]
        for target in (until, min(until + 1, run.times.steps)):
            # The first steps of a run begin it, even where there are none.
            if run.state.number < target or target == 0:
                run.advance(until=target)
            rows.append(self._rows())
            if target == until:
                self._kept = run.state.copy(), self.arrays.copy()
        noted = Noted(*(np.concatenate(arrays) for arrays in zip(*rows, strict=True)))
        noted = noted.in_order_of(noted.members)  # threads note in any order
        self._held = noted.chosen(noted.steps > until)
        return noted.chosen(noted.steps <= until)

    def _rows(self) -> Noted:
        noted = self.arrays.take()
        return noted._replace(members=self._order[noted.members])

    def _count(self, found: Crossings) -> NDArray[np.int64]:
        """Keep what is of interest; return the last whole step of each member before it ends."""
        last = np.full(len(self._order), np.iinfo(np.int64).max)
        rank = self._seen[found.members, found.which] + _rank(found)
        most = np.array([event.count or np.iinfo(np.int64).max for event in self.watched.events])
        until = self.watched.until[found.which]
        ends = np.flatnonzero((until > 0) & (rank == np.where(until > 0, until, -1)))
        # Rows are ordered by time, so that the first end of each member is its end.
        where = np.full(len(self._order), len(rank))
        np.minimum.at(where, found.members[ends], ends)
        ended = where < len(rank)
        last[ended] = found.steps[where[ended]] - 1
        kept = found.chosen((rank <= most[found.which]) & (np.arange(len(rank)) <= where[found.members]))
        np.add.at(self._seen, (kept.members, kept.which), 1)
        self._pieces.append(kept)
        return last

    def _limits(self) -> NDArray[np.int64]:
        found = np.empty_like(self.arrays.limit)
        found[self._order] = self.arrays.limit
        return found

    def _end(self) -> None:
        """Let the loops leave out members that have ended, whatever became of them afterwards."""
        state, status = self.run.state, codes("Status")
        limits = self._limits()
        ended = limits < state.number
        failed = state["status"] != status["DONE"]
        state["status"][ended & ~(failed & (state["step"] <= limits))] = status["ENDED"]
        for each in self._failed.values():
            self.run.fail(*each)

    @property
    def found(self) -> Crossings:
        """All that were found, ordered by member and time."""
        pieces = self._pieces
        together = Crossings(*(np.concatenate(arrays) for arrays in zip(*pieces, strict=True)))
        return together.chosen(np.argsort(together.members, kind="stable"))


def _rank(found: Crossings) -> Any:
    """Return for each crossing which one it is, from 1, of its member and event."""
    order = np.lexsort((np.arange(len(found.t)), found.which, found.members))
    members, which = found.members[order], found.which[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (members[1:] != members[:-1]) | (which[1:] != which[:-1])
    begins = np.maximum.accumulate(np.where(new, np.arange(len(order)), 0))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - begins + 1
    return rank
