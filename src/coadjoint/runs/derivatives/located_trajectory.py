"""Runs of one member to be differentiated, with crossings of events, or with steps that the scheme chooses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.memory import check_available_memory
from coadjoint.methods.protocol.method import Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.derivatives.crossings import Crossings
from coadjoint.runs.derivatives.differentiable_run import DifferentiableRun, Stretch, Trajectory
from coadjoint.runs.loops.loops import Loops
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.runs.times import Times

if TYPE_CHECKING:
    from coadjoint.runs.events import Event
    from coadjoint.runs.output_times import OutputTimes

Floats = NDArray[np.float64]

# Times from the start that differ by less, relative to the times of the run, are one.
SAME_TIME = 64 * UNIT_ROUNDOFF


def trajectory_of(
    run: DifferentiableRun,
    x0: Any,
    t_span: Any,
    save_every: int,
    t_eval: Any,
    attitude: Any,
    reverse: str | None,
    events: tuple[Event, ...] = (),
    inputs: Mapping[str, Any] | None = None,
) -> Trajectory:
    """Integrate a run to be differentiated."""
    arguments = run, x0, t_span, save_every, t_eval, attitude, reverse
    if not events and not run.prepared.method.own_steps:
        return Trajectory(*arguments, inputs)
    if run.inputs is not None:
        raise TypeError(
            "runs with events or steps of their own have no derivatives with inputs; prepare without inputs="
        )
    run.prepared.values_of({} if inputs is None else inputs)
    return LocatedTrajectory(*arguments, events)


class LocatedTrajectory(Trajectory):
    """A run of one member with its outputs, which are the points of the solution and the crossings of events."""

    def __init__(
        self,
        run: DifferentiableRun,
        x0: Any,
        t_span: Any,
        save_every: int,
        t_eval: Any,
        attitude: Any,
        reverse: str | None,
        events: tuple[Event, ...],
    ) -> None:
        prepared = run.prepared
        self.system, self.values, self.inputs = run.system, None, {}
        self.start = prepared.start(x0, attitude)
        assert self.start.single
        self.members, self.n, self.side = 1, self.start.momenta.shape[1], self.start.groups.shape[1]
        self.solution = prepared.run(x0, t_span, save_every, t_eval=t_eval, attitude=attitude, events=events)
        self.times, moments = prepared.times_of(t_span, save_every, t_eval)
        steps = prepared.at_fixed_steps(run.scheme)
        self.loops = cast(Loops, steps.loops(self.times.h))
        self.parts = PartialSteps(run.system, run.scheme, self.loops)
        found = self.solution.events
        crossing_times = np.zeros(0) if found is None else found.t
        ended = found is not None and bool(np.isfinite(found.ends(1)[0]))
        self._plain, self._ended = len(self.solution.t) - ended, ended
        numbers = _numbers_of(self.times, moments, self._plain)
        self.t = np.concatenate([self.solution.t[: self._plain], crossing_times])
        if prepared.method.own_steps:
            self._take_own_steps(prepared.method)
        else:
            self._take_steps(steps, numbers, crossing_times, reverse)
        self._states, self._elements_at_outputs = self._at_outputs()
        if found is not None:
            rows = np.arange(self._plain, len(self.t))
            self.crossings = Crossings(self, run.system, found, rows)

    def _take_steps(self, prepared: Any, numbers: Any, crossing_times: Floats, reverse: str | None) -> None:
        """Take the whole steps of the run before the last output, in stretches."""
        times = self.times
        number, length = _before(times, crossing_times)
        number, length = np.concatenate([numbers[0], number]), np.concatenate([numbers[1], length])
        times = times._replace(steps=int(np.max(number, initial=0)))
        self.times = times.with_saved_steps(np.union1d(number, 0))
        self._run = prepared.begun(self.times, self.start)
        distance = self._stretch_length() if reverse == "exact" else max(1, times.steps)
        self.stretches = [self._integrated(step, distance) for step in range(0, max(1, times.steps), distance)]
        if reverse == "reversible":
            self.stretches = [self._integrated(times.steps, 0)._replace(k0=0, undone=True)]
        self.steps, self.states = self.times.saved, self._run.saved["x"].copy()
        self.groups = self._elements()
        self.started = times.t0 + self.steps * times.h
        self.length, self.point = length, np.searchsorted(self.steps, number)
        self.elapsed = number * times.h + length
        self.scale = np.full(len(length), abs(times.h))

    def _take_own_steps(self, method: Method) -> None:
        """Repeat the steps of the scheme up to the last output."""
        self.finished, times, start = True, self.times, self.start
        forward, tolerance = np.sign(times.h), SAME_TIME * max(abs(times.t0), abs(times.end), abs(times.h))
        last = float(np.max(forward * (self.t - times.t0), initial=0.0))
        x, group = start.momenta.copy(), np.array(self.loops.initial_groups(start.groups)).reshape(1, -1)
        states, groups, elapsed, memory = [x], [group], [0.0], None
        lengths: list[float] = []
        self.stretches = []
        while True:
            length, memory = method.next_length(start.system, x[0], float(forward), memory)
            lengths.append(abs(length))
            if forward * (elapsed[-1] + length) > last - tolerance:
                break
            if len(lengths) % 1024 == 0:  # not more often, since files of the system are read
                check_available_memory(
                    16 * (x.size + group.size) * len(lengths), "the states of the steps that the scheme chooses"
                )
            t = times.t0 + elapsed[-1]
            self.stretches.append(
                Stretch(
                    t0=float(t),
                    h=float(length),
                    k0=0,
                    k1=1,
                    momenta=x,
                    errors=np.zeros_like(x),
                    groups=group.reshape(1, self.side, self.side),
                    group_errors=np.zeros((1, self.side, self.side)),
                    before=len(lengths) - 1,
                )
            )
            x, group = self.parts.take(x, group, np.array([t]), np.array([length]))
            states.append(x)
            groups.append(group)
            elapsed.append(elapsed[-1] + float(length))
        ends = np.array(elapsed)
        self.steps, self.states = np.arange(len(states)), np.array(states)
        self.groups = np.array(groups).reshape(len(groups), 1, self.side, self.side)
        self.started = times.t0 + ends
        self.elapsed = self.t - times.t0
        after = forward * self.elapsed
        self.point = np.clip(np.searchsorted(forward * ends, after + tolerance, side="right") - 1, 0, None)
        length = self.elapsed - ends[self.point]
        self.length = np.where(np.abs(length) <= tolerance, 0.0, length)
        self.scale = np.array(lengths)[self.point]

    def _at_outputs(self) -> tuple[Floats, Floats]:
        """Return states (points, 1, n) and elements of the loop (points, 1, d, d) at the outputs."""
        x = self.states[self.point, 0, : self.n]
        group = self.groups[self.point, 0].reshape(len(x), -1)
        partial = np.flatnonzero(self.length)
        if len(partial):
            x[partial], group[partial] = self.after(self.point[partial], self.length[partial])
        return x[:, None], np.swapaxes(group.reshape(len(x), 1, self.side, self.side), 2, 3)

    def after(self, points: NDArray[np.int64], lengths: Floats) -> tuple[Floats, Floats]:
        """Return states and elements after partial steps of these lengths from saved steps."""
        x = np.ascontiguousarray(self.states[points, 0])
        group = np.ascontiguousarray(self.groups[points, 0].reshape(len(x), self.side**2))
        starts = np.asarray(self.started[points], dtype=np.float64)
        after, groups = self.parts.take(x, group, starts, lengths, np.zeros(len(x), dtype=np.int64))
        # Behind the coordinates are the accounts of forces.
        return after[:, : self.n], groups

    @property
    def workers(self) -> int:
        return 1

    @property
    def threads_inside(self) -> int:
        # A call takes one of the steps that a scheme chooses: threads would be started for each.
        return 1 if self.finished else super().threads_inside

    @property
    def saved_rows(self) -> Any:
        rows = np.arange(self._plain)
        return np.append(rows, len(self.t) - 1) if self._ended else rows

    @property
    def outputs(self) -> tuple[Floats, Floats]:
        return self._states, self._elements_at_outputs


def _numbers_of(times: Times, moments: OutputTimes | None, count: int) -> tuple[NDArray[np.int64], Floats]:
    """Return the step before each of the first saved points, and the length of the partial step after it."""
    if moments is None:
        return times.saved[:count], np.zeros(count)
    return moments.number[:count], moments.length[:count]


def _before(times: Times, t: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the step before each crossing, and the length of the partial or whole step to it."""
    steps = (t - times.t0) / times.h
    nearest = np.rint(steps)
    whole = np.abs(steps - nearest) <= SAME_TIME * (1.0 + np.abs(steps) + abs(times.t0 / times.h))
    number = np.clip(np.where(whole, nearest - 1.0, np.floor(steps)), 0, None).astype(np.int64)
    return number, np.where(whole & (nearest > 0), times.h, t - times.at(number))
