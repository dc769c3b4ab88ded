"""Conjugations X -> U X U* of states that are skew-Hermitian matrices, or pairs of them, and the damping along them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.errors import IntegrationError

Matrix = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]

MAX_MIDPOINTS = 192  # iterations of the midpoint rule; convergent ones take some ten
NEAR_ROUND_OFF = 2.0**-40  # of the state: corrections below it that stagnate are round-off


def check_conjugated(system: Any, name: str) -> None:
    """Raise ValueError unless unitary matrices conjugate the states of a system of matrices."""
    if not system.algebra.skew:
        raise ValueError(
            f"{name} conjugates matrices by unitary ones, and those of {system.algebra} are not skew-Hermitian; take "
            "LinearDamping, or a system with structure constants"
        )


def acting_layers(system: Any) -> int:
    """Return the layers of the elements that move a state: two only where a carried field has a stream of its own."""
    return 1 if system.second_stream is None else 2


def times(system: Any, A: Matrix, B: Matrix) -> Matrix:
    """Return products of matrices, or of pairs A0 + eps A1 with eps^2 = 0."""
    if len(system.matrix_shape) == 2 or system.independent_layers:
        return A @ B
    first, second = A[..., 0, :, :], A[..., 1, :, :]
    return np.stack([first @ B[..., 0, :, :], first @ B[..., 1, :, :] + second @ B[..., 0, :, :]], axis=-3)


def with_layers(system: Any, A: Matrix) -> Matrix:
    """Return an element of the system from one of a single layer."""
    if len(system.matrix_shape) == 2 or A.ndim == 3 or system.independent_layers:
        return A
    return np.stack([A, np.zeros_like(A)])


def exponential(system: Any, A: Matrix) -> Matrix:
    """Return exp(A) of a skew-Hermitian element."""
    first = A if A.ndim == 2 else A[0]
    angles, V = np.linalg.eigh(-1j * first)
    adjoint = np.conj(V.T)
    unitary = (V * np.exp(1j * angles)) @ adjoint
    if A.ndim == 3:
        # Divided differences of the exponential, by the midpoint of two eigenvalues.
        half = 0.5 * (angles[:, None] - angles[None, :])
        divided = np.exp(0.5j * (angles[:, None] + angles[None, :])) * np.sinc(half / np.pi)
        unitary = np.stack([unitary, V @ (divided * (adjoint @ A[1] @ V)) @ adjoint])
    return unitary if system.complex else np.ascontiguousarray(unitary.real)


def conjugated(system: Any, U: Matrix, X: Matrix) -> Matrix:
    """Return U X U* for states (..., N, N) or (..., 2, N, N)."""
    return times(system, times(system, U, X), _adjoint(U))


def damping_element(system: Any, factor: float, X: Matrix, t: float) -> Matrix:
    """Return the element A of the damping X' = [A, X]: `factor` times the dual of [Y, X]."""
    return _element(system, factor, system.bracket(system.stream_of(X, t), X))


def _element(system: Any, factor: float, Z: Matrix) -> Matrix:
    """Return `factor` times the dual of Z, without a layer that does not act."""
    A = factor * system.dual(Z)
    if acting_layers(system) < len(system.matrix_shape) - 1:
        A[..., 1, :, :] = 0.0
    return np.asarray(A)


def damped_midpoint(system: Any, factor: float, X: Matrix, t: float, tau: float) -> tuple[Matrix, Matrix]:
    """Return the midpoint M = X + [A, M]/2 + A M A/4 of the damping, and its element A = tau A(M)."""
    M, size, last = X, float(np.abs(X).max(initial=0.0)), np.inf
    for _ in range(MAX_MIDPOINTS):
        A = tau * damping_element(system, factor, M, t + 0.5 * tau)
        before = M
        M = X + 0.5 * system.bracket(A, M) + 0.25 * times(system, times(system, A, M), A)
        change = float(np.abs(M - before).max(initial=0.0))
        if change == 0.0 or (change >= 0.5 * last and change <= NEAR_ROUND_OFF * size):
            return M, A
        last = change
    raise IntegrationError(
        "the midpoint rule of the damping did not converge; take a smaller step", step=1, time=t, residual=last
    )


def damped(system: Any, factor: float, X: Matrix, t: float, tau: float) -> Matrix:
    """Return the state after the damping of a time tau: the Cayley transform of A conjugates it."""
    M, A = damped_midpoint(system, factor, X, t, tau)
    return np.asarray(X + system.bracket(A, M))


