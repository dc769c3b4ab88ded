"""Runs with events: chunks of steps alternate with the location of crossings in them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.events import EventArrays, Noted
from coadjoint.kernels.interface import codes
from coadjoint.memory import check_room
from coadjoint.runs.crossings import Crossings, Failed, WatchedEvents
from coadjoint.runs.events import Ending, Events
from coadjoint.runs.loops import Plan
from coadjoint.runs.partial_steps import PartsOfSteps
from coadjoint.runs.progress import progress_bar
from coadjoint.runs.run import Run
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.system_checks import unforced

FIRST_CHUNK = 256
MOST_STEPS = 2**16
BYTES_OF_A_CHUNK = 2**28
"""Memory that is touched only where events are found."""


class EventRun:
    """The steps of a run together with the location of its events.

    `parts` takes partial steps of the same scheme; `run` is at its start.
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
        self._held: Noted | None = None  # flags of a step beyond the current chunk
        self._failed: dict[int, Failed] = {}
        run.look_for(self.arrays.address)
        self._kept = run.state.copy(), self.arrays.copy()  # state before the steps not yet searched

    @property
    def last(self) -> NDArray[np.int64]:
        """Last whole step of each member before it ended, shape (members,)."""
        found = np.empty_like(self.arrays.limit)
        found[self._order] = self.arrays.limit
        return np.minimum(found, self.run.state.number)

    def advance(self, progress: bool = False) -> None:
        """Take steps until all members have ended."""
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
        """Store the events in the run; for a single member that an event ended, also its last point."""
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
            # With t_eval, all of its steps may already be saved.
            run.saved["x"][points, 0], run.saved["values"][points, 0] = x, values

    def _move_up(self, going: NDArray[np.int64]) -> None:
        """Redistribute the active members over the lanes once half of them have ended."""
        if not 0 < 2 * len(going) <= self._abreast:
            return
        rounds = self.run.loops.rounds_among(going, self.run.workers)
        if rounds is not None:
            plan = self.run.plan
            self.run.plan, self._abreast = Plan(plan.key, plan.layout, rounds), len(going)

    def _take(self, until: int) -> None:
        """Take the steps up to number `until`, and locate the events in them."""
        kept = self._kept
        noted = self._noted(until)
        found, failed = self.watched.located(noted, self.parts, self.run.times.t0, self.run.times.h)
        # One step may be flagged for one event at its end, and for another after the next step.
        found = found.chosen(np.lexsort((found.which, found.t * np.sign(self.run.times.h), found.members)))
        last = self._count(found)
        for each in failed:
            if each.step - 1 <= last[each.member]:
                last[each.member] = each.step - 1
                self._failed[each.member] = each
        if (last < self._limits()).any():
            # A member ended or failed within a step, unknown to the loops: the steps are repeated with its limit set.
            ends = np.minimum(self._limits(), last)
            self.run.state, self._held = kept[0].copy(), None
            self.arrays.put_back(kept[1])
            self.arrays.limit[:] = ends[self._order]
            self._noted(until)
        self._end()

    def _noted(self, until: int) -> Noted:
        """Return the flags of the steps up to number `until`; the loops need one further step to set them."""
        run, rows = self.run, [] if self._held is None else [self._held]
        for target in (until, min(until + 1, run.times.steps)):
            # The first call of `advance` initializes the run, even if it has no steps.
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
        """Store the crossings of interest; return the last whole step of each member before a terminal event."""
        last = np.full(len(self._order), np.iinfo(np.int64).max)
        rank = self._seen[found.members, found.which] + _rank(found)
        most = np.array([event.count or np.iinfo(np.int64).max for event in self.watched.events])
        until = self.watched.until[found.which]
        ends = np.flatnonzero((until > 0) & (rank == np.where(until > 0, until, -1)))
        # Rows are ordered by time: the first terminal crossing of a member ends it.
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
        """Mark members that have ended, so that the loops skip them; a failure after the end is discarded."""
        state, status = self.run.state, codes("Status")
        limits = self._limits()
        ended = limits < state.number
        failed = state["status"] != status["DONE"]
        state["status"][ended & ~(failed & (state["step"] <= limits))] = status["ENDED"]
        for each in self._failed.values():
            self.run.fail(*each)

    @property
    def found(self) -> Crossings:
        """All crossings, ordered by member and time."""
        pieces = self._pieces
        together = Crossings(*(np.concatenate(arrays) for arrays in zip(*pieces, strict=True)))
        return together.chosen(np.argsort(together.members, kind="stable"))


def _rank(found: Crossings) -> Any:
    """Rank of each crossing, from 1, among those of its member and event."""
    order = np.lexsort((np.arange(len(found.t)), found.which, found.members))
    members, which = found.members[order], found.which[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (members[1:] != members[:-1]) | (which[1:] != which[:-1])
    begins = np.maximum.accumulate(np.where(new, np.arange(len(order)), 0))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - begins + 1
    return rank
