"""Solvers for the slopes of Runge-Kutta steps in NumPy, for any number type, with derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.numerics.stages import Step
from coadjoint.program.numbers import roundoff

MAX_ITERATIONS = 200  # for 53 bits; proportional to the number of bits
ROUGHEST = 2**-8  # of the size of the stages: larger corrections are not tested for round-off
SAMPLES, SAMPLE_LENGTH, SAMPLED = 8, 3, 32  # of this test: points, iterations from each, and most times their distance


class Evaluation(NamedTuple):
    """The slopes L of a step, shape (s, n), and, if requested, their derivatives dL / dx, shape (s, n, n)."""

    slopes: NDArray[Any]
    derivatives: NDArray[np.float64] | None


def explicit(step: Step, iterations: int, tangent: bool) -> Evaluation:
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
    return Evaluation(slopes, derivatives)


def iterated(step: Step, iterations: int, tangent: bool) -> Evaluation:
    """Return the slopes L_j = h b_j f(X_j^m), and dL_j = h b_j f'(X_j^m) dX_j^m."""
    iterates = iterate(step, iterations)
    slopes = step.fields(iterates[-1])
    if not tangent:
        return Evaluation(slopes, None)
    return Evaluation(slopes, step.jacobians(iterates[-1]) @ iterate_tangents(step, iterates))


def implicit(step: Step, iterations: int, tangent: bool) -> Evaluation:
    """Return the slopes L_j = h b_j f(x + sum_k mu_jk L_k), and dL_j = h b_j f'(X_j) dX_j."""
    slopes = iterate_to_stagnation(step, step.fields)
    if not tangent:
        return Evaluation(slopes, None)
    jacobians = step.jacobians(step.points(slopes))
    return Evaluation(slopes, step.solve_slopes(jacobians, np.zeros_like(jacobians)))


def structure_frozen(step: Step, iterations: int, tangent: bool) -> Evaluation:
    """Return the slopes of equation (7), linear in the stages X, with J(Z) frozen: W_j = h b_j sign J(Z_j) M.

    dL_j = W_j dX_j + (derivative of L_j with respect to Z_j) dZ_j.
    """
    iterates = iterate(step, iterations)
    frozen = iterates[-1]
    blocks = step.structure_hessians(frozen)
    slopes = _linear(step, frozen, blocks, lambda points: step.products(frozen, step.gradients(points)))
    if not tangent:
        return Evaluation(slopes, None)
    frozen_blocks = step.structure_derivatives(frozen, step.gradients(step.points(slopes)))
    return Evaluation(slopes, step.solve_slopes(blocks, frozen_blocks @ iterate_tangents(step, iterates)))


def gradient_frozen(step: Step, iterations: int, tangent: bool) -> Evaluation:
    """Return the slopes of equation (7) with u = grad H(Z) frozen: W_j = h b_j sign D_u(Z_j), and dL_j likewise."""
    iterates = iterate(step, iterations)
    frozen = iterates[-1]
    gradients = step.gradients(frozen)
    blocks = step.structure_derivatives(frozen, gradients)
    slopes = _linear(step, frozen, blocks, lambda points: step.products(points, gradients))
    if not tangent:
        return Evaluation(slopes, None)
    frozen_blocks = step.structure_hessians(step.points(slopes), frozen)
    return Evaluation(slopes, step.solve_slopes(blocks, frozen_blocks @ iterate_tangents(step, iterates)))


SOLVERS: dict[str, Callable[[Step, int, bool], Evaluation]] = {
    "explicit": explicit,
    "iterated": iterated,
    "implicit": implicit,
    "structure": structure_frozen,
    "gradient": gradient_frozen,
}
"""Name of the solver of a scheme -> function."""


def _linear(
    step: Step, frozen: NDArray[Any], blocks: NDArray[Any], slopes_at: Callable[[NDArray[Any]], NDArray[Any]]
) -> NDArray[Any]:
    """Return the slopes at the stages that solve a linear system."""
    return slopes_at(frozen + step.solve_stages(blocks, step.points(slopes_at(frozen)) - frozen))


def iterate(step: Step, count: int) -> list[NDArray[Any]]:
    """Return the function iterates X^0 = x, X^1, ..., X^count of equation (6), each of shape (s, n)."""
    iterates = [step.start()]
    for _ in range(count):
        iterates.append(step.points(step.fields(iterates[-1])))
    return iterates


def iterate_tangents(step: Step, iterates: list[NDArray[Any]]) -> NDArray[np.float64]:
    """Return the derivative of the last of the function iterates, shape (s, n, n)."""
    derivatives = step.stage_derivatives(np.zeros((len(step.times), step.x.size, step.x.size)))
    for points in iterates[:-1]:
        derivatives = step.stage_derivatives(step.jacobians(points) @ derivatives)
    return derivatives


def _at_roundoff(step: Step, slopes_at: Callable[[NDArray[Any]], NDArray[Any]], start: NDArray[Any], unit: Any) -> bool:
    """Test whether iterations from points that differ by roundings end as far apart as the corrections are large.

    ``at_round_off`` in ``stages/stagnation.hpp`` is its counterpart for steps in C++.
    """
    component = np.arange(start.shape[1])
    spacing = 0 if start.dtype == object else np.finfo(start.dtype).smallest_subnormal
    ends: list[NDArray[Any]] = []
    distance, correction = 0 * start, 0 * start
    for sample in range(SAMPLES + 1):
        points = start + start * (((7 * component + 5 * sample) % 17 - 8) * (2 * unit if sample else 0 * unit))
        for passed in range(SAMPLE_LENGTH):
            before, points = points, step.points(slopes_at(points))
            if sample:
                distance = np.maximum(distance, np.abs(points - ends[passed]))
            else:
                ends.append(points)
                correction = np.abs(points - before)
    return bool(np.all(correction <= SAMPLED * (distance + spacing + np.abs(start) * (2 * unit))))


@suggest_keywords
def iterate_to_stagnation(step: Step, slopes_at: Callable[[NDArray[Any]], NDArray[Any]]) -> NDArray[Any]:
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
    from coadjoint.kernels.interface import limit

    most_growth = 2 ** limit("GROWTH_BITS")  # growth of the correction at which the iteration counts as divergent
    unit = roundoff(float if step.x.dtype != object else type(step.x[0]))
    if unit == 0:
        raise TypeError(
            "the stages are computed by iteration, which does not terminate in exact fractions; take floats or "
            "mpmath.mpf"
        )
    max_iterations = MAX_ITERATIONS * max(1, int(-np.log2(float(unit)) / 53))
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
        if largest is not None and largest <= ROUGHEST * size and _at_roundoff(step, slopes_at, points, unit):
            return slopes_at(points)
    residual = float(largest) if largest is not None else float("nan")
    raise IntegrationError(
        f"the stages of a step do not converge (last correction {residual:.3g}); take a smaller step",
        step=1,
        time=float(step.times[0]),
        residual=residual,
    )
