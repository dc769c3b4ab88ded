"""Runs with events: chunks of steps, and times and states of crossings within the steps that the loops have flagged."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.polynomials.monomials import check_names
from coadjoint.kernels.interface import codes
from coadjoint.kernels.tables.recording import EventArrays, FlaggedSteps, values_along
from coadjoint.runs.events import (
    Event,
    RecordedEvents,
    TerminalEvent,
    events_of_numbers,
    joined_events,
    numbers_of_events,
)
from coadjoint.runs.loops.member_batches import status_name
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.runs.plan_and_state import State
from coadjoint.runs.results.quantities import is_formula
from coadjoint.runs.run import Run
from coadjoint.short_repr import distinct, short
from coadjoint.systems.batch import Batch
from coadjoint.systems.coordinates import coordinates_of, number_of_coordinate
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.system import System
from coadjoint.systems.user_functions import with_time
from coadjoint.validation import is_integer, read_integer

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Values = Callable[[NDArray[np.int64], Floats], Floats]
Failures = dict[int, tuple[int, tuple[str, float, str]]]
"""Members that failed during the location of crossings: their step, and status, residual and reason of the failure."""

FIRST_PIECE = 256  # steps, few because an event may end a run soon
# Most steps of a chunk.
MAX_STEPS = 2**16
MAX_CHUNK_BYTES = 2**28
"""Memory of a chunk; only the part with events is written."""
ARRAYS, FAILED = "event arrays ", "event failures"
"""Names of stored numbers: of the arrays of events, with their numbers, and of failures, as JSON."""


class Position(NamedTuple):
    """An `EventRun` after some steps, all of them searched: state, arrays, pieces and counts of crossings, failures."""

    state: State
    arrays: list[NDArray[Any]]
    pieces: int
    counts: Integers
    failed: Failures


class EventRun:
    """Steps of a run with location of events; from its start, or from `stored`, the numbers that it returned there."""

    def __init__(self, run: Run, watched: WatchedEvents, stored: Mapping[str, Any] | None = None) -> None:
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
        self._packed_members = members
        run.plan = run.plan.with_events(self.arrays.address)
        none, failed = np.zeros(0, dtype=np.int64), Failures()
        rows = np.zeros((0, extent.size)), np.zeros((0, extent.square))
        found = self._recorded(Crossings(none, none, np.zeros(0), *rows, none, none))
        if stored is not None:
            found = events_of_numbers(stored, found, members)
            self.arrays.restore_arrays([array[self._order] for array in self._arrays_among(stored)])
            for member, step, (status, residual, reason) in json.loads(bytes(stored[FAILED])):
                failed[member] = step, (status, residual, reason)
                run.mark_failed(member, step, status, residual, reason)
        self._pieces, self._counts, self._failed = [found], np.zeros((members, count), dtype=np.int64), failed
        np.add.at(self._counts, (found.member, found.which), 1)
        self.commit()

    @property
    def found(self) -> RecordedEvents:
        """All crossings of the steps so far, ordered by member and time."""
        return joined_events(self._pieces)

    @property
    def bytes_of_crossings(self) -> int:
        """Memory of the crossings so far."""
        return sum(values.nbytes for piece in self._pieces for values in numbers_of_events(piece).values())

    def stored(self) -> dict[str, NDArray[Any]]:
        """Return the numbers with which a run from its state finds the same events."""
        inverse, failed = np.argsort(self._order), [(m, *failure) for m, failure in self._failed.items()]
        arrays = {f"{ARRAYS}{k}": array[inverse] for k, array in enumerate(self.arrays.copy())}
        return {**numbers_of_events(self.found), **arrays, FAILED: np.frombuffer(json.dumps(failed).encode(), np.uint8)}

    def _arrays_among(self, stored: Mapping[str, Any]) -> list[NDArray[Any]]:
        """Return the arrays of `stored`, in the order of the members; ValueError if they do not fit this run."""
        of_run = self.arrays.copy()
        arrays = [stored[f"{ARRAYS}{k}"] for k in range(len(of_run))]
        for own, array in zip(of_run, arrays, strict=True):
            if (own.shape, own.dtype) != (array.shape, array.dtype):
                raise ValueError(f"an array of events is {array.dtype} of shape {array.shape}, not {own.shape}")
        return arrays

    def close(self) -> None:
        """Discard what members have saved after their ends, and let the run have its events."""
        run = self.run
        run.close(np.minimum(self.limits, run.state.number))
        run.events = self.found
        if run.failed_count:
            run.ending = None
        run.save_ending()

    def advance(self, until: int) -> None:
        """Take the steps up to number `until` in chunks; after an interrupt call `restore`."""
        while True:
            self._advance_chunk(min(until, self.run.number + self._max_chunk))
            if self.run.number == until or self.run.is_over:
                break

    def commit(self) -> None:
        """Let `restore` return to this point."""
        self._position = Position(
            self.run.state.copy(), self.arrays.copy(), len(self._pieces), self._counts, self._failed
        )

    def restore(self) -> None:
        """Return to the end of the last chunk."""
        state, arrays, pieces, self._counts, self._failed = self._position
        self._restore(state, arrays)
        self.run.ending = None
        del self._pieces[pieces:]

    def repack_members(self, packed: int | None = None) -> None:
        """Redistribute the active members over the lanes once half of those `packed` have ended."""
        self._packed_members = packed or self._packed_members
        active = np.flatnonzero(self.run.state["status"] == codes("Status")["DONE"])
        if not 0 < 2 * len(active) <= self._packed_members:
            return
        plan = self.run.plan
        rounds = plan.loops.rounds_among(active, plan.workers)
        if rounds is not None:
            self.run.plan, self._packed_members = plan.with_rounds(rounds), len(active)

    def _restore(self, state: State, arrays: list[NDArray[Any]]) -> None:
        run, order = self.run, self.run.loops.order
        if order is not None and state.number < run.state.number == run.times.steps:
            run.saved = run.saved.take(order, 1)  # which the last step has brought into the order of the members
        run.state = state.copy()
        self.arrays.restore_arrays(arrays)

    def _advance_chunk(self, until: int) -> None:
        """Take the steps up to number `until`, and locate their events."""
        run = self.run
        self.repack_members()
        flagged = self._flagged_until(until)
        crossings, failures = self.watched.locate(flagged, self.parts, run.times.t0, run.times.h)
        # One step may be flagged for one event at its end, and for another after the next step.
        crossings = crossings.select(
            np.lexsort((crossings.which, crossings.t * np.sign(run.times.h), crossings.members))
        )
        crossings, last = self._counted(crossings)
        for member, (step, failure) in failures.items():
            if step - 1 <= last[member]:
                last[member] = step - 1
                self._failed = {**self._failed, member: (step, failure)}
        if (last < self.limits).any():
            # A member ended or failed within a step, undetected by the loops: repeat the steps with its limit set.
            ends = np.minimum(self.limits, last)
            self._restore(self._position.state, self._position.arrays)
            self.arrays.limit[:] = ends[self._order]
            self._flagged_until(until)
        self._mark_ended()
        if len(crossings.t):
            self._pieces.append(self._recorded(crossings))
            self._counts = self._counts.copy()
            np.add.at(self._counts, (crossings.members, crossings.which), 1)
            if run.start.single and run.state["status"][0] == codes("Status")["ENDED"]:
                self._end(crossings)
        self.commit()

    def _flagged_until(self, until: int) -> FlaggedSteps:
        """Take the steps up to number `until`; return their flags, which the loops set in one further step."""
        run, first, batches = self.run, self._position.state.number, []
        for target in sorted({until, min(until + 1, run.times.steps)}):
            # The first call of `advance` initializes the run, even if it has no steps.
            if run.state.number < target or target == 0:
                run.advance(until=target)
            taken = self.arrays.take()
            batches.append(taken._replace(members=self._order[taken.members]))
            if target == until:
                state, arrays = run.state.copy(), self.arrays.copy()
        self._restore(state, arrays)
        flagged = FlaggedSteps(*(np.concatenate(arrays) for arrays in zip(*batches, strict=True)))
        flagged = flagged.sorted()  # threads flag in any order
        return flagged.select((flagged.steps > first) & (flagged.steps <= until))

    def _counted(self, crossings: Crossings) -> tuple[Crossings, Integers]:
        """Return crossings up to the counts of their events, and the last whole step before each terminal event."""
        last = np.full(len(self._order), np.iinfo(np.int64).max)
        rank = self._counts[crossings.members, crossings.which] + _rank(crossings)
        max_counts = np.array([event.count or np.iinfo(np.int64).max for event in self.watched.events])
        until = self.watched.until[crossings.which]
        ends = np.flatnonzero((until > 0) & (rank == np.where(until > 0, until, -1)))
        # Rows are ordered by time: the first terminal crossing of a member ends it.
        end_rows = np.full(len(self._order), len(rank))
        np.minimum.at(end_rows, crossings.members[ends], ends)
        ended = end_rows < len(rank)
        last[ended] = crossings.steps[end_rows[ended]] - 1
        counted = (rank <= max_counts[crossings.which]) & (np.arange(len(rank)) <= end_rows[crossings.members])
        return crossings.select(counted), last

    def _recorded(self, crossings: Crossings) -> RecordedEvents:
        run, watched, attitude = self.run, self.watched, None
        if run.start.representation is not None:
            attitude = run.loops.corrected_groups_at(
                run.start, crossings.members, crossings.t - run.times.t0, crossings.groups
            )
        states = run.start.system.states_of(crossings.states[:, : run.start.momenta.shape[1]])
        about = crossings.which, crossings.members, crossings.direction, attitude, watched.coordinates, watched.events
        return RecordedEvents(watched.names, crossings.t, states, *about)

    def _end(self, crossings: Crossings) -> None:
        """Let the last crossing of a single member be the end of its run."""
        run, last, attitude = self.run, int(self.limits[0]), self._pieces[-1].attitude
        points = int(np.searchsorted(run.times.saved, last, side="right"))
        x, t = crossings.states[-1], float(crossings.t[-1])
        values = run.loops.values_at(x, t, run.state["last"][0])
        run.ending = TerminalEvent(points + 1, last + 1, t, x, values, None if attitude is None else attitude[-1])

    @property
    def limits(self) -> NDArray[np.int64]:
        """Last whole step that each member may take, (members,)."""
        limits = np.empty_like(self.arrays.limit)
        limits[self._order] = self.arrays.limit
        return limits

    def _mark_ended(self) -> None:
        """Mark ended members, which the loops then skip; failures after the end are discarded."""
        state, status = self.run.state, codes("Status")
        limits = self.limits
        ended = limits < state.number
        failed = state["status"] != status["DONE"]
        state["status"][ended & ~(failed & (state["step"] <= limits))] = status["ENDED"]
        for member, (step, failure) in self._failed.items():
            self.run.mark_failed(member, step, *failure)


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


MAX_ROUNDS = 200
"""Limit on the rounds of a search; a root takes about seven (bisection down to the smallest float: 1074)."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
"""Part of the bracket that a round of the golden-section search keeps."""
MIN_BRACKET = 2.0**-26
"""Bracket width at a minimum below which function values are indistinguishable, sqrt(2^-52)."""


