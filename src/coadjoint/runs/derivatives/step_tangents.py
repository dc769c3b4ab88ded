"""Derivative of one step by its state and by inputs, in a compiled loop with arrays that are kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import raised_by
from coadjoint.kernels.loop import StopFlag
from coadjoint.kernels.tables.cotangents import ForwardRun, advance_tables
from coadjoint.kernels.tables.structures import as_structure
from coadjoint.methods.protocol.derivatives import DerivativeTables
from coadjoint.runs.derivatives.input_derivatives import INPUTS

Floats = NDArray[np.float64]


class StepTangents:
    """The derivatives (n, n) by the state and (n, k) by k inputs, if any, of a step of length h."""

    def __init__(self, tables: DerivativeTables, n: int, h: float, inputs: Sequence[int] = ()) -> None:
        count = n + len(inputs)
        assert isinstance(tables.forward, str)
        self._tables, self._tangents, self._name = tables, np.zeros((1, count, n)), tables.forward
        self._units, self._momenta = np.eye(count, n), np.zeros((1, n))
        self._h, self._fixed = h, None if INPUTS in tables.coefficients else as_structure(tables.tables_at(h))
        coefficients = np.zeros((count, tables.coefficient_count))
        if len(inputs):
            directions = np.zeros((count, 1 + max(inputs)))
            directions[np.arange(n, count), inputs] = 1.0
            coefficients += tables.coefficients[INPUTS].of_coefficients(directions, tables.coefficient_count)
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

    def __call__(self, x: Floats, t: float, values: Floats | None) -> Floats | None:
        """Return the derivatives side by side, (n, n + k), at values of the inputs; None if they are not finite."""
        structure = self._fixed if values is None else self._tables.tables_at(self._h, values)
        self._momenta[0], self._tangents[0], self._run.t0 = x, self._units, t
        if not advance_tables(self._name, structure, self._run, 0, 1, StopFlag()):
            if (raised := raised_by(self._tables.keepalive)) is not None:
                raise raised
            return None
        found = self._after[0, 0].T.copy()
        return found if np.isfinite(found).all() else None
