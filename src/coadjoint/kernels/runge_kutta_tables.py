"""Construction of the arrays of the compiled loop from a system and a Runge-Kutta method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.bandwidth import NO_BAND, narrow_band
from coadjoint.kernels.field_tables import field_of, group_of, substeps
from coadjoint.kernels.interface import codes, limit
from coadjoint.kernels.runge_kutta import RungeKuttaTables
from coadjoint.kernels.tables import CompiledTables
from coadjoint.systems.system_checks import System


class Tableau(Protocol):
    """Protocol of a Runge-Kutta scheme."""

    @property
    def solver(self) -> str:
        """Name of the solver, one of `SOLVERS`."""

    @property
    def function_iterations(self) -> int:
        """Number of function iterations before the output, or before the linear system."""

    def coefficients(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return nodes, scales, the matrix of the stages, and the weights of the output."""

    def forecast(self, ratio: float) -> NDArray[np.float64]:
        """Return the matrix of the initial guess of the stages; `ratio` is substep over previous substep."""


def runge_kutta_tables(
    system: System, method: Tableau, representation: Any = None, fractions: Sequence[float] = (1.0,)
) -> CompiledTables:
    """Return `RungeKuttaTables`, which do not depend on the step, for a method whose substeps have these fractions.

    Raise TypeError if a function of the user cannot be compiled.
    """
    field, keepalive = field_of(system)
    group = group_of(system, representation)
    node, scale, mix, out = method.coefficients()
    linear, implicit = method.solver in ("structure", "gradient"), method.solver == "implicit"
    direct = linear and node.size * max(system.dim, group.size) <= limit("LARGEST_DIRECT")
    dense = np.zeros((0, 0))
    if direct and method.solver == "structure":
        dense = np.asarray(system.hamiltonian.hessian(np.zeros(system.dim)), dtype=np.float64)
    most = limit("LARGEST_DENSE" if implicit else "LARGEST_DIRECT")
    large = (linear or implicit) and not direct and node.size * system.dim > most
    band, position = narrow_band(system, node.size, method.solver) if large else NO_BAND
    fraction, moment = substeps(fractions)
    tables = RungeKuttaTables(
        field,
        group,
        node.size,
        len(fractions),
        codes("Solver")[method.solver.upper()],
        method.function_iterations,
        direct,
        _flat(node),
        _flat(scale),
        _flat(mix),
        _flat(out),
        _flat(np.stack([method.forecast(ratio) for ratio in _ratios(fractions)])),
        _flat(dense),
        band,
        position,
        fraction,
        moment,
    )
    return CompiledTables(tables, keepalive)


def _ratios(fractions: Sequence[float]) -> list[float]:
    """Return the length of each substep relative to the previous one."""
    return [fractions[part] / fractions[part - 1] for part in range(len(fractions))]


def _flat(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array(values, dtype=np.float64).ravel()
