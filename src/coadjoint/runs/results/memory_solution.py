"""Solutions of runs in memory; attributes are computed from the arrays of the loops on first use."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import Layout, NamedArrays
from coadjoint.rounding import in_standard_mode
from coadjoint.runs.loops.loops import GroupCorrection
from coadjoint.runs.results.quantities import NamedValues, Observed, ObservedValues
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import Statistics, with_products
from coadjoint.runs.start import Start, start_without_groups
from coadjoint.systems.batch import Batch
from coadjoint.systems.system import System

if TYPE_CHECKING:
    from coadjoint.runs.plan_and_state import Plan
    from coadjoint.runs.run import Run

Floats = NDArray[np.float64]

# Arrays that a solution copies from a large state of a run; a small state is shared, since copying takes a step's time.
REPORTED_ARRAYS = ("worst", "status", "evaluations", "iterations")
# Numbers (8 MB) beyond which a state is large.
MAX_STATE_NUMBERS = 2**20


class MemorySolution(Solution):
    """The solution of a run in memory; it does not keep the tables of the run alive."""

    _system_of_run: Callable[[], System | Batch]
    _saved_points: int
    _names: list[str]
    _seconds: float
    _elapsed: float
    _corrected_groups: GroupCorrection
    _initial_values: Floats | None = None
    _taken: int | None = None
    """Steps of a run that has not reached its end."""
    _ending = None
    events = None
    incomplete = None
    _layout: Layout
    _numbers: Floats
    _prepared_system: System | Batch
    _momenta: Floats | None = None
    """Of a run of one vector; its start is made on first use."""

    @cached_property
    def _saved(self) -> NamedArrays:
        return self._layout.saved_in(self._numbers)

    @cached_property
    def _state(self) -> NamedArrays:
        return self._layout.state_in(self._numbers)

    @cached_property
    def system(self) -> System | Batch:
        return self._system_of_run()

    @cached_property
    def t(self) -> Floats:
        times = self._times.saved_times[: self._saved_points]
        if self._ending is not None:
            times[-1] = self._ending.t
        return times

    @cached_property
    def _start(self) -> Start:
        assert self._momenta is not None
        return start_without_groups(self._prepared_system, self._momenta[None], True)

    @cached_property
    def x(self) -> NDArray[Any]:
        if self._momenta is not None:
            saved = self._layout.saved
            return self._numbers[saved.slices["x"]].reshape(saved.shapes["x"])[:, 0]
        rows = self._without_member_axis(self._points("x"))
        # Work integrals of forces may follow the coordinates.
        return self._states(rows[..., : self._start.momenta.shape[1]] if self._work_integrals else rows)

    @cached_property
    def x0(self) -> NDArray[Any]:
        momenta = self._start.momenta
        return self._states(momenta[0] if self._start.single else momenta)

    @cached_property
    def t_eval(self) -> Floats | None:
        return None if self._times.between is None else self.t

    @cached_property
    def energy(self) -> Floats:
        return self._without_member_axis(self._points("values")[..., 0])

    @cached_property
    def casimirs(self) -> Mapping[str, Floats]:
        values = self._points("values")
        return NamedValues(
            {name: self._without_member_axis(values[..., i + 1]) for i, name in enumerate(self._names[1:])}
        )

    @cached_property
    def initial(self) -> Mapping[str, Any]:
        values = self._saved["values"][0] if self._initial_values is None else self._initial_values
        single = self._start.single
        return NamedValues({name: values[0, i] if single else values[:, i] for i, name in enumerate(self._names)})

    @cached_property
    def work(self) -> Mapping[str, Mapping[str, Floats]]:
        states, dim = self._points("x"), self._start.momenta.shape[1]
        by_force: dict[str, dict[str, Floats]] = {}
        for column, (force, invariant) in enumerate(self._work_integrals):
            by_force.setdefault(force, {})[invariant] = self._without_member_axis(states[..., dim + column])
        return NamedValues(by_force)

    @cached_property
    def observed(self) -> Mapping[str, Floats]:
        return NamedValues()

    @cached_property
    @in_standard_mode
    def attitude(self) -> Floats | None:
        start = self._start
        if start.representation is None:
            return None
        groups = self._corrected_groups(start, self._times, self._saved, self._saved_points)
        if self._ending is not None:
            groups[-1] = self._ending.attitude
        return groups[:, 0] if start.single else groups

    @cached_property
    def attitude0(self) -> Floats | None:
        start = self._start
        if start.representation is None:
            return None
        # Runs may share the array of a unit element.
        return start.groups[0].copy() if start.single else start.groups.copy()

    @cached_property
    def carried(self) -> str | None:
        return self._start.carried

    @cached_property
    def failed(self) -> NDArray[np.bool_] | None:
        return None if self._start.single else self._state["status"] != 0

    @cached_property
    def stats(self) -> Statistics:
        taken = self._times.steps if self._taken is None else self._taken
        statistics = Statistics(
            steps=int(taken if self._ending is None else self._ending.steps),
            evaluations=int(self._state["evaluations"].sum()),
            iterations=int(self._state["iterations"].sum()),
            seconds=self._seconds,
            elapsed=self._elapsed,
        )
        return with_products(statistics, self)

    @cached_property
    def _worst(self) -> Floats:
        return self._state["worst"][0] if self._start.single else self._state["worst"]

    def _points(self, name: str) -> NDArray[Any]:
        points = self._saved[name]
        return points if len(points) == self._saved_points else points[: self._saved_points]

    def _without_member_axis(self, series: NDArray[Any]) -> NDArray[Any]:
        return series[:, 0] if self._start.single else series

    def _states(self, rows: Floats) -> NDArray[Any]:
        return np.asarray(self._start.system.states_of(rows))


def most_evaluations(solution: Solution) -> float:
    """Return the largest number of evaluations of a member of a run in memory."""
    return float(np.max(cast(MemorySolution, solution)._state["evaluations"]))


def solution_of_run(run: Run, saved_points: int, observed: Observed | None, **fields: Any) -> Solution:
    """Return the solution of the first saved points of a run in memory, with further fields."""
    state = run.state.arrays
    if state.numbers.size > MAX_STATE_NUMBERS:
        state = state.subset(REPORTED_ARRAYS)
    solution = MemorySolution(
        {
            **run.plan.shared,
            "events": run.events,
            "_start": run.start,
            "_saved": run.saved,
            "_saved_points": saved_points,
            "_state": state,
            "_seconds": run.seconds,
            "_elapsed": run.seconds,
            "_ending": run.ending,
            "_initial_values": run.initial,
            **fields,
        }
    )
    if observed is not None:
        # Observed quantities do not use the work integrals that may follow the coordinates.
        series = observed.along(solution.t, solution._points("x"))
        named = ObservedValues({name: solution._without_member_axis(values) for name, values in series.items()})
        named.formulas = observed.formulas
        vars(solution)["observed"] = named
    return solution


def solution_of_numbers(
    plan: Plan, start: Start | None, momenta: Floats, numbers: Floats, seconds: float, elapsed: float
) -> Solution:
    """Return the solution of a run whose arrays are in one allocation; without a start, that of one vector."""
    fields = dict(plan.shared, _numbers=numbers, _seconds=seconds, _elapsed=elapsed)
    if start is None:
        fields["_momenta"] = momenta
    else:
        fields["_start"] = start
    return MemorySolution(fields)