class Crossings(NamedTuple):
    """Member, step, time, state, group element, event and direction of each of m crossings."""

    members: Integers
    steps: Integers
    t: Floats
    states: Floats
    groups: Floats
    which: Integers
    direction: Integers

    def select(self, selection: Any) -> Crossings:
        return Crossings(*(array[selection] for array in self))


class WatchedEvents:
    """Events compiled for a system, and their location; `coordinates` is empty for matrices."""

    def __init__(self, system: System | Batch, events: Sequence[Event], x0: Floats, t0: float) -> None:
        from coadjoint.kernels.tables.invariants import invariants_table

        plain_system = system.unforced
        self.system, self.events = system, tuple(events)
        known = self.coordinates = coordinates_of(system)
        self.names = names_of(self.events, known)
        functions = [
            (f"the event {name}", _function_of(event, name, plain_system, known, x0, t0))
            for event, name in zip(self.events, self.names, strict=True)
        ]
        self.compiled = invariants_table(functions, plain_system.dim)
        self.direction = np.array([event.direction for event in self.events], dtype=np.int64)
        self.until = np.array([event.until for event in self.events], dtype=np.int64)

    def values(self, states: Floats, t: Floats) -> Floats:
        """Evaluate all events at states (m, n) and times (m,); shape (m, E)."""
        out = np.empty((len(t), 1, len(self.events)))
        values_along(self.compiled.tables, states[:, None], t, out)
        return out[:, 0]

    def locate(self, flagged: FlaggedSteps, parts: PartialSteps, t0: float, h: float) -> tuple[Crossings, Failures]:
        """Return the crossings in the flagged steps, by member and time, and the members that failed."""
        # Crossings of failed members are dropped from the step of the failure on.
        if (raised := self.compiled.raised()) is not None:
            raise raised
        crossing = codes("Crossing")
        search = _Search(self, flagged, parts, t0, h)
        rows, events = np.nonzero((flagged.codes == crossing["RISING"]) | (flagged.codes == crossing["FALLING"]))
        sign_changes = search.between(
            rows, events, np.zeros(len(rows)), flagged.before, np.ones(len(rows)), flagged.after
        )
        pairs = search.pairs(*np.nonzero(flagged.codes == crossing["NEAR"]))
        isolated_crossings = search.isolated_crossings(*np.nonzero(flagged.codes == crossing["BETWEEN"]))
        rows, events, theta, rising = (
            np.concatenate(both) for both in zip(sign_changes, *pairs, isolated_crossings, strict=True)
        )
        selected = (self.direction[events] == 0) | (self.direction[events] == rising)
        rows, events, theta, rising = rows[selected], events[selected], theta[selected], rising[selected]
        # Simultaneous crossings are in the order of the events.
        order = np.lexsort((events, theta, rows))
        rows, events, theta, rising = rows[order], events[order], theta[order], rising[order]
        states, groups = search.states_at(rows, theta)
        members, steps = flagged.members[rows], flagged.steps[rows]
        crossings = Crossings(members, steps, t0 + (steps - 1 + theta) * h, states, groups, events, rising)
        failed = self._failed(flagged, search, t0, h)
        if failed:
            last = dict.fromkeys(flagged.members.tolist(), np.iinfo(np.int64).max)
            last |= {member: step for member, (step, _) in failed.items()}
            crossings = crossings.select(steps < np.array([last[m] for m in members.tolist()], dtype=np.int64))
        return crossings, failed

    def _failed(self, flagged: FlaggedSteps, search: _Search, t0: float, h: float) -> Failures:
        """Return the first failure of each member that failed."""
        undefined = flagged.codes == codes("Crossing")["UNDEFINED"]
        rows = np.flatnonzero(undefined.any(axis=1) | (search.status != 0))
        failures: Failures = {}
        for row in rows[np.argsort(flagged.steps[rows], kind="stable")].tolist():
            member, step = int(flagged.members[row]), int(flagged.steps[row])
            if member in failures:
                continue
            if undefined[row].any():
                name = self.names[int(np.argmax(undefined[row]))]
                when = distinct(t0 + step * h, t0 + (step - 1) * h)[0]
                reason = f"the event {name} is not a number at t = {when}; its function is undefined there"
                failures[member] = step, ("UNDEFINED", np.nan, reason)
            else:
                status, residual = status_name(search.status[row]), float(search.residual[row])
                failures[member] = step, (status, residual, "")
        return failures


