"""Runs with events: chunks of steps, each followed by the location of its crossings."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import codes
from coadjoint.kernels.tables.recording import EventArrays, FlaggedSteps
from coadjoint.long_operations import progress_bar
from coadjoint.runs.crossings import Crossings, Failures, WatchedEvents
from coadjoint.runs.events import RecordedEvents, TerminalEvent
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.runs.run import Run

# Steps of the first chunk, few because an event may end a run soon, and the most of a later one.
FIRST_CHUNK = 256
MAX_STEPS = 2**16
MAX_CHUNK_BYTES = 2**28
"""Memory of a chunk; only the part with events is written."""


class EventRun:
    """Steps of a run, which is at its start, with location of events."""

    def __init__(self, run: Run, watched: WatchedEvents) -> None:
        self.run, self.watched = run, watched
        self.parts = PartialSteps(run.plan.system, run.plan.method, run.loops, run.plan.workers)
        members, extent = len(run.start.momenta), run.plan.layout.extent
        count = len(watched.events)
        per_step = EventArrays.bytes_per_step(members, count, extent.size, extent.square)
        chunk = min(run.times.steps, MAX_STEPS, max(1, MAX_CHUNK_BYTES // per_step)) + 1
        self._max_chunk = max(chunk - 1, 1)
        remaining = np.tile(watched.until, (members, 1))
        self.arrays = EventArrays(
            watched.compiled.tables, watched.direction, remaining, extent.size, extent.square, chunk
        )
        order = run.loops.order
        self._order = np.arange(members) if order is None else order
        self._crossing_counts = np.zeros((members, count), dtype=np.int64)
        self._crossings: list[Crossings] = []
        self._packed_members = members
        self._pending: FlaggedSteps | None = None  # flags of steps beyond the current chunk
        self._failed: Failures = {}
        run.plan = run.plan.with_events(self.arrays.address)
        self._checkpoint = run.state.copy(), self.arrays.copy()  # state before the steps not yet searched

    def advance(self, progress: bool = False) -> None:
        run, chunk = self.run, min(FIRST_CHUNK, self._max_chunk)
        steps, first = run.times.steps, 0
        with progress_bar(steps, progress) as bar:
            while True:
                until = min(steps, first + chunk)
                self._advance_chunk(until)
                bar(until - first)
                first = until
                active = np.flatnonzero(run.state["status"] == codes("Status")["DONE"])
                if until == steps or not (len(active) or (self._pending is not None and len(self._pending.steps))):
                    break
                self._repack_members(active)
                chunk = min(4 * chunk, self._max_chunk)
        run.close(np.minimum(self._limits(), run.state.number))
        self._store_events()

    def _store_events(self) -> None:
        run, crossings = self.run, self.found
        attitude = None
        if run.start.representation is not None:
            attitude = run.loops.corrected_groups_at(
                run.start, crossings.members, crossings.t - run.times.t0, crossings.groups
            )
        states = crossings.states[:, : run.start.momenta.shape[1]]
        run.events = RecordedEvents(
            self.watched.names,
            crossings.t,
            run.start.system.states_of(states),
            crossings.which,
            crossings.members,
            crossings.direction,
            attitude,
            self.watched.coordinates,
            self.watched.events,
        )
        last = int(self._limits()[0])
        if not run.start.single or last >= run.times.steps or run.failed_count:
            return
        points = int(np.searchsorted(run.times.saved, last, side="right"))
        x, t = crossings.states[-1], float(crossings.t[-1])
        values = run.loops.values_at(x, t, run.state["last"][0])
        run.ending = TerminalEvent(points + 1, last + 1, t, x, values, None if attitude is None else attitude[-1])
        if points < run.times.points:
            # With t_eval, all steps may already be saved.
            run.saved["x"][points, 0], run.saved["values"][points, 0] = x, values

    def _repack_members(self, active: NDArray[np.int64]) -> None:
        """Redistribute the active members over the lanes once half of them have ended."""
        if not 0 < 2 * len(active) <= self._packed_members:
            return
        plan = self.run.plan
        rounds = plan.loops.rounds_among(active, plan.workers)
        if rounds is not None:
            self.run.plan, self._packed_members = plan.with_rounds(rounds), len(active)

    def _advance_chunk(self, until: int) -> None:
        """Take the steps up to number `until`, and locate their events."""
        checkpoint = self._checkpoint
        flagged = self._flagged_until(until)
        crossings, failed = self.watched.locate(flagged, self.parts, self.run.times.t0, self.run.times.h)
        # One step may be flagged for one event at its end, and for another after the next step.
        crossings = crossings.select(
            np.lexsort((crossings.which, crossings.t * np.sign(self.run.times.h), crossings.members))
        )
        last = self._record_crossings(crossings)
        for member, (step, failure) in failed.items():
            if step - 1 <= last[member]:
                last[member] = step - 1
                self._failed[member] = step, failure
        if (last < self._limits()).any():
            # A member ended or failed within a step, undetected by the loops: repeat the steps with its limit set.
            ends = np.minimum(self._limits(), last)
            self.run.state, self._pending = checkpoint[0].copy(), None
            self.arrays.restore_arrays(checkpoint[1])
            self.arrays.limit[:] = ends[self._order]
            self._flagged_until(until)
        self._mark_ended()

    def _flagged_until(self, until: int) -> FlaggedSteps:
        """Return the flags of the steps up to number `until`; the loops need one further step to set them."""
        run, batches = self.run, [] if self._pending is None else [self._pending]
        for target in (until, min(until + 1, run.times.steps)):
            # The first call of `advance` initializes the run, even if it has no steps.
            if run.state.number < target or target == 0:
                run.advance(until=target)
            taken = self.arrays.take()
            batches.append(taken._replace(members=self._order[taken.members]))
            if target == until:
                self._checkpoint = run.state.copy(), self.arrays.copy()
        flagged = FlaggedSteps(*(np.concatenate(arrays) for arrays in zip(*batches, strict=True)))
        flagged = flagged.sorted()  # threads flag in any order
        self._pending = flagged.select(flagged.steps > until)
        return flagged.select(flagged.steps <= until)

    def _record_crossings(self, crossings: Crossings) -> NDArray[np.int64]:
        """Record crossings up to the counts of their events; return the last whole step before each terminal event."""
        last = np.full(len(self._order), np.iinfo(np.int64).max)
        rank = self._crossing_counts[crossings.members, crossings.which] + _rank(crossings)
        max_counts = np.array([event.count or np.iinfo(np.int64).max for event in self.watched.events])
        until = self.watched.until[crossings.which]
        ends = np.flatnonzero((until > 0) & (rank == np.where(until > 0, until, -1)))
        # Rows are ordered by time: the first terminal crossing of a member ends it.
        end_rows = np.full(len(self._order), len(rank))
        np.minimum.at(end_rows, crossings.members[ends], ends)
        ended = end_rows < len(rank)
        last[ended] = crossings.steps[end_rows[ended]] - 1
        recorded = crossings.select(
            (rank <= max_counts[crossings.which]) & (np.arange(len(rank)) <= end_rows[crossings.members])
        )
        np.add.at(self._crossing_counts, (recorded.members, recorded.which), 1)
        self._crossings.append(recorded)
        return last

    def _limits(self) -> NDArray[np.int64]:
        """Return the last whole step that each member may take, (members,)."""
        limits = np.empty_like(self.arrays.limit)
        limits[self._order] = self.arrays.limit
        return limits

    def _mark_ended(self) -> None:
        """Mark ended members, which the loops then skip; failures after the end are discarded."""
        state, status = self.run.state, codes("Status")
        limits = self._limits()
        ended = limits < state.number
        failed = state["status"] != status["DONE"]
        state["status"][ended & ~(failed & (state["step"] <= limits))] = status["ENDED"]
        for member, (step, failure) in self._failed.items():
            self.run.mark_failed(member, step, *failure)

    @property
    def found(self) -> Crossings:
        """All crossings, ordered by member and time."""
        pieces = self._crossings
        together = Crossings(*(np.concatenate(arrays) for arrays in zip(*pieces, strict=True)))
        return together.select(np.argsort(together.members, kind="stable"))


def _rank(crossings: Crossings) -> Any:
    """Rank of each crossing, from 1, among those of its member and event."""
    order = np.lexsort((np.arange(len(crossings.t)), crossings.which, crossings.members))
    members, which = crossings.members[order], crossings.which[order]
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = (members[1:] != members[:-1]) | (which[1:] != which[:-1])
    begins = np.maximum.accumulate(np.where(is_first, np.arange(len(order)), 0))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - begins + 1
    return rank
