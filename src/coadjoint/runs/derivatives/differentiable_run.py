"""A run whose derivatives are computed: its steps and outputs, in stretches, and the tables of its scheme."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import StopFlag
from coadjoint.kernels.tables.cotangents import BackwardRun, ForwardRun, advance_tables
from coadjoint.kernels.tables.tangents import check_differentiable
from coadjoint.memory import check_available_memory
from coadjoint.methods.protocol.derivatives import DerivativeTables, derivative_tables, has_derivatives
from coadjoint.methods.protocol.stepwise_derivatives import stepwise_derivatives
from coadjoint.runs.derivatives.attitudes import AttitudeDerivatives
from coadjoint.runs.loops.execution import sum_in_threads
from coadjoint.runs.loops.rows import split_members
from coadjoint.runs.output_times import OutputTimes, check_partial_steps, resample
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.parameters import Parameter, parameters_of
from coadjoint.systems.protocol import forces_of, is_batch, is_matrix_system
from coadjoint.validation import read_choice

if TYPE_CHECKING:
    from coadjoint.runs.prepared_run import PreparedRun

Floats = NDArray[np.float64]

REVERSES = ("exact", "reversible")
# Numbers of the states of a stretch of steps of a member: they stay in the cache.
NUMBERS_OF_STRETCH = 2**15
# Largest memory of the first states of stretches, above which these are longer.
BYTES_OF_CHECKPOINTS = 2**25


class Stretch(NamedTuple):
    """Steps k0 + 1 to k1 of all members, from t0 + k0 h, and the unfinished states from which they start.

    If `undone`, the states are those at the end, from which the steps are undone.
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


