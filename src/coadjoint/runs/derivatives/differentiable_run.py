"""A run whose derivatives are computed: its steps and outputs, in segments, and the tables of its scheme."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.compiled import as_structure
from coadjoint.kernels.tables.derivatives import BackwardRun, ForwardRun, check_differentiable
from coadjoint.memory import check_available_memory
from coadjoint.methods.forced import Forced
from coadjoint.methods.protocol.derivative_tables import DerivativeTables
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.derivatives.run_tables import INPUTS, build_tables, by_linear, tables_of_members, without_inputs
from coadjoint.runs.derivatives.segments import ONE, Segment, carry
from coadjoint.runs.events import Event
from coadjoint.runs.loops.shifted_attitude import AttitudeDerivatives
from coadjoint.runs.partial_steps import check_partial_steps, resample
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.times import OutputTimes, Times
from coadjoint.short_repr import distinct
from coadjoint.systems.energy_derivatives import EnergyDerivative, FixedVelocity
from coadjoint.systems.parameters import Parameter, parameters_of_members, values_of_member
from coadjoint.validation import read_choice

if TYPE_CHECKING:
    from coadjoint.runs.derivatives.located_trajectory import CrossingDerivatives

Floats = NDArray[np.float64]

NUMBERS_OF_SEGMENT = 2**15  # numbers of the states of a segment of the members in lanes, which stay in the cache
SIDE_BY_SIDE = 8  # members in the widest vectors
STEPS_OF_SEGMENT = 16  # steps of a segment below which the allocations of a call take longer than its steps
# Largest memory of the first states of segments, above which these are longer, and of the states of short segments.
BYTES_OF_CHECKPOINTS = 2**25


REVERSES = ("exact", "reversible")
FIXED = ("momentum", "velocity")
"""What a parameter leaves as it is in the initial state."""


class Arguments(NamedTuple):
    """Arguments of a run to be differentiated, as of `PreparedRun.run`."""

    x0: Any
    t_span: Any
    save_every: int
    t_eval: Any
    attitude: Any
    events: tuple[Event, ...] = ()
    inputs: Mapping[str, Any] = {}
    fixed: str = FIXED[0]

    @property
    def keywords(self) -> dict[str, Any]:
        own = {name: value for name, value in self._asdict().items() if name not in ("inputs", "fixed")}
        return own | dict(self.inputs)


class DifferentiableRun:
    """A prepared run with the derivative of the energy by its parameters, and the tables of its scheme."""

    def __init__(self, prepared: PreparedRun, given: tuple[Any, Mapping[str, Floats]] | None = None) -> None:
        # `given` are a system and values of its parameters, with which that of the run was made; they may be zero.
        system = prepared.system
        self.scheme = prepared.scheme.fixed_steps
        # The scheme of the Hamiltonian part.
        self.base = cast(Forced, self.scheme).inner if system.forces else self.scheme
        if self.base.own_steps:
            raise TypeError(
                f"{self.base} chooses its own steps, and with forces its runs have no derivatives; take a scheme with "
                "a given step"
            )
        plain = system.of_member(0).unforced
        if self.base.differentiates(plain):
            check_differentiable(plain)
        self.prepared, self.system = prepared, system
        self._original: Any = system if given is None else given[0]
        self._values = None if given is None else given[1]
        self.parameters: Mapping[str, Parameter] = parameters_of_members(self._original, self._values)
        self.representation, self.inputs = prepared.representation, prepared.inputs
        self._tables: dict[Any, DerivativeTables] = {}

    @staticmethod
    def of(prepared: PreparedRun) -> DifferentiableRun:
        """Return the derivatives of a run by all parameters, which it keeps."""
        if prepared.cache.derivatives is None:
            prepared.cache.derivatives = DifferentiableRun(prepared)
        return prepared.cache.derivatives  # type: ignore[no-any-return]

    def of_member(self, member: int) -> DifferentiableRun:
        """Return the derivatives of the run of one member of a batch alone."""
        prepared = self.prepared.of_member(member)
        values = values_of_member(self._values, member)
        return (
            DifferentiableRun.of(prepared)
            if values is None
            else DifferentiableRun(prepared, (self._original[member], values))
        )

    def energy(self, name: str, member: int = 0) -> EnergyDerivative:
        """Return the derivative of the energy by a parameter, or by the inputs for `INPUTS`."""
        if name == INPUTS and self.inputs is not None:
            return by_linear(self.inputs)
        of_member = self.parameters
        if self.system.is_batch:
            of_member = parameters_of_members(self._original[member], values_of_member(self._values, member))
        energy = of_member[name].energy()
        return energy if self.inputs is None else without_inputs(energy, self.inputs)

    def energies(self, name: str, members: int) -> list[tuple[slice, EnergyDerivative]]:
        """Return the derivatives of the energy by a parameter, each with its members."""
        if self.system.is_batch:
            return [(slice(m, m + 1), self.energy(name, m)) for m in range(members)]
        return [(slice(0, members), self.energy(name))]

    def tables(self, h: float, names: Iterable[str]) -> DerivativeTables:
        """Return the tables of the scheme for a step, with the parameters of these names, `INPUTS` for the inputs."""
        chosen = frozenset(names)
        if (h, chosen) not in self._tables:
            named = [name for name in self.parameters if name in chosen]
            self._tables[h, chosen] = (
                tables_of_members(self, h, named)
                if self.system.is_batch
                else build_tables(self, h, named, INPUTS in chosen)
            )
        return self._tables[h, chosen]

    def check_reverse(self, reverse: str, h: float) -> None:
        """Raise an error for an unknown way of reverse mode, or if the steps cannot be undone."""
        method, undoes = self.prepared.method, read_choice(reverse, "reverse", REVERSES) == "reversible"
        if undoes and (method.own_steps or not self.tables(h, self.parameters).reversible):
            raise TypeError(f'{method} has no steps that can be undone; take reverse="exact"')

    def attitudes(self, tables: DerivativeTables) -> AttitudeDerivatives | None:
        """Return the derivatives of the attitudes, or None without a group element."""
        first, group = self.system.of_member(0), self.representation
        return None if group is None else AttitudeDerivatives(first, tables.shift, group, tables.of_members)


class Trajectory:
    """A run that was integrated, in segments whose first states are stored, or in one of all steps."""

    # Output k is `length[k]` after the step with the number steps[point[k]], and `elapsed[k]` after the start.

    crossings: CrossingDerivatives | None = None
    finished = False  # whether every segment is one step that starts from the saved state after the one before
    saved_rows: Any = slice(None)  # outputs that are the points of the solution
    workers = threads_inside = 1  # threads, and those that may share a member
    inputs: dict[str, tuple[NDArray[np.int64], bool]]  # indices among the values, and whether members have their own
    deviation = 0.0  # largest relative error of a state from which the flows of a step were undone
    solution: Solution
    t: Floats
    outputs: tuple[Floats, Floats]  # states (points, members, n) and elements of the loop (points, members, d, d)

    def __init__(self, run: DifferentiableRun, given: Arguments, reverse: str | None) -> None:
        prepared, self.reverse = run.prepared, reverse
        self.values = prepared.values_of(given.inputs, given.x0)
        self.times, moments = prepared.times_of(given.t_span, given.save_every, given.t_eval)
        self.start = prepared.start(given.x0, given.attitude, self.values)
        self.system = prepared.system_at(self.values)
        indices = {} if run.inputs is None else run.inputs.indices
        by_member = {name for name, value in given.inputs.items() if np.ndim(value) > indices[name].ndim}
        self.inputs = {name: (one, name in by_member) for name, one in indices.items()}
        self.members, self.n = self.start.momenta.shape
        self.fixed_velocities: list[FixedVelocity] = []
        if read_choice(given.fixed, "fixed", FIXED) == "velocity":
            t0, rows = float(self.times.t0), self.start.momenta
            self.fixed_velocities = [FixedVelocity.at(self.system.of_member(m), x, t0) for m, x in enumerate(rows)]
        self.side = self.start.groups.shape[1]
        self._integrate(run, given, moments)
        prepared.check_first_step(self.solution)

    def _integrate(self, run: DifferentiableRun, given: Arguments, moments: OutputTimes | None) -> None:
        if moments is None:
            self._take_steps(run.prepared, self.times)
            moments = OutputTimes(self.times.saved_times, self.steps, np.zeros(len(self.steps)))
        else:
            check_partial_steps(run.system, moments, differentiated=True)
            self._take_steps(run.prepared, self.times.with_saved_steps(moments.marks))
            resample(self._run, moments)
        self._locate(moments.number, moments.length)
        self.solution = self._run.solution(run.prepared.observed(self.start))
        self.t = self.solution.t
        elements = self._elements()[: len(self.point)]
        self.outputs = self.with_members(self.start.system.rows_of(self.solution.x)), np.swapaxes(elements, 2, 3)

    def _take_steps(self, prepared: PreparedRun, times: Times) -> None:
        self.times, self._run = times, prepared.begun(times, self.start, self.values)
        self.workers, self.threads_inside = self._run.plan.workers, self._run.plan.inside
        distance = self._segment_length(prepared.scheme) if self.reverse == "exact" else max(1, times.steps)
        self.segments = [self._integrated(step, distance) for step in range(0, max(1, times.steps), distance)]
        if self.reverse == "reversible":
            self.segments = [self._integrated(times.steps, 0)._replace(k0=0, undone=True)]
        self.steps = times.saved
        self.started = times.t0 + self.steps * times.h
        self.states, self.groups = self._run.saved["x"].copy(), self._elements()

    def _locate(self, number: NDArray[np.int64], length: Floats) -> None:
        """Store where the outputs are, after partial steps of some lengths from the steps of these numbers."""
        self.length, self.point = length, np.searchsorted(self.steps, number)
        self.elapsed = number * self.times.h + length

    def _integrated(self, step: int, distance: int) -> Segment:
        state, last = self._run.state, min(step + distance, self.times.steps)
        # Behind the coordinates are the work integrals of forces.
        momenta, errors = (state[name][:, : self.n].copy() for name in ("momenta", "errors"))
        groups, group_errors = (state[name].copy() for name in ("groups", "group_errors"))
        self._run.advance(until=last)
        return Segment(self.times.t0, self.times.h, step, last, momenta, errors, groups, group_errors)

    def _segment_length(self, scheme: Method) -> int:
        steps, numbers = self.times.steps, self.n + self.side**2
        lanes = min(self.members, limit("MOST_LANES"))
        # Where a segment of an implicit scheme begins may alter the last bits, which do not depend on other members.
        side_by_side = SIDE_BY_SIDE if scheme.explicit and self.members > 1 else 1
        length, bytes_of_each = max(1, NUMBERS_OF_SEGMENT // (numbers * side_by_side)), 16 * numbers * self.members
        length = max(length, min(STEPS_OF_SEGMENT, BYTES_OF_CHECKPOINTS // (8 * numbers * lanes)))
        length = max(length, -(-steps * bytes_of_each // BYTES_OF_CHECKPOINTS))
        stored = scheme.stored_states
        if flows := len(self.system.of_member(0).flows):
            stored += 4 * (flows - 1) * len(cast(Forced, scheme.fixed_steps).fractions)
        check_available_memory(
            bytes_of_each * (steps // length + 1) + 8 * numbers * lanes * (stored * min(length, steps) + 1),
            f"the states of {steps} steps of {self.members} members, from which they are repeated,",
        )
        return length

    def _elements(self) -> Floats:
        """Return the elements of the saved points as stored by the loops, transposed."""
        stored = self._run.saved["group"]
        return stored.reshape(len(stored), self.members, self.side, self.side).copy()

    def partial(self, k: int) -> Segment:
        point = self.point[k]
        momenta = np.ascontiguousarray(self.states[point, :, : self.n])
        return Segment.of_step(float(self.started[point]), float(self.length[k]), momenta, self.groups[point])

    def with_members(self, series: Any) -> Floats:
        return np.asarray(series[:, None] if self.start.single else series)

    def forward(
        self, tables: DerivativeTables, segment: Segment, of_x: Floats, of_groups: Floats, coefficients: Floats
    ) -> tuple[Floats, Floats]:
        """Return tangents (points, members, ...) at the saved steps of a segment, or after a partial step."""
        marks, threads = self._marks(segment), self.threads_inside
        run = segment.forward(of_x.copy(), of_groups.copy(), coefficients, marks=marks, threads=threads)
        self._carry(tables, run)
        return run.at_points, run.at_groups

    def backward(self, tables: DerivativeTables, segment: Segment, *arrays: Floats) -> None:
        """Carry cotangents from the end of a segment to its start, in place; `arrays` as of `Segment.backward`."""
        run = segment.backward(*arrays, marks=self._marks(segment), threads=self.threads_inside)
        self._carry(tables, run)
        self.deviation = max(self.deviation, float(run.deviations.max(initial=0.0)))

    def inside(self, segment: Segment) -> NDArray[np.bool_]:
        """Return which saved steps belong to a segment of whole steps."""
        assert segment.before is not None
        return (self.steps > segment.before + segment.k0) & (self.steps <= segment.before + segment.k1)

    def _structures(self, tables: DerivativeTables, h: float) -> Iterator[tuple[int, int, Any]]:
        """Yield ranges of members that share tables, with these."""
        if tables.of_members is not None:
            yield from tables.tables_at(h)
        elif self.values is None or self.values.ndim == 1:
            yield 0, self.members, tables.tables_at(h, *(() if self.values is None else (self.values,)))
        else:
            yield from ((m, m + 1, tables.tables_at(h, one)) for m, one in enumerate(self.values))

    def _marks(self, segment: Segment) -> NDArray[np.int64]:
        if segment.before is None:
            return ONE
        return self.steps[self.inside(segment)] - segment.before

    def _carry(self, tables: DerivativeTables, run: ForwardRun | BackwardRun) -> None:
        """Carry the vectors of all members, each with its inputs, on the threads of the run."""
        compiled, solved = not callable(tables.forward), True
        arrays = as_structure(run) if compiled else run
        for first, last, structure in self._structures(tables, run.h):
            own = arrays
            if run.coefficients.ndim == 3 and not compiled:
                own = cast(ForwardRun, run)._replace(coefficients=run.coefficients[first], apart=False)
            solved = solved and carry(tables, structure, own, first, last, self.workers)
        if not solved:
            begin, end = distinct(run.t0 + run.k0 * run.h, run.t0 + run.k1 * run.h)
            raise IntegrationError(
                f"the linear equations of the derivatives between t = {begin} and {end} are not solved; take a "
                f"smaller step than {abs(run.h):g}",
                step=run.k1,
                time=run.t0 + run.k1 * run.h,
                residual=float("nan"),
                partial=self.solution,
            )
