"""Stages of Runge-Kutta steps, and solvers for their slopes, in NumPy for any number type, with derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.interface import limit
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.program.numbers import Number, roundoff
from coadjoint.short_repr import record_repr
from coadjoint.systems.system import System

# Most iterations in JAX and PyTorch: an error that halves in each of them is then round-off; and the largest last
# correction of a fixed point there, relative to it, beyond round-off.
MOST_ITERATIONS, LARGEST_CORRECTION = 50, 1e-13
LARGEST_ROUNDOFF, STALLED = 2**-32, 4  # corrections below this that do not fall in so many iterations may be round-off
MAX_ITERATIONS = 200  # for 53 bits; proportional to the number of bits
LARGEST_SAMPLED = 2**-8  # of the size of the stages: larger corrections are not sampled
SAMPLES, SAMPLE_LENGTH, SAMPLED = 8, 3, 32  # of this test: points, iterations from each, and most times their distance


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


class StageProblem(NamedTuple):
    """A step as seen by Runge-Kutta schemes: the system, coefficients, state, times of the stages, and h scale_j."""

    system: System
    coefficients: Coefficients
    x: NDArray[Any]
    times: list[Any]
    lengths: list[Any]

    def points(self, slopes: NDArray[Any]) -> NDArray[Any]:
        """Return the stages X_i = x + sum_j mix_ij L_j, shape (s, n)."""
        return self.x + self.coefficients.mix @ slopes

    def end(self, slopes: NDArray[Any]) -> NDArray[Any]:
        """Return the end of the step, x + sum_j out_j L_j."""
        return np.asarray(self.x + self.coefficients.out @ slopes)

    def start(self) -> NDArray[Any]:
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
        J, sign = self.system.product_derivative, self.system.sign
        return np.stack([sign * J(Z, u) * length for Z, u, length in parts])

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
def begin(tableau: Callable[[Number], Coefficients], system: System, x: Any, t: Any, h: Any) -> StageProblem:
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
    return StageProblem(system, coefficients, point, times, [length * b for b in coefficients.scale])


def most_rounds(limit_of_floats: int, unit: Any) -> int:
    """Return the limit of an iteration that converges linearly, for numbers of this unit round-off."""
    return limit_of_floats * max(1, int(1 / unit).bit_length() // 53)


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


Evaluation = tuple[NDArray[Any], NDArray[np.float64] | None]
"""The slopes L of a step, shape (s, n), and, if requested, their derivatives dL / dx, shape (s, n, n)."""


def explicit(step: StageProblem, iterations: int, tangent: bool) -> Evaluation:
    """Return the slopes L_j = h f(x + sum_{k<j} a_jk L_k), and dL_j = h f'(X_j) (1 + sum_{k<j} a_jk dL_k)."""
    s, n = len(step.times), step.x.size
    slopes = np.zeros((s, n), dtype=step.x.dtype)
    derivatives = np.zeros((s, n, n)) if tangent else None
    for j in range(s):
        X = step.points(slopes)[j]
        slopes[j] = step.lengths[j] * step.system.vector_field(X, step.times[j])
        if derivatives is not None:
            derivatives[j] = (
                step.lengths[j] * step.system.jacobian(X, step.times[j]) @ step.stage_derivatives(derivatives)[j]
            )
    return slopes, derivatives


def iterated(step: StageProblem, iterations: int, tangent: bool) -> Evaluation:
    """Return the slopes L_j = h b_j f(X_j^m), and dL_j = h b_j f'(X_j^m) dX_j^m."""
    iterates = iterate(step, iterations)
    slopes = step.fields(iterates[-1])
    if not tangent:
        return slopes, None
    return slopes, step.jacobians(iterates[-1]) @ iterate_tangents(step, iterates)


def implicit(step: StageProblem, iterations: int, tangent: bool) -> Evaluation:
    """Return the slopes L_j = h b_j f(x + sum_k mu_jk L_k), and dL_j = h b_j f'(X_j) dX_j."""
    slopes = iterate_to_stagnation(step, step.fields)
    if not tangent:
        return slopes, None
    jacobians = step.jacobians(step.points(slopes))
    return slopes, step.solve_slopes(jacobians, np.zeros_like(jacobians))


def structure_frozen(step: StageProblem, iterations: int, tangent: bool) -> Evaluation:
    """Return the slopes of equation (7), linear in the stages, with J(Z) frozen: W_j = h b_j sign J(Z_j) M."""
    # dL_j = W_j dX_j + (derivative of L_j with respect to Z_j) dZ_j.
    iterates = iterate(step, iterations)
    frozen = iterates[-1]
    blocks = step.structure_hessians(frozen)
    slopes = _linear(step, frozen, blocks, lambda points: step.products(frozen, step.gradients(points)))
    if not tangent:
        return slopes, None
    frozen_blocks = step.structure_derivatives(frozen, step.gradients(step.points(slopes)))
    return slopes, step.solve_slopes(blocks, frozen_blocks @ iterate_tangents(step, iterates))


def gradient_frozen(step: StageProblem, iterations: int, tangent: bool) -> Evaluation:
    """Return the slopes of equation (7) with u = grad H(Z) frozen: W_j = h b_j sign D_u(Z_j), and dL_j likewise."""
    iterates = iterate(step, iterations)
    frozen = iterates[-1]
    gradients = step.gradients(frozen)
    blocks = step.structure_derivatives(frozen, gradients)
    slopes = _linear(step, frozen, blocks, lambda points: step.products(points, gradients))
    if not tangent:
        return slopes, None
    frozen_blocks = step.structure_hessians(step.points(slopes), frozen)
    return slopes, step.solve_slopes(blocks, frozen_blocks @ iterate_tangents(step, iterates))


