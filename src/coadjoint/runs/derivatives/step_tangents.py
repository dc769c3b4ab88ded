"""Derivative of one step by its state and by inputs, with arrays that are kept for compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.tables.structures import as_structure
from coadjoint.methods.protocol.derivative_tables import DerivativeTables
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.derivatives.input_derivatives import INPUTS, tables_with_inputs
from coadjoint.runs.derivatives.stretches import Stretch, carry
from coadjoint.runs.inputs import Inputs
from coadjoint.systems.system import System

Floats = NDArray[np.float64]


class StepTangents:
    """The derivatives (n, n) by the state and (n, k) by k inputs, if any, of a step of length h.

    `vectors` (k, n) in rows replace the unit vectors of the state, for derivatives along them, (n, k).
    """

    def __init__(
        self, tables: DerivativeTables, n: int, h: float, inputs: Sequence[int] = (), vectors: Floats | None = None
    ) -> None:
        units = np.eye(n + len(inputs), n) if vectors is None else vectors
        count = len(units)
        self._tables, self._tangents = tables, np.zeros((1, count, n))
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
        return as_structure(table) if isinstance(self._tables.forward, str) else table

    def __call__(self, x: Floats, t: float, values: Floats | None) -> Floats | None:
        """Return the derivatives side by side, (n, n + k), at values of the inputs; None if they are not finite."""
        structure = self._fixed if values is None else self._tables.tables_at(self._h, values)
        self._momenta[0], self._tangents[0] = x, self._units
        tables, run = self._tables, self._run
        if isinstance(tables.forward, str):
            run.t0 = t
        else:
            run = run._replace(t0=t)
        if not carry(tables, structure, run, 0, 1):
            return None
        found = self._after[0, 0].T.copy()
        return found if np.isfinite(found).all() else None


def compiled_tangents(
    method: Method, system: System, h: float, vectors: Floats | None = None, inputs: Inputs | None = None
) -> StepTangents | None:
    """Return the derivatives of a step in the compiled loop of a scheme; None if there is no such loop.

    Functions of the user in J(x) or the Hamiltonian would have to be compiled: systems with any have none.
    """
    called = system.algebra is None or any(term.called for term in system.hamiltonian.terms())
    if called or not method.differentiable:
        return None
    if inputs is None:
        return StepTangents(method.derivative_tables(system, h, None, {}), system.dim, h, vectors=vectors)
    return StepTangents(tables_with_inputs(inputs, method, h, None, {}), system.dim, h, vectors=vectors)
