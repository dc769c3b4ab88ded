"""Derivatives of runs with inputs: the tables of a scheme, into which each call writes its values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.tables.invariants import invariants_table
from coadjoint.kernels.tables.structures import NotWritable
from coadjoint.kernels.tables.writable import WritableTables
from coadjoint.methods.protocol.derivative_tables import EXACT, DerivativeTables
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.program.multiples import NO_MULTIPLES
from coadjoint.runs.inputs import Inputs
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.parameter_differences import DISTANCE, RADIUS, NearbySystems

Floats = NDArray[np.float64]

INPUTS = "inputs"
"""Name of the derivatives by all inputs; their entries are those of `Inputs.values`."""


def tables_with_inputs(
    inputs: Inputs,
    scheme: Method,
    h: float,
    representation: Representation,
    energies: Mapping[str, EnergyDerivative],
) -> DerivativeTables:
    """Return the tables of a compiled scheme, of which `tables_at(step, values)` are those with inputs.

    Derivatives by inputs, with the name `INPUTS`, are those of the computed map. `energies` are the derivatives of the
    energy by other parameters.
    """
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
        return inputs.writable(CompiledLoop("", tables.tables_at(step), sources=tables.sources), watch)

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
    """Yield the systems with changed inputs, in the order in which these were prepared.

    The change of a state in a step, relative to its size, is of the size of the distance.
    """
    J = np.max(np.abs(inputs.system.structure_matrix(np.cos(1.0 + np.arange(inputs.system.dim)))))
    distance = RADIUS * DISTANCE / (abs(h) * (float(J) or 1.0))
    for index in inputs.changing.tolist():

        def moved(by: float, index: int = index) -> Any:
            other = values.copy()
            other[index] += by
            return inputs.system_at(other, system)

        yield NearbySystems(INPUTS, distance, moved)
