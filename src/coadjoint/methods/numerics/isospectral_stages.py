"""Steps of isospectral Gauss methods in NumPy, of matrices and of two layers: the reference for the compiled steps.

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
from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem

Matrix = NDArray[Any]
Floats = NDArray[np.float64]

MAX_ITERATIONS = 192
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

    IntegrationError: the iteration does not converge; `scheme_name` is for the message.
    """
    identity, times = np.eye(len(W)), [t + h * float(row.sum()) for row in a]
    P0 = system.stream_of(W, t)
    V = np.stack([identity + h * row.sum() * P0 for row in a])
    U = np.stack([identity - h * row.sum() * P0 for row in a])
    stagnation, change = _StagnationTest(len(W)), np.inf
    for _ in range(MAX_ITERATIONS):
        if system.algebra.skew:
            U = np.conj(np.swapaxes(V, -1, -2))
        M = V @ W @ U
        P = np.stack([system.stream_of(m, time) for m, time in zip(M, times, strict=True)])
        V_new, U_new = identity + h * _weighted_sums(a, P @ V), identity - h * _weighted_sums(a, U @ P)
        change = max(_largest(V_new - V), 0.0 if system.algebra.skew else _largest(U_new - U))
        V, U = V_new, U_new
        if stagnation.after(change, 1.0):
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

    The linear equations of the stages are iterated for all directions at once, like the stages. IntegrationError: the
    iteration does not converge.
    """
    n, s = system.dim, len(b)
    check_available_memory(8 * 13 * s * n**2, f"the derivative of a step of {n} numbers")
    directions = system.algebra.projected(system.from_vector(np.eye(n)))
    V, U, M, P, times = stages
    # Axes: stage, direction, row, column.
    dV, dU = np.zeros((2, s, *directions.shape), dtype=M.dtype)
    dM, dP = dV, dU
    V1, U1, M1, P1 = (array[:, None] for array in (V, U, M, P))

    def slopes(along: Matrix) -> Matrix:
        return np.stack([slope_along(system, m, dm, time) for m, dm, time in zip(M, along, times, strict=True)])

    stagnation, change = _StagnationTest(len(W)), np.inf
    for _ in range(MAX_ITERATIONS):
        dM_new = dV @ W @ U1 + V1 @ directions @ U1 + V1 @ W @ dU
        # A difference is linear in its direction up to an error relative to it. Along the corrections of dM these
        # errors shrink with them; along dM they would stay, and corrections might cycle above ROUND_OFF_CANDIDATE.
        dP = slopes(dM_new) if system.linear_stream else dP + slopes(dM_new - dM)
        dM = dM_new
        dV_new, dU_new = h * _weighted_sums(a, dP @ V1 + P1 @ dV), -h * _weighted_sums(a, dU @ P1 + U1 @ dP)
        change = max(_largest(dV_new - dV), _largest(dU_new - dU))
        dV, dU = dV_new, dU_new
        if stagnation.after(change, _largest(dV)):
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


def _weighted_sums(a: Floats, stages: Matrix) -> Matrix:
    return np.tensordot(a, stages, 1)


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
        stagnant = self._stagnant_count >= (1 if fast else max(STAGNANT_CORRECTIONS, self._count // 4))
        return change == 0.0 or (change <= ROUND_OFF_CANDIDATE * size and self._count >= FIRST_TESTED and stagnant)


def as_blocks(X: Matrix) -> Matrix:
    """Return A + eps B, given as (2, N, N), as the matrix ``[[A, B], [0, A]]``: products are those of dual numbers.

    Examples
    --------
    >>> as_blocks(np.array([[[1.0]], [[2.0]]]))
    array([[1., 2.],
           [0., 1.]])
    """
    return np.block([[X[0], X[1]], [np.zeros_like(X[0]), X[0]]])


def of_blocks(A: Matrix) -> Matrix:
    """Return the two layers: the inverse of `as_blocks`."""
    N = len(A) // 2
    return np.stack([A[:N, :N], A[:N, N:]])


def two_layer_increment(
    system: TwoLayerSystem, X: Matrix, t: Any, h: Any, a: NDArray[np.float64], b: NDArray[np.float64]
) -> Matrix:
    """Return the change (2, N, N) of a state in a step; raise IntegrationError if the stages do not converge."""
    W, identity = as_blocks(X), np.eye(2 * len(X[0]))

    def stream(M: Matrix) -> Matrix:
        return as_blocks(system.stream_of(of_blocks(M)))

    Y = [stream(W) for _ in b]
    M, previous, change = [W for _ in b], np.inf, np.inf
    for _ in range(MAX_ITERATIONS):
        # V and U are solved exactly for given streams, unlike in the kernels: an independent implementation.
        V, U = _solve_stages(h * a, Y, identity, left=False), _solve_stages(-h * a, Y, identity, left=True)
        new = [v @ W @ u for v, u in zip(V, U, strict=True)]
        change = max(float(np.abs(n - m).max()) for n, m in zip(new, M, strict=True))
        M, Y = new, [stream(m) for m in new]
        if change == 0.0 or (change <= ROUND_OFF * float(np.abs(W).max()) and not change < previous):
            increment = sum(weight * (y @ m - m @ y) for weight, y, m in zip(b, Y, M, strict=True))
            return of_blocks(np.asarray(h * increment))
        if not change < DIVERGED * float(np.abs(W).max()):
            break
        previous = change
    raise IntegrationError(
        f"the stages do not converge with a step of {float(h):g}; take a smaller one",
        step=1,
        time=float(t),
        residual=change,
    )


def _solve_stages(a: NDArray[np.float64], Y: list[Matrix], identity: Matrix, left: bool) -> list[Matrix]:
    """Return the solution of V_i = 1 + sum_j a_ij Y_j V_j, or with V_j on the left of Y_j."""
    s, n = len(Y), len(identity)
    matrix = np.eye(s * n, dtype=Y[0].dtype)
    for i in range(s):
        for j in range(s):
            part = Y[j].T if left else Y[j]
            matrix[i * n : (i + 1) * n, j * n : (j + 1) * n] -= a[i, j] * part
    solution = np.linalg.solve(matrix, np.tile(identity.astype(matrix.dtype), (s, 1)))
    parts = [solution[i * n : (i + 1) * n] for i in range(s)]
    return [part.T for part in parts] if left else parts
