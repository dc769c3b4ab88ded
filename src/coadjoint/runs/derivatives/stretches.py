"""Stretches of steps to be differentiated: the arrays of the kernels for them, and the calls of these."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import StopFlag
from coadjoint.kernels.tables.compiled import raised_by
from coadjoint.kernels.tables.derivatives import BackwardRun, ForwardRun, advance_tables
from coadjoint.methods.protocol.derivative_tables import DerivativeTables, Kernel
from coadjoint.runs.loops.execution import sum_in_threads
from coadjoint.runs.loops.groups import split_members

Floats = NDArray[np.float64]

ONE = np.ones(1, dtype=np.int64)  # the mark of a single step


class Stretch(NamedTuple):
    """Steps k0 + 1 to k1 of all members, and the states from which they start, or, if `undone`, end."""

    t0: float
    h: float
    k0: int
    k1: int
    momenta: Floats
    errors: Floats
    groups: Floats
    group_errors: Floats
    undone: bool = False
    before: int | None = 0

    @classmethod
    def of_step(cls, t0: float, h: float, momenta: Floats, groups: Floats, before: int | None = None) -> Stretch:
        """Return a single step from finished states."""
        return cls(t0, h, 0, 1, momenta, np.zeros_like(momenta), groups, np.zeros_like(groups), before=before)

    def forward(
        self,
        tangents: Floats,
        group_tangents: Floats,
        coefficients: Floats,
        *,
        marks: NDArray[np.int64] = ONE,
        threads: int = 1,
    ) -> ForwardRun:
        """Return the run of a kernel, which overwrites tangents (members, count, n) and (members, count, d, d)."""
        return ForwardRun(
            **self._common(marks, threads),
            carried=tangents.shape[1],
            at_points=np.zeros((len(marks), *tangents.shape)),
            at_groups=np.zeros((len(marks), *group_tangents.shape)),
            tangents=tangents,
            group_tangents=group_tangents,
            coefficients=coefficients,
            apart=coefficients.ndim == 3,
        )

    def backward(
        self,
        at_points: Floats,
        at_groups: Floats,
        cotangents: Floats,
        group_cotangents: Floats,
        coefficients: Floats,
        *,
        marks: NDArray[np.int64] = ONE,
        threads: int = 1,
    ) -> BackwardRun:
        """Return the run of a kernel, which overwrites cotangents and adds to `coefficients` (members, number)."""
        return BackwardRun(
            **self._common(marks, threads),
            group_errors=self.group_errors,
            at_points=np.ascontiguousarray(at_points),
            at_groups=np.ascontiguousarray(at_groups),
            cotangents=cotangents,
            group_cotangents=group_cotangents,
            coefficients=coefficients,
            deviations=np.zeros(len(cotangents)),
            undone=self.undone,
        )

    def _common(self, marks: NDArray[np.int64], threads: int) -> dict[str, Any]:
        members, size = self.momenta.shape
        own = {name: getattr(self, name) for name in ("t0", "h", "k0", "k1", "momenta", "errors", "groups")}
        sizes = {"members": members, "size": size, "square": self.groups[0].size, "marked": len(marks)}
        return {**own, **sizes, "marks": marks, "threads": threads}


def carry(tables: DerivativeTables, structure: Any, run: Any, first: int, last: int, workers: int = 1) -> bool:
    """Carry the vectors of the members `first` to `last` - 1; return whether all linear equations were solved."""
    name: Kernel = tables.backward if hasattr(run, "cotangents") else tables.forward
    stop, lanes = StopFlag(), limit("MOST_LANES")
    if callable(name):
        for start in range(first, last, lanes):
            name(structure, run, start, min(start + lanes, last))
        return True
    if workers == 1 or last - first <= lanes:
        solved = advance_tables(name, structure, run, first, last, stop)
    else:
        ranges = split_members(first, last, workers, lanes)
        solved = not sum_in_threads(
            lambda some: not advance_tables(name, structure, run, *some, stop), ranges, workers, stop
        )
    if (raised := raised_by(tables.keepalive)) is not None:
        raise raised
    return solved
