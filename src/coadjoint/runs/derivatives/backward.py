"""Gradients of whole runs: cotangents carried backward, from the last step to the first."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import LargeStepWarning, unknown_name
from coadjoint.long_operations import warn_caller
from coadjoint.methods.protocol.derivative_tables import DerivativeTables
from coadjoint.rounding import in_standard_mode
from coadjoint.runs.derivatives.differentiable_run import DifferentiableRun, Trajectory
from coadjoint.runs.derivatives.forward import overflow, read_like
from coadjoint.runs.derivatives.located_trajectory import function_of_rows
from coadjoint.runs.derivatives.run_tables import INPUTS
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.energy_derivatives import gradients_at
from coadjoint.systems.step_derivatives import derivative_of

Floats = NDArray[np.float64]

LARGEST_DEVIATION = 2.0**-20  # largest relative error of states of a gradient without a warning: about six digits


class Gradient(Mapping[str, Any]):
    """Derivatives of a number by the initial state and the parameters of a run; see `PreparedRun.vjp`.

    A mapping with the keys "x0", the names of the parameters, with an attitude "attitude0", and with inputs "inputs": a
    mapping from their names to derivatives.

    Attributes
    ----------
    rule : mapping
        As in `Tangents`.
    """

    def __init__(self, values: Mapping[str, Any], rule: Mapping[str, str]) -> None:
        self._values, self.rule = dict(values), dict(rule)

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        arrays = {name: value for name, value in self.items() if name != INPUTS} | self._values.get(INPUTS, {})
        return f"<gradient by {', '.join(f'{name} {np.shape(value)}' for name, value in arrays.items())}>"


class Cotangents(NamedTuple):
    """Derivatives of a number by the outputs of a run, in their shapes; those that were not given are zero."""

    x: Any
    attitude: Any
    energy: Any
    observed: dict[str, Any]
    events: dict[str, Any]

    def check_finite(self) -> None:
        series = {"x": self.x, "attitude": self.attitude, "energy": self.energy}
        series |= {f"observed {name}": one for name, one in self.observed.items()}
        series |= {f"{name} of events": one for name, one in self.events.items()}
        for name, numbers in series.items():
            if numbers is not None and not np.isfinite(numbers).all():
                raise ValueError(f"{name} contains NaN or infinity; every number must be finite")


def read_cotangents(
    solution: Solution,
    x: Any = None,
    attitude: Any = None,
    energy: Any = None,
    observed: Mapping[str, Any] | None = None,
    events: Mapping[str, Any] | None = None,
) -> Cotangents:
    """Validate the cotangents of the outputs of a run."""
    of_x, of_energy = _read(x, solution.x, "x"), _read(energy, solution.energy, "energy")
    of_observed, of_events = {}, {}
    for name, given in (observed or {}).items():
        if name not in solution.observed:
            raise unknown_name("observed quantity of this run", name, solution.observed)
        if given is not None:
            of_observed[name] = _read(given, solution.observed[name], f"observed {name}")
    if attitude is not None and solution.attitude is None:
        raise ValueError("attitude was given to a pullback of a run without one; prepare it with attitude=True")
    of_attitude = _read(attitude, solution.attitude, "attitude")
    if events is not None and solution.events is None:
        raise ValueError("events was given to a pullback of a run without them; give events= to vjp")
    if unknown := set(events or {}) - {"t", "x"}:
        raise unknown_name("result of events", min(unknown), ("t", "x"))
    for name, given in (events or {}).items():
        if given is not None:
            of_events[name] = _read(given, getattr(solution.events, name), f"{name} of events")
    return Cotangents(of_x, of_attitude, of_energy, of_observed, of_events)


def _read(given: Any, series: Any, name: str) -> Any:
    if given is None:
        return None
    numbers = read_like(series, given, name)
    if numbers.shape != np.shape(series):
        raise ValueError(f"{name} has the shape {numbers.shape}; as in the solution it must be {np.shape(series)}")
    return numbers


class Pullback:
    """The function from cotangents of the outputs of a run to a gradient; see `PreparedRun.vjp`."""

    def __init__(self, solution: Solution, gradient: Callable[[Cotangents], Gradient]) -> None:
        self.solution, self._gradient = solution, gradient

    def __repr__(self) -> str:
        return f"<pullback of {self.solution!r}>"

    @in_standard_mode
    def __call__(
        self,
        x: Any = None,
        *,
        attitude: Any = None,
        energy: Any = None,
        observed: Mapping[str, Any] | None = None,
        events: Mapping[str, Any] | None = None,
    ) -> Gradient:
        """Return the gradient of a number whose derivatives by the outputs of the run are given.

        Parameters
        ----------
        x, attitude, energy : array_like, optional
            Derivatives by ``sol.x``, ``sol.attitude`` and ``sol.energy``, in their shapes; zero if omitted.
        observed : mapping, optional
            Derivatives by the quantities of ``sol.observed``, by name.
        events : mapping, optional
            Derivatives by the crossings of events: "t" by ``sol.events.t``, and "x" by ``sol.events.x``.

        Returns
        -------
        Gradient
            Derivatives by "x0", each parameter, with an attitude "attitude0", and with inputs "inputs", by their names.

        Raises
        ------
        ValueError, TypeError
            For arrays of other shapes.
        IntegrationError
            The derivatives overflow.
        """
        return self._gradient(read_cotangents(self.solution, x, attitude, energy, observed, events))


def pullback_of_run(run: DifferentiableRun, trajectory: Trajectory) -> Pullback:
    """Return the function for gradients of a run by everything."""
    inputs = [] if run.inputs is None else [INPUTS]
    names = [*run.parameters, *inputs]
    return Pullback(trajectory.solution, partial(gradient_of, run, trajectory, names=names))


def gradient_of(
    run: DifferentiableRun, trajectory: Trajectory, given: Cotangents, names: Iterable[str], by_member: bool = False
) -> Gradient:
    """Return the gradient by x0, attitude0 and these parameters, if `by_member` with an axis of members."""
    solution, members = trajectory.solution, trajectory.members
    given.check_finite()
    wanted = frozenset(names)
    tables = run.tables(trajectory.times.h, wanted)
    (states, groups), rows = trajectory.outputs, trajectory.saved_rows
    of_x, of_energy, of_attitude = np.zeros(states.shape), np.zeros(states.shape[:2]), None
    if given.x is not None:
        of_x[rows] = trajectory.with_members(run.system.rows_of(given.x))
    if given.observed:
        of_x[rows] += _of_observed(run, trajectory, states[rows], trajectory.t[rows], given.observed)
    if given.energy is not None:
        of_energy[rows] = trajectory.with_members(given.energy)
    if given.attitude is not None:
        of_attitude = np.zeros((len(states), members, trajectory.side, trajectory.side))
        of_attitude[rows] = trajectory.with_members(given.attitude)
    if trajectory.crossings is not None:
        of_times = given.events.get("t", np.zeros(len(trajectory.crossings.rows)))
        if "x" in given.events:
            of_x[trajectory.crossings.rows, 0] += run.system.rows_of(given.events["x"])
        of_times = of_times + _of_moments(run, trajectory, states, given.observed)
        trajectory.crossings.pull(of_times, of_x, of_attitude, of_energy)
    by_member = by_member or run.system.is_batch
    first = int(run.system.is_batch)  # parameters of a batch have an axis of members
    shapes = {name: one.value.shape[first:] for name, one in run.parameters.items() if name in wanted}
    if INPUTS in wanted and run.inputs is not None:
        shapes[INPUTS] = (len(run.inputs.values),)
    totals = {name: np.zeros((members, prod(shape))) for name, shape in shapes.items()}
    if of_energy.any():
        of_x += of_energy[..., None] * gradients_at(trajectory.system, states, trajectory.t)
        for name, total in totals.items():
            for some, energy in run.energies(name, members):
                weights = np.ascontiguousarray(of_energy[:, some])
                total[some] += np.einsum("pm,pmj->mj", weights, energy.at(states[:, some]))
    attitudes, start = run.attitudes(tables), trajectory.start
    of_x0, of_A0, of_groups = np.zeros((members, trajectory.n)), np.zeros(groups.shape[1:]), np.zeros(groups.shape)
    if attitudes is not None and of_attitude is not None:
        of_x0, of_A0, of_factors, of_groups = attitudes.cotangents(
            start.momenta, start.groups, trajectory.elapsed, groups, of_attitude
        )
        for name, total in totals.items():
            total += tables.factors[name].of_entries(of_factors, total.shape[1])
    through_steps, of_element, coefficients = _through_steps(run, trajectory, tables, of_x, of_groups)
    of_x0 += through_steps
    for name, total in totals.items() if trajectory.fixed_velocities else ():
        for some, energy in run.energies(name, members):
            for m in range(members)[some]:
                total[m] += trajectory.fixed_velocities[m].pull(energy, of_x0[m])
    states0 = run.system.states_of(of_x0)
    values: dict[str, Any] = {"x0": states0[0] if start.single else states0}
    for name, total in totals.items():
        by_coefficients, entries, shape = tables.coefficients[name], total.shape[1], shapes[name]
        if by_member or name == INPUTS:
            total += by_coefficients.of_entries(coefficients, entries)
            values[name] = total.reshape(members, *shape)
        else:
            sums = total.sum(axis=0) + by_coefficients.of_entries(coefficients.sum(axis=0), entries)
            values[name] = sums.reshape(shape)
    if attitudes is not None:
        of_start = of_A0 if attitudes.shifted else of_element
        values["attitude0"] = of_start[0] if start.single else of_start
    of_inputs = values.pop(INPUTS, None)
    arrays = dict(values)
    if of_inputs is not None:
        values[INPUTS] = {
            name: (of_inputs if own else of_inputs.sum(axis=0))[..., indices]
            for name, (indices, own) in trajectory.inputs.items()
        }
        arrays |= {f"{INPUTS}.{name}": one for name, one in values[INPUTS].items()}
    gradient = Gradient(values, {name: rule for name, rule in tables.rules.items() if name in wanted})
    for name, value in arrays.items():
        if not np.isfinite(value).all():
            times = trajectory.times
            raise overflow(f"by {name} overflows", times.steps, float(times.end), solution, gradient)
    return gradient


def _of_observed(
    run: DifferentiableRun, trajectory: Trajectory, states: Floats, times: Floats, observed: Mapping[str, Any]
) -> Floats:
    """Return the cotangents of the states (points, members, n) for those of observed quantities."""
    total = np.zeros_like(states)
    for name, given in observed.items():
        cotangents, quantity = trajectory.with_members(given), run.prepared.observe[name]
        for k, m in np.ndindex(states.shape[:2]):
            function = function_of_rows(run.system.of_member(m), quantity, float(times[k]))
            total[k, m] += np.ravel(cotangents[k, m]) @ derivative_of(function, states[k, m])[1]
    return total


def _of_moments(run: DifferentiableRun, trajectory: Trajectory, states: Floats, observed: Mapping[str, Any]) -> Floats:
    """Return the cotangents of the times of crossings at which quantities are observed that depend on the time."""
    crossings = trajectory.crossings
    assert crossings is not None
    total = np.zeros(len(crossings.rows))
    _, number, point = np.intersect1d(crossings.rows, trajectory.saved_rows, return_indices=True)
    for c, k in zip(number.tolist(), point.tolist(), strict=True):
        for name, given in observed.items():
            quantity, x = run.prepared.observe[name], states[crossings.rows[c], 0]
            total[c] += np.ravel(given[k]) @ crossings.slope(run.system, quantity, c, x)
    return total


def _through_steps(
    run: DifferentiableRun, trajectory: Trajectory, tables: DerivativeTables, of_x: Floats, of_groups: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the cotangents of the initial states, the elements of the loops, and the coefficients by member."""
    points, members, n, d = len(trajectory.steps), trajectory.members, trajectory.n, trajectory.side
    coefficients = np.zeros((members, tables.coefficient_count))
    at_steps, groups_at_steps = np.zeros((points, members, n)), np.zeros((points, members, d, d))
    # Elements are stored transposed.
    stored = np.swapaxes(of_groups, 2, 3)
    for k, point in enumerate(trajectory.point):
        if trajectory.length[k] == 0.0:
            at_steps[point] += of_x[k]
            groups_at_steps[point] += stored[k]
            continue
        cotangents, group_cotangents = np.zeros((members, n)), np.zeros((members, d, d))
        after = of_x[k : k + 1], stored[k : k + 1]
        trajectory.backward(tables, trajectory.partial(k), *after, cotangents, group_cotangents, coefficients)
        at_steps[point] += cotangents
        groups_at_steps[point] += group_cotangents
    cotangents, group_cotangents = np.zeros((members, n)), np.zeros((members, d, d))
    for segment in reversed(trajectory.segments):
        inside = trajectory.inside(segment)
        if trajectory.finished:
            # The cotangents are those of the saved step that ends the segment.
            at_steps[inside] += cotangents
            groups_at_steps[inside] += group_cotangents
            cotangents, group_cotangents = np.zeros_like(cotangents), np.zeros_like(group_cotangents)
        after = at_steps[inside], groups_at_steps[inside]
        trajectory.backward(tables, segment, *after, cotangents, group_cotangents, coefficients)
    if trajectory.steps[0] == 0:
        cotangents += at_steps[0]
        group_cotangents += groups_at_steps[0]
    if trajectory.deviation > LARGEST_DEVIATION:
        error = min(1.0, trajectory.deviation)
        warn_caller(
            f"the gradient through steps of {abs(trajectory.times.h):.3g} by {run.base} has errors of about "
            f"{error:.1g} of its size: the flows of a step contract so strongly that, undone, they return to the "
            "state before it only within this error; take a shorter step, or tangents by jvp",
            LargeStepWarning,
        )
    return cotangents, np.swapaxes(group_cotangents, 1, 2), coefficients
