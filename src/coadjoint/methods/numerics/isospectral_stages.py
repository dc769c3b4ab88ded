"""Stages of isospectral Gauss methods in NumPy, and their derivative: the reference for the compiled steps.

``V_i = 1 + h sum_j a_ij P_j V_j`` and ``U_i = 1 - h sum_j a_ij U_j P_j`` are inverses of one another at the end of a
step, ``M_i = V_i W U_i`` and ``P_i = stream(M_i)``. For skew-Hermitian W, U_i is V_i*.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.memory import check_available_memory
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.matrices.matrix_system import MatrixSystem

Matrix = NDArray[Any]
Floats = NDArray[np.float64]

MOST_ITERATIONS = 192
FIRST_TESTED = 3  # first iteration tested for convergence; early corrections may grow
LATE_ITERATION = 12  # from this iteration on, a single correction that does not fall is not yet stagnation
STAGNANT_CORRECTIONS = 3  # consecutive corrections that do not fall count as stagnation
ROUND_OFF_CANDIDATE = 2.0**17 * UNIT_ROUNDOFF  # relative to the entries: a correction can be round-off only below this
ROUND_OFF = 64 * UNIT_ROUNDOFF  # times sqrt(N), relative to the entries: a stagnant correction below it is round-off
DIVERGED = 1 / UNIT_ROUNDOFF  # corrections of matrices that begin near 1; later iterations would overflow
DIFFERENCE_STEP = 2.0**-17


class Stages(NamedTuple):
    """The stages of a step, one matrix each: V, U, M and P, shape (s, N, N), and their times."""

    V: Matrix
    U: Matrix
    M: Matrix
    P: Matrix
    times: list[float]


def stages_of(system: MatrixSystem, W: Matrix, t: float, h: float, a: Floats, scheme_name: str) -> Stages:
    """Return the stages of a step of length h from W (N, N) at time t, with coefficients a (s, s).

    Raise IntegrationError, which names the scheme `scheme_name`, if the iteration does not converge.
    """
    one, times = np.eye(len(W)), [t + h * float(row.sum()) for row in a]
    P0 = system.stream_of(W, t)
    V = np.stack([one + h * row.sum() * P0 for row in a])
    U = np.stack([one - h * row.sum() * P0 for row in a])
    rest, change = _StagnationTest(len(W)), np.inf
    for _ in range(MOST_ITERATIONS):
        if system.algebra.skew:
            U = np.conj(np.swapaxes(V, -1, -2))
        M = V @ W @ U
        P = np.stack([system.stream_of(m, time) for m, time in zip(M, times, strict=True)])
        V_new, U_new = one + h * _mixed(a, P @ V), one - h * _mixed(a, U @ P)
        change = max(_largest(V_new - V), 0.0 if system.algebra.skew else _largest(U_new - U))
        V, U = V_new, U_new
        if rest.after(change, 1.0):
            return Stages(V, U, M, P, times)
        if not change < DIVERGED:
            break
    raise IntegrationError(
        f"the stages of {scheme_name} do not converge with a step of {float(h):g}; take a smaller one",
        step=1,
        time=float(t),
        residual=float(change),
    )


def increment_of(stages: Stages, h: float, b: Floats) -> Matrix:
    """Return the change of W in the step."""
    return np.asarray(h * np.tensordot(b, stages.P @ stages.M - stages.M @ stages.P, 1))


def derivative_of(system: MatrixSystem, W: Matrix, stages: Stages, t: float, h: float, a: Floats, b: Floats) -> Floats:
    """Return the derivative (n, n) of a step in coordinates, for the projection on the algebra.

    The linear equations of the stages are iterated for all directions at once, as the stages themselves. Raise
    IntegrationError if the iteration does not converge.
    """
    n, s = system.dim, len(b)
    check_available_memory(8 * 12 * s * n**2, f"the derivative of a step of {n} numbers")
    directions = system.algebra.projected(system.from_vector(np.eye(n)))
    V, U, M, P, times = stages
    # Axes: stage, direction, row, column.
    dV, dU = np.zeros((2, s, *directions.shape), dtype=M.dtype)
    V1, U1, M1, P1 = (found[:, None] for found in (V, U, M, P))
    rest, change = _StagnationTest(len(W)), np.inf
    for _ in range(MOST_ITERATIONS):
        dM = dV @ W @ U1 + V1 @ directions @ U1 + V1 @ W @ dU
        dP = np.stack([slope_along(system, m, dm, time) for m, dm, time in zip(M, dM, times, strict=True)])
        dV_new, dU_new = h * _mixed(a, dP @ V1 + P1 @ dV), -h * _mixed(a, dU @ P1 + U1 @ dP)
        change = max(_largest(dV_new - dV), _largest(dU_new - dU))
        dV, dU = dV_new, dU_new
        if rest.after(change, _largest(dV)):
            rows = directions + h * np.tensordot(b, dP @ M1 + P1 @ dM - dM @ P1 - M1 @ dP, 1)
            return system.to_vector(rows).T
        if not change < DIVERGED:
            break
    raise IntegrationError(
        "the linear equations of the stages do not converge; take a smaller step",
        step=1,
        time=float(t),
        residual=change,
    )


def slope_along(system: MatrixSystem, M: Matrix, directions: Matrix, t: float) -> Matrix:
    """Return the derivative of the stream at M along matrices (k, N, N); by central differences if it is nonlinear."""
    if system.linear_stream:
        return system.slope_of(directions, t)
    sizes = np.abs(directions).max(axis=(-2, -1), keepdims=True)
    small = DIFFERENCE_STEP * (_largest(M) or 1.0) / np.where(sizes > 0.0, sizes, 1.0)
    ahead, behind = (system.slope_of(M + side * small * directions, t) for side in (1.0, -1.0))
    return np.asarray((ahead - behind) / (2.0 * small))


def _mixed(a: Floats, of_stages: Matrix) -> Matrix:
    return np.tensordot(a, of_stages, 1)


def _largest(values: Matrix) -> float:
    return float(np.abs(values).max(initial=0.0))


class _StagnationTest:
    """Test whether the corrections of an iteration stagnate at round-off."""

    def __init__(self, N: int) -> None:
        self._rounding = ROUND_OFF * float(np.sqrt(N))
        self._smallest, self._stagnant_count, self._count = np.inf, 0, 0

    def after(self, change: float, size: float) -> bool:
        """Return whether to stop after a correction `change`, for entries of this size."""
        self._count += 1
        self._stagnant_count = 0 if change < self._smallest else self._stagnant_count + 1
        self._smallest = min(self._smallest, change)
        # In a slow iteration with complex eigenvalues, corrections oscillate while they shrink.
        fast = change <= self._rounding * size and self._count < LATE_ITERATION
        still = self._stagnant_count >= (1 if fast else max(STAGNANT_CORRECTIONS, self._count // 4))
        return change == 0.0 or (change <= ROUND_OFF_CANDIDATE * size and self._count >= FIRST_TESTED and still)