def units_of(system: Any) -> Matrix:
    """Return the units of the coordinates of matrices, projected on the algebra."""
    return np.asarray(system.algebra.projected(system.from_vector(np.eye(system.dim))))


def _adjoint(X: Matrix) -> Matrix:
    return np.conj(np.swapaxes(X, -1, -2))


def damped_along(
    system: Any, factor: float, X: Matrix, directions: Matrix, t: float, tau: float
) -> tuple[Matrix, Matrix]:
    """Return `damped` and its derivative along matrices of the algebra, by that of the equation of the midpoint."""
    # M = L X L* with L = (1 - A/2)^-1; its change is L dX L* + (Z - Z*)/2 with Z = L dA M.
    M, A = damped_midpoint(system, factor, X, t, tau)
    bracket, middle = system.bracket, t + 0.5 * tau
    Y, L = system.stream_of(M, middle), _resolvent(system, A)
    start = conjugated(system, L, directions)

    def change_of_element(dM: Matrix) -> Matrix:
        return _element(system, tau * factor, bracket(system.slope_of(dM, middle), M) + bracket(Y, dM))

    def improved(dM: Matrix) -> Matrix:
        Z = times(system, times(system, L, change_of_element(dM)), M)
        return np.asarray(start + 0.5 * (Z - _adjoint(Z)))

    dM = _fixed_point(improved, start, t)
    end = np.asarray(X + bracket(A, M))
    return end, np.asarray(directions + bracket(change_of_element(dM), M) + bracket(A, dM))


def _resolvent(system: Any, A: Matrix) -> Matrix:
    """Return (1 - A/2)^-1."""
    if len(system.matrix_shape) == 2 or system.independent_layers:
        return np.linalg.inv(np.eye(A.shape[-1]) - 0.5 * A)
    first = np.linalg.inv(np.eye(A.shape[-1]) - 0.5 * A[0])
    return np.stack([first, 0.5 * first @ A[1] @ first])


def _fixed_point(improved: Callable[[Matrix], Matrix], start: Matrix, t: float) -> Matrix:
    """Return the solution of X = improved(X), a linear equation, to round-off."""
    X, last = start, np.inf
    for _ in range(MAX_MIDPOINTS):
        before, X = X, improved(X)
        change, size = float(np.abs(X - before).max(initial=0.0)), float(np.abs(X).max(initial=0.0))
        if change == 0.0 or (change >= 0.5 * last and change <= NEAR_ROUND_OFF * size):
            return X
        last = change
    raise IntegrationError(
        "the derivative of the damping did not converge; take a smaller step", step=1, time=t, residual=last
    )


def adjoint_casimir(block: Any) -> float:
    """Return c of a block u(N), su(N) or so(N): - sum_k [E_k, [E_k, A]] = c A, E_k an orthonormal basis, tr A = 0."""
    return float(2 * block.N if block.complex else block.N - 2)


def blocks_of_rows(algebra: Any) -> npt.NDArray[np.int64]:
    """Return four times the number of the diagonal block of each row, with bits: 2 if traceless, 1 if real."""
    return np.array(
        [
            4 * k + 2 * kind.traceless + (not kind.complex)
            for k, (_, block, kind) in enumerate(algebra.parts)
            for _ in range(block.N)
        ],
        dtype=np.int64,
    )


def gaussian_element(algebra: Any, deviates: Floats, variance: float, corrected: bool) -> Matrix:
    """Return a Gaussian element of a skew-Hermitian algebra, from N^2 normal deviates.

    Its components have a variance, with a correction by which one exponential has weak order two.
    """
    # E exp(Z) differs from exp(v L/2), L the Laplacian, by c v^2 L/48: sums of products k l k l and k l l k of basis
    # elements are those of k k l l plus c/2 L and 0, and a variance v - c v^2/24 removes the difference.
    A = np.zeros(algebra.shape, dtype=np.complex128 if algebra.complex else np.float64)
    for rows, block, _ in algebra.parts:
        g = deviates.reshape(algebra.shape)[rows, rows]
        lower = np.tril(g, -1) + (1j * np.triu(g, 1).T if block.complex else 0.0)
        part = np.sqrt(0.5) * (lower - np.conj(lower.T)) + (1j * np.diag(np.diagonal(g)) if block.complex else 0.0)
        c = adjoint_casimir(block) if corrected else 0.0
        A[rows, rows] = np.sqrt(variance / (1.0 + variance * c / 24.0)) * part
    return A
