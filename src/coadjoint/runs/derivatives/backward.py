"""Gradients of whole runs: cotangents carried backward, from the last step to the first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError, unknown_name
from coadjoint.methods.protocol.derivatives import DerivativeTables
from coadjoint.methods.protocol.step_derivatives import derivative_of
from coadjoint.runs.derivatives.differentiable_run import DifferentiableRun, Trajectory
from coadjoint.runs.derivatives.forward import gradients_at
from coadjoint.runs.derivatives.results import Gradient
from coadjoint.runs.results.solution import Solution
from coadjoint.validation import are_finite, read_numbers

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
    ) -> Gradient:
        """Return the gradient of a number whose derivatives by the outputs of the run are given.

        Parameters
        ----------
        x, attitude, energy : array_like, optional
            Derivatives by ``sol.x``, ``sol.attitude`` and ``sol.energy``, in their shapes; zero if omitted.
        observed : mapping, optional
            Derivatives by the quantities of ``sol.observed``, by name.

        Returns
        -------
        Gradient
            Derivatives by "x0", each parameter, and with an attitude "attitude0".

        Raises
        ------
        ValueError, TypeError
            For arrays of other shapes.
        IntegrationError
            The derivatives overflow.
        """
        return self.gradient(x, attitude, energy, observed, self._run.parameters)

    def gradient(
        self,
        x: Any,
        attitude: Any,
        energy: Any,
        observed: Mapping[str, Any] | None,
        names: Iterable[str],
        by_member: bool = False,
    ) -> Gradient:
        """Return the gradient by x0, attitude0 and the parameters of these names.

        `by_member`: derivatives by parameters have an axis of members, over which they are not summed.
        """
        run, trajectory = self._run, self._trajectory
        solution, members = trajectory.solution, trajectory.members
        tables = run.tables(trajectory.times.h, names)
        states, groups = trajectory.outputs
        of_x = trajectory.with_members(_read(x, solution.x, "x")).copy()
        parameters = {name: np.zeros((members, run.parameters[name].value.size)) for name in tables.rules}
        if energy is not None:
            of_energy = trajectory.with_members(_read(energy, solution.energy, "energy"))
            of_x += of_energy[..., None] * gradients_at(run.system, states, solution.t)
            for name, total in parameters.items():
                total += np.einsum("pm,pmj->mj", of_energy, run.energy(name).at(states))
        if observed is not None:
            of_x += self._of_observed(states, observed)
        attitudes = run.attitudes(tables)
        if attitude is not None and attitudes is None:
            raise ValueError("attitude was given to a pullback of a run without one; prepare it with attitude=True")
        of_x0, of_A0, of_groups = np.zeros((members, trajectory.n)), np.zeros(groups.shape[1:]), np.zeros(groups.shape)
        if attitudes is not None and attitude is not None:
            of_attitude = trajectory.with_members(_read(attitude, solution.attitude, "attitude"))
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
        values = {"x0": of_x0[0] if trajectory.start.single else of_x0}
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
        for name, value in values.items():
            if not are_finite(np.asarray(value)):
                raise IntegrationError(
                    f"the derivative by {name} overflows: small changes grow beyond all numbers; take a shorter span",
                    step=trajectory.times.steps,
                    time=float(trajectory.times.end),
                    residual=float("nan"),
                    partial=solution,
                )
        return Gradient(values, tables.rules)

    def _of_observed(self, states: Floats, observed: Mapping[str, Any]) -> Floats:
        """Return the cotangents of the states (points, members, n) for those of observed quantities."""
        trajectory, total = self._trajectory, np.zeros_like(states)
        functions = self._run.prepared.observe
        for name, given in observed.items():
            if name not in functions:
                raise unknown_name("observed quantity of this run", name, functions)
            cotangents = trajectory.with_members(_read(given, trajectory.solution.observed[name], f"observed {name}"))
            function = functions[name]

            def flat(state: Floats, function: Any = function) -> Floats:
                return np.ravel(function(state))

            for index in np.ndindex(states.shape[:2]):
                total[index] += np.ravel(cotangents[index]) @ derivative_of(flat, states[index]).derivative
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
    if cotangent is None:
        return np.zeros(np.shape(series))
    numbers = read_numbers(cotangent, name)
    if numbers.shape != np.shape(series):
        raise ValueError(f"{name} has the shape {numbers.shape}; as in the solution it must be {np.shape(series)}")
    if not are_finite(numbers):
        raise ValueError(f"{name} contains NaN or infinity; every number must be finite")
    return numbers
