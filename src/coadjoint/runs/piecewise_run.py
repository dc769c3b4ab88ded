"""Runs in pieces, with memory independent of their length; between pieces a run can be stored and resumed bitwise."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial, reduce
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.interface import codes
from coadjoint.runs.events import Event
from coadjoint.runs.plan_and_state import State
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.memory_solution import REPORTED_ARRAYS, solution_of_run
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.run import first_point_not_finite, in_pieces
from coadjoint.runs.start import Start
from coadjoint.runs.times import Times

if TYPE_CHECKING:
    from coadjoint.runs.crossings import EventRun

STATE_PREFIX = "state."
"""Prefix of the arrays of a `State` among those that are stored."""
FIRST_PIECE = 64  # steps
TAKING_INTERVAL, TAKING_RATIO = 10.0, 20
"""A piece is taken after 10 s, or after 20 times the duration of the last time."""
NOT_OCCURRED = np.array([-1.0, np.nan])
"""Step and time of an event that has not occurred."""


class PiecewiseRun:
    """A run that holds only the points saved since the last `release_points`, at most `max_points`."""

    # Pieces end at multiples of `max_points`; `order_undefined` after an interrupt that left a batch out of order.

    def __init__(
        self,
        prepared: PreparedRun,
        times: Times,
        start: Start,
        max_points: int,
        stored: Mapping[str, Any] | None = None,
        events: tuple[Event, ...] = (),
    ) -> None:
        self._observed = prepared.observed(start)
        state = None if stored is None else state_of(stored)
        if state is not None and state.number == 0:
            state = None  # no step yet: begin at the start
        self._max_points = max_points
        passed = 0 if state is None else times.after(state.number).passed
        # At least two: the start alone would leave no room for a step.
        points_held = max_points - passed % max_points if passed else max(2, max_points)
        self._spare = 1 if events else 0  # of the step that events look ahead, or the end of a run by an event
        self.run = prepared.begun(times._replace(max_points=points_held + self._spare), start, state=state)
        worst = self.run.state["worst"]
        self._earlier_worst: NDArray[np.float64] = np.zeros_like(worst)
        self._undefined = {"energy": NOT_OCCURRED, "attitude": NOT_OCCURRED}
        self._may_overflow = start.representation is not None and self.run.loops.attitude_may_overflow(start, times)
        if stored is not None:
            self._earlier_worst = np.array(stored["earlier"])
            self._undefined = {name: np.array(stored[f"undefined {name}"]) for name in self._undefined}
            self.run.initial = np.array(stored["initial"])
        self.order_undefined = False
        self._events: EventRun | None = None
        if events:
            from coadjoint.runs.crossings import EventRun

            watched = prepared.watched(events, start.momenta[0], times.t0)
            self._events = EventRun(self.run, watched, None if state is None else stored)

    @property
    def number(self) -> int:
        """Steps so far, the one in which an event ended a single-member run included."""
        return self.run.state.number if self.run.ending is None else self.run.ending.steps

    @property
    def reach(self) -> int:
        """Last step that can be taken before `release_points`."""
        times = self.run.times
        return times._replace(max_points=cast(int, times.max_points) - self._spare).reach

    @property
    def bytes_of_state(self) -> int:
        """Size of `stored`, about."""
        return self.run.state.arrays.numbers.nbytes + self.bytes_of_crossings

    @property
    def bytes_of_crossings(self) -> int:
        return 0 if self._events is None else self._events.bytes_of_crossings

    @property
    def points_held(self) -> int:
        if self.run.ending is not None:
            return self.run.ending.points
        numbers, state = self.run.times.saved, self.run.state
        if self.run.start.single and state["status"][0] not in (codes("Status")["DONE"], codes("Status")["ENDED"]):
            return int(np.searchsorted(numbers, state["step"][0]))
        return int(np.searchsorted(numbers, state.number, side="right"))

    @property
    def is_over(self) -> bool:
        """Whether no steps remain: all are done, or the only member has failed."""
        return self.number == self.run.times.steps or (self.run.start.single and bool(self.run.state["status"][0]))

    def advance(self, until: int) -> None:
        """Take the steps up to number `until`, at most `reach`; an interrupt discards (the last of) them."""
        events, run = self._events, self.run
        restore = partial(setattr, run, "state", run.state.copy()) if events is None else events.restore
        try:
            (events or run).advance(until)
        except BaseException:
            restore()
            self.order_undefined = self.run.loops.order is not None
            raise
        if self.run.initial is None:
            first, order = self.run.saved["values"][0], self.run.loops.order
            if order is None or until == self.run.times.steps:
                self.run.initial = first.copy()
            else:
                self.run.initial = first[np.argsort(order)]

    def advance_into(
        self, take: Callable[[PiecewiseRun], None], until: int | None = None, progress: bool = False
    ) -> None:
        """Take the steps up to number `until`, or all; `take` uses what they save, such as an archive.

        It reads the points in memory, `piece`, and the state, `stored`, released afterwards: when memory is full, every
        ten seconds or less often, before an interrupt, and at the end.
        """
        last = self.run.times.steps if until is None else until
        taken, seconds, when = -1, 0.0, time.perf_counter()
        if not self.is_over and self.number < last:
            try:
                for number in in_pieces(self, self.advance, last, FIRST_PIECE, progress):
                    now = time.perf_counter()
                    if number == self.reach or now - when > max(TAKING_INTERVAL, TAKING_RATIO * seconds):
                        taken = number
                        take(self)
                        self.release_points()
                        when = time.perf_counter()
                        seconds = when - now
            except KeyboardInterrupt:
                if taken != self.number and not self.order_undefined:
                    take(self)
                raise
        if taken != self.number:
            take(self)

    def piece(self) -> Solution:
        """Return the points in memory, with drifts and work of all steps so far; then call `release_points`."""
        run, order = self.run, self.run.loops.order
        if order is not None and self.number < run.times.steps:
            run.saved = run.saved.take(np.argsort(order), 1)
        reported = run.state.arrays.subset(REPORTED_ARRAYS)
        reported["worst"][:] = self.worst
        if self._events is not None:
            ended = reported["status"] == codes("Status")["ENDED"]
            reported["status"][ended] = codes("Status")["DONE"]
            run.discard_points(self._events.limits)
            run.save_ending()
            run.events = self._events.found
        solution = solution_of_run(run, self.points_held, self._observed, _state=reported)
        self._record_undefined(solution)
        return solution

    @property
    def first(self) -> int:
        """Index, among all saved points, of the first one in memory."""
        return self.run.times.passed

    def release_points(self) -> None:
        """Release the saved points in memory; no-op before the first step."""
        run = self.run
        if self.number:
            passed = run.times.after(run.state.number).passed
            run.release_points(self._max_points - passed % self._max_points + self._spare)
            if self._events is not None:
                self._events.repack_members(packed=len(run.start.momenta))

    @property
    def worst(self) -> NDArray[np.float64]:
        """Largest deviations in each tenth of the run so far, (members, tenths, invariants)."""
        return larger_deviations(self._earlier_worst, self.run.state["worst"])

    def stored(self, begin_block: bool = False) -> dict[str, Any]:
        """Return the numbers from which the run resumes bitwise; `block` has the largest deviations since its begin."""
        assert self.run.initial is not None
        block = reduce(larger_deviations, np.moveaxis(self.run.state["worst"], 1, 0))
        if begin_block:
            self._earlier_worst = self.worst
            self.run.state["worst"][:] = 0.0
            if self._events is not None:
                self._events.commit()
        return {
            **{f"{STATE_PREFIX}{name}": value for name, value in self.run.state.to_mapping().items()},
            "earlier": self._earlier_worst,
            "block": block,
            "initial": self.run.initial,
            **{f"undefined {name}": position for name, position in self._undefined.items()},
            **({} if self._events is None else self._events.stored()),
        }

    def failure(self, partial: Any) -> IntegrationError | None:
        """Return the error of a run that is `is_over`, with its partial solution, or None."""
        if len(self.run.failed_members):
            return self.run.failure(partial)
        for name, occurred in self._undefined.items():
            step, when = occurred.tolist()
            if step >= 0:
                return self.run.undefined_error(name, int(step), when, partial)
        return None

    def _record_undefined(self, solution: Solution) -> None:
        """Record the first point at which an energy or a group element is not finite although the state is."""
        status = self.run.state["status"]
        running, shape = np.ones(len(status), dtype=bool), (len(solution.t), len(status))
        running[self.run.failed_members] = False
        series = {"energy": solution.energy.reshape(shape)[:, running]}
        if self._may_overflow and solution.attitude is not None:
            series["attitude"] = solution.attitude.reshape(*shape, solution.attitude.shape[-1] ** 2)[:, running]
        if self._events is not None:
            ended = self.run.times.saved[: len(solution.t), None] > self._events.limits[running]
            series = {name: np.where(ended.T, 0.0, values.T).T for name, values in series.items()}
        for name, values in series.items():
            first = first_point_not_finite(values)
            if first is not None and self._undefined[name][0] < 0:
                self._undefined[name] = np.array([self.run.times.saved[first], solution.t[first]])


def state_of(stored: Mapping[str, Any]) -> State:
    """Extract the `State` from the stored arrays of a run."""
    return State.from_mapping(
        {name[len(STATE_PREFIX) :]: stored[name] for name in stored if name.startswith(STATE_PREFIX)}
    )


def larger_deviations(earlier: NDArray[np.float64], later: NDArray[np.float64]) -> NDArray[np.float64]:
    """Combine largest deviations of two successive pieces with the NaN semantics of the loops.

    >>> larger_deviations(np.array([1.0, 2.0, np.nan, 3.0]), np.array([2.0, 1.0, 0.0, np.nan]))
    array([ 2.,  2., nan, nan])
    """
    return np.where((later <= earlier) | (later == 0.0), earlier, later)
