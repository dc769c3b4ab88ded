"""Stages of Runge-Kutta steps, and the linear systems in them, in any number type."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.program.numbers import Number
from coadjoint.short_repr import record_repr
from coadjoint.systems.system_checks import System


class Coefficients(NamedTuple):
    """A tableau: ``X_i = x + sum_j mix_ij L_j``, ``L_j = h scale_j f(X_j, t + node_j h)``; a step adds ``out_j L_j``.

    Gauss methods have scale = b, mix = mu, out = 1; explicit ones, whose b_j may vanish, scale = 1, mix = a, out = b.
    """

    node: NDArray[Any]
    scale: NDArray[Any]
    mix: NDArray[Any]
    out: NDArray[Any]

    def __repr__(self) -> str:
        return record_repr(self)


class Step(NamedTuple):
    """A step as seen by Runge-Kutta schemes: the system, coefficients, state, times of the stages, and h scale_j."""

    system: System
    coefficients: Coefficients
    x: NDArray[Any]
    times: list[Any]
    lengths: list[Any]

    def points(self, slopes: NDArray[Any]) -> NDArray[Any]:
        """Return the stages X_i = x + sum_j mix_ij L_j, shape (s, n)."""
        return self.x + self.coefficients.mix @ slopes

    def start(self) -> NDArray[Any]:
        """Return X_i = x for every stage."""
        return np.stack([self.x] * len(self.times))

    def fields(self, points: NDArray[Any]) -> NDArray[Any]:
        """Return L_j = h scale_j f(X_j), shape (s, n)."""
        # Arrays are the first factors: mpmath prints an array that is the second one, for an error that is caught.
        parts = zip(points, self.times, self.lengths, strict=True)
        return np.stack([self.system.vector_field(X, t) * length for X, t, length in parts])

    def jacobians(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """Return h scale_j f'(X_j), shape (s, n, n)."""
        parts = zip(points, self.times, self.lengths, strict=True)
        return np.stack([self.system.jacobian(X, t) * length for X, t, length in parts])

    def gradients(self, points: NDArray[Any]) -> NDArray[Any]:
        """Return grad H(X_j), shape (s, n)."""
        return np.stack([self.system.hamiltonian.gradient(X, t) for X, t in zip(points, self.times, strict=True)])

    def products(self, momenta: NDArray[Any], gradients: NDArray[Any]) -> NDArray[Any]:
        """Return h scale_j sign J(Z_j) u_j, shape (s, n)."""
        sign, J = self.system.sign, self.system.structure_matrix
        parts = zip(momenta, gradients, self.lengths, strict=True)
        return np.stack([(J(Z) @ u) * (length * sign) for Z, u, length in parts])

    def stage_derivatives(self, derivatives: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return dX_i / dx = 1 + sum_j mix_ij dL_j / dx, shape (s, n, n)."""
        return np.eye(self.x.size) + np.einsum("ij,jab->iab", self.coefficients.mix, derivatives)

    def structure_hessians(self, momenta: NDArray[Any], points: NDArray[Any] | None = None) -> NDArray[Any]:
        """Return h scale_j sign J(Z_j) H''(X_j), shape (s, n, n); X = Z if not given."""
        sign, H, J = self.system.sign, self.system.hamiltonian, self.system.structure_matrix
        states = momenta if points is None else points
        parts = zip(momenta, states, self.times, self.lengths, strict=True)
        return np.stack([(J(Z) @ H.hessian(X, t)) * (length * sign) for Z, X, t, length in parts])

    def structure_derivatives(self, momenta: NDArray[Any], gradients: NDArray[Any]) -> NDArray[Any]:
        """Return the derivatives of h scale_j sign J(Z) u_j at Z_j, shape (s, n, n), such as h scale_j sign D_u."""
        parts = zip(momenta, gradients, self.lengths, strict=True)
        return np.stack([structure_derivative(self.system, Z, u) * length for Z, u, length in parts])

    def solve_stages(self, blocks: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
        """Return the solution of Y_i = sum_j mix_ij W_j Y_j + right_i; right has shape (s, n) or (s, n, lanes)."""
        s, n = len(self.times), self.x.size
        mix = self.coefficients.mix
        coupled = np.stack([np.concatenate([mix[i, j] * blocks[j] for j in range(s)], axis=1) for i in range(s)])
        matrix = np.eye(s * n, dtype=np.int64) - coupled.reshape(s * n, s * n)
        return linear_solve(matrix, right.reshape(s * n, -1)).reshape(right.shape)

    def solve_slopes(self, blocks: NDArray[np.float64], constant: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the solution of dL_j = W_j (1 + sum_k mix_jk dL_k) + constant_j, shape (s, n, n)."""
        return np.asarray(blocks @ self.solve_stages(blocks, self.stage_derivatives(constant)) + constant)


def read_tableau(coefficients: Coefficients, solver: str, scheme: str) -> Coefficients:
    """Return a tableau as floats; raise ValueError or TypeError if its shapes or values do not suit the solver."""
    if not isinstance(coefficients, tuple) or len(coefficients) != len(Coefficients._fields):
        raise TypeError(f"coefficients of {scheme} must return coadjoint.methods.Coefficients(node, scale, mix, out)")
    tableau = Coefficients(*(np.asarray(entry, dtype=np.float64) for entry in coefficients))
    s = tableau.node.size
    for name, entry in tableau._asdict().items():
        shape = (s, s) if name == "mix" else (s,)
        if entry.shape != shape or not s:
            raise ValueError(
                f"{name} of {scheme} has the shape {entry.shape}; node has {s} stages, so it must be {shape}"
            )
        if not np.all(np.isfinite(entry)):
            raise ValueError(f"{name} of {scheme} contains NaN or infinity; every coefficient must be finite")
    if solver == "explicit" and np.any(np.triu(tableau.mix)):
        i, j = np.argwhere(np.triu(tableau.mix))[0]
        raise ValueError(
            f"mix[{i}, {j}] of {scheme} is {tableau.mix[i, j]:g}, but an explicit stage uses only the slopes before it"
            '; make it zero, or take solver = "implicit"'
        )
    return tableau


@suggest_keywords
def begin(tableau: Callable[[Number], Coefficients], system: System, x: Any, t: Any, h: Any) -> Step:
    """Return a step at its start, in the number type of x, for an implicit step of your own in Python.

    Parameters
    ----------
    tableau : callable
        Function of a number type that returns `Coefficients`, such as ``lambda number: gauss_tableau(2, number)``.
    system : LiePoissonSystem or PoissonSystem
        The system.
    x : array_like, shape (n,)
        The state: floats, or numbers of another type in an array of objects.
    t, h : number
        Time at the start, and length of the step.

    Returns
    -------
    Step
        ``fields(points)`` are the slopes L_j = h scale_j f(X_j), ``points(slopes)`` the stages X_i = x + sum_j mix_ij
        L_j, both (s, n); ``coefficients`` is the tableau and ``x`` the state.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> step = co.methods.begin(lambda number: co.methods.gauss_tableau(1, number), body, (1.0, 0.2, 0.5), 0.0, 0.1)
    >>> step.fields(step.start()).shape
    (1, 3)
    """
    point = np.asarray(x)
    number: Number = float
    if point.dtype == object:
        number = type(point[0])
    else:
        point = point.astype(np.float64)
    time, length = number(t), number(h)
    coefficients = tableau(number)
    times = [time + length * c for c in coefficients.node]
    return Step(system, coefficients, point, times, [length * b for b in coefficients.scale])


def structure_derivative(system: System, x: NDArray[Any], u: NDArray[Any]) -> NDArray[Any]:
    """Return the derivative of sign * J(x) u with respect to x, shape (n, n): on a Lie algebra sign * D_u."""
    if system.algebra is not None:
        return np.asarray(system.sign * system.algebra.coadjoint(u))
    if system.derivative_function is None:
        raise TypeError(f"the derivative of J is unknown for {system.name}; give derivative=")
    return np.asarray(system.sign * np.einsum("ijk,j->ik", np.asarray(system.derivative_function(x)), u))


def linear_solve(matrix: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    """Solve a linear system in any number type, by elimination with partial pivoting; `right` is (m, lanes)."""
    if matrix.dtype != object:
        return np.asarray(np.linalg.solve(matrix, right))
    A, B = matrix.copy(), right.copy()
    size = len(A)
    for k in range(size):
        pivot = k + max(range(size - k), key=lambda i: abs(A[k + i, k]))
        A[[k, pivot]], B[[k, pivot]] = A[[pivot, k]], B[[pivot, k]]
        for i in range(k + 1, size):
            factor = A[i, k] / A[k, k]
            A[i, k:], B[i] = A[i, k:] - factor * A[k, k:], B[i] - factor * B[k]
    for k in reversed(range(size)):
        B[k] = (B[k] - A[k, k + 1 :] @ B[k + 1 :]) / A[k, k]
    return B
