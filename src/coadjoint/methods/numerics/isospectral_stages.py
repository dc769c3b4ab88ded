"""Isospectral Gauss steps in NumPy, with derivatives: the reference for the compiled steps.

``V_i = 1 + h sum_j a_ij P_j V_j`` and ``U_i = 1 - h sum_j a_ij U_j P_j`` (U_i = V_i* for skew-Hermitian W) are inverse
at the end of a step, ``M_i = V_i W U_i``, ``P_i = stream(M_i)``. Layers are (k, N, N); inner products are real.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.step_derivatives import LinearizedStep

Matrix = NDArray[Any]
Floats = NDArray[np.float64]

MAX_ITERATIONS = 192  # of a step; slower convergence is refused, since a shorter step is cheaper
FIRST_TESTED = 3  # first iteration tested for convergence; early corrections may grow
LATE_ITERATION = 12  # from this iteration on, a single correction that does not fall is not yet stagnation
STAGNANT_CORRECTIONS = 3  # consecutive corrections that do not fall count as stagnation
ROUND_OFF_CANDIDATE = 2.0**17 * UNIT_ROUNDOFF  # relative to the entries: a correction can be round-off only below this
ROUND_OFF = 64 * UNIT_ROUNDOFF  # times sqrt(N), relative to the entries: a stagnant correction below it is round-off
DIVERGED = 1 / UNIT_ROUNDOFF  # corrections of matrices that begin near 1; later iterations would overflow
DIFFERENCE_STEP = 2.0**-17  # about the cube root of the unit roundoff, relative to the state: errors are balanced


NO_CONVERGENCE = "the linear equations of the stages do not converge; take a smaller step"


class Stages(NamedTuple):
    """The stages of a step, one matrix each: V, U, M and P, shape (s, N, N), and their times."""

    V: Matrix
    U: Matrix
    M: Matrix
    P: Matrix
    times: list[float]


def has_layers(system: MatrixSystem) -> bool:
    """Return whether states have layers."""
    return len(system.matrix_shape) == 3


def stages_of(system: MatrixSystem, W: Matrix, t: float, h: float, a: Floats, scheme_name: str) -> Stages:
    """Return the stages of a step of length h from a state W at time t, with coefficients a (s, s)."""
    if has_layers(system):
        return stages_of_layers(system, W, t, h, a)
    identity, times = np.eye(len(W)), [t + h * float(row.sum()) for row in a]
    P0 = system.stream_of(W, t)

    def update(V: Matrix, U: Matrix, *_: Matrix) -> Any:
        if system.algebra.skew:
            U = np.conj(np.swapaxes(V, -1, -2))
        M = V @ W @ U
        P = np.stack([system.stream_of(m, time) for m, time in zip(M, times, strict=True)])
        V_new, U_new = identity + h * weighted_sums(a, P @ V), identity - h * weighted_sums(a, U @ P)
        change = max(largest(V_new - V), 0.0 if system.algebra.skew else largest(U_new - U))
        return (V_new, U_new, M, P), change, 1.0

    start = tuple(np.stack([identity + sign * h * row.sum() * P0 for row in a]) for sign in (1, -1))
    failure = f"the stages of {scheme_name} do not converge with a step of {float(h):g}; take a smaller one"
    V, U, M, P = iterated(update, (*start, *start), len(W), failure, t)
    return Stages(V, U, M, P, times)


def increment_of(system: MatrixSystem, stages: Stages, h: float, b: Floats) -> Matrix:
    """Return the change of the state in the step."""
    change = _in_stages(stages, h, b)
    return of_blocks(system, change) if has_layers(system) else change


def _in_stages(stages: Stages, h: float, b: Floats) -> Matrix:
    return np.asarray(h * np.tensordot(b, stages.P @ stages.M - stages.M @ stages.P, 1))


def slope_along(system: MatrixSystem, M: Matrix, directions: Matrix, t: float) -> Matrix:
    """Return the derivative of the stream at M along matrices (k, N, N); by central differences if it is nonlinear."""
    if system.linear_stream:
        return system.slope_of(directions, t)
    sizes = np.abs(directions).max(axis=(-2, -1), keepdims=True)
    small = DIFFERENCE_STEP * (largest(M) or 1.0) / np.where(sizes > 0.0, sizes, 1.0)
    ahead, behind = (system.slope_of(M + side * small * directions, t) for side in (1.0, -1.0))
    return np.asarray((ahead - behind) / (2.0 * small))


def weighted_sums(a: Floats, stages: Matrix) -> Matrix:
    """Return the sums over stages (s, ...) with coefficients (s, s)."""
    return np.tensordot(a, stages, 1)


def largest(values: Matrix) -> float:
    """Return the size of the largest entry."""
    return float(np.abs(values).max(initial=0.0))


def iterated(update: Callable[..., Any], start: Any, N: int, failure: str, t: float) -> Any:
    """Iterate `update(*state)` -> state, correction, size until corrections stagnate at round-off."""
    state, change, smallest, stagnant_count = start, np.inf, np.inf, 0
    for count in range(1, MAX_ITERATIONS + 1):
        state, change, size = update(*state)
        stagnant_count = 0 if change < smallest else stagnant_count + 1
        smallest = min(smallest, change)
        # In a slow iteration with complex eigenvalues, corrections oscillate while they shrink.
        fast = change <= ROUND_OFF * float(np.sqrt(N)) * size and count < LATE_ITERATION
        stagnant = stagnant_count >= (1 if fast else max(STAGNANT_CORRECTIONS, count // 4))
        if change == 0.0 or (change <= ROUND_OFF_CANDIDATE * size and count >= FIRST_TESTED and stagnant):
            return state
        if not change < DIVERGED * max(1.0, size):
            break
    raise IntegrationError(failure, step=1, time=float(t), residual=float(change))


def as_blocks(system: MatrixSystem, X: Matrix) -> Matrix:
    """Return layers (..., k, N, N) as one matrix, with their products: block-diagonal, or [[A, B], [0, A]]."""
    if system.independent_layers:
        k, N = X.shape[-3:-1]
        blocks = np.zeros((*X.shape[:-3], k * N, k * N), dtype=X.dtype)
        for l in range(k):
            blocks[..., l * N : (l + 1) * N, l * N : (l + 1) * N] = X[..., l, :, :]
        return blocks
    A, B = X[..., 0, :, :], X[..., 1, :, :]  # of A + eps B, products of dual numbers
    rows = np.concatenate([A, B], axis=-1), np.concatenate([np.zeros_like(A), A], axis=-1)
    return np.concatenate(rows, axis=-2)


def of_blocks(system: MatrixSystem, A: Matrix) -> Matrix:
    """Return the layers (..., k, N, N): the inverse of `as_blocks`."""
    k, N, _ = system.matrix_shape
    rows = range(k) if system.independent_layers else (0, 0)
    return np.stack([A[..., i * N : (i + 1) * N, l * N : (l + 1) * N] for l, i in enumerate(rows)], axis=-3)


def stages_of_layers(system: MatrixSystem, X: Matrix, t: Any, h: Any, a: NDArray[np.float64]) -> Stages:
    """Return the stages, in blocks, of a step of a state (k, N, N); IntegrationError if they do not converge."""
    W = as_blocks(system, X)
    identity = np.eye(len(W))

    def stream(M: Matrix) -> Matrix:
        return as_blocks(system, system.stream_of(of_blocks(system, M)))

    Y = [stream(W) for _ in a]
    M, previous, change = [W for _ in a], np.inf, np.inf
    for _ in range(MAX_ITERATIONS):
        # V and U are solved exactly for given streams, unlike in the kernels: an independent implementation.
        V, U = _solve_stages(h * a, Y, identity, left=False), _solve_stages(-h * a, Y, identity, left=True)
        new = [v @ W @ u for v, u in zip(V, U, strict=True)]
        change = max(float(np.abs(n - m).max()) for n, m in zip(new, M, strict=True))
        M, Y = new, [stream(m) for m in new]
        if change == 0.0 or (change <= ROUND_OFF * float(np.abs(W).max()) and not change < previous):
            return Stages(np.stack(V), np.stack(U), np.stack(M), np.stack(Y), [t] * len(Y))
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


def linearized_step(
    system: MatrixSystem, W: Matrix, stages: Stages, t: float, h: float, a: Floats, b: Floats
) -> LinearizedStep:
    """Return the step of these stages from a state W with its derivative, projected on the algebra."""
    layers = has_layers(system)
    of_state = as_blocks(system, W) if layers else W

    def tangents(rows: Floats) -> Floats:
        directions = system.algebra.projected(system.from_vector(rows))
        directions = as_blocks(system, directions) if layers else directions
        after = _along(system, of_state, stages, directions, t, h, a, b)
        return system.to_vector(of_blocks(system, after) if layers else after)

    def cotangent(row: Floats) -> Floats:
        after = system.from_vector(row)
        after = _of_blocks_transposed(system, after) if layers else after
        before = _transposed(system, of_state, stages, after, t, h, a, b)
        return system.to_vector(system.algebra.projected(_as_blocks_transposed(system, before) if layers else before))

    end = of_state + _in_stages(stages, h, b)
    end = of_blocks(system, end) if layers else end
    return LinearizedStep(system.to_vector(end), tangents, cotangent)


def _slopes(system: MatrixSystem, stages: Stages, along: Matrix) -> Matrix:
    """Return the derivatives of the streams of the stages along matrices (stages, k, N, N)."""
    if has_layers(system):
        return as_blocks(system, system.slope_of(of_blocks(system, along)))
    return np.stack([slope_along(system, *one) for one in zip(stages.M, along, stages.times, strict=True)])


def _slopes_transposed(system: MatrixSystem, stages: Stages, of_streams: Matrix) -> Matrix:
    """Return the cotangents of the stages for those of their streams, (stages, N, N)."""
    algebra = system.algebra
    if has_layers(system):
        layers = _as_blocks_transposed(system, of_streams)
        return _of_blocks_transposed(system, system.slope_transposed((layers - _adjoint(layers)) / 2))
    if system.stream.kind != "BY_FUNCTION":
        # Symmetric for all matrices that are skew-Hermitian if the algebra is: the stages have a trace.
        return np.asarray(system.slope_of((of_streams - _adjoint(of_streams)) / 2 if algebra.skew else of_streams))
    # Functions are symmetric in the pairing of the algebra.
    inner = algebra.projected(algebra.dual(of_streams))
    return np.asarray(algebra.dual(_slopes(system, stages, inner[:, None])[:, 0]))


def _along(
    system: MatrixSystem, W: Matrix, stages: Stages, directions: Matrix, t: float, h: float, a: Floats, b: Floats
) -> Matrix:
    """Return the derivatives of the step along matrices (k, N, N)."""
    V1, U1, M1, P1 = (array[:, None] for array in stages[:4])

    def update(dV: Matrix, dU: Matrix, dM: Matrix, dP: Matrix) -> Any:
        dM_new = dV @ W @ U1 + V1 @ directions @ U1 + V1 @ W @ dU
        # A difference is linear in its direction up to an error relative to it. Along the corrections of dM these
        # errors shrink with them; along dM they would stay, and corrections might cycle above ROUND_OFF_CANDIDATE.
        linear = system.linear_stream
        dP = _slopes(system, stages, dM_new) if linear else dP + _slopes(system, stages, dM_new - dM)
        dV_new, dU_new = h * weighted_sums(a, dP @ V1 + P1 @ dV), -h * weighted_sums(a, dU @ P1 + U1 @ dP)
        change = max(largest(dV_new - dV), largest(dU_new - dU))
        return (dV_new, dU_new, dM_new, dP), change, largest(dV_new)

    # Axes: stage, direction, row, column.
    zero = np.zeros((len(b), *directions.shape), dtype=M1.dtype)
    _, _, dM, dP = iterated(update, (zero,) * 4, len(W), NO_CONVERGENCE, t)
    return np.asarray(directions + h * np.tensordot(b, dP @ M1 + P1 @ dM - dM @ P1 - M1 @ dP, 1))


def _transposed(
    system: MatrixSystem, W: Matrix, stages: Stages, after: Matrix, t: float, h: float, a: Floats, b: Floats
) -> Matrix:
    """Return the cotangent before the step for that after it, matrices (N, N)."""
    V, U, M, P = stages[:4]
    Vt, Ut, Mt, Pt = (_adjoint(array) for array in (V, U, M, P))
    WU, VW = _adjoint(W @ U), _adjoint(V @ W)
    weights = (h * b)[:, None, None]
    of_M = weights * (Pt @ after - after @ Pt)
    of_P = weights * (after @ Mt - Mt @ after)

    def update(v: Matrix, u: Matrix, m: Matrix, p: Matrix, q: Matrix) -> Any:
        p_new = of_P + h * weighted_sums(a.T, v) @ Vt - Ut @ (h * weighted_sums(a.T, u))
        linear = system.linear_stream
        q = _slopes_transposed(system, stages, p_new) if linear else q + _slopes_transposed(system, stages, p_new - p)
        m = of_M + q
        v_new = m @ WU + Pt @ (h * weighted_sums(a.T, v))
        u_new = VW @ m - (h * weighted_sums(a.T, u)) @ Pt
        change = max(largest(v_new - v), largest(u_new - u))
        return (v_new, u_new, m, p_new, q), change, max(largest(v_new), largest(u_new))

    zero = np.zeros_like(M)
    _, _, m, _, _ = iterated(update, (zero,) * 5, len(W), NO_CONVERGENCE, t)
    return np.asarray(after + np.sum(Vt @ m @ Ut, axis=0))


def _as_blocks_transposed(system: MatrixSystem, blocks: Matrix) -> Matrix:
    if system.independent_layers:
        return of_blocks(system, blocks)
    N = blocks.shape[-1] // 2
    A, B = blocks[..., :N, :N] + blocks[..., N:, N:], blocks[..., :N, N:]
    return np.stack([A, B], axis=-3)


def _of_blocks_transposed(system: MatrixSystem, of_layers: Matrix) -> Matrix:
    if system.independent_layers:
        return as_blocks(system, of_layers)
    A, B = of_layers[..., 0, :, :], of_layers[..., 1, :, :]
    rows = np.concatenate([A, B], axis=-1)
    return np.concatenate([rows, np.zeros_like(rows)], axis=-2)


def _adjoint(matrices: Matrix) -> Matrix:
    return np.conj(np.swapaxes(matrices, -1, -2))