class _Search:
    """Event functions evaluated within the flagged steps."""

    def __init__(self, watched: WatchedEvents, flagged: FlaggedSteps, parts: PartialSteps, t0: float, h: float) -> None:
        self.watched, self.flagged, self.parts, self.h = watched, flagged, parts, h
        self.begin: Floats = np.asarray(t0 + (flagged.steps - 1) * h, dtype=np.float64)
        # Statuses and residuals of partial steps that fail.
        self.status = np.zeros(len(flagged.steps), dtype=np.int64)
        self.residual = np.full(len(flagged.steps), np.nan)
        # Resolution of the roots: the spacing of floats at the time of the step.
        self.least = np.maximum(2.0**-52, 0.5 * np.spacing(np.abs(self.begin) + abs(h)) / abs(h))

    def states_at(self, rows: Integers, theta: Floats) -> tuple[Floats, Floats]:
        """Return states and group elements at fractions `theta` of the steps; NaN where the partial step fails."""
        flagged = self.flagged
        result = self.parts.attempt(
            flagged.states[rows], flagged.groups[rows], self.begin[rows], theta * self.h, flagged.members[rows]
        )
        failed = result.status != 0
        # A step may occur in several rows, one for each event; the last failure is recorded.
        self.status[rows[failed]], self.residual[rows[failed]] = result.status[failed], result.residual[failed]
        return result.momenta, result.groups

    def values(self, rows: Integers, events: Integers, theta: Floats) -> Floats:
        states, _ = self.states_at(rows, theta)
        return self.watched.values(states, self.begin[rows] + theta * self.h)[np.arange(len(rows)), events]

    def between(
        self, rows: Integers, events: Integers, low: Floats, before: Floats, high: Floats, after: Floats
    ) -> tuple[Integers, Integers, Floats, Integers]:
        """Return the roots between two points of a step with known values of the events."""
        selection = (rows, events) if before.ndim > 1 else slice(None)
        first, last = before[selection], after[selection]
        theta = roots(
            lambda subset, t: self.values(rows[subset], events[subset], low[subset] + t * (high - low)[subset]),
            first,
            last,
            self.least[rows] / np.maximum(high - low, 2.0**-52),
        )
        return rows, events, low + theta * (high - low), np.where(first < 0.0, 1, -1)

    def isolated_crossings(self, rows: Integers, events: Integers) -> tuple[Integers, Integers, Floats, Integers]:
        """Return the crossings in the intervals that the series of a scheme has isolated."""
        low, high = self.flagged.before[rows, events], self.flagged.after[rows, events]
        at_start = self.watched.values(self.flagged.states[rows], self.begin[rows])[np.arange(len(rows)), events]
        first = np.where(low == 0.0, at_start, self.values(rows, events, low))
        last = self.values(rows, events, high)
        # A root moved past an end of its interval by rounding is spurious or belongs to the next interval.
        bracketed = (first != 0.0) & (np.sign(first) != np.sign(last))
        return self.between(*(a[bracketed] for a in (rows, events, low, first, high, last)))

    def pairs(self, rows: Integers, events: Integers) -> list[tuple[Integers, Integers, Floats, Integers]]:
        """Return the crossings in steps where g may go through zero and back."""
        first, last = self.flagged.before[rows, events], self.flagged.after[rows, events]
        side = np.sign(first)
        theta, value = minimize_each(
            lambda subset, t: side[subset] * self.values(rows[subset], events[subset], t), len(rows)
        )
        crossed = value <= 0.0
        rows, events, side, theta = rows[crossed], events[crossed], side[crossed], theta[crossed]
        middle, zeros, ones = side * value[crossed], np.zeros(len(rows)), np.ones(len(rows))
        left = self.between(rows, events, zeros, first[crossed], theta, middle)
        # A zero without a change of sign belongs to the left part.
        through = middle != 0.0
        right = self.between(*(a[through] for a in (rows, events, theta, middle, ones, last[crossed])))
        return [left, right]