class DifferentiableRun:
    """A prepared run with the derivative of the energy by its parameters, and the tables of its scheme.

    `parameters` replace those of its system. Raises TypeError for what cannot be differentiated.
    """

    def __init__(self, prepared: PreparedRun, parameters: Mapping[str, Parameter] | None = None) -> None:
        system = prepared.system
        for unsupported, what, instead in (
            (is_batch(system), "of a batch", "differentiate the run of each member"),
            (bool(forces_of(system)), "of a system with forces", "take the system without them"),
            (is_matrix_system(system), "of a system of matrices", "only systems of vectors have them"),
            (prepared.takes_inputs, "prepared with inputs", "prepare without inputs=, and differentiate by parameters"),
        ):
            if unsupported:
                raise TypeError(f"runs {what} have no derivatives: {system!r}; {instead}")
        if prepared.method.own_steps:
            raise TypeError(f"{prepared.method} chooses its own steps, and its runs have no derivatives; give a step")
        if has_derivatives(prepared.scheme):
            check_differentiable(system)
        self.prepared, self.system = prepared, system
        self.parameters: Mapping[str, Parameter] = parameters_of_run(system) if parameters is None else parameters
        self.representation = prepared.representation
        self._energies: dict[str, EnergyDerivative] = {}
        self._tables: dict[Any, DerivativeTables] = {}

    def energy(self, name: str) -> EnergyDerivative:
        """Return the derivative of the energy by a parameter."""
        if name not in self._energies:
            self._energies[name] = self.parameters[name].energy()
        return self._energies[name]

    def tables(self, h: float, names: Iterable[str]) -> DerivativeTables:
        """Return the tables of the scheme for a step, with the parameters of these names."""
        chosen = frozenset(names)
        if (h, chosen) not in self._tables:
            self._tables[h, chosen] = self._build_tables(h, [name for name in self.parameters if name in chosen])
        return self._tables[h, chosen]

    def _build_tables(self, h: float, names: Sequence[str]) -> DerivativeTables:
        scheme = self.prepared.scheme
        if has_derivatives(scheme):
            energies = {name: self.energy(name) for name in names}
            return derivative_tables(scheme, self.system, h, self.representation, energies)
        if self.representation is not None:
            raise TypeError(
                f"attitudes by {scheme} have no derivatives; take Splitting or GaussLegendre, or no attitude"
            )
        return stepwise_derivatives(scheme, self.system, {name: self.parameters[name] for name in names})

    def check_reverse(self, reverse: Any, h: float) -> None:
        """Validate how a run is differentiated backward; raise TypeError for a scheme whose steps cannot be undone."""
        if read_choice(reverse, "reverse", REVERSES) == "reversible" and not self.tables(h, self.parameters).reversible:
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

    def __init__(
        self,
        run: DifferentiableRun,
        x0: Any,
        t_span: Any,
        save_every: int,
        t_eval: Any,
        attitude: Any,
        reverse: str | None,
    ) -> None:
        prepared = run.prepared
        times, moments = prepared.times_of(t_span, save_every, t_eval)
        if moments is not None:
            check_partial_steps(run.system, moments)
            times = times.with_saved_steps(moments.marks)
        self.times, self.start = times, prepared.start(x0, attitude)
        self._run = prepared.begun(times, self.start)
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

    def _integrated(self, step: int, distance: int) -> Stretch:
        """Take the steps of a stretch."""
        state, last = self._run.state, min(step + distance, self.times.steps)
        momenta, errors, groups, group_errors = (
            state[name].copy() for name in ("momenta", "errors", "groups", "group_errors")
        )
        self._run.advance(until=last)
        return Stretch(self.times.t0, self.times.h, step, last, momenta, errors, groups, group_errors)

    def _stretch_length(self) -> int:
        steps, numbers = self.times.steps, self.n + self.side**2
        length, bytes_of_each = max(1, NUMBERS_OF_STRETCH // numbers), 16 * numbers * self.members
        length = max(length, -(-steps * bytes_of_each // BYTES_OF_CHECKPOINTS))
        lanes = min(self.members, limit("MOST_LANES"))
        check_available_memory(
            bytes_of_each * (steps // length + 1) + 8 * numbers * lanes * min(length, steps),
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
            t0=float(self.times.t0 + self.steps[point] * self.times.h),
            h=float(self.length[k]),
            k0=0,
            k1=1,
            momenta=np.ascontiguousarray(self.states[point]),
            errors=np.zeros((members, self.n)),
            groups=self.groups[point],
            group_errors=np.zeros((members, self.side, self.side)),
        )

    @property
    def outputs(self) -> tuple[Floats, Floats]:
        """States (points, members, n) and elements of the loop (points, members, d, d) at the outputs."""
        return self.with_members(self.solution.x), np.swapaxes(self._elements()[: len(self.point)], 2, 3)

    def with_members(self, series: Any) -> Floats:
        """Return a series of the solution with an axis of members."""
        return np.asarray(series[:, None] if self.start.single else series)

    def forward(
        self, tables: DerivativeTables, stretch: Stretch, of_x: Floats, of_groups: Floats, coefficients: Floats
    ) -> tuple[Floats, Floats]:
        """Carry tangents (members, count, n) and (members, count, d, d) over a stretch.

        Returns those after its saved steps, or after a partial step, with a first axis of points.
        """
        marks = self._marks(stretch)
        at_points, at_groups = (np.zeros((len(marks), *one.shape)) for one in (of_x, of_groups))
        fields = stretch._asdict()
        del fields["group_errors"], fields["undone"]
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
            **fields,
        )
        self._call(tables.forward, tables.tables_at(stretch.h), run)
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
        marks = self._marks(stretch)
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
            **stretch._asdict(),
        )
        self._call(tables.backward, tables.tables_at(stretch.h), run)

    def inside(self, stretch: Stretch) -> NDArray[np.bool_]:
        """Return which saved steps belong to a stretch of whole steps."""
        return (self.steps > stretch.k0) & (self.steps <= stretch.k1)

    def _marks(self, stretch: Stretch) -> NDArray[np.int64]:
        if stretch.h != self.times.h or stretch.t0 != self.times.t0:
            return np.ones(1, dtype=np.int64)
        return self.steps[self.inside(stretch)]

    def _call(self, kernel: str | Callable[[Any], None], tables: Any, run: ForwardRun | BackwardRun) -> None:
        """Call a kernel for all members, on the threads of the run, or a function."""
        if not isinstance(kernel, str):
            return kernel(run)
        name = kernel
        stop = StopFlag()
        ranges = split_members(0, self.members, self._run.workers, limit("MOST_LANES"))

        def unsolved(members: tuple[int, int]) -> int:
            return not advance_tables(name, tables, run, *members, stop)

        count = unsolved(ranges[0]) if len(ranges) == 1 else sum_in_threads(unsolved, ranges, self._run.workers, stop)
        if count:
            raise IntegrationError(
                f"the linear equations of the derivatives between t = {run.t0 + run.k0 * run.h:g} and "
                f"{run.t0 + run.k1 * run.h:g} are not solved; take a smaller step than {abs(run.h):g}",
                step=run.k1,
                time=run.t0 + run.k1 * run.h,
                residual=float("nan"),
                partial=self.solution,
            )


def parameters_of_run(system: Any) -> dict[str, Parameter]:
    """Return the parameters of the system of a run; none for systems that cannot be differentiated."""
    if is_batch(system) or forces_of(system) or is_matrix_system(system):
        return {}
    return parameters_of(system)
