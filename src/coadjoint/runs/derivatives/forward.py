"""Tangents of whole runs, carried forward with the states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError, unknown_name
from coadjoint.memory import check_available_memory
from coadjoint.methods.protocol.derivative_tables import DerivativeTables
from coadjoint.program.sources import Multiples
from coadjoint.runs.derivatives.differentiable_run import DifferentiableRun, Trajectory
from coadjoint.runs.derivatives.run_tables import INPUTS
from coadjoint.runs.results.solution import Solution
from coadjoint.short_repr import record_repr, short
from coadjoint.systems.energy_derivatives import gradients_at
from coadjoint.systems.parameters import unknown_parameter
from coadjoint.validation import read_numbers, to_array

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Tangents:
    """Derivatives of a run along directions of its initial state and its parameters; see `PreparedRun.jvp`.

    Attributes
    ----------
    x : ndarray
        The shape of ``sol.x``, with a trailing axis of directions if these were given with one.
    attitude : ndarray or None
        In the same way for ``sol.attitude``.
    energy : ndarray
        In the same way for ``sol.energy``.
    events : mapping
        In the same way for the crossings of events: "t" for ``sol.events.t``, and "x" for ``sol.events.x``; empty
        without events.
    rule : mapping
        For each parameter, "exact" if the derivative is that of the computed map, "added part" or "differences"; see
        the notes of `PreparedRun.jvp`. Of a batch, the one farthest from the computed map.
    """

    x: Floats
    attitude: Floats | None
    energy: Floats
    events: Mapping[str, Floats] = field(default_factory=dict)
    rule: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        return record_repr(self)


class Directions:
    """Directions of the initial states, the attitudes, the parameters and the inputs, `count` of each."""

    def __init__(self, run: DifferentiableRun, trajectory: Trajectory, given: Mapping[str, Any]) -> None:
        members, n, d = trajectory.members, trajectory.n, trajectory.side
        single, shape = trajectory.start.single, trajectory.start.system.shape
        shapes: dict[str, tuple[int, ...]] = {"x0": shape if single else (members, *shape)}
        if d:
            shapes["attitude0"] = (d, d) if single else (members, d, d)
        shapes |= {name: parameter.value.shape for name, parameter in run.parameters.items()}
        shapes |= {
            f"{INPUTS}.{name}": (members, *indices.shape) if by_member else indices.shape
            for name, (indices, by_member) in trajectory.inputs.items()
        }
        given = _flat(given, run)
        counts: dict[str, int | None] = {}
        arrays = {}
        for name, value in given.items():
            if name not in shapes:
                raise unknown_parameter(run.system, "direction of this run", name, shapes)
            what, shape = f"the direction {name}", shapes[name]
            array = read_like(trajectory.solution.x if name == "x0" else None, value, what)
            check_shape(name, array, shape)
            if not np.isfinite(array).all():
                raise ValueError(f"the direction {name} contains NaN or infinity; every number must be finite")
            counts[name] = array.shape[-1] if array.ndim > len(shape) else None
            arrays[name] = array
        if not arrays:
            known = dict.fromkeys(name.partition(".")[0] for name in shapes)
            raise ValueError(f"no direction was given; the names are {', '.join(known)}")
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

        if not run.system.has_matrices:
            x0 = run.system.rows_of(rows("x0"))
        else:  # these must be in the algebra
            x0 = run.system.read(rows("x0").reshape(-1, *run.system.shape), "the direction x0")
        x0 = np.asarray(x0).reshape(self.count, members, n)
        self.x0 = np.ascontiguousarray(np.moveaxis(x0, 0, 1))
        groups = rows("attitude0").reshape(self.count, members, d, d) if d else np.zeros((self.count, members, 0, 0))
        self.attitude0 = np.ascontiguousarray(np.moveaxis(groups, 0, 1))
        self.by_system = (members,) if run.system.is_batch else ()
        self.parameters = {
            name: np.moveaxis(rows(name).reshape(self.count, *self.by_system, -1), 0, -2)
            for name in run.parameters
            if name in arrays
        }
        for name, directions in self.parameters.items() if trajectory.fixed_velocities else ():
            for some, energy in run.energies(name, members):
                for m in range(members)[some]:
                    own = directions[m] if self.by_system else directions
                    self.x0[m] += trajectory.fixed_velocities[m].along(energy, own)
        directed = {name: one for name, one in trajectory.inputs.items() if f"{INPUTS}.{name}" in arrays}
        self.inputs: Floats | None = None
        if directed and trajectory.values is not None:
            leading = (members, self.count) if any(each for _, each in directed.values()) else (self.count,)
            self.inputs = np.zeros((*leading, trajectory.values.shape[-1]))
            for name, (indices, by_member) in directed.items():
                found = rows(f"{INPUTS}.{name}")
                found = np.swapaxes(found, 0, 1) if by_member else found
                leading = found.shape[: found.ndim - indices.ndim]
                self.inputs[..., indices.ravel()] = found.reshape(*leading, -1)

    @property
    def names(self) -> list[str]:
        """Names of the parameters with directions, and `INPUTS` if there are directions of inputs."""
        return [*self.parameters, *([] if self.inputs is None else [INPUTS])]

    def of_coefficients(self, tables: DerivativeTables) -> Floats:
        """Return the directions of the coefficients of the tables, (count, their number), or of each member."""
        total = self.along(tables.coefficients, tables.coefficient_count)
        if self.inputs is None:
            return total
        rows = self.inputs.reshape(-1, self.inputs.shape[-1])
        by_inputs = tables.coefficients[INPUTS].of_directions(rows, tables.coefficient_count)
        return total + by_inputs.reshape(*self.inputs.shape[:-1], tables.coefficient_count)

    def along(self, maps: Mapping[str, Multiples], number: int) -> Floats:
        """Return the directions (count, number), or of each member, of numbers that maps give for the parameters."""
        total = np.zeros((*self.by_system, self.count, number))
        for name, directions in self.parameters.items():
            total += maps[name].of_directions(directions, number)
        return total


def tangents_of_outputs(
    run: DifferentiableRun, trajectory: Trajectory, given: Mapping[str, Any]
) -> tuple[Directions, Floats, Floats | None]:
    """Return the tangents (points, members, count, n) of the states and (..., d, d) of the attitudes of a run."""
    directions = Directions(run, trajectory, given)
    # Parameters without a direction need no added part.
    tables = run.tables(trajectory.times.h, directions.names)
    points, numbers = len(trajectory.steps), trajectory.members * (trajectory.n + trajectory.side**2)
    check_available_memory(
        16 * points * numbers * directions.count, f"the tangents of {points} points along {directions.count} directions"
    )
    attitudes = run.attitudes(tables)
    of_x, of_groups = _tangents_at_outputs(trajectory, tables, directions, attitudes is not None and attitudes.shifted)
    if attitudes is None:
        return directions, of_x, None
    start, (_, groups) = trajectory.start, trajectory.outputs
    along, of_factors = (directions.x0, directions.attitude0), directions.along(tables.factors, len(tables.shift))
    at_outputs = start.momenta, start.groups, trajectory.elapsed, groups
    return directions, of_x, attitudes.tangents(*at_outputs, *along, of_factors, of_groups)


def tangents_of_run(
    run: DifferentiableRun, trajectory: Trajectory, given: Mapping[str, Any]
) -> tuple[Solution, Tangents]:
    """Return the solution of a run and its tangents along directions."""
    directions, of_x, of_attitudes = tangents_of_outputs(run, trajectory, given)
    solution, (x, _) = trajectory.solution, trajectory.outputs
    rules = run.tables(trajectory.times.h, directions.names).rules
    of_energy = np.einsum("pmi,pmki->pmk", gradients_at(trajectory.system, x, trajectory.t), of_x)
    for name, of_entries in directions.parameters.items():
        each = of_entries if run.system.is_batch else [of_entries]
        for (some, energy), directions_of_some in zip(run.energies(name, trajectory.members), each, strict=True):
            of_energy[:, some] += energy.at(x[:, some]) @ directions_of_some.T
    if run.inputs is not None and directions.inputs is not None:
        at = run.inputs.in_energy
        of_inputs = np.broadcast_to(directions.inputs, (trajectory.members, *directions.inputs.shape[-2:]))
        of_energy += np.einsum("pmi,mki->pmk", x[..., at], of_inputs[..., at])
    of_times = None
    if trajectory.crossings is not None:
        of_times = trajectory.crossings.follow(of_x, of_attitudes, of_energy)

    def shaped(series: Floats, rows: Any = trajectory.saved_rows) -> Floats:
        """Move directions (points, members, count, ...) to the last axis, and drop axes that were not given."""
        last = np.moveaxis(series[rows], 2, -1)
        last = last[..., 0] if directions.single else last
        return last[:, 0] if trajectory.start.single else last

    states, events = run.system.states_of(of_x), {}
    if trajectory.crossings is not None and of_times is not None:
        rows = trajectory.crossings.rows
        events = {"t": shaped(of_times, slice(None)), "x": shaped(states, rows)}
    tangents = Tangents(
        x=shaped(states),
        attitude=None if of_attitudes is None else shaped(of_attitudes),
        energy=shaped(of_energy),
        events=events,
        rule={name: rules[name] for name in directions.names},
    )
    for name, series in (("x", of_x), ("attitude", of_attitudes), ("energy", of_energy)):
        if series is None:
            continue
        finite = np.isfinite(series).all(axis=tuple(range(1, series.ndim)))
        if not finite.all():
            first = int(np.argmin(finite))
            time, step = float(trajectory.t[first]), int(trajectory.steps[trajectory.point[first]])
            raise overflow(f"of {name} overflows at t = {time:g}", step, time, solution, tangents)
    return solution, tangents


def _flat(given: Any, run: DifferentiableRun) -> dict[str, Any]:
    """Return directions by name, with those of inputs as "inputs.name"."""
    found = read_mapping(given, "directions", "names")
    if run.inputs is None:
        return found
    of_inputs = read_mapping(found.pop(INPUTS, {}), "the direction inputs", "names of inputs")
    for name, value in of_inputs.items():
        if name not in run.inputs.indices:
            raise unknown_name("input of this run", name, run.inputs.indices)
        found[f"{INPUTS}.{name}"] = value
    return found


def read_mapping(given: Any, what: str, keys: str) -> dict[str, Any]:
    """Validate a mapping to arrays and return a copy."""
    if not isinstance(given, Mapping):
        raise TypeError(f"{what} is {short(given)}; give a mapping from {keys} to arrays")
    return dict(given)


def _tangents_at_outputs(
    trajectory: Trajectory, tables: DerivativeTables, directions: Directions, shifted: bool
) -> tuple[Floats, Floats]:
    """Return the tangents of states, (points, members, count, n), and elements of the loop, (..., d, d)."""
    coefficients = directions.of_coefficients(tables)
    of_x0, of_A0 = directions.x0, directions.attitude0
    stored = np.zeros_like(of_A0) if shifted else np.ascontiguousarray(np.swapaxes(of_A0, 2, 3))
    points, start = len(trajectory.steps), trajectory.steps[0] == 0
    at_points, at_groups = (np.zeros((points, *one.shape)) for one in (of_x0, stored))
    if start:
        at_points[0], at_groups[0] = of_x0, stored
    last = of_x0, stored
    for segment in trajectory.segments:
        inside = trajectory.inside(segment)
        at_points[inside], at_groups[inside] = trajectory.forward(tables, segment, *last, coefficients)
        if trajectory.finished:
            (end,) = np.flatnonzero(inside)
            last = at_points[end], at_groups[end]
    of_x, of_groups = at_points[trajectory.point], at_groups[trajectory.point]
    for k in np.flatnonzero(trajectory.length).tolist():
        point = trajectory.point[k]
        (of_x[k],), (of_groups[k],) = trajectory.forward(
            tables, trajectory.partial(k), at_points[point], at_groups[point], coefficients
        )
    return of_x, np.swapaxes(of_groups, 3, 4)


def check_shape(name: str, direction: Any, shape: tuple[int, ...]) -> None:
    """Raise ValueError if an array has the shape neither of a direction nor of several ones."""
    if shape not in (direction.shape, direction.shape[:-1]):
        raise ValueError(
            f"the direction {name} has the shape {direction.shape}; it must be {shape}, or with a last axis of "
            "directions"
        )


def read_like(series: Any, given: Any, what: str) -> Any:
    """Return numbers that may be complex if those of a series are, as some matrices."""
    return to_array(given, what, "iufc").astype(np.complex128) if np.iscomplexobj(series) else read_numbers(given, what)


def overflow(what: str, step: int, time: float, solution: Any, derivatives: Any) -> IntegrationError:
    """Return the error of derivatives that are not finite."""
    return IntegrationError(
        f"the derivative {what}: small changes grow beyond all numbers; take a shorter span",
        step=step,
        time=time,
        residual=float("nan"),
        partial=solution,
        derivatives=derivatives,
    )
