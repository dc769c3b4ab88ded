"""Derivatives with inputs: tables of a scheme, into which each call writes its values, and derivatives of one step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.tables.compiled import CompiledTables, NotWritable, as_structure
from coadjoint.kernels.tables.invariants import invariants_table
from coadjoint.kernels.tables.writable import WritableTables
from coadjoint.methods.protocol.derivative_tables import EXACT, DerivativeTables
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.program.multiples import NO_MULTIPLES
from coadjoint.runs.derivatives.stretches import Stretch, carry
from coadjoint.runs.inputs import Inputs
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.parameter_differences import DISTANCE, RADIUS, NearbySystems
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

INPUTS = "inputs"  # name of the derivatives by all inputs; their entries are those of `Inputs.values`


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


class StepTangents:
    """The derivatives of a step of length h, (n, n) by the state or along `vectors`, and (n, k) by inputs."""

    def __init__(
        self, tables: DerivativeTables, n: int, h: float, inputs: Sequence[int] = (), vectors: Floats | None = None
    ) -> None:
        units = np.eye(n + len(inputs), n) if vectors is None else vectors
        count = len(units)
        self._tables, self._tangents, self._compiled = tables, np.zeros((1, count, n)), not callable(tables.forward)
        self._units, self._momenta = units, np.zeros((1, n))
        self._h, self._fixed = h, None
        if INPUTS not in tables.coefficients:
            self._fixed = self._prepared(tables.tables_at(h))
        coefficients = np.zeros((count, tables.coefficient_count))
        if len(inputs):
            directions = np.zeros((count, 1 + max(inputs)))
            directions[np.arange(n, count), inputs] = 1.0
            coefficients += tables.coefficients[INPUTS].of_directions(directions, tables.coefficient_count)
        step = Stretch.of_step(0.0, h, self._momenta, np.zeros((1, 0, 0)))
        run = step.forward(self._tangents, np.zeros((1, count, 0, 0)), coefficients)
        self._after, self._run = run.at_points, self._prepared(run)

    def _prepared(self, table: Any) -> Any:
        """Return a table as the compiled loop reads it, or itself for steps in Python."""
        return as_structure(table) if self._compiled else table

    def __call__(self, x: Floats, t: float, values: Floats | None) -> Floats | None:
        """Return the derivatives side by side, (n, n + k), at values of the inputs; None if they are not finite."""
        structure = self._fixed if values is None else self._tables.tables_at(self._h, values)
        self._momenta[0], self._tangents[0] = x, self._units
        run = self._run
        if self._compiled:
            run.t0 = t
        else:
            run = run._replace(t0=t)
        if not carry(self._tables, structure, run, 0, 1):
            return None
        found = self._after[0, 0].T.copy()
        return found if np.isfinite(found).all() else None


def compiled_tangents(
    method: Method, system: System, h: float, vectors: Floats | None = None, inputs: Inputs | None = None
) -> StepTangents | None:
    """Return the derivatives of a step in the compiled loop; None without such a loop, and for user functions."""
    called = system.algebra is None or any(term.called for term in system.hamiltonian.terms())
    if called or not method.differentiable:
        return None
    if inputs is None:
        tables = method.derivative_tables(system, h, None, {})
    else:
        tables = tables_with_inputs(inputs, method, h, None, {})
    return StepTangents(tables, system.dim, h, vectors=vectors)
