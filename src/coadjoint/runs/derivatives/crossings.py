"""Derivatives of the crossings of events: their times, and outputs that move with them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.methods.protocol.step_derivatives import derivative_of
from coadjoint.runs.crossings.crossings import WatchedEvents
from coadjoint.systems.coordinates import coordinates_of
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.parameter_differences import NODES, WEIGHTS
from coadjoint.systems.user_functions import takes_time

if TYPE_CHECKING:
    from coadjoint.runs.derivatives.located_trajectory import LocatedTrajectory
    from coadjoint.runs.events import RecordedEvents

Floats = NDArray[np.float64]

# Distance of the nodes of differences along a partial step, relative to the step.
DISTANCE = 2.0**-6


class Crossings:
    """Crossings of a run of one member, which are `rows` of its outputs.

    A crossing is at the time T at which g vanishes after a partial step of length T - t from a saved step. Derivatives
    by T are those of partial steps, by central differences of order 8.
    """

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
    """Return the gradient of the function of an event."""
    if isinstance(g, str):
        g = coordinates_of(system).index(g)
    if isinstance(g, int | np.integer):
        return np.asarray(np.eye(len(x))[g])
    return np.asarray(derivative_of(function_of_rows(system, g, t), x).derivative[0])


def function_of_rows(system: Any, quantity: Any, t: float) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """Return a quantity at a time as a function of a row of numbers, of which matrices are projected."""
    if isinstance(quantity, Quadratic):
        quantity = quantity.bind(system.dim).value
        time_argument: tuple[float, ...] = ()
    else:
        is_function = not isinstance(quantity, Polynomial | Invariant)
        time_argument = (t,) if is_function and takes_time(quantity, "observe") else ()

    def of_row(row: NDArray[Any]) -> NDArray[Any]:
        state = system.states_of(row)
        if system.has_matrices:
            state = system.algebra.projected(system.from_vector(row))
        return np.ravel(quantity(state, *time_argument))

    return of_row
