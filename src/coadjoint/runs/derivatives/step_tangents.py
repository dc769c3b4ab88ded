"""Derivative of one step by its state and by parameters, in a compiled loop with arrays that are kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import StopFlag
from coadjoint.kernels.tables.cotangents import ForwardRun, advance_tables
from coadjoint.kernels.tables.structures import as_structure
from coadjoint.methods.protocol.derivatives import DerivativeTables
from coadjoint.systems.energy_derivatives import EnergyDerivative

Floats = NDArray[np.float64]


class StepTangents:
    """The derivatives (n, n) by the state and (n, entries) by one parameter, if any, of a step of length h."""

    def __init__(self, tables: DerivativeTables, n: int, h: float, entries: int = 0) -> None:
        count = n + entries
        assert isinstance(tables.forward, str)
        self._tables, self._tangents, self._name = tables, np.zeros((1, count, n)), tables.forward
        self._units, self._momenta = np.eye(count, n), np.zeros((1, n))
        self._structure, self._n = tables.tables_at(h), n
        directions = np.eye(count)[:, n:]
        coefficients = np.zeros((count, tables.coefficient_count))
        for one in tables.coefficients.values():
            coefficients += one.of_coefficients(directions, tables.coefficient_count)
        self._after, empty = np.zeros((1, 1, count, n)), np.zeros(0)
        self._run = as_structure(
            ForwardRun(
                size=n,
                square=0,
                members=1,
                carried=count,
                t0=0.0,
                h=h,
                k0=0,
                k1=1,
                momenta=self._momenta,
                errors=np.zeros((1, n)),
                groups=empty,
                marked=1,
                marks=np.ones(1, dtype=np.int64),
                at_points=self._after,
                at_groups=empty,
                tangents=self._tangents,
                group_tangents=empty,
                coefficients=coefficients,
            )
        )

    def __call__(self, x: Floats, t: float) -> Floats | None:
        """Return the derivatives side by side, (n, n + entries); None if they are not finite numbers."""
        self._momenta[0], self._tangents[0], self._run.t0 = x, self._units, t
        if not advance_tables(self._name, self._structure, self._run, 0, 1, StopFlag()):
            return None
        found = self._after[0, 0].T.copy()
        return found if np.isfinite(found).all() else None


def linear_inputs(coordinates: NDArray[np.int64]) -> EnergyDerivative:
    """Return the derivative of the energy by the coefficients of the linear term at these coordinates."""
    count = len(coordinates)
    return EnergyDerivative.of_monomials(count)._replace(
        linear=coordinates, linear_entry=np.arange(count), linear_factor=np.ones(count)
    )
