"""Tangents of whole runs, carried forward with the states."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError, unknown_name
from coadjoint.memory import check_available_memory
from coadjoint.methods.protocol.derivatives import DerivativeTables
from coadjoint.runs.derivatives.differentiable_run import DifferentiableRun, Trajectory
from coadjoint.runs.derivatives.results import Tangents
from coadjoint.runs.results.solution import Solution
from coadjoint.short_repr import short
from coadjoint.validation import are_finite, read_numbers

Floats = NDArray[np.float64]


class Directions:
    """Directions of the initial states, the initial attitudes and the parameters, `count` of each.

    `x0` is (members, count, n), `attitude0` (members, count, d, d), and each of `parameters` (count, entries).
    """

    def __init__(self, run: DifferentiableRun, trajectory: Trajectory, given: Mapping[str, Any]) -> None:
        members, n, d = trajectory.members, trajectory.n, trajectory.side
        single = trajectory.start.single
        shapes: dict[str, tuple[int, ...]] = {"x0": (n,) if single else (members, n)}
        if d:
            shapes["attitude0"] = (d, d) if single else (members, d, d)
        shapes |= {name: parameter.value.shape for name, parameter in run.parameters.items()}
        if not isinstance(given, Mapping):
            raise TypeError(f"directions is {short(given)}; give a mapping from names to arrays")
        counts: dict[str, int | None] = {}
        arrays = {}
        for name, value in given.items():
            if name not in shapes:
                raise unknown_name("direction of this run", name, shapes)
            array, shape = read_numbers(value, f"the direction {name}"), shapes[name]
            if array.shape != shape and array.shape[:-1] != shape:
                raise ValueError(
                    f"the direction {name} has the shape {array.shape}; it must be {shape}, or with a last axis of "
                    "directions"
                )
            if not are_finite(array):
                raise ValueError(f"the direction {name} contains NaN or infinity; every number must be finite")
            counts[name] = array.shape[-1] if array.ndim > len(shape) else None
            arrays[name] = array
        if not arrays:
            raise ValueError(f"no direction was given; the names are {', '.join(shapes)}")
        if len(set(counts.values())) > 1:
            raise ValueError(f"the directions differ in number: {counts}; give all of them the same last axis")
        number = next(iter(counts.values()))
        self.single, self.count = number is None, 1 if number is None else number
        if not self.count:
            raise ValueError("the last axis of the directions is empty; give at least one")

        def rows(name: str) -> Floats:
            """Return (count, ...) directions, zero if not given."""
            if name not in arrays:
                return np.zeros((self.count, *shapes[name]))
            array = arrays[name]
            return array[None] if self.single else np.moveaxis(array, -1, 0)

        self.x0 = np.ascontiguousarray(np.moveaxis(rows("x0").reshape(self.count, members, n), 0, 1))
        groups = rows("attitude0").reshape(self.count, members, d, d) if d else np.zeros((self.count, members, 0, 0))
        self.attitude0 = np.ascontiguousarray(np.moveaxis(groups, 0, 1))
        self.parameters = {name: rows(name).reshape(self.count, -1) for name in run.parameters if name in arrays}

    def of_coefficients(self, tables: DerivativeTables) -> Floats:
        """Return the directions of the coefficients of the tables, (count, their number)."""
        total = np.zeros((self.count, tables.coefficient_count))
        for name, directions in self.parameters.items():
            total += tables.coefficients[name].of_coefficients(directions, tables.coefficient_count)
        return total

    def of_factors(self, tables: DerivativeTables) -> Floats:
        """Return the directions of the factors of subtracted Casimirs, (count, their number)."""
        total = np.zeros((self.count, len(tables.shift)))
        for name, directions in self.parameters.items():
            total += tables.factors[name].of_coefficients(directions, len(tables.shift))
        return total


class OutputTangents(NamedTuple):
    """Tangents of the states (points, members, count, n) and the attitudes (..., d, d) of a run along directions."""

    directions: Directions
    tables: DerivativeTables
    of_x: Floats
    of_attitudes: Floats | None


def tangents_of_outputs(run: DifferentiableRun, trajectory: Trajectory, given: Mapping[str, Any]) -> OutputTangents:
    """Return the tangents of the states and the attitudes of a run along directions."""
    directions = Directions(run, trajectory, given)
    # Parameters without a direction need no added part.
    tables = run.tables(trajectory.times.h, directions.parameters)
    points, numbers = len(trajectory.steps), trajectory.members * (trajectory.n + trajectory.side**2)
    check_available_memory(
        16 * points * numbers * directions.count, f"the tangents of {points} points along {directions.count} directions"
    )
    attitudes = run.attitudes(tables)
    of_x, of_groups = _tangents_at_outputs(trajectory, tables, directions, attitudes is not None and attitudes.shifted)
    if attitudes is None:
        return OutputTangents(directions, tables, of_x, None)
    _, groups = trajectory.outputs
    factors = directions.of_factors(tables)
    for m in range(trajectory.members):
        of_groups[:, m] = attitudes.tangents(
            trajectory.start.momenta[m],
            trajectory.start.groups[m],
            trajectory.elapsed,
            groups[:, m],
            directions.x0[m],
            directions.attitude0[m],
            factors,
            of_groups[:, m],
        )
    return OutputTangents(directions, tables, of_x, of_groups)


def tangents_of_run(
    run: DifferentiableRun, trajectory: Trajectory, given: Mapping[str, Any]
) -> tuple[Solution, Tangents]:
    """Return the solution of a run and its tangents along directions."""
    directions, tables, of_x, of_attitudes = tangents_of_outputs(run, trajectory, given)
    solution, (x, _) = trajectory.solution, trajectory.outputs
    of_energy = np.einsum("pmi,pmki->pmk", gradients_at(run.system, x, solution.t), of_x)
    for name, of_entries in directions.parameters.items():
        of_energy += run.energy(name).at(x) @ of_entries.T

    for name, series in (("x", of_x), ("attitude", of_attitudes), ("energy", of_energy)):
        if series is None:
            continue
        finite = np.isfinite(series).reshape(len(series), -1).all(axis=1)
        if not finite.all():
            first = int(np.argmin(finite))
            raise IntegrationError(
                f"the derivative of {name} overflows at t = {solution.t[first]:g}: small changes grow beyond all "
                "numbers; take a shorter span",
                step=int(trajectory.steps[trajectory.point[first]]),
                time=float(solution.t[first]),
                residual=float("nan"),
                partial=solution,
            )

    def shaped(series: Floats) -> Floats:
        """Move directions (points, members, count, ...) to the last axis, and drop axes that were not given."""
        last = np.moveaxis(series, 2, -1)
        last = last[..., 0] if directions.single else last
        return last[:, 0] if trajectory.start.single else last

    return solution, Tangents(
        x=shaped(of_x),
        attitude=None if of_attitudes is None else shaped(of_attitudes),
        energy=shaped(of_energy),
        rule={name: tables.rules[name] for name in directions.parameters},
    )


def gradients_at(system: Any, x: Floats, times: Floats) -> Floats:
    """Return grad H at states (points, members, n)."""
    gradient = system.hamiltonian.gradient
    return np.array([[gradient(state, t) for state in states] for states, t in zip(x, times.tolist(), strict=True)])


def _tangents_at_outputs(
    trajectory: Trajectory, tables: DerivativeTables, directions: Directions, shifted: bool
) -> tuple[Floats, Floats]:
    """Return the tangents of states, (points, members, count, n), and elements of the loop, (..., d, d).

    Loops of shifted runs start at the unit element, others at the initial attitude.
    """
    coefficients = directions.of_coefficients(tables)
    of_x0, of_A0 = directions.x0, directions.attitude0
    stored = np.zeros_like(of_A0) if shifted else np.ascontiguousarray(np.swapaxes(of_A0, 2, 3))
    (stretch,) = trajectory.stretches
    at_points, at_groups = trajectory.forward(tables, stretch, of_x0, stored, coefficients)
    if trajectory.steps[0] == 0:
        at_points, at_groups = np.concatenate([of_x0[None], at_points]), np.concatenate([stored[None], at_groups])
    of_x, of_groups = at_points[trajectory.point], at_groups[trajectory.point]
    for k in np.flatnonzero(trajectory.length).tolist():
        point = trajectory.point[k]
        (of_x[k],), (of_groups[k],) = trajectory.forward(
            tables, trajectory.partial(k), at_points[point], at_groups[point], coefficients
        )
    return of_x, np.swapaxes(of_groups, 3, 4)
