"""Derivatives of runs with inputs: the tables of a scheme, into which each call writes its values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.tables.inputs import InputsNotLocated, InputTables
from coadjoint.kernels.tables.invariants import invariants_table
from coadjoint.methods.protocol.derivative_tables import EXACT, DerivativeTables
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.program.added_part import CoefficientMap
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
    found = _Located(inputs, scheme, h, representation, energies)
    if not found.tables.located:
        return _Located(inputs, scheme, h, representation, {**energies, INPUTS: by_linear(inputs)}).tables_at_values()
    try:
        triplets = list(found.at(h).derivatives(found.tables.located, len(inputs.values)))
    except InputsNotLocated as reason:
        raise TypeError(
            f'{scheme} has no derivatives by inputs for {inputs.system.name}: {reason}; take parts="auto"'
        ) from None
    changing = set(inputs.changing.tolist())
    by_inputs = CoefficientMap.of_triplets([one for one in triplets if one[1] in changing])
    tables = found.tables_at_values()
    return tables._replace(
        coefficients={**tables.coefficients, INPUTS: by_inputs},
        factors={**tables.factors, INPUTS: CoefficientMap.of_triplets(())},
        rules={**tables.rules, INPUTS: EXACT},
    )


class _Located:
    """Tables of two systems that differ in the inputs, by which the inputs are located for each step."""

    def __init__(
        self,
        inputs: Inputs,
        scheme: Method,
        h: float,
        representation: Representation,
        energies: Mapping[str, EnergyDerivative],
    ) -> None:
        self._values, self._h = inputs.random_values(), h
        self._pair = [
            scheme.derivative_tables(inputs.system_at(values), h, representation, energies) for values in self._values
        ]
        self.tables = self._pair[0]
        self._watch = invariants_table([], inputs.system.dim).tables
        self._by_step: dict[float, InputTables] = {}

    def at(self, step: float) -> InputTables:
        """Return the tables of a step; those of the whole step are cached, and those of the last other one."""
        found = self._by_step.get(step)
        if found is None:
            first, second = (CompiledLoop("", one.tables_at(step), parts=one.parts) for one in self._pair)
            found = InputTables((first, second), (self._watch, self._watch), self._values)
            self._by_step = {h: one for h, one in self._by_step.items() if h == self._h} | {step: found}
        return found

    def tables_at_values(self) -> DerivativeTables:
        """Return the tables with inputs."""

        def tables_at(step: float, values: Floats) -> Any:
            located = self.at(step)
            structure, _ = located.shared(values)
            structure.owner = located
            return structure

        return self.tables._replace(tables_at=tables_at)


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
