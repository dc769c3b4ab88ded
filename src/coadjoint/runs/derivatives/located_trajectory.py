"""Runs of one member to be differentiated, with crossings of events, or with steps that the scheme chooses."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.memory import check_available_memory
from coadjoint.methods.protocol.method import Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.derivatives.crossings import Crossings
from coadjoint.runs.derivatives.differentiable_run import Arguments, DifferentiableRun, Trajectory
from coadjoint.runs.derivatives.stretches import Stretch
from coadjoint.runs.loops.loops import Loops
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.runs.times import Times

if TYPE_CHECKING:
    from coadjoint.runs.output_times import OutputTimes

Floats = NDArray[np.float64]

# Times from the start that differ by less, relative to the times of the run, are one.
SAME_TIME = 64 * UNIT_ROUNDOFF


class LocatedTrajectory(Trajectory):
    """A run of one member with its outputs, which are the points of the solution and the crossings of events."""

    def _integrate(self, run: DifferentiableRun, given: Arguments, moments: OutputTimes | None) -> None:
        prepared, times = run.prepared, self.times
        assert self.start.single
        self.solution = prepared.run(**given.keywords)
        steps = prepared.at_fixed_steps(run.scheme)
        self.loops = cast(Loops, steps.loops(times.h))
        self.parts = PartialSteps(run.system, run.scheme, self.loops)
        found = self.solution.events
        crossing_times = np.zeros(0) if found is None else found.t
        ended = found is not None and bool(np.isfinite(found.ends(1)[0]))
        # The last point of a run that an event has ended is its crossing.
        plain = len(self.solution.t) - ended
        self.t = np.concatenate([self.solution.t[:plain], crossing_times])
        self.saved_rows = np.arange(plain)
        if prepared.method.own_steps:
            self._take_own_steps(prepared.method)
        else:
            number, length = _before(times, crossing_times)
            before = (times.saved, np.zeros(len(times.saved))) if moments is None else (moments.number, moments.length)
            number = np.concatenate([before[0][:plain], number])
            length = np.concatenate([before[1][:plain], length])
            times = times._replace(steps=int(np.max(number, initial=0)))
            self._take_steps(steps, times.with_saved_steps(np.union1d(number, 0)))
            self._locate(number, length)
            self.scale = np.full(len(length), abs(times.h))
        self.outputs = self._at_outputs()
        if found is not None:
            self.crossings = Crossings(self, run.system, found, np.arange(plain, len(self.t)))
        if ended:
            self.saved_rows = np.append(self.saved_rows, len(self.t) - 1)

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
            elements, number = group.reshape(1, self.side, self.side), len(lengths) - 1
            self.stretches.append(Stretch.of_step(float(t), float(length), x, elements, before=number))
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


def _before(times: Times, t: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the step before each crossing, and the length of the partial or whole step to it."""
    steps = (t - times.t0) / times.h
    nearest = np.rint(steps)
    whole = np.abs(steps - nearest) <= SAME_TIME * (1.0 + np.abs(steps) + abs(times.t0 / times.h))
    number = np.clip(np.where(whole, nearest - 1.0, np.floor(steps)), 0, None).astype(np.int64)
    return number, np.where(whole & (nearest > 0), times.h, t - times.at(number))
