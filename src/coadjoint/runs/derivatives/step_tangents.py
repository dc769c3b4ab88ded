"""Derivative of one step by its state and by inputs, with arrays that are kept for compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import raised_by
from coadjoint.kernels.loop import StopFlag
from coadjoint.kernels.tables.cotangents import ForwardRun, advance_tables
from coadjoint.kernels.tables.structures import as_structure
from coadjoint.methods.protocol.derivative_tables import DerivativeTables
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.derivatives.input_derivatives import INPUTS
from coadjoint.systems.system_checks import System

Floats = NDArray[np.float64]


class StepTangents:
    """The derivatives (n, n) by the state and (n, k) by k inputs, if any, of a step of length h.

    `vectors` (k, n) in rows replace the unit vectors of the state, for derivatives along them, (n, k).
    """

    def __init__(
        self,
        tables: DerivativeTables,
        n: int,
        h: float,
        inputs: Sequence[int] = (),
        vectors: Floats | None = None,
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
            coefficients += tables.coefficients[INPUTS].of_coefficients(directions, tables.coefficient_count)
        self._after = np.zeros((1, 1, count, n))
        self._run: Any = self._prepared(
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
                groups=np.zeros((1, 0)),
                marked=1,
                marks=np.ones(1, dtype=np.int64),
                at_points=self._after,
                at_groups=np.zeros((1, 1, count, 0, 0)),
                tangents=self._tangents,
                group_tangents=np.zeros((1, count, 0, 0)),
                coefficients=coefficients,
                threads=1,
            )
        )

    def _prepared(self, table: Any) -> Any:
        """Return a table as the compiled loop reads it, or itself for steps in Python."""
        return as_structure(table) if isinstance(self._tables.forward, str) else table

    def __call__(self, x: Floats, t: float, values: Floats | None) -> Floats | None:
        """Return the derivatives side by side, (n, n + k), at values of the inputs; None if they are not finite."""
        structure = self._fixed if values is None else self._tables.tables_at(self._h, values)
        self._momenta[0], self._tangents[0] = x, self._units
        if not isinstance(self._tables.forward, str):
            self._tables.forward(structure, self._run._replace(t0=t), 0, 1)
        else:
            self._run.t0 = t
            if not advance_tables(self._tables.forward, structure, self._run, 0, 1, StopFlag()):
                if (raised := raised_by(self._tables.keepalive)) is not None:
                    raise raised
                return None
        found = self._after[0, 0].T.copy()
        return found if np.isfinite(found).all() else None


def compiled_tangents(method: Method, system: System, h: float, vectors: Floats | None = None) -> StepTangents | None:
    """Return the derivatives of a step in the compiled loop of a scheme; None if there is no such loop.

    Functions of the user would have to be compiled: systems with any have none.
    """
    if has_user_functions(system) or not method.differentiable:
        return None
    return StepTangents(method.derivative_tables(system, h, None, {}), system.dim, h, vectors=vectors)


def has_user_functions(system: System) -> bool:
    """Return whether J(x) or the Hamiltonian contains functions of the user."""
    return system.algebra is None or any(term.called for term in system.hamiltonian.terms())
