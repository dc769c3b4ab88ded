"""Tables for the derivatives of a run: compiled ones, those of steps in Python, with inputs, and with forces around."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, lru_cache, partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.compiled import CompiledTables, NotWritable, as_structure
from coadjoint.kernels.tables.derivatives import FlowCotangents
from coadjoint.kernels.tables.invariants import invariants_table
from coadjoint.kernels.tables.writable import WritableTables
from coadjoint.methods.forced import Forced
from coadjoint.methods.protocol.derivative_tables import EXACT, DerivativeTables
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.program.sources import NO_MULTIPLES
from coadjoint.runs.derivatives.forced_steps import (
    FlowEntry,
    ForcedTables,
    joined_tables,
    structure_of_members,
)
from coadjoint.runs.derivatives.segments import Segment, StepwiseDerivatives, carry, stepwise_derivatives
from coadjoint.runs.inputs import Inputs
from coadjoint.runs.loops.member_batches import Columns
from coadjoint.runs.loops.shifted_attitude import AttitudeDerivatives
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.parameter_differences import (
    DISTANCE,
    RADIUS,
    NearbySystems,
    nearby_systems,
)
from coadjoint.systems.parameters import Parameter, check_may_change, parameters_of, with_entry_moved
from coadjoint.systems.system import System

if TYPE_CHECKING:
    from coadjoint.runs.derivatives.differentiable_run import DifferentiableRun

Floats = NDArray[np.float64]

INPUTS = "inputs"  # name of the derivatives by all inputs; their entries are those of `Inputs.values`
NONE = np.zeros(0)  # values of no inputs
FEWEST_IN_LANES = 8  # members of a batch below which lanes are not faster than one member after the other


def build_tables(run: DifferentiableRun, h: float, names: Sequence[str], by_inputs: bool) -> DerivativeTables:
    """Return the tables of a step h, with the parameters of these names, and with the inputs if `by_inputs`."""
    if not run.system.forces:
        return _of_scheme(run, run.system, run.inputs, h, names, by_inputs)
    plain, inputs, representation = run.system.unforced, run.inputs, run.representation
    scheme = cast(Forced, run.scheme)
    of_plain = None if inputs is None else inputs.of_hamiltonian
    in_energy = [name for name in names if name in parameters_of(plain)]
    inner = _of_scheme(run, plain, of_plain, h, in_energy, by_inputs and of_plain is not None)
    entries = _flow_entries(run, names)
    attitudes = None if representation is None else AttitudeDerivatives(plain, inner.shift, representation)
    loops = run.prepared.loops(h)

    def entries_at(values: Floats) -> list[FlowEntry]:
        if inputs is None:
            return entries
        at_values = partial(inputs.system_at, values)
        moved = [one._replace(nearby=one.nearby.with_systems(at_values)) for one in entries]
        return moved + (_flow_entries_of_inputs(run, inputs, values, h) if by_inputs else [])

    def tables_at(step: float, values: Floats = NONE) -> Any:
        if inputs is None:
            return forced.structure(run.system, loops, step, entries, ())
        of_inner = () if of_plain is None else (values[: len(of_plain.values)],)
        system, of_values = inputs.system_at(values), loops.with_values(values)
        return forced.structure(system, of_values, step, entries_at(values), of_inner)

    generic = NONE if inputs is None else inputs.values
    system = run.system if inputs is None else inputs.system_at(generic)
    forced = ForcedTables(system, inner, scheme, entries_at(generic), attitudes)
    steps_at = lru_cache(2)(tables_at) if inputs is None else tables_at
    return forced.derivative_tables(steps_at, [*names, *([INPUTS] if by_inputs else [])])


def differ_in_columns(prepared: PreparedRun) -> bool:
    """Return whether the members of a batch differ in coefficients of one set of tables, also those of derivatives."""
    loops: Any = prepared.loops(prepared.step)
    if loops.columns_of_members is None or loops.order is not None:
        return False
    systems = [member.unforced for member in prepared.system.distinct]
    each = [[one.energy().monomials for one in parameters_of(system).values()] for system in systems]
    return all(one == each[0] for one in each)


class MemberColumns:
    """Tables of the derivatives of steps without forces of the members of a batch, which differ in columns."""

    def __init__(self, run: DifferentiableRun, h: float, names: Sequence[str]) -> None:
        systems, loops = run.system.systems, run.prepared.loops(run.prepared.step)
        if loops.columns_of_members is None:
            raise TypeError(f"the members of {run.system.name} have different functions; use prepared.jvp or vjp")
        self._columns: Columns = loops.columns_of_members
        self.values, self._dim = self._columns.values, systems[0].dim
        energies = {name: [run.energy(name, m) for m in range(len(systems))] for name in names}
        of_first = {name: each[0] for name, each in energies.items()}
        tables = run.base.derivative_tables(systems[0].unforced, h, run.representation, of_first)
        coefficients, factors = (
            {name: tables.monomials[name][k].of_energies(each) for name, each in energies.items()} for k in range(2)
        )
        self.tables = tables._replace(
            of_members=loops.shift_factors, coefficients=coefficients, factors=factors, tables_at=cache(self._ranges)
        )
        self._of_first = tables

    def _writable(self, step: float) -> tuple[WritableTables, bool]:
        """Return the tables of a step into which the members are written, and whether as columns."""
        loop = CompiledTables(self._of_first.tables_at(step), sources=self._of_first.sources)
        writable = self._columns.written_from(loop, invariants_table([], self._dim), self.values[0])
        in_lanes = type(loop.tables) is FlowCotangents and self._dim <= limit("WIDEST")
        return writable, in_lanes and not writable.separate_tables

    def together(self, step: float, count: int) -> Any:
        """Return the tables of the first members as columns; None if they are written apart."""
        writable, in_lanes = self._writable(step)
        if not count or not in_lanes:
            return None
        found, _, stride = writable.each(self.values[:count])
        found.stride, found.owner = stride, writable
        return found

    def are_of(self, each: Sequence[DerivativeTables], structure: Any) -> bool:
        """Return whether the coefficients of members are the first ones of their tables with forces."""
        found = [
            (own.position, own.number, own.factor[m], one.coefficients[name].take(np.arange(len(own.number))))
            for name, own in self.tables.coefficients.items()
            for m, one in enumerate(each)
        ]
        same = all(all(map(np.array_equal, own, other)) for *own, other in found)
        return same and self.tables.coefficient_count == structure.inner_coefficients

    def _ranges(self, step: float) -> list[tuple[int, int, Any]]:
        writable, _ = self._writable(step)
        members = len(self.values)
        rest = members % limit("MOST_LANES")
        count = members - (rest if rest < FEWEST_IN_LANES else 0)
        together = self.together(step, count)
        ranges = [] if together is None else [(0, count, together)]
        for m in range(0 if together is None else count, members):
            alone, _ = writable.shared(self.values[m])
            alone.owner = writable
            ranges.append((m, m + 1, alone))
        return ranges


def tables_of_members(run: DifferentiableRun, h: float, names: Sequence[str]) -> DerivativeTables:
    """Return the tables of the members of a batch, which differ in columns."""
    if not run.system.forces:
        return MemberColumns(run, h, names).tables
    system, loops, forced = run.system, run.prepared.loops(h), cast(Forced, run.scheme)
    firsts = np.unique(system.owners, return_index=True)[1]
    owners = (np.arange(len(system)) if system.has_noise else firsts[system.owners]).tolist()
    known = {m: run.of_member(m).tables(h, names) for m in dict.fromkeys(owners)}
    each = [known[m] for m in owners]
    columns, stepping = None, None
    if run.base.differentiates(system.first.unforced) and differ_in_columns(run.prepared):
        in_energy = [name for name in names if name in parameters_of(system.first.unforced)]
        columns = MemberColumns(run, h, in_energy)
        of_loops = cast(Columns, loops.columns_of_members).tables(loops.compiled[0], loops.watches[0])
        stepping = None if of_loops.separate_tables else of_loops

    @lru_cache(2)
    def tables_at(step: float) -> Any:
        structures = [one.tables_at(step) for one in each]
        if columns is None or stepping is None or not columns.are_of(each, structures[0]):
            return structure_of_members(structures)
        inner = [columns.together(c * step, len(each)) for c in dict.fromkeys(forced.fractions)]
        in_columns = None if None in inner else (stepping.each(columns.values)[0], inner)
        return structure_of_members(structures, in_columns)

    tables_at(h)  # raises NotWritable for members whose derivatives are not joined
    return joined_tables(each, tables_at)


def _flow_entries(run: DifferentiableRun, names: Sequence[str]) -> list[FlowEntry]:
    """Return the entries of parameters by which flows of forces change."""
    found, by_energy = [], _using_energy(run)
    for name in names:
        parameter = run.parameters[name]
        if parameter.field:
            check_may_change(run.system, name)
        moving = by_energy if parameter.position is None else _flows_of_force(run, parameter.position)
        if not moving:
            continue
        nearby = nearby_parameters(run.system, {name: parameter})
        field, energy = "", None
        if run.inputs is None:  # derivatives of the energy may depend on inputs
            field, energy = parameter.field, None if parameter.field else parameter.energy()
        found += [FlowEntry(name, entry, one, moving, field, energy) for entry, one in enumerate(nearby)]
    return found


def _flow_entries_of_inputs(run: DifferentiableRun, inputs: Inputs, values: Floats, h: float) -> list[FlowEntry]:
    """Return the inputs by which flows of forces change."""
    found, by_energy = [], _using_energy(run)
    for index, nearby in zip(inputs.changing.tolist(), changed_inputs(inputs, run.system, values, h), strict=True):
        torque = inputs.force_of(index)
        moving = by_energy if torque is None else _flows_of_force(run, torque)
        if moving:
            found.append(FlowEntry(INPUTS, index, nearby, moving))
    return found


def _using_energy(run: DifferentiableRun) -> tuple[int, ...]:
    return tuple(j for j, (_, flow) in enumerate(run.system.flows) if flow._needs_energy(run.system.unforced))


def _flows_of_force(run: DifferentiableRun, position: int) -> tuple[int, ...]:
    """Return the flows that a force at this position changes: its own, and that which evaluates its law."""
    sampled = run.system.forces[position].sampled
    return tuple(j for j, (k, _) in enumerate(run.system.flows) if k == position or (sampled and not j))


def _of_scheme(
    run: DifferentiableRun, system: Any, inputs: Inputs | None, h: float, names: Sequence[str], by_inputs: bool
) -> DerivativeTables:
    """Return the tables of the scheme on a system without forces."""
    scheme, representation = run.base, run.representation
    if scheme.differentiates(system):
        energies = {name: run.energy(name) for name in names}
        if inputs is not None:
            return tables_with_inputs(inputs, scheme, h, representation, energies)
        tables = scheme.derivative_tables(system, h, representation, energies)
        # Of the whole step, and of the last other one.
        return tables._replace(tables_at=lru_cache(2)(lambda step: as_structure(tables.tables_at(step))))

    exact = names if scheme.by_stages and representation is None and not system.has_matrices else ()
    nearby = nearby_parameters(system, {name: run.parameters[name] for name in names if name not in exact})
    by_stages = [run.energy(name) for name in exact]
    sizes = {name: run.parameters[name].value.size for name in names}
    if inputs is None:
        steps = StepwiseDerivatives(scheme, system, nearby, h, representation, energies=by_stages)
        return stepwise_derivatives(lambda: steps, sizes, exact)

    as_given = run.prepared.given_method.fixed_steps

    def steps_at(values: Floats) -> StepwiseDerivatives:
        at_values = [one.with_systems(partial(inputs.system_at, values)) for one in nearby]
        if by_inputs:
            at_values += changed_inputs(inputs, system, values, h)
        here = inputs.system_at(values)
        settled = partial(inputs.settled, as_given)
        return StepwiseDerivatives(scheme, here, at_values, h, representation, settled, by_stages)

    tables = stepwise_derivatives(steps_at, sizes | ({INPUTS: len(inputs.changing)} if by_inputs else {}), exact)
    if by_inputs:
        # The entries are those of all values.
        numbered = tables.coefficients[INPUTS]._replace(number=inputs.changing)
        tables = tables._replace(coefficients={**tables.coefficients, INPUTS: numbered})
    return tables


def nearby_parameters(system: Any, parameters: Mapping[str, Parameter]) -> list[NearbySystems]:
    """Return the systems with moved entries of parameters, one parameter after the other."""
    return [
        nearby
        for name, parameter in parameters.items()
        for nearby in nearby_systems(name, parameter.value, partial(with_entry_moved, system, name, parameter))
    ]


def tables_with_inputs(
    inputs: Inputs,
    scheme: Method,
    h: float,
    representation: Representation,
    energies: Mapping[str, EnergyDerivative],
) -> DerivativeTables:
    """Return the tables of a compiled scheme, of which `tables_at(step, values)` are those with inputs."""
    tables, at = _located(inputs, scheme, h, representation, energies)
    if not tables.located:
        return _located(inputs, scheme, h, representation, {**energies, INPUTS: by_linear(inputs)})[0]
    try:
        by_inputs = at(h).derivatives(tables.located)
    except NotWritable as reason:
        raise TypeError(
            f'{scheme} has no derivatives by inputs for {inputs.system.name}: {reason}; take parts="auto"'
        ) from None
    return tables._replace(
        coefficients={**tables.coefficients, INPUTS: by_inputs},
        factors={**tables.factors, INPUTS: NO_MULTIPLES},
        rules={**tables.rules, INPUTS: EXACT},
    )


def _located(
    inputs: Inputs,
    scheme: Method,
    h: float,
    representation: Representation,
    energies: Mapping[str, EnergyDerivative],
) -> tuple[DerivativeTables, Callable[[float], WritableTables]]:
    """Return tables with inputs, and those into which inputs are written for each step."""
    tables = scheme.derivative_tables(inputs.system_at(inputs.generic), h, representation, energies)
    watch = invariants_table([], inputs.system.dim)

    # Those of the whole step, and of the last other one.
    @lru_cache(2)
    def at(step: float) -> WritableTables:
        return inputs.writable(CompiledTables(tables.tables_at(step), sources=tables.sources), watch)

    def tables_at(step: float, values: Floats) -> Any:
        located = at(step)
        structure, _ = located.shared(values)
        structure.owner = located
        return structure

    return tables._replace(tables_at=tables_at), at


def by_linear(inputs: Inputs) -> EnergyDerivative:
    """Return the derivative of the energy by the inputs."""
    at = inputs.in_energy
    return EnergyDerivative.of_monomials(len(inputs.values))._replace(
        linear=at, linear_entry=at, linear_factor=np.ones(len(at))
    )


def without_inputs(energy: EnergyDerivative, inputs: Inputs) -> EnergyDerivative:
    """Return the derivative of the energy by a parameter of the system, without coefficients that are inputs."""
    rest = ~np.isin(energy.linear, inputs.in_energy)
    return energy._replace(
        linear=energy.linear[rest],
        linear_entry=energy.linear_entry[rest],
        linear_factor=energy.linear_factor[rest],
    )


def changed_inputs(inputs: Inputs, system: Any, values: Floats, h: float) -> Iterator[NearbySystems]:
    """Yield the systems with changed inputs; a state changes in a step, relative to its size, as by the distance."""
    J = np.max(np.abs(inputs.system.structure_matrix(np.cos(1.0 + np.arange(inputs.system.dim)))))
    distance = RADIUS * DISTANCE / (abs(h) * (float(J) or 1.0))
    for index in inputs.changing.tolist():

        def moved(by: float, index: int = index) -> Any:
            other = values.copy()
            other[index] += by
            return inputs.system_at(other, system)

        yield NearbySystems(INPUTS, distance, moved)


StepTangents = Callable[[Floats, float, Floats | None], Floats | None]
"""Derivatives (n, n + k) of a step, by the state, then inputs, at a state, a time and inputs; None if not finite."""


def step_tangents(
    tables: DerivativeTables, n: int, h: float, inputs: Sequence[int] = (), vectors: Floats | None = None
) -> StepTangents:
    """Return the derivatives of a step of length h, by the state or along `vectors`, and by inputs."""
    units = np.eye(n + len(inputs), n) if vectors is None else vectors
    count, is_compiled = len(units), not callable(tables.forward)
    # Compiled loops read structures, steps in Python the tables themselves.
    prepared: Callable[[Any], Any] = as_structure if is_compiled else lambda table: table
    momenta, tangents = np.zeros((1, n)), np.zeros((1, count, n))
    fixed = None if INPUTS in tables.coefficients else prepared(tables.tables_at(h))
    coefficients = np.zeros((count, tables.coefficient_count))
    if len(inputs):
        directions = np.zeros((count, 1 + max(inputs)))
        directions[np.arange(n, count), inputs] = 1.0
        coefficients += tables.coefficients[INPUTS].of_directions(directions, tables.coefficient_count)
    forward = Segment.of_step(0.0, h, momenta, np.zeros((1, 0, 0))).forward(
        tangents, np.zeros((1, count, 0, 0)), coefficients
    )
    after, prepared_run = forward.at_points, prepared(forward)

    def derivatives(x: Floats, t: float, values: Floats | None) -> Floats | None:
        structure = fixed if values is None else tables.tables_at(h, values)
        momenta[0], tangents[0] = x, units
        run = prepared_run
        if is_compiled:
            run.t0 = t
        else:
            run = run._replace(t0=t)
        if not carry(tables, structure, run, 0, 1):
            return None
        found = after[0, 0].T.copy()
        return found if np.isfinite(found).all() else None

    return derivatives


def compiled_tangents(
    method: Method, system: System, h: float, vectors: Floats | None = None, inputs: Inputs | None = None
) -> StepTangents | None:
    """Return the derivatives of a step in the compiled loop; None without such a loop, and for user functions."""
    called = system.algebra is None or any(term.called for term in system.hamiltonian.terms())
    if called or not method.differentiates(system):
        return None
    if inputs is None:
        tables = method.derivative_tables(system, h, None, {})
    else:
        tables = tables_with_inputs(inputs, method, h, None, {})
    return step_tangents(tables, system.dim, h, vectors=vectors)
