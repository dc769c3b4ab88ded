"""Tables for the derivatives of a run: compiled ones, those of steps in Python, and with forces around either."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.compiled import CompiledTables
from coadjoint.kernels.tables.cotangents import FlowCotangents
from coadjoint.kernels.tables.invariants import invariants_table
from coadjoint.methods.forced import Forced
from coadjoint.methods.protocol.derivative_tables import (
    DerivativeTables,
    StepwiseDerivatives,
    nearby_parameters,
    stepwise_derivatives,
)
from coadjoint.runs.derivatives.attitudes import AttitudeDerivatives, ElementDifferences
from coadjoint.runs.derivatives.forced_steps import FlowEntry, ForcedSteps, forced_tables
from coadjoint.runs.derivatives.input_derivatives import INPUTS, changed_inputs, tables_with_inputs
from coadjoint.runs.inputs import Inputs
from coadjoint.runs.loops.groups import Columns
from coadjoint.runs.loops.loops import loops_of_system
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.runs.preparation import Preparation
from coadjoint.systems.parameters import check_may_change, force_numbers, parameters_of

if TYPE_CHECKING:
    from coadjoint.runs.derivatives.differentiable_run import DifferentiableRun

Floats = NDArray[np.float64]

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
    loops_of = partial(loops_of_system, plain) if of_plain is None else of_plain.loops
    loops = {c: loops_of(run.base, c * h, representation) for c in dict.fromkeys(scheme.fractions)}

    def entries_at(values: Floats) -> list[FlowEntry]:
        if inputs is None:
            return entries
        at_values = partial(inputs.system_at, values)
        moved = [one._replace(nearby=one.nearby.with_systems(at_values)) for one in entries]
        return moved + (_flow_entries_of_inputs(run, inputs, values, h) if by_inputs else [])

    def steps_at(step: float, values: Floats = NONE) -> ForcedSteps:
        system, of_steps = run.system if inputs is None else inputs.system_at(values), loops
        inner_values: tuple[Floats, ...] = ()
        if of_plain is not None:
            inner_values = (values[: len(of_plain.values)],)
            of_steps = {c: one.with_values(*inner_values) for c, one in loops.items()}
        structures = {c * step: inner.tables_at(c * step, *inner_values) for c in loops}
        parts = {c * step: PartialSteps(system.unforced, run.base, one) for c, one in of_steps.items()}
        return ForcedSteps(system, inner, scheme, structures, parts, entries_at(values), attitudes)

    every = entries_at(NONE if inputs is None else inputs.values)
    return forced_tables(inner, steps_at, every, [*names, *([INPUTS] if by_inputs else [])])


def differ_in_columns(prepared: Preparation) -> bool:
    """Return whether the members of a batch differ in coefficients of one set of tables, also those of derivatives."""
    loops: Any = prepared.loops(prepared.step)
    if loops.columns_of_members is None or loops.order is not None:
        return False
    each = [[one.energy().monomials for one in parameters_of(member).values()] for member in prepared.system.distinct]
    return all(one == each[0] for one in each)


def tables_of_members(run: DifferentiableRun, h: float, names: Sequence[str]) -> DerivativeTables:
    """Return the tables of the members of a batch, which differ in columns."""
    systems, loops = run.system.systems, run.prepared.loops(run.prepared.step)
    columns = cast(Columns, loops.columns_of_members)
    energies = {name: [run.energy(name, m) for m in range(len(systems))] for name in names}
    tables = run.base.derivative_tables(
        systems[0], h, run.representation, {name: each[0] for name, each in energies.items()}
    )
    watch = invariants_table([], systems[0].dim)

    @cache
    def tables_at(step: float) -> list[tuple[int, int, Any]]:
        loop = CompiledTables(tables.tables_at(step), sources=tables.sources)
        writable = columns.written_from(loop, watch, columns.values[0])
        count = 0
        ranges: list[tuple[int, int, Any]] = []
        in_lanes = type(loop.tables) is FlowCotangents and systems[0].dim <= limit("WIDEST")
        if in_lanes and not writable.separate_tables:
            rest = len(systems) % limit("MOST_LANES")
            count = len(systems) - (rest if rest < FEWEST_IN_LANES else 0)
        if count:
            together, _, stride = writable.each(columns.values[:count])
            together.stride = stride
            ranges.append((0, count, together))
        ranges += [(m, m + 1, writable.shared(columns.values[m])[0]) for m in range(count, len(systems))]
        for *_, structure in ranges:
            structure.owner = writable
        return ranges

    coefficients, factors = (
        {name: tables.monomials[name][k].of_energies(each) for name, each in energies.items()} for k in range(2)
    )
    return tables._replace(
        tables_at=tables_at, of_members=loops.shift_factors, coefficients=coefficients, factors=factors
    )


def _flow_entries(run: DifferentiableRun, names: Sequence[str]) -> list[FlowEntry]:
    """Return the entries of parameters by which flows of forces change."""
    of_forces, found = force_numbers(run.system), []
    by_energy = _using_energy(run)
    for name in names:
        if name in of_forces:
            check_may_change(run.system, name)
        moving = (of_forces[name].position,) if name in of_forces else by_energy
        if not moving:
            continue
        nearby = nearby_parameters(run.system, {name: run.parameters[name]})
        part: Any = None
        if run.inputs is None:  # derivatives of the energy may depend on inputs
            part = of_forces[name].field if name in of_forces else run.parameters[name].energy()
        found += [FlowEntry(name, entry, one, moving, part) for entry, one in enumerate(nearby)]
    return found


def _flow_entries_of_inputs(run: DifferentiableRun, inputs: Inputs, values: Floats, h: float) -> list[FlowEntry]:
    """Return the inputs by which flows of forces change."""
    found, by_energy = [], _using_energy(run)
    for index, nearby in zip(inputs.changing.tolist(), changed_inputs(inputs, run.system, values, h), strict=True):
        torque = inputs.force_of(index)
        moving = by_energy if torque is None else (torque,)
        if moving:
            found.append(FlowEntry(INPUTS, index, nearby, moving))
    return found


def _using_energy(run: DifferentiableRun) -> tuple[int, ...]:
    return tuple(j for j, force in enumerate(run.system.forces) if force.uses_energy)


def _of_scheme(
    run: DifferentiableRun, system: Any, inputs: Inputs | None, h: float, names: Sequence[str], by_inputs: bool
) -> DerivativeTables:
    """Return the tables of the scheme on a system without forces."""
    scheme, representation = run.base, run.representation
    if scheme.differentiable:
        energies = {name: run.energy(name) for name in names}
        if inputs is not None:
            return tables_with_inputs(inputs, scheme, h, representation, energies)
        return scheme.derivative_tables(system, h, representation, energies)

    def elements() -> ElementDifferences | None:
        return None if representation is None else ElementDifferences(scheme, h, representation)

    nearby = nearby_parameters(system, {name: run.parameters[name] for name in names})
    sizes = {name: run.parameters[name].value.size for name in names}
    if inputs is None:
        steps = StepwiseDerivatives(scheme, system, nearby, elements())
        return stepwise_derivatives(lambda: steps, sizes)

    as_given = run.prepared.given_method.fixed_steps

    def steps_at(values: Floats) -> StepwiseDerivatives:
        at_values = [one.with_systems(partial(inputs.system_at, values)) for one in nearby]
        if by_inputs:
            at_values += changed_inputs(inputs, system, values, h)
        here = inputs.system_at(values)
        return StepwiseDerivatives(scheme, here, at_values, elements(), partial(inputs.settled, as_given))

    tables = stepwise_derivatives(steps_at, sizes | ({INPUTS: len(inputs.changing)} if by_inputs else {}))
    if by_inputs:
        # The entries are those of all values.
        numbered = tables.coefficients[INPUTS]._replace(number=inputs.changing)
        tables = tables._replace(coefficients={**tables.coefficients, INPUTS: numbered})
    return tables
