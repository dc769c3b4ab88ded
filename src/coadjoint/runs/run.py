"""Arrays of a run, and the compiled loops that fill them."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.interface import codes
from coadjoint.kernels.library import kernels
from coadjoint.kernels.loop import NamedArrays, single_blas_thread
from coadjoint.long_operations import paced, progress_bar
from coadjoint.runs.events import RecordedEvents, TerminalEvent
from coadjoint.runs.loops.loops import Loops
from coadjoint.runs.loops.member_batches import failure_text, run_in_threads, status_name
from coadjoint.runs.plan_and_state import Plan, State
from coadjoint.runs.results.memory_solution import solution_of_run
from coadjoint.runs.results.quantities import Observed
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.start import Start
from coadjoint.runs.times import Times
from coadjoint.short_repr import distinct

PIECE_SECONDS = 0.25
"""Target time of a piece of a run that shows its progress, or is stored."""
GROWTH = 2.0
"""Growth of a state from which on a failure may be that of the motion, which grows without bound in finite time."""
# Of a point at which the state is finite.
UNDEFINED = {
    "energy": "the energy at t = {} is not a finite number, though the state is: the Hamiltonian overflows or is "
    "undefined there; start elsewhere, or correct its value",
    "attitude": "the attitude at t = {} is no finite matrix, though the momentum is finite: the group element grows "
    "until it overflows; take a shorter span, or attitude=False",
}
# Largest number of calls of the compiled loop in a run that is rounded in turns.
TURNS = 1024


class Run:
    """A plan and a start, the state after some of the steps, and the points saved so far; a `state` resumes a run."""

    initial: NDArray[np.float64] | None = None  # invariants at the start, if not those of the first saved point
    events: RecordedEvents | None = None
    ending: TerminalEvent | None = None  # that ended a single-member run
    seconds = 0.0
    failed_count = 0

    def __init__(self, plan: Plan, start: Start, state: State | None = None) -> None:
        if state is not None:
            plan = plan.with_times(plan.times.after(state.number))
        self.plan, self.start = plan, start
        self.saved = NamedArrays(plan.layout.saved)
        self.failure_reasons: dict[int, str] = {}
        if state is None:
            groups = plan.loops.initial_groups(start.groups) if plan.groups[1] else None
            self.state = State.of_start(plan.layout, start.momenta, groups)
        else:
            state.check_fits(plan.layout.state)
            self.state = state.copy()
            self.saved.numbers.fill(np.nan)

    @classmethod
    def of_arrays(cls, plan: Plan, start: Start, saved: NamedArrays, state: State) -> Run:
        """Return the run whose loops have filled these arrays."""
        run: Run = object.__new__(cls)
        run.plan, run.start, run.saved, run.state, run.failure_reasons = plan, start, saved, state, {}
        return run

    @property
    def times(self) -> Times:
        return self.plan.times

    @property
    def loops(self) -> Loops:
        return self.plan.loops

    def release_points(self, max_points: int) -> None:
        """Release the saved points, and allocate arrays for those that follow, so many at most."""
        self.plan = self.plan.with_times(self.times._replace(max_points=max_points).after(self.state.number))
        self.saved = NamedArrays(self.plan.layout.saved)
        self.saved.numbers.fill(np.nan)

    @property
    def ends(self) -> NDArray[np.float64]:
        """Times at which events ended the runs of members, (members,); NaN where none did."""
        members = len(self.start.momenta)
        return np.full(members, np.nan) if self.events is None else self.events.ends(members)

    def close(self, last: NDArray[np.int64]) -> None:
        """Discard points saved after the last steps of members that events have ended."""
        order, status = self.loops.order, codes("Status")
        if order is not None and self.state.number < self.times.steps:
            self.saved = self.saved.take(np.argsort(order), 1)
        numbers, state = self.times.saved, self.state["status"]
        ended = state == status["ENDED"]
        self.discard_points(last)
        state[ended] = status["DONE"]
        energy = self.saved["values"][..., 0]
        undefined = ~np.isfinite(energy) & (numbers[:, None] <= last) & (state == status["DONE"])
        self.failed_count = int(np.count_nonzero((state != status["DONE"]) | undefined.any(axis=0)))

    def discard_points(self, last: NDArray[np.int64]) -> None:
        """Discard the points of members, in their order, after their last steps."""
        for name in ("x", "group", "values"):
            self.saved[name][self.times.saved[:, None] > last] = np.nan

    def save_ending(self) -> None:
        """Save the event that ended a single-member run as its last point."""
        # With t_eval, all steps may already be saved.
        if self.ending is not None and self.ending.points <= self.times.points:
            point = self.ending.points - 1, 0
            self.saved["x"][point], self.saved["values"][point] = self.ending.x, self.ending.values

    @property
    def number(self) -> int:
        """Steps so far."""
        return self.state.number

    @property
    def reach(self) -> int:
        """Last step for which there is memory."""
        return self.times.reach

    @property
    def is_over(self) -> bool:
        """Whether no member takes further steps."""
        return self.number == self.times.steps or not (self.state["status"] == codes("Status")["DONE"]).any()

    def advance(self, until: int | None = None) -> None:
        """Take the steps up to number `until`, or all, round by round; an interrupt aborts."""
        plan, state = self.plan, self.state
        loops, order = plan.loops, plan.loops.order
        first, last = state.number, plan.times.steps if until is None else until
        start_time = time.perf_counter()
        if order is not None:
            state.arrays = state.arrays.take(order, 0)
        arrays = plan.layout, plan.schedule, self.saved, state.arrays, first, last
        try:
            with single_blas_thread(loops.rows):
                for member_batches in plan.rounds:
                    self.failed_count += run_in_threads(member_batches, arrays, loops.raised, plan.workers)
        finally:  # the solution so far of an interrupted run has its time, and its members in order
            self.seconds += time.perf_counter() - start_time
            if order is not None:
                state.arrays = state.arrays.take(np.argsort(order), 0)
        if order is not None and last == plan.times.steps:
            self.saved = self.saved.take(np.argsort(order), 1)
        state.number = last
        if loops.matrices is not None:
            numbers = plan.times.saved
            self._measure(np.flatnonzero((numbers <= last) & ((numbers > first) | (first == 0))))

    def _measure(self, points: NDArray[np.int64]) -> None:
        """Compute the invariants of matrices at new saved points, and the largest deviations in each tenth."""
        if not len(points):
            return
        times, worst, loops = self.times, self.state["worst"], self.loops
        at_start = loops.values_of_matrices(self.start.momenta, times.t0)
        for k in points.tolist():
            number = int(times.saved[k])
            t = float(times.at(times.saved[k]))
            values = self.saved["values"][k] = loops.values_of_matrices(self.saved["x"][k], t)
            tenth = max(0, number - 1) * worst.shape[1] // max(1, times.steps)
            with np.errstate(invalid="ignore"):  # members may be about to overflow
                worst[:, tenth] = np.fmax(worst[:, tenth], np.abs(values - at_start))

    def solution(self, observed: Observed | None) -> Solution:
        saved_points = self.saved.offsets.shapes["x"][0] if self.ending is None else self.ending.points
        if not self.failed_count:
            solution = solution_of_run(self, saved_points, observed)
            if self.start.representation is not None and self.loops.attitude_may_overflow(self.start, self.times):
                self._check_attitude(solution)
            return solution
        taken = None
        if self.start.single and self.state["status"][0]:
            failed = int(self.state["step"][0])
            saved_points, taken = int(np.searchsorted(self.times.saved, failed)), failed - 1
        incomplete = "failed" if self.start.single else None
        raise self.failure(solution_of_run(self, saved_points, observed, incomplete=incomplete, _taken=taken))

    def interrupted(self, observed: Observed | None) -> Solution:
        """Return the points saved before an interrupt; members that had not reached a point are NaN there."""
        order, numbers = self.loops.order, self.times.saved
        if order is not None and self.state.number < self.times.steps:
            self.saved = self.saved.take(np.argsort(order), 1)
        x = self.saved["x"]
        # The arrays of a member are zero until its loop has filled them, and then sets the residual to NaN.
        waiting = (self.state["residual"] == 0.0) & (self.state["status"] == 0)
        saved_points = 0
        if not waiting.all():
            for name in ("x", "group", "values"):
                self.saved[name][:, waiting] = np.nan
            reached = np.isfinite(x).any(axis=(1, 2))
            saved_points = int(np.flatnonzero(reached)[-1]) + 1 if reached.any() else 0
        worst, values = self.state["worst"], self.saved["values"]
        worst[:], self.state["status"][:] = 0.0, 0
        if self.loops.matrices is not None:
            self._measure(np.arange(saved_points))
        tenths = np.maximum(0, numbers[:saved_points] - 1) * worst.shape[1] // max(1, self.times.steps)
        with np.errstate(invalid="ignore"):
            for tenth in np.unique(tenths):
                deviations = np.abs(values[:saved_points][tenths == tenth] - values[0])
                worst[:, tenth] = np.fmax.reduce(deviations, axis=0, initial=0.0)
        worst[~np.isfinite(x[:saved_points]).any(axis=(0, 2))] = np.nan
        taken = int(numbers[saved_points - 1]) if saved_points else 0
        return solution_of_run(self, saved_points, observed, incomplete="interrupted", watched=False, _taken=taken)

    def describe_interrupt(self, stopped: KeyboardInterrupt, observed: Observed | None) -> None:
        """Attach the points saved before an interrupt to it."""
        stopped.partial = self.interrupted(observed)  # type: ignore[attr-defined]
        stopped.add_note("The solution so far is the attribute partial of the error; archive= stores it on disk")

    @property
    def failed_members(self) -> NDArray[np.int64]:
        status = codes("Status")
        return np.flatnonzero((self.state["status"] != status["DONE"]) & (self.state["status"] != status["ENDED"]))

    def failure(self, partial: Any) -> IntegrationError:
        failed = self.failed_members
        if len(failed):
            return self._error(int(failed[0]), len(failed), partial)
        solution = solution_of_run(self, self.times.points, None)
        first = first_point_not_finite(solution.energy)
        assert first is not None
        return self.undefined_error("energy", int(self.times.saved[first]), float(solution.t[first]), partial)

    def mark_failed(self, member: int, step: int, status: str, residual: float = np.nan, reason: str = "") -> None:
        """Mark a member as failed in a step, from outside the loops; `reason` replaces the text of the status."""
        state = self.state
        state["status"][member], state["step"][member] = codes("Status")[status], step
        state["residual"][member] = residual
        if reason:
            self.failure_reasons[member] = reason
        self.failed_count += 1

    def _check_attitude(self, solution: Solution) -> None:
        """Raise if a group element overflowed although the momentum did not: the factor of a shift may grow."""
        first = first_point_not_finite(solution.attitude)
        if first is not None:
            raise self.undefined_error("attitude", int(self.times.saved[first]), float(solution.t[first]), solution)

    def undefined_error(self, name: str, step: int, when: float, partial: Any) -> IntegrationError:
        """Return the error for an "energy" or "attitude" that is not finite after a step, at time `when`."""
        message = UNDEFINED[name].format(self._shown(when))
        return IntegrationError(message, step=step, time=when, residual=float("nan"), partial=partial)

    def _error(self, member: int, count: int, partial: Any) -> IntegrationError:
        step = int(self.state["step"][member])
        when = float(self.times.t0 + (step - 1) * self.times.h)
        residual = float(self.state["residual"][member])
        members = (
            "" if self.start.single else f" for {count} of {len(self.start.momenta)} members (first: member {member})"
        )
        status = status_name(self.state["status"][member])
        if member in self.failure_reasons:
            message = f"in step {step}, {self.failure_reasons[member]}{members}"
        else:
            from coadjoint.runs.failure_causes import cause_of_failure

            cause = cause_of_failure(self, member, step) if status in ("OVERFLOWED", "UNDEFINED") else None
            reason, advice = cause or (
                failure_text(status, self.plan.method, residual, bool(self.loops.work_integrals)),
                self._advice(member, step, status),
            )
            message = f"in step {step}, at t = {self._shown(when)}, {reason}{members}; {advice}"
        return IntegrationError(message, step=step, time=when, residual=residual, partial=partial)

    def _advice(self, member: int, step: int, status: str) -> str:
        # The step of a run does not affect adaptive schemes.
        own_steps = self.plan.method.own_steps
        advice = "end t_span before" if own_steps else f"take a smaller step than {abs(self.times.h):g}"
        if status == "PARALLEL":
            return advice + ", or make the vectors orthonormal more often: give a smaller renormalize_every"
        from coadjoint.runs.failure_causes import hint_of_spins

        advice += hint_of_spins(self.start.system.of_member(member), self.start.momenta[member])
        if step > 1 and not own_steps and self._grown(member):
            advice += (
                "; if that fails near the same time, the motion itself grows without bound there: end t_span before"
            )
        return advice

    def _shown(self, when: float) -> str:
        """Format the time of a step, with the digits that distinguish it from the step before."""
        return distinct(when, when - self.times.h)[0]

    def _grown(self, member: int) -> bool:
        """Whether the state of a failed member has grown since the start, as it does where the motion blows up."""
        start = self.start.momenta[member]
        last = self.state["momenta"][member, : len(start)]
        return not np.abs(last).max() <= GROWTH * np.abs(start).max()


def first_point_not_finite(series: Any) -> int | None:
    """Return the index of the first saved point at which a number of a series is not finite, or None."""
    values = np.asarray(series)
    finite = np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    return None if finite.all() else int(np.argmin(finite))


class InPieces(Protocol):
    """How far a run is that takes its steps in pieces, `Run` or `PiecewiseRun`."""

    @property
    def number(self) -> int: ...
    @property
    def reach(self) -> int: ...
    @property
    def is_over(self) -> bool: ...


def in_pieces(
    run: InPieces,
    advance: Callable[[int], None],
    until: int,
    first: int,
    progress: bool = False,
    timed: bool = True,
) -> Iterator[int]:
    """Take the steps up to number `until`, and yield their number after each piece, which the caller uses.

    `advance` takes the steps up to a number. A piece is of `first` steps, and a later one at most four times as long;
    if `timed`, it takes `PIECE_SECONDS`.
    """
    size = first
    with progress_bar(until - run.number, progress) as bar:
        while True:
            before, began = run.number, time.perf_counter()
            advance(min(until, run.reach, before + size))
            taken, seconds = run.number - before, time.perf_counter() - began
            size = paced(taken, seconds, PIECE_SECONDS, 4 * size) if timed else 4 * size
            bar(taken)
            yield run.number
            if run.is_over or run.number >= until:
                break


@contextmanager
def rounding(direction: int) -> Iterator[None]:
    """Let the loops that this thread calls round up (1) or down (-1)."""
    if kernels().set_rounding(ctypes.c_int64(direction)):
        raise RuntimeError("this processor rounds to nearest only")
    try:
        yield
    finally:
        kernels().set_rounding(ctypes.c_int64(0))


def advance_up(run: Run) -> None:
    """Take all steps of a run in one thread, rounded up."""
    with rounding(1):
        run.advance()


def advance_in_turns(run: Run, first: int = 1) -> None:
    """Take all steps in one thread, rounded up and down in turns: errors of constant direction remain."""
    steps = run.times.steps
    turns = min(steps, TURNS)
    for turn in range(turns):
        with rounding(first if turn % 2 == 0 else -first):
            run.advance(until=steps * (turn + 1) // turns)
