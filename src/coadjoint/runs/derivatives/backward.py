"""Gradients of whole runs: cotangents carried backward, from the last step to the first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError, unknown_name
from coadjoint.methods.protocol.derivative_tables import DerivativeTables
from coadjoint.methods.protocol.step_derivatives import derivative_of
from coadjoint.runs.derivatives.differentiable_run import DifferentiableRun, Trajectory
from coadjoint.runs.derivatives.forward import read_states
from coadjoint.runs.derivatives.input_derivatives import INPUTS
from coadjoint.runs.derivatives.observed import function_of_rows
from coadjoint.runs.derivatives.results import Gradient
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.energy_gradients import gradients_at
from coadjoint.systems.protocol import rows_of, states_of
from coadjoint.validation import read_numbers

Floats = NDArray[np.float64]


class Pullback:
    """The function from cotangents of the outputs of a run to a gradient; see `PreparedRun.vjp`."""

    def __init__(self, run: DifferentiableRun, trajectory: Trajectory) -> None:
        self._run, self._trajectory = run, trajectory

    def __repr__(self) -> str:
        return f"<pullback of {self.solution!r}>"

    @property
    def solution(self) -> Solution:
        """The solution of the run."""
        return self._trajectory.solution

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
        inputs = [] if self._run.inputs is None else [INPUTS]
        return self.gradient(x, attitude, energy, observed, [*self._run.parameters, *inputs], events=events)

    def gradient(
        self,
        x: Any,
        attitude: Any,
        energy: Any,
        observed: Mapping[str, Any] | None,
        names: Iterable[str],
        by_member: bool = False,
        events: Mapping[str, Any] | None = None,
    ) -> Gradient:
        """Return the gradient by x0, attitude0 and the parameters of these names, `INPUTS` for the inputs.

        `by_member`: derivatives by parameters have an axis of members, over which they are not summed.
        """
        run, trajectory = self._run, self._trajectory
        solution, members = trajectory.solution, trajectory.members
        wanted = frozenset(names)
        tables = run.tables(trajectory.times.h, wanted)
        states, groups = trajectory.outputs
        rows, points = trajectory.saved_rows, len(trajectory.t)
        given = None if x is None else read_states(run.system, x, "x")
        of_x, of_energy = np.zeros(states.shape), np.zeros(states.shape[:2])
        of_x[rows] = trajectory.with_members(rows_of(run.system, _checked(given, solution.x, "x")))
        if observed is not None:
            of_x[rows] += self._of_observed(states[rows], trajectory.t[rows], observed)
        of_energy[rows] = trajectory.with_members(_read(energy, solution.energy, "energy"))
        of_attitude = None
        if attitude is not None and run.representation is not None:
            of_attitude = np.zeros((points, members, trajectory.side, trajectory.side))
            of_attitude[rows] = trajectory.with_members(_read(attitude, solution.attitude, "attitude"))
        if events is not None and trajectory.crossings is None:
            raise ValueError("events was given to a pullback of a run without them; give events= to vjp")
        if trajectory.crossings is not None:
            of_events = {"t": None, "x": None} | dict(events or {})
            if unknown := set(of_events) - {"t", "x"}:
                raise unknown_name("result of events", min(unknown), ("t", "x"))
            found: Any = solution.events
            given = None if of_events["x"] is None else read_states(run.system, of_events["x"], "x of events")
            of_x[trajectory.crossings.rows, 0] += rows_of(run.system, _checked(given, found.x, "x of events"))
            of_times = _read(of_events["t"], found.t, "t of events")
            if observed is not None:
                of_times = of_times + self._of_moments(states, observed)
            trajectory.crossings.pull(of_times, of_x, of_attitude, of_energy)
        parameters = {
            name: np.zeros((members, one.value.size)) for name, one in run.parameters.items() if name in wanted
        }
        of_inputs = None
        if run.inputs is not None and INPUTS in wanted:
            of_inputs = np.zeros((members, len(run.inputs.values)))
        if of_energy.any():
            of_x += of_energy[..., None] * gradients_at(trajectory.system, states, trajectory.t)
            if run.inputs is not None and of_inputs is not None:
                at = run.inputs.in_energy
                of_inputs[:, at] += np.einsum("pm,pmi->mi", of_energy, states[..., at])
            for name, total in parameters.items():
                total += np.einsum("pm,pmj->mj", of_energy, run.energy(name).at(states))
        attitudes = run.attitudes(tables)
        if attitude is not None and attitudes is None:
            raise ValueError("attitude was given to a pullback of a run without one; prepare it with attitude=True")
        of_x0, of_A0, of_groups = np.zeros((members, trajectory.n)), np.zeros(groups.shape[1:]), np.zeros(groups.shape)
        if attitudes is not None and of_attitude is not None:
            for m in range(members):
                of_x0[m], of_A0[m], of_factors, of_groups[:, m] = attitudes.cotangents(
                    trajectory.start.momenta[m],
                    trajectory.start.groups[m],
                    trajectory.elapsed,
                    groups[:, m],
                    of_attitude[:, m],
                )
                for name, total in parameters.items():
                    total[m] += tables.factors[name].of_entries(of_factors, total.shape[1])
        through_steps, of_element, coefficients = self._through_steps(tables, of_x, of_groups)
        of_x0 += through_steps
        states0 = states_of(run.system, of_x0)
        values: dict[str, Any] = {"x0": states0[0] if trajectory.start.single else states0}
        for name, total in parameters.items():
            by_coefficients, entries = tables.coefficients[name], total.shape[1]
            shape = run.parameters[name].value.shape
            if by_member:
                total += [by_coefficients.of_entries(row, entries) for row in coefficients]
                values[name] = total.reshape(members, *shape)
            else:
                sums = total.sum(axis=0) + by_coefficients.of_entries(coefficients.sum(axis=0), entries)
                values[name] = sums.reshape(shape)
        if attitudes is not None:
            of_start = of_A0 if attitudes.shifted else of_element
            values["attitude0"] = of_start[0] if trajectory.start.single else of_start
        arrays = dict(values)
        if of_inputs is not None:
            of_inputs += [tables.coefficients[INPUTS].of_entries(row, of_inputs.shape[1]) for row in coefficients]
            values[INPUTS] = {
                name: (of_inputs if one.by_member else of_inputs.sum(axis=0))[..., one.indices]
                for name, one in trajectory.inputs.items()
            }
            arrays |= {f"{INPUTS}.{name}": one for name, one in values[INPUTS].items()}
        gradient = Gradient(values, {name: rule for name, rule in tables.rules.items() if name in wanted})
        for name, value in arrays.items():
            if not np.isfinite(value).all():
                raise IntegrationError(
                    f"the derivative by {name} overflows: small changes grow beyond all numbers; take a shorter span",
                    step=trajectory.times.steps,
                    time=float(trajectory.times.end),
                    residual=float("nan"),
                    partial=solution,
                    derivatives=gradient,
                )
        return gradient

    def _of_observed(self, states: Floats, times: Floats, observed: Mapping[str, Any]) -> Floats:
        """Return the cotangents of the states (points, members, n) for those of observed quantities."""
        trajectory, total = self._trajectory, np.zeros_like(states)
        functions = self._run.prepared.observe
        for name, given in observed.items():
            if name not in functions:
                raise unknown_name("observed quantity of this run", name, functions)
            cotangents = trajectory.with_members(_read(given, trajectory.solution.observed[name], f"observed {name}"))
            for k, m in np.ndindex(states.shape[:2]):
                function = function_of_rows(self._run.system, functions[name], float(times[k]))
                total[k, m] += np.ravel(cotangents[k, m]) @ derivative_of(function, states[k, m]).derivative
        return total

    def _of_moments(self, states: Floats, observed: Mapping[str, Any]) -> Floats:
        """Return the cotangents of the times of crossings at which quantities are observed that depend on the time."""
        trajectory, functions = self._trajectory, self._run.prepared.observe
        assert trajectory.crossings is not None
        numbers = np.arange(len(states))
        total = np.zeros(len(numbers[trajectory.crossings.rows]))
        for c, row in enumerate(numbers[trajectory.crossings.rows].tolist()):
            for k in np.flatnonzero(numbers[trajectory.saved_rows] == row).tolist():
                for name, given in observed.items():
                    cotangents = trajectory.with_members(_read(given, trajectory.solution.observed[name], name))
                    slope = trajectory.crossings.slope(self._run.system, functions[name], c, states[row, 0])
                    total[c] += np.ravel(cotangents[k, 0]) @ slope
        return total

    def _through_steps(
        self, tables: DerivativeTables, of_x: Floats, of_groups: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the cotangents of the initial states, the elements of the loops, and the coefficients by member."""
        trajectory = self._trajectory
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
            trajectory.backward(
                tables,
                trajectory.partial(k),
                of_x[k : k + 1],
                stored[k : k + 1],
                cotangents,
                group_cotangents,
                coefficients,
            )
            at_steps[point] += cotangents
            groups_at_steps[point] += group_cotangents
        cotangents, group_cotangents = np.zeros((members, n)), np.zeros((members, d, d))
        for stretch in reversed(trajectory.stretches):
            inside = trajectory.inside(stretch)
            if trajectory.finished:
                # The cotangents are those of the saved step that ends the stretch.
                at_steps[inside] += cotangents
                groups_at_steps[inside] += group_cotangents
                cotangents, group_cotangents = np.zeros_like(cotangents), np.zeros_like(group_cotangents)
            trajectory.backward(
                tables,
                stretch,
                at_steps[inside],
                groups_at_steps[inside],
                cotangents,
                group_cotangents,
                coefficients,
            )
        if trajectory.steps[0] == 0:
            cotangents += at_steps[0]
            group_cotangents += groups_at_steps[0]
        return cotangents, np.swapaxes(group_cotangents, 1, 2), coefficients


def _read(cotangent: Any, series: Any, name: str) -> Floats:
    """Validate the cotangent of a series of a solution; zero if it is None."""
    return np.asarray(_checked(None if cotangent is None else read_numbers(cotangent, name), series, name))


def _checked(numbers: Any, series: Any, name: str) -> Any:
    """Validate the shape and the numbers of a cotangent; zero if it is None."""
    if numbers is None:
        return np.zeros_like(series)
    if numbers.shape != np.shape(series):
        raise ValueError(f"{name} has the shape {numbers.shape}; as in the solution it must be {np.shape(series)}")
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name} contains NaN or infinity; every number must be finite")
    return numbers