def names_of(events: Sequence[Event], coordinates: Sequence[str]) -> tuple[str, ...]:
    """Return the names of events: as given, else that of the coordinate, else "event k"."""
    names: list[str] = []
    for k, event in enumerate(events):
        name, g = event.name, cast(Any, event.g)
        if name is None and is_integer(g):
            name = dict(enumerate(coordinates)).get(g)
        elif name is None and not callable(g):
            name = g
        if event.name is None and (name is None or name in names):
            name = f"event {k}"
        if name in names:
            raise ValueError(f"two events have the name {short(name)}; give each a name= of its own")
        names.append(str(name))
    return tuple(names)


def _function_of(event: Event, name: str, plain_system: Any, coordinates: Sequence[str], x0: Floats, t0: float) -> Any:
    """Return the object of an event that the kernels compile."""
    g, n, matrices = cast(Any, event.g), plain_system.dim, plain_system.has_matrices
    if matrices and not callable(g):
        raise TypeError(
            f"the event {name} is about coordinates, and the states of {plain_system.name} are matrices; give a "
            "function of a matrix"
        )
    number = coordinate_of(g, name, coordinates, n)
    if number is not None:
        return Quadratic(0.0, linear=np.eye(1, n, number)[0])
    check_names(g, coordinates, f"the event {name}")
    if is_formula(g):
        return g
    function, start = with_time(g, name), plain_system.states_of(x0) if matrices else x0
    value = function(start.copy(), t0)
    if np.ndim(value) != 0 or np.asarray(value).dtype.kind not in "iuf":
        raise TypeError(f"the event {name} returns {short(value)} at the start; it must return one real number")
    if not matrices:
        return Invariant(g)

    def of_row(x: Floats, t: float = 0.0) -> float:
        return float(function(plain_system.states_of(x), t))

    of_row.called_in_python = True  # type: ignore[attr-defined]
    return Invariant(of_row)


