"""A run whose derivatives are computed: its steps and outputs, in stretches, and the tables of its scheme."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.functions.compiled_functions import raised_by
from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import StopFlag
from coadjoint.kernels.tables.cotangents import BackwardRun, ForwardRun, advance_tables
from coadjoint.kernels.tables.tangents import check_differentiable
from coadjoint.memory import check_available_memory
from coadjoint.methods.forced import Forced
from coadjoint.methods.protocol.derivative_tables import DerivativeTables, Kernel
from coadjoint.runs.derivatives.attitudes import AttitudeDerivatives
from coadjoint.runs.derivatives.input_derivatives import INPUTS, without_inputs
from coadjoint.runs.derivatives.run_tables import build_tables
from coadjoint.runs.inputs import Inputs
from coadjoint.runs.loops.execution import sum_in_threads
from coadjoint.runs.loops.groups import split_members
from coadjoint.runs.output_times import OutputTimes, check_partial_steps, resample
from coadjoint.runs.results.solution import Solution
from coadjoint.short_repr import distinct
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.parameters import Parameter, parameters_of
from coadjoint.systems.protocol import is_batch, rows_of, shape_of, unforced
from coadjoint.validation import read_choice

if TYPE_CHECKING:
    from coadjoint.runs.derivatives.crossings import Crossings
    from coadjoint.runs.prepared_run import PreparedRun

Floats = NDArray[np.float64]

REVERSES = ("exact", "reversible")
# Numbers of the states of a stretch of steps of a member: they stay in the cache.
NUMBERS_OF_STRETCH = 2**15
# Steps of a stretch below which the allocations of a call take longer than its steps.
STEPS_OF_STRETCH = 16
# Largest memory of the first states of stretches, above which these are longer, and of states for stretches of
# STEPS_OF_STRETCH steps.
BYTES_OF_CHECKPOINTS = 2**25


class Stretch(NamedTuple):
    """Steps k0 + 1 to k1 of all members, from t0 + k0 h, and the unfinished states from which they start.

    Step k is number `before` + k of the run; None for a partial step. If `undone`, the states are those at the end,
    from which the steps are undone.
    """

    t0: float
    h: float
    k0: int
    k1: int
    momenta: Floats
    errors: Floats
    groups: Floats
    group_errors: Floats
    undone: bool = False
    before: int | None = 0


class DifferentiableRun:
    """A prepared run with the derivative of the energy by its parameters, and the tables of its scheme.

    `parameters` replace those of its system. Raises TypeError for what cannot be differentiated.
    """

    def __init__(self, prepared: PreparedRun, parameters: Mapping[str, Parameter] | None = None) -> None:
        system = prepared.system
        if is_batch(system):
            raise TypeError(f"runs of a batch have no derivatives: {system!r}; differentiate the run of each member")
        self.scheme = prepared.scheme.fixed_steps
        # The scheme of the Hamiltonian part.
        self.base = self.scheme.base if isinstance(self.scheme, Forced) else self.scheme
        if self.base.own_steps:
            raise TypeError(
                f"{self.base} chooses its own steps, and with forces its runs have no derivatives; take a scheme with "
                "a given step"
            )
        if self.base.differentiable:
            check_differentiable(unforced(system))
        self.prepared, self.system = prepared, system
        self.parameters: Mapping[str, Parameter] = parameters_of_run(system) if parameters is None else parameters
        self.representation, self.inputs = prepared.representation, prepared.inputs
        self._energies: dict[str, EnergyDerivative] = {}
        self._tables: dict[Any, DerivativeTables] = {}

    def energy(self, name: str) -> EnergyDerivative:
        """Return the derivative of the energy by a parameter."""
        if name not in self._energies:
            energy = self.parameters[name].energy()
            self._energies[name] = energy if self.inputs is None else without_inputs(energy, self.inputs)
        return self._energies[name]

    def tables(self, h: float, names: Iterable[str]) -> DerivativeTables:
        """Return the tables of the scheme for a step, with the parameters of these names, `INPUTS` for the inputs."""
        chosen = frozenset(names)
        if (h, chosen) not in self._tables:
            self._tables[h, chosen] = build_tables(
                self, h, [name for name in self.parameters if name in chosen], INPUTS in chosen
            )
        return self._tables[h, chosen]

    def check_reverse(self, reverse: Any, h: float) -> None:
        """Validate how a run is differentiated backward; raise TypeError for a scheme whose steps cannot be undone."""
        if read_choice(reverse, "reverse", REVERSES) == "exact":
            return
        if self.prepared.method.own_steps or not self.tables(h, self.parameters).reversible:
            raise TypeError(f'{self.prepared.method} has no steps that can be undone; take reverse="exact"')

    def attitudes(self, tables: DerivativeTables) -> AttitudeDerivatives | None:
        """Return the derivatives of the attitudes, or None without a group element."""
        if self.representation is None:
            return None
        return AttitudeDerivatives(self.system, tables.shift, self.representation)


class Trajectory:
    """A run that was integrated, in stretches whose first states are stored, or in one of all steps.

    `reverse` is "exact" or "reversible" for a run to be differentiated backward, and None forward. Of reversible runs
    the last state is stored.

    `states` (points, members, n) and `groups` (points, members, d, d) are those after the saved `steps`, elements as in
    the loops. Output k is `length[k]` after the step with the number steps[point[k]], `elapsed[k]` after the start.
    """

    crossings: Crossings | None = None
    finished: bool = False
    """Whether every stretch is one step that starts from the saved state after the one before."""

    def __init__(
        self,
        run: DifferentiableRun,
        x0: Any,
        t_span: Any,
        save_every: int,
        t_eval: Any,
        attitude: Any,
        reverse: str | None,
        inputs: Mapping[str, Any] | None = None,
    ) -> None:
        prepared = run.prepared
        given = {} if inputs is None else inputs
        self.values = prepared.values_of(given)
        times, moments = prepared.times_of(t_span, save_every, t_eval)
        if moments is not None:
            check_partial_steps(run.system, moments)
            times = times.with_saved_steps(moments.marks)
        self.times, self.start = times, prepared.start(x0, attitude, self.values)
        self.system = prepared.system_at(self.values)
        self.inputs = given_inputs(run.inputs, given)
        self._run = prepared.begun(times, self.start, self.values)
        self.members, self.n = self.start.momenta.shape
        self.side = self.start.groups.shape[1]
        distance = self._stretch_length() if reverse == "exact" else max(1, times.steps)
        self.stretches = [self._integrated(step, distance) for step in range(0, max(1, times.steps), distance)]
        if reverse == "reversible":
            self.stretches = [self._integrated(times.steps, 0)._replace(k0=0, undone=True)]
        self.steps = times.saved
        self.states = self._run.saved["x"].copy()
        self.groups = self._elements()
        if moments is None:
            moments = OutputTimes(times.saved_times, self.steps, np.zeros(len(self.steps)))
        else:
            resample(self._run, moments)
        self.solution: Solution = self._run.solution(prepared.observed(self.start))
        self.length, self.point = moments.length, np.searchsorted(self.steps, moments.number)
        self.elapsed = moments.number * times.h + moments.length
        self.t: Floats = self.solution.t
        self.started = times.t0 + self.steps * times.h

    def _integrated(self, step: int, distance: int) -> Stretch:
        """Take the steps of a stretch."""
        state, last = self._run.state, min(step + distance, self.times.steps)
        # Behind the coordinates are the accounts of forces.
        momenta, errors = (state[name][:, : self.n].copy() for name in ("momenta", "errors"))
        groups, group_errors = (state[name].copy() for name in ("groups", "group_errors"))
        self._run.advance(until=last)
        return Stretch(self.times.t0, self.times.h, step, last, momenta, errors, groups, group_errors)

    def _stretch_length(self) -> int:
        steps, numbers = self.times.steps, self.n + self.side**2
        length, bytes_of_each = max(1, NUMBERS_OF_STRETCH // numbers), 16 * numbers * self.members
        lanes = min(self.members, limit("MOST_LANES"))
        length = max(length, min(STEPS_OF_STRETCH, BYTES_OF_CHECKPOINTS // (8 * numbers * lanes)))
        length = max(length, -(-steps * bytes_of_each // BYTES_OF_CHECKPOINTS))
        check_available_memory(
            bytes_of_each * (steps // length + 1) + 8 * numbers * lanes * (min(length, steps) + 1),
            f"the states of {steps} steps of {self.members} members, from which they are repeated,",
        )
        return length

    def _elements(self) -> Floats:
        """Return the elements of the saved points as stored by the loops, transposed."""
        stored = self._run.saved["group"]
        return stored.reshape(len(stored), self.members, self.side, self.side).copy()

    def partial(self, k: int) -> Stretch:
        """Return the partial step to output k."""
        point, members = self.point[k], self.members
        return Stretch(
            t0=float(self.started[point]),
            h=float(self.length[k]),
            k0=0,
            k1=1,
            momenta=np.ascontiguousarray(self.states[point, :, : self.n]),
            errors=np.zeros((members, self.n)),
            groups=self.groups[point],
            group_errors=np.zeros((members, self.side, self.side)),
            before=None,
        )

    @property
    def workers(self) -> int:
        """Number of threads."""
        return self._run.plan.workers

    @property
    def threads_inside(self) -> int:
        """Number of threads that may share a member."""
        return self._run.plan.inside

    @property
    def saved_rows(self) -> Any:
        """Outputs that are the points of the solution."""
        return slice(None)

    @property
    def start_shape(self) -> tuple[int, ...]:
        """Shape of the initial states."""
        shape = shape_of(self.start.system)
        return shape if self.start.single else (self.members, *shape)

    @property
    def outputs(self) -> tuple[Floats, Floats]:
        """States (points, members, n) and elements of the loop (points, members, d, d) at the outputs."""
        return self.with_members(rows_of(self.start.system, self.solution.x)), np.swapaxes(
            self._elements()[: len(self.point)], 2, 3
        )

    def with_members(self, series: Any) -> Floats:
        """Return a series of the solution with an axis of members."""
        return np.asarray(series[:, None] if self.start.single else series)

    def forward(
        self, tables: DerivativeTables, stretch: Stretch, of_x: Floats, of_groups: Floats, coefficients: Floats
    ) -> tuple[Floats, Floats]:
        """Carry tangents (members, count, n) and (members, count, d, d) over a stretch.

        `coefficients` are (count, their number), or with a first axis of members. Returns those after its saved steps,
        or after a partial step, with a first axis of points.
        """
        marks = self._marks(stretch)
        at_points, at_groups = (np.zeros((len(marks), *one.shape)) for one in (of_x, of_groups))
        fields = stretch._asdict()
        del fields["group_errors"], fields["undone"], fields["before"]
        run = ForwardRun(
            size=self.n,
            square=self.side**2,
            members=self.members,
            carried=of_x.shape[1],
            marked=len(marks),
            marks=marks,
            at_points=at_points,
            at_groups=at_groups,
            tangents=of_x.copy(),
            group_tangents=of_groups.copy(),
            coefficients=coefficients,
            threads=self.threads_inside,
            **fields,
        )
        for structure, first, last in self._tables_of_members(tables, stretch.h, coefficients.ndim == 3):
            one = run if coefficients.ndim == 2 else run._replace(coefficients=coefficients[first])
            self._call(tables.forward, tables, structure, one, first, last)
        return at_points, at_groups

    def backward(
        self,
        tables: DerivativeTables,
        stretch: Stretch,
        at_points: Floats,
        at_groups: Floats,
        cotangents: Floats,
        group_cotangents: Floats,
        coefficients: Floats,
    ) -> None:
        """Carry cotangents (members, n) and (members, d, d) from the end of a stretch to its start, in place.

        Those of its saved steps, or of a partial step, are added; derivatives by coefficients (members, count) as well.
        """
        marks, fields = self._marks(stretch), stretch._asdict()
        del fields["before"]
        run = BackwardRun(
            size=self.n,
            square=self.side**2,
            members=self.members,
            marked=len(marks),
            marks=marks,
            at_points=np.ascontiguousarray(at_points),
            at_groups=np.ascontiguousarray(at_groups),
            cotangents=cotangents,
            group_cotangents=group_cotangents,
            coefficients=coefficients,
            threads=self.threads_inside,
            **fields,
        )
        for structure, first, last in self._tables_of_members(tables, stretch.h):
            self._call(tables.backward, tables, structure, run, first, last)

    def _tables_of_members(
        self, tables: DerivativeTables, h: float, each: bool = False
    ) -> Iterator[tuple[Any, int, int]]:
        """Yield the tables of a step with the inputs of members, and the first and last of these members.

        `each`: of one member after the other.
        """
        values, members = self.values, self.members
        if values is not None and values.ndim == 2:
            yield from ((tables.tables_at(h, values[m]), m, m + 1) for m in range(members))
            return
        shared = tables.tables_at(h) if values is None else tables.tables_at(h, values)
        yield from ((shared, m, m + 1) for m in range(members)) if each else ((shared, 0, members),)

    def inside(self, stretch: Stretch) -> NDArray[np.bool_]:
        """Return which saved steps belong to a stretch of whole steps."""
        assert stretch.before is not None
        return (self.steps > stretch.before + stretch.k0) & (self.steps <= stretch.before + stretch.k1)

    def _marks(self, stretch: Stretch) -> NDArray[np.int64]:
        if stretch.before is None:
            return np.ones(1, dtype=np.int64)
        return self.steps[self.inside(stretch)] - stretch.before

    def _call(
        self,
        kernel: Kernel,
        tables: DerivativeTables,
        structure: Any,
        run: ForwardRun | BackwardRun,
        first: int,
        last: int,
    ) -> None:
        """Call a kernel for the members `first` to `last` - 1, on the threads of the run, or a function."""
        if not isinstance(kernel, str):
            return kernel(structure, run, first, last)
        name = kernel
        stop = StopFlag()
        ranges = split_members(first, last, self.workers, limit("MOST_LANES"))

        def unsolved(members: tuple[int, int]) -> int:
            return not advance_tables(name, structure, run, *members, stop)

        count = unsolved(ranges[0]) if len(ranges) == 1 else sum_in_threads(unsolved, ranges, self.workers, stop)
        if (raised := raised_by(tables.keepalive)) is not None:
            raise raised
        if count:
            begin, end = distinct(run.t0 + run.k0 * run.h, run.t0 + run.k1 * run.h)
            raise IntegrationError(
                f"the linear equations of the derivatives between t = {begin} and {end} are not solved; take a "
                f"smaller step than {abs(run.h):g}",
                step=run.k1,
                time=run.t0 + run.k1 * run.h,
                residual=float("nan"),
                partial=self.solution,
            )


class GivenInput(NamedTuple):
    """The indices of an input among the values, in their shape, and whether each member has its own value."""

    indices: NDArray[np.int64]
    by_member: bool


def given_inputs(inputs: Inputs | None, given: Mapping[str, Any]) -> dict[str, GivenInput]:
    """Return the inputs of a run by name."""
    if inputs is None:
        return {}
    return {
        name: GivenInput(indices, name in given and np.ndim(given[name]) > indices.ndim)
        for name, indices in inputs.indices.items()
    }


def parameters_of_run(system: Any) -> Mapping[str, Parameter]:
    """Return the parameters of the system of a run.

    Those of a batch have an axis of members; they are those that all members have, in one shape.
    """
    if not is_batch(system):
        return parameters_of(system)
    members = [parameters_of(member) for member in system]
    found = {}
    for name, first in members[0].items():
        if all(name in one and one[name].value.shape == first.value.shape for one in members):
            found[name] = first._replace(value=np.stack([one[name].value for one in members]))
    return found