SOLVERS: dict[str, Callable[[StageProblem, int, bool], Evaluation]] = {
    "explicit": explicit,
    "iterated": iterated,
    "implicit": implicit,
    "structure": structure_frozen,
    "gradient": gradient_frozen,
}
"""Name of the solver of a scheme -> function."""


def _linear(
    step: StageProblem, frozen: NDArray[Any], blocks: NDArray[Any], slopes_at: Callable[[NDArray[Any]], NDArray[Any]]
) -> NDArray[Any]:
    """Return the slopes at the stages that solve a linear system."""
    return slopes_at(frozen + step.solve_stages(blocks, step.points(slopes_at(frozen)) - frozen))


def iterate(step: StageProblem, count: int) -> list[NDArray[Any]]:
    """Return the function iterates X^0 = x, X^1, ..., X^count of equation (6), each of shape (s, n)."""
    iterates = [step.start()]
    for _ in range(count):
        iterates.append(step.points(step.fields(iterates[-1])))
    return iterates


def iterate_tangents(step: StageProblem, iterates: list[NDArray[Any]]) -> NDArray[np.float64]:
    """Return the derivative of the last of the function iterates, shape (s, n, n)."""
    derivatives = step.stage_derivatives(np.zeros((len(step.times), step.x.size, step.x.size)))
    for points in iterates[:-1]:
        derivatives = step.stage_derivatives(step.jacobians(points) @ derivatives)
    return derivatives


def _at_roundoff(
    step: StageProblem, slopes_at: Callable[[NDArray[Any]], NDArray[Any]], start: NDArray[Any], unit: Any
) -> bool:
    """Test whether iterations from points that differ by roundings end as far apart as the corrections are large."""
    # The counterpart of ``at_round_off`` in ``stages/stagnation.hpp``.
    component = np.arange(start.shape[1])
    spacing = 0 if start.dtype == object else np.finfo(start.dtype).smallest_subnormal
    ends: list[NDArray[Any]] = []
    distance, correction = 0 * start, 0 * start
    for sample in range(SAMPLES + 1):
        roundings = ((7 * component + 5 * sample) % 17 - 8) * (1 if sample else 0)
        points = start + start * (roundings * (2 * unit)) + roundings * spacing
        for passed in range(SAMPLE_LENGTH):
            before, points = points, step.points(slopes_at(points))
            if sample:
                distance = np.maximum(distance, np.abs(points - ends[passed]))
            else:
                ends.append(points)
                correction = np.abs(points - before)
    return bool(np.all(correction <= SAMPLED * (distance + spacing + np.abs(start) * (2 * unit))))


@suggest_keywords
def iterate_to_stagnation(step: StageProblem, slopes_at: Callable[[NDArray[Any]], NDArray[Any]]) -> NDArray[Any]:
    """Iterate X = x + mix L(X) until the correction no longer falls, and return the last slopes L, shape (s, n).

    ``settle`` in ``stages/stagnation.hpp`` is its counterpart for steps in C++.

    Parameters
    ----------
    step : Step
        The step, from `begin`.
    slopes_at : callable
        Function of the stages X, shape (s, n), that returns the slopes; usually ``step.fields``.

    Returns
    -------
    ndarray, shape (s, n)
        The slopes L; the step adds ``step.coefficients.out @ L`` to the state.

    Raises
    ------
    IntegrationError
        The iteration does not converge.
    TypeError
        The numbers are exact fractions, for which it does not end.

    Examples
    --------
    The implicit midpoint rule:

    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> step = co.methods.begin(lambda number: co.methods.gauss_tableau(1, number), body, (1.0, 0.2, 0.5), 0.0, 0.1)
    >>> x = step.x + co.methods.iterate_to_stagnation(step, step.fields)[0]
    >>> float(abs(x @ x - 1.29)) < 1e-14
    True
    """
    most_growth = 2 ** limit("GROWTH_BITS")  # growth of the correction at which the iteration counts as divergent
    unit = roundoff(float if step.x.dtype != object else type(step.x[0]))
    if unit == 0:
        raise TypeError(
            "the stages are computed by iteration, which does not terminate in exact fractions; take floats or "
            "mpmath.mpf"
        )
    max_iterations = most_rounds(MAX_ITERATIONS, unit)
    points, stagnant, largest, first = step.start(), 0, None, 0
    smallest = np.full(step.x.size, np.inf, dtype=step.x.dtype)
    with np.errstate(over="ignore", invalid="ignore"):  # divergence is detected by the last correction
        for iteration in range(1, max_iterations + 1):
            slopes = slopes_at(points)
            new = step.points(slopes)
            change = np.max(np.abs(new - points), axis=0)
            points, largest, size = new, max(change), max(np.max(np.abs(new), axis=0))
            if largest == 0:
                return slopes
            first = largest if iteration == 1 else first
            if not largest <= most_growth * first:
                break
            # Where coordinates move each other in turns, every other correction vanishes, and is no smallest one.
            decreased = (change > 0) & (change < smallest)
            falling, smallest = bool(np.any(decreased)), np.where(decreased, change, smallest)
            stagnant = stagnant + 1 if iteration > 3 and not falling and largest <= 2**21 * unit * size else 0
            if stagnant >= max(2, iteration // 4):  # slow corrections may oscillate for longer before they shrink
                return slopes
        if largest is not None and largest <= LARGEST_SAMPLED * size and _at_roundoff(step, slopes_at, points, unit):
            return slopes_at(points)
    residual = float(largest) if largest is not None else float("nan")
    raise IntegrationError(
        f"the stages of a step do not converge (last correction {residual:.3g}); take a smaller step",
        step=1,
        time=float(step.times[0]),
        residual=residual,
    )