def coordinate_of(g: Any, name: str, coordinates: Sequence[str], n: int) -> int | None:
    """Return the number of the coordinate of the event of this name; None if its g is a function."""
    if callable(g):
        return None
    if is_integer(g):
        return read_integer(g, "g", 0, n - 1)
    if g not in coordinates and set("+-*/^") & set(g):
        raise ValueError(
            f"the event {name} is {short(g)}, which is no coordinate; give a polynomial, "
            f"co.Polynomial({short(g)}, basis={short(tuple(coordinates), 200)})"
        )
    return number_of_coordinate(coordinates, g)


def roots(values: Values, before: Floats, after: Floats, resolution: Floats) -> Floats:
    """Find a root of each of m functions between 0 and 1, where the values `before` and `after` differ in sign."""
    # T. R. Chandrupatla, Adv. Eng. Softw. 28 (1997) 145-149; the first point is that of the secant.
    found = np.ones(len(before))
    indices = np.flatnonzero(after != 0.0)
    a, b, fa, fb = np.ones(len(indices)), np.zeros(len(indices)), after[indices], before[indices]
    with np.errstate(invalid="ignore", over="ignore"):
        secant = fa / (fa - fb)
    t = np.clip(np.where(np.isfinite(secant), secant, 0.5), 0.01, 0.99)
    for _ in range(MAX_ROUNDS):
        if not len(indices):
            break
        middle = a + t * (b - a)
        fm = values(indices, middle)
        same = np.sign(fm) == np.sign(fa)
        c, fc = np.where(same, a, b), np.where(same, fa, fb)
        b, fb = np.where(same, b, a), np.where(same, fb, fa)
        a, fa = middle, fm
        best = np.where(np.abs(fa) < np.abs(fb), a, b)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            least_t = resolution[indices] / np.abs(b - a)
            done = (least_t > 0.5) | (fa == 0.0) | np.isnan(fm)
            xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb)
            quadratic = fa / (fb - fa) * (fc / (fb - fc)) + (c - a) / (b - a) * (fa / (fc - fa)) * (fb / (fc - fb))
            accepted = (phi * phi < xi) & ((1.0 - phi) ** 2 < 1.0 - xi)
            t = np.clip(np.where(accepted, quadratic, 0.5), least_t, 1.0 - least_t)
        found[indices] = np.where(fa == 0.0, a, best)
        if done.any():
            active = ~done
            indices, a, b, fa, fb, t = indices[active], a[active], b[active], fa[active], fb[active], t[active]
    return found


def minimize_each(values: Values, count: int) -> tuple[Floats, Floats]:
    """Minimize functions, positive at 0 and 1, by golden sections up to a value that is not; return theta and value."""
    position, smallest = np.ones(count), np.full(count, np.inf)
    indices = np.arange(count)
    low, high = np.zeros(count), np.ones(count)
    left, right = high - GOLDEN, low + GOLDEN
    at_left, at_right = values(indices, left), values(indices, right)
    while len(indices):
        lower = at_left < at_right
        position[indices], smallest[indices] = np.where(lower, left, right), np.where(lower, at_left, at_right)
        active = (smallest[indices] > 0.0) & (high - low > MIN_BRACKET)
        indices, low, high, lower = indices[active], low[active], high[active], lower[active]
        left, right, at_left, at_right = left[active], right[active], at_left[active], at_right[active]
        if not len(indices):
            break
        low, high = np.where(lower, low, left), np.where(lower, right, high)
        probe = np.where(lower, high - GOLDEN * (high - low), low + GOLDEN * (high - low))
        value = values(indices, probe)
        left, right = np.where(lower, probe, right), np.where(lower, left, probe)
        at_left, at_right = np.where(lower, value, at_right), np.where(lower, at_left, value)
    return position, smallest
