"""Tables of the compiled loop for Runge-Kutta methods, and narrow-band orderings of their Jacobians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import codes, limit
from coadjoint.kernels.tables.compiled import CompiledTables
from coadjoint.kernels.tables.field import Field, GroupField, field_of, group_of, sources_of_field, substeps
from coadjoint.program.sources import CoefficientNumbers, Multiples, Sources
from coadjoint.program.term_table import Terms
from coadjoint.systems.system import System


class RungeKuttaTables(NamedTuple):
    """The arrays of a Runge-Kutta method: X_i = x + sum_j mix_ij L_j with L_j = h scale_j f(X_j, t + node_j h), and the
    step adds sum_j out_j L_j; the guess is x + sum_j forecast_ij L_j with the last slopes. `direct` systems have LU
    factors, others are iterated, or factored in a `band` in the order `position`; if it is -1, they are solved without
    a matrix.
    """

    field: Field
    group: GroupField
    stages: int
    substeps: int
    solver: int
    iterations: int
    direct: bool
    node: NDArray[np.float64]
    scale: NDArray[np.float64]
    mix: NDArray[np.float64]
    out: NDArray[np.float64]
    forecast: NDArray[np.float64]
    quadratic: NDArray[np.float64]
    band: int
    position: NDArray[np.uint32]
    fraction: NDArray[np.float64]
    moment: NDArray[np.float64]

    @property
    def terms(self) -> Terms:
        """Terms of the Hamiltonian, as `FlowTables` have them."""
        return self.field.terms

    def at_step(self, h: float) -> RungeKuttaTables:
        return self


RUNGE_KUTTA_LOOP = "runge_kutta_advance"
"""Name of the loop in the library."""


def runge_kutta_tables(
    system: System, method: Any, representation: Any = None, fractions: Sequence[float] = (1.0,)
) -> CompiledTables:
    """Return `RungeKuttaTables`, which do not depend on the step, for a `RungeKuttaMethod` with these substeps."""
    field, keepalive = field_of(system)
    group = group_of(system, representation)
    node, scale, mix, out = method.coefficients()
    linear, implicit = method.solver in ("structure", "gradient"), method.solver == "implicit"
    direct = linear and node.size * max(system.dim, group.size) <= limit("LARGEST_DIRECT")
    dense = np.zeros((0, 0))
    if direct and method.solver == "structure":
        dense = np.asarray(system.hamiltonian.hessian(np.zeros(system.dim)), dtype=np.float64)
    size_limit = limit("LARGEST_DENSE" if implicit else "LARGEST_DIRECT")
    is_large = (linear or implicit) and not direct and node.size * system.dim > size_limit
    band, position = narrow_band(system, node.size, method.solver) if is_large else NO_BAND
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
    return CompiledTables(tables, keepalive, lambda: sources_of_field(system, field).and_of(_of_dense(system, dense)))


def _of_dense(system: System, dense: NDArray[np.float64]) -> Sources:
    """Return the sources of the dense M, the Hessian, if it is needed."""
    terms = system.hamiltonian.terms()
    if not dense.size:
        return Sources()
    if len(terms) > 1 or (form := terms[0].form) is None:
        return Sources(computed={"quadratic": CoefficientNumbers.of(terms).others})
    position = form.rows * len(form.linear) + form.indices
    entries = Multiples(position, len(form.linear) + np.arange(len(position)), np.ones(len(position)))
    return Sources({"quadratic": entries})


def _ratios(fractions: Sequence[float]) -> list[float]:
    """Return the length of each substep relative to the previous one."""
    return [fractions[part] / fractions[part - 1] for part in range(len(fractions))]


def _flat(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array(values, dtype=np.float64).ravel()


MAX_HALF_BANDWIDTH = 48  # diagonals on either side; each unknown costs two multiplications per pair of diagonals
MAX_NUMBERS = 2**25  # largest number of entries of the factors
MAX_MEAN_COUPLINGS = 64  # average couplings per coordinate; with more there is no narrow band

NO_BAND: tuple[int, NDArray[np.uint32]] = (-1, np.zeros(0, dtype=np.uint32))


def narrow_band(system: System, stages: int, solver: str) -> tuple[int, NDArray[np.uint32]]:
    """Return the bandwidth of a Jacobian (-1: no narrow band) and positions (n,), by reverse Cuthill-McKee.

    The `stages` unknowns of a coordinate are adjacent. The Jacobian is sign (D_u + J(x) H'') for "implicit", J(x) H''
    for "structure", D_u for "gradient".
    """
    if system.algebra is None:
        return NO_BAND
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    n = system.dim
    i, j, k, _ = system.algebra.triples
    pattern = coo_array((n, n)).tocsr()
    if solver != "structure":
        pattern = pattern + _pattern(n, np.concatenate([i, j]), np.concatenate([k, k]))
    if solver != "gradient":
        hessian_pattern = _hessian(system, n)
        if hessian_pattern is None:
            return NO_BAND
        pattern = pattern + _pattern(n, np.concatenate([i, j]), np.concatenate([j, i])) @ hessian_pattern
    if pattern.nnz > MAX_MEAN_COUPLINGS * n:
        return NO_BAND
    symmetric = (pattern + pattern.T).tocsr()
    order = reverse_cuthill_mckee(symmetric, symmetric_mode=True)
    position = np.empty(n, dtype=np.uint32)
    position[order] = np.arange(n, dtype=np.uint32)
    rows, columns = symmetric.nonzero()
    band = int(np.max(np.abs(position[rows].astype(np.int64) - position[columns].astype(np.int64)), initial=0))
    reach = stages * (band + 1) - 1
    fits = reach <= MAX_HALF_BANDWIDTH and stages * n * (3 * reach + 1) <= MAX_NUMBERS
    return (band, position) if fits else NO_BAND


def _pattern(n: int, rows: Any, columns: Any) -> Any:
    from scipy.sparse import coo_array

    return coo_array((np.ones(len(rows)), (rows, columns)), shape=(n, n)).tocsr()


def _hessian(system: System, n: int) -> Any:
    """Return the sparsity pattern of the Hessian of the Hamiltonian; None if it has too many entries."""
    rows: list[Any] = [np.zeros(0, dtype=np.int64)]
    columns: list[Any] = [np.zeros(0, dtype=np.int64)]
    for term in system.hamiltonian.terms():
        if term.form is not None:
            rows.append(term.form.rows)
            columns.append(np.asarray(term.form.indices))
            continue
        groups = list(term.couplings())
        if sum(len(group) ** 2 for group in groups) > MAX_MEAN_COUPLINGS * n:
            return None
        rows.extend(np.repeat(group, len(group)) for group in groups)
        columns.extend(np.tile(group, len(group)) for group in groups)
    return _pattern(n, np.concatenate(rows), np.concatenate(columns))
