"""Runs of one member with crossings of events or own steps, to be differentiated; derivatives of the crossings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.crossings import WatchedEvents, coordinate_of
from coadjoint.runs.derivatives.differentiable_run import Arguments, DifferentiableRun, Trajectory
from coadjoint.runs.derivatives.segments import Segment
from coadjoint.runs.events import RecordedEvents
from coadjoint.runs.partial_steps import PartialSteps, reject_noisy_derivatives
from coadjoint.runs.times import OutputTimes, Times
from coadjoint.systems.coordinates import coordinates_of
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.parameter_differences import NODES, WEIGHTS
from coadjoint.systems.step_derivatives import derivative_of
from coadjoint.systems.user_functions import with_time

Floats = NDArray[np.float64]

SAME_TIME = 64 * UNIT_ROUNDOFF  # times that differ by less, relative to the times of the run, are one
DISTANCE = 2.0**-6  # of the nodes of differences along a partial step, relative to the step


class LocatedTrajectory(Trajectory):
    """A run of one member with its outputs, which are the points of the solution and the crossings of events."""

    def _integrate(self, run: DifferentiableRun, given: Arguments, moments: OutputTimes | None) -> None:
        prepared, times = run.prepared, self.times
        assert self.start.single
        reject_noisy_derivatives(run.system)
        self.solution = prepared.run(**given.keywords)
        steps = prepared.at_fixed_steps(run.scheme)
        self.loops = steps.loops(times.h)
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
            self.crossings = CrossingDerivatives(self, run.system, found, np.arange(plain, len(self.t)))
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
        self.segments = []
        while True:
            length, memory = method.next_length(start.system, x[0], float(forward), memory)
            lengths.append(abs(length))
            if forward * (elapsed[-1] + length) > last - tolerance:
                break
            t = times.t0 + elapsed[-1]
            elements, number = group.reshape(1, self.side, self.side), len(lengths) - 1
            self.segments.append(Segment.of_step(float(t), float(length), x, elements, before=number))
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
        # Behind the coordinates are the work integrals of forces.
        return after[:, : self.n], groups


def _before(times: Times, t: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the step before each crossing, and the length of the partial or whole step to it."""
    steps = (t - times.t0) / times.h
    nearest = np.rint(steps)
    whole = np.abs(steps - nearest) <= SAME_TIME * (1.0 + np.abs(steps) + abs(times.t0 / times.h))
    number = np.clip(np.where(whole, nearest - 1.0, np.floor(steps)), 0, None).astype(np.int64)
    return number, np.where(whole & (nearest > 0), times.h, t - times.at(number))


class CrossingDerivatives:
    """Crossings of a run of one member, which are `rows` of its outputs."""

    # Where g vanishes after a partial step from a saved one; derivatives by its length are differences of order 8.

    def __init__(self, trajectory: LocatedTrajectory, system: Any, found: RecordedEvents, rows: Any) -> None:
        self.rows, t = rows, trajectory.t[rows]
        points, lengths = trajectory.point[rows], trajectory.length[rows]
        momenta, t0 = trajectory.start.momenta[0], trajectory.times.t0
        watched = WatchedEvents(system, found.asked, momenta, t0)
        start, loops, members = trajectory.start, trajectory.loops, np.zeros(len(rows), dtype=np.int64)
        n, d = trajectory.n, trajectory.side
        self.of_x, self.of_g = np.zeros((len(rows), n)), np.zeros(len(rows))
        self.of_energy, self.of_attitude = np.zeros(len(rows)), np.zeros((len(rows), d, d))
        distance = DISTANCE * trajectory.scale[rows] * np.sign(trajectory.times.h)
        self._t, self._distance = t, distance
        for node, weight in zip(NODES.tolist(), WEIGHTS.tolist(), strict=True):
            for sign in (1.0, -1.0):
                by, factor = sign * node * distance, sign * weight / distance
                x, groups = trajectory.after(points, lengths + by)
                self.of_x += factor[:, None] * x
                if len(rows):
                    self.of_g += factor * watched.values(x, t + by)[np.arange(len(rows)), found.which]
                energies = [system.energy(row, time) for row, time in zip(x, (t + by).tolist(), strict=True)]
                self.of_energy += factor * np.array(energies)
                if d:
                    elapsed = trajectory.elapsed[rows] + by
                    elements = loops.corrected_groups_at(start, members, elapsed, groups)
                    self.of_attitude += factor[:, None, None] * elements
        x = trajectory.outputs[0][rows, 0]
        self._gradients = np.zeros((len(rows), n))
        for row, (event, time) in enumerate(zip(found.which.tolist(), t.tolist(), strict=True)):
            self._gradients[row] = _gradient(system, found.asked[event].g, x[row], time)

    def slope(self, system: Any, quantity: Any, crossing: int, x: Floats) -> Floats:
        """Return the derivative of an observed quantity by the time of a crossing, at a fixed state."""
        t, distance = float(self._t[crossing]), float(self._distance[crossing])
        total: Any = 0.0
        for node, weight in zip(NODES.tolist(), WEIGHTS.tolist(), strict=True):
            after, before = (function_of_rows(system, quantity, t + by * distance)(x) for by in (node, -node))
            total = total + weight / distance * (after - before)
        return np.ravel(total)

    def follow(self, of_x: Floats, of_attitude: Floats | None, of_energy: Floats) -> Floats:
        """Return the tangents of the times, (crossings, 1, k), and let the rows of the tangents follow them."""
        with np.errstate(divide="ignore", invalid="ignore"):
            of_times = -np.einsum("ci,cki->ck", self._gradients, of_x[self.rows, 0]) / self.of_g[:, None]
            of_x[self.rows, 0] += of_times[..., None] * self.of_x[:, None]
            of_energy[self.rows, 0] += of_times * self.of_energy[:, None]
            if of_attitude is not None:
                of_attitude[self.rows, 0] += of_times[..., None, None] * self.of_attitude[:, None]
        return np.asarray(of_times[:, None])

    def pull(self, of_times: Floats, of_x: Floats, of_attitude: Floats | None, of_energy: Floats) -> None:
        """Replace cotangents that follow the crossings by those at fixed times; `of_times` are those of the times."""
        total = of_times + np.einsum("ci,ci->c", self.of_x, of_x[self.rows, 0])
        total = total + self.of_energy * of_energy[self.rows, 0]
        if of_attitude is not None:
            total = total + np.einsum("cab,cab->c", self.of_attitude, of_attitude[self.rows, 0])
        with np.errstate(divide="ignore", invalid="ignore"):
            of_x[self.rows, 0] -= np.where(total == 0.0, 0.0, total / self.of_g)[:, None] * self._gradients


def _gradient(system: Any, g: Any, x: Floats, t: float) -> Floats:
    number = coordinate_of(g, "", coordinates_of(system), len(x))
    if number is not None:
        return np.asarray(np.eye(len(x))[number])
    return np.asarray(derivative_of(function_of_rows(system, g, t), x)[1][0])


def function_of_rows(system: Any, quantity: Any, t: float) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """Return a quantity at a time as a function of a row of numbers, of which matrices are projected."""
    if isinstance(quantity, Quadratic):
        quantity = quantity.bind(system.dim).value
    function = with_time(quantity, "observe")

    def of_row(row: NDArray[Any]) -> NDArray[Any]:
        state = system.states_of(row)
        if system.has_matrices:
            state = system.algebra.projected(system.from_vector(row))
        return np.ravel(function(state, t))

    return of_row
