"""Tables for the derivatives of a run: compiled ones, those of steps in Python, and with forces around either."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache, partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.compiled import CompiledTables, as_structure
from coadjoint.kernels.tables.derivatives import BackwardRun, FlowCotangents, ForwardRun
from coadjoint.kernels.tables.invariants import invariants_table
from coadjoint.long_operations import note_progress
from coadjoint.methods.forced import Forced
from coadjoint.methods.protocol.derivative_tables import DIFFERENCES, DerivativeTables
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.methods.protocol.step_derivatives import LinearizedStep
from coadjoint.program.generators import group_side
from coadjoint.program.multiples import NO_MULTIPLES, Multiples
from coadjoint.runs.derivatives.attitudes import AttitudeDerivatives
from coadjoint.runs.derivatives.forced_steps import FlowEntry, ForcedSteps, forced_tables
from coadjoint.runs.derivatives.input_derivatives import INPUTS, changed_inputs, tables_with_inputs
from coadjoint.runs.inputs import Inputs
from coadjoint.runs.loops.groups import Columns
from coadjoint.runs.loops.loops import loops_of_system
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.runs.preparation import Preparation
from coadjoint.systems.parameter_differences import (
    DISTANCE,
    NODES,
    WEIGHTS,
    NearbySystems,
    differences,
    nearby_systems,
)
from coadjoint.systems.parameters import Parameter, check_may_change, force_numbers, parameters_of, with_entry_moved

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
        tables = scheme.derivative_tables(system, h, representation, energies)
        # Of the whole step, and of the last other one.
        return tables._replace(tables_at=lru_cache(2)(lambda step: as_structure(tables.tables_at(step))))

    nearby = nearby_parameters(system, {name: run.parameters[name] for name in names})
    sizes = {name: run.parameters[name].value.size for name in names}
    if inputs is None:
        steps = StepwiseDerivatives(scheme, system, nearby, h, representation)
        return stepwise_derivatives(lambda: steps, sizes)

    as_given = run.prepared.given_method.fixed_steps

    def steps_at(values: Floats) -> StepwiseDerivatives:
        at_values = [one.with_systems(partial(inputs.system_at, values)) for one in nearby]
        if by_inputs:
            at_values += changed_inputs(inputs, system, values, h)
        here = inputs.system_at(values)
        return StepwiseDerivatives(scheme, here, at_values, h, representation, partial(inputs.settled, as_given))

    tables = stepwise_derivatives(steps_at, sizes | ({INPUTS: len(inputs.changing)} if by_inputs else {}))
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


class StepwiseDerivatives:
    """Derivatives of steps by the state (`Method.linearized`), of their group elements, and of both by parameters.

    Derivatives by parameters, and of the elements g of A -> A g by the state, are central differences of order 8.
    """

    def __init__(
        self,
        method: Method,
        system: Any,
        nearby: Sequence[NearbySystems],
        h: float,
        representation: Representation,
        method_of: Callable[[Any], Method] | None = None,
    ) -> None:
        self._method_of: Callable[[Any], Method] = (lambda _: method) if method_of is None else method_of
        self._method, self._system, self._nearby = method, system, nearby
        self._h, self._representation = h, representation
        self._steps: dict[int, tuple[Any, PartialSteps]] = {}

    def step(self, x: Floats, t: float, h: float) -> LinearizedStep:
        """Return a step with its derivative by the state."""
        return self._method.linearized(self._system, x, t, h)

    def element(self, x: Floats, t: float, h: float) -> tuple[Floats, Floats]:
        """Return the element (d, d) of a step, and its derivative (n, d, d) by the state; empty without an attitude."""
        if self._representation is None:
            return np.zeros((0, 0)), np.zeros((len(x), 0, 0))
        distance = DISTANCE * (float(np.max(np.abs(x))) or 1.0)
        moves = distance * np.concatenate([NODES, -NODES])[:, None, None] * np.eye(len(x))
        rows = np.concatenate([x[None], (x + moves).reshape(-1, len(x))])
        elements = self._elements(self._system, rows, t, h)
        moved = elements[1:].reshape(len(moves), len(x), *elements.shape[1:])
        weights = np.concatenate([WEIGHTS, -WEIGHTS]) / distance
        return elements[0], np.tensordot(weights, moved, axes=1)

    def _elements(self, system: Any, x: Floats, t: float, h: float) -> Floats:
        """Return the elements (m, d, d) of a step of a system from states (m, n)."""
        if id(system) not in self._steps:
            loops = loops_of_system(system, self._method, self._h, self._representation)
            if any(loops.corrections):
                raise TypeError(f"attitudes by {self._method} have no derivatives; take Splitting or GaussLegendre")
            # The system is stored with its loops: its number is not used for another one.
            self._steps[id(system)] = system, PartialSteps(system, self._method, loops)
        d = group_side(system.dim, self._representation)
        count, units = len(x), np.tile(np.eye(d).ravel(), (len(x), 1))
        owners = np.zeros(count, dtype=np.int64)
        _, groups = self._steps[id(system)][1].take(
            np.ascontiguousarray(x), units, np.full(count, t), np.full(count, h), owners
        )
        return np.swapaxes(groups.reshape(count, d, d), 1, 2)

    def by_parameters(self, x: Floats, t: float, h: float) -> tuple[Floats, Floats]:
        """Return the derivatives (entries, n) of a step and (entries, d, d) of its element by entries of parameters."""

        def after(system: Any) -> Floats:
            return np.asarray(self._method_of(system).step(system, x, t, h), dtype=np.float64)

        def turned(system: Any) -> Floats:
            return np.zeros((0, 0)) if self._representation is None else self._elements(system, x[None], t, h)[0]

        rows, of_element = differences(self._nearby, after), differences(self._nearby, turned)
        return np.array(rows).reshape(len(rows), len(x)), np.array(of_element)

    @np.errstate(over="ignore", invalid="ignore")
    def forward(self, run: ForwardRun, first: int, last: int) -> None:
        """Carry tangent vectors of members, as the compiled kernels do."""
        directed = bool(run.coefficients.any())
        for member in range(first, last):
            x, vectors, mark = run.momenta[member], run.tangents[member], 0
            group, of_group = _matrix_of(run, member), run.group_tangents[member]
            for k in range(run.k0 + 1, run.k1 + 1):
                t = run.t0 + (k - 1) * run.h
                note_progress(f"the derivative of step {k} of {run.k1}")
                step, (g, by_state) = self.step(x, t, run.h), self.element(x, t, run.h)
                of_g = np.tensordot(vectors, by_state, axes=1)
                vectors = step.tangents(vectors)
                if directed:
                    by_entries, of_elements = self.by_parameters(x, t, run.h)
                    vectors = vectors + run.coefficients @ by_entries
                    of_g = of_g + np.tensordot(run.coefficients, of_elements, axes=1)
                # Elements are stored transposed.
                of_group, group = g.T @ of_group + np.swapaxes(of_g, 1, 2) @ group, g.T @ group
                x = step.end
                if mark < run.marked and run.marks[mark] == k:
                    run.at_points[mark, member], run.at_groups[mark, member] = vectors, of_group
                    mark += 1
            run.tangents[member], run.group_tangents[member] = vectors, of_group

    @np.errstate(over="ignore", invalid="ignore")
    def backward(self, run: BackwardRun, first: int, last: int) -> None:
        """Carry cotangents of members, as the compiled kernels do."""
        for member in range(first, last):
            x, group, states, groups = run.momenta[member], _matrix_of(run, member), [], []
            steps: list[LinearizedStep] = []
            elements: list[tuple[Floats, Floats]] = []
            for k in range(run.k0 + 1, run.k1 + 1):
                note_progress(f"the derivative of step {k} of {run.k1}")
                t = run.t0 + (k - 1) * run.h
                states.append(x)
                groups.append(group)
                steps.append(self.step(x, t, run.h))
                elements.append(self.element(x, t, run.h))
                x, group = steps[-1].end, elements[-1][0].T @ group
            cotangent, mark = run.cotangents[member], run.marked
            of_group = run.group_cotangents[member]
            for k in range(run.k1, run.k0, -1):
                if mark > 0 and run.marks[mark - 1] == k:
                    mark -= 1
                    cotangent = cotangent + run.at_points[mark, member]
                    of_group = of_group + run.at_groups[mark, member]
                number = k - run.k0 - 1
                g, by_state = elements[number]
                of_g = groups[number] @ of_group.T
                if self._nearby:
                    by_entries, of_elements = self.by_parameters(states[number], run.t0 + (k - 1) * run.h, run.h)
                    run.coefficients[member] += by_entries @ cotangent + np.tensordot(of_elements, of_g, axes=2)
                cotangent = steps[number].cotangent(cotangent) + np.tensordot(by_state, of_g, axes=2)
                of_group = g @ of_group
            run.cotangents[member], run.group_cotangents[member] = cotangent, of_group


def _matrix_of(run: ForwardRun | BackwardRun, member: int) -> Floats:
    """Return the element of a member before the steps, transposed as in the loops."""
    side = round(run.square**0.5)
    return np.asarray(run.groups[member]).reshape(side, side)


def stepwise_derivatives(steps_at: Callable[..., StepwiseDerivatives], sizes: Mapping[str, int]) -> DerivativeTables:
    """Return the derivatives of a scheme without compiled ones, in the form of these; `sizes` are of parameters."""
    coefficients, start = {}, 0
    for name, size in sizes.items():
        entries = np.arange(size)
        coefficients[name] = Multiples(start + entries, entries, np.ones(size))
        start += size
    return DerivativeTables(
        tables_at=lambda h, *values: steps_at(*values),
        forward=StepwiseDerivatives.forward,
        backward=StepwiseDerivatives.backward,
        coefficient_count=start,
        coefficients=coefficients,
        factors=dict.fromkeys(sizes, NO_MULTIPLES),
        rules=dict.fromkeys(sizes, DIFFERENCES),
    )
