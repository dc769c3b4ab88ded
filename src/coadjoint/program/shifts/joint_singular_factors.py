"""`singular_factors` of many matrices at once: zeros of det(M - c C), enclosed by the signs of pivots."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.components import connected
from coadjoint.program.bounded import (
    SMALLEST_FACTOR,
    SMALLEST_PRODUCT,
    Bounded,
    determinant_terms,
    sum_of,
    two_product,
    two_sum,
)
from coadjoint.program.parts.agreement import Agreement, Undecided
from coadjoint.program.shifts.shift import BISECTIONS, definiteness

Floats = NDArray[np.float64]
Masks = NDArray[np.bool_]

SWEEPS = 6  # of rotations; the error is squared in each, and more would follow from a poor estimate
OFFSET = 2.0**-46  # of the points between which a zero is interpolated, relative to M
RADIUS = 2.0**-78  # of the enclosure of a zero, relative to M


def joint_singular_factors(matrix: Floats, casimir: Floats, agreement: Agreement) -> Floats:
    """Return the factors (count, members) of `singular_factors`, for matrices (n, n, members) and one Casimir."""
    size, members = len(matrix), matrix.shape[-1]
    off_diagonal = matrix.reshape(size**2, members)[~np.eye(size, dtype=bool).ravel()]
    if not agreement.decide(np.any(off_diagonal != 0.0, axis=0)):
        return np.zeros((0, members))
    sign, smallest = definiteness(casimir.tobytes(), size)
    if sign == 0:
        return np.zeros((0, members))
    definite, largest = sign * casimir, np.max(np.abs(matrix), axis=(0, 1))
    bound, scale = 2.0 * size**2 * largest / smallest, largest / smallest
    used = np.any(matrix != 0.0, axis=-1) | (casimir != 0.0)
    label = connected(size, *np.nonzero(used))
    factors = []
    for number in np.unique(label):
        own = np.flatnonzero(label == number)
        block, of_block = matrix[np.ix_(own, own)], definite[np.ix_(own, own)]
        if len(own) == 1:
            factors += [*_beyond(bound, partial(_sign_of_quotient, block[0, 0], of_block[0, 0]), agreement, 1)]
            continue
        zeros = _zeros(block, of_block, _eigenvalues(block, of_block), scale, agreement)
        factors += [*_beyond(bound, partial(_sign, zeros, block, of_block), agreement, len(own))]
    return np.sort(sign * np.array(factors), axis=0)


def _beyond(
    bound: Floats, sign_at: Callable[[Floats], tuple[Floats, Masks]], agreement: Agreement, count: int
) -> Floats:
    """Return the floats beyond zeros (count, members), between -bound and bound, by the bisections of alone matrices.

    `sign_at` is that of points minus the zeros, and whether it is certain.
    """
    low, high = (np.repeat(end[None], count, axis=0) for end in (-bound, bound))
    every = np.ones(low.shape, dtype=bool)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        sign, certain = sign_at(middle)
        every &= certain
        above = sign > 0.0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    agreement.require(every)
    return high


def _sign(zeros: Bounded, matrix: Floats, casimir: Floats, points: Floats) -> tuple[Floats, Masks]:
    # Exact where the sign is not obvious.
    beyond = (points - zeros.high) - zeros.low
    certain = np.abs(beyond) > zeros.error
    if len(matrix) <= 3 and not certain.all():
        rows, near = np.nonzero(~certain)
        singular = _is_singular(matrix[..., near], casimir, points[rows, near])
        beyond[rows[singular], near[singular]], certain[rows[singular], near[singular]] = 0.0, True
    return beyond, certain


def _is_singular(matrix: Floats, casimir: Floats, point: Floats) -> Masks:
    """Return for which matrices M - c C of up to three rows is exactly singular."""
    entries: list[list[list[Floats]]] = [[[] for _ in matrix] for _ in matrix]
    large = np.ones(len(point), dtype=bool)
    for i, j in np.ndindex(*casimir.shape):
        product, rest = two_product(point, np.full_like(point, -casimir[i, j]))
        entries[i][j] = [*two_sum(matrix[i, j], product), rest]
        for part in (*entries[i][j], matrix[i, j]):
            large &= (part == 0.0) | (np.abs(part) > SMALLEST_FACTOR)
    determinant = sum_of(determinant_terms(entries))
    return large & (determinant.high == 0.0) & (determinant.error == 0.0)


def _sign_of_quotient(entry: Floats, casimir: float, point: Floats) -> tuple[Floats, Masks]:
    """Return the sign of point - entry / casimir for a positive entry of the Casimir."""
    product, rest = two_product(point, np.full_like(point, casimir))
    beyond = (product - entry) + rest
    return beyond, (np.abs(product) > SMALLEST_PRODUCT) | (point == 0.0)


def _zeros(matrix: Floats, casimir: Floats, estimates: Floats, scale: Floats, agreement: Agreement) -> Bounded:
    """Return the zeros of det(M - c C), ascending, (n, members), each known to within `RADIUS`."""
    order = np.array([_pivot_order(matrix[..., 0] - estimate[0] * casimir) for estimate in estimates])
    ends = [Bounded.of(estimates + end * OFFSET * scale) for end in (-1.0, 1.0)]
    pivots = [_elimination(matrix, casimir, one, order)[1] for one in ends]
    zeros = ends[0] + (ends[1] - ends[0]) * (pivots[0] / (pivots[0] - pivots[1]))
    centers = Bounded(zeros.high, zeros.low, np.zeros_like(estimates))
    for end in (0, 1):
        shift = Bounded.of(np.broadcast_to((2.0 * end - 1.0) * RADIUS * scale, estimates.shape))
        negative, _, certain = _elimination(matrix, casimir, centers + shift, order)
        agreement.require(certain & (negative == np.arange(end, len(matrix) + end)[:, None]))
    return Bounded(zeros.high, zeros.low, np.broadcast_to(RADIUS * scale * (1.0 + 2.0**-20), estimates.shape))


def _pivot_order(matrix: Floats) -> list[int]:
    """Return coordinates by the sizes of the pivots in the elimination of the first matrix."""
    rest, order, remaining = matrix.copy(), list[int](), list(range(len(matrix)))
    while remaining:
        p = max(remaining, key=lambda k: abs(rest[k, k]))
        remaining.remove(p)
        order.append(p)
        if remaining and not rest[p, p]:
            raise Undecided
        rest = rest - np.multiply.outer(rest[p], rest[p] / rest[p, p]) if remaining else rest
    return order


def _elimination(
    matrix: Floats, casimir: Floats, factors: Bounded, order: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Bounded, NDArray[np.bool_]]:
    """Return how many zeros of det(M - c C) are below c, the last pivot of M - c C, and whether the number is certain.

    There are several c (k, members), each with an order of the pivots (k, n). By Sylvester's law of inertia, as many
    pivots are negative.
    """
    first, second = np.triu_indices(len(matrix))
    rows, columns = order[:, first].T, order[:, second].T
    of_casimir = np.broadcast_to(casimir[rows, columns][..., None], (*rows.shape, matrix.shape[-1]))
    upper = Bounded.of(matrix[rows, columns]) - factors * Bounded.of(of_casimir)
    at = np.zeros((len(matrix), len(matrix)), dtype=np.int64)
    at[first, second] = at[second, first] = np.arange(len(first))
    negative, certain = np.zeros(factors.high.shape, dtype=np.int64), np.ones(factors.high.shape, dtype=bool)
    for p in range(len(matrix)):
        pivot = upper[at[p, p]].copy()
        signs, sure = pivot.signs()
        negative += signs < 0.0
        certain &= sure & (signs != 0.0)
        later = np.arange(p + 1, len(matrix))
        if len(later):
            row = upper[at[p, later]]
            form = row / pivot
            i, j = np.triu_indices(len(later))
            upper[at[later[i], later[j]]] = upper[at[later[i], later[j]]] - row[i] * form[j]
    return negative, pivot, certain


def _eigenvalues(matrix: Floats, casimir: Floats) -> Floats:
    """Return estimates of the zeros of det(M - c C), ascending, for definite C: rotations of a similar matrix."""
    size = len(matrix)
    lower = np.zeros((size, size))
    for i in range(size):
        for j in range(i + 1):
            rest = casimir[i, j] - sum(lower[i, k] * lower[j, k] for k in range(j))
            lower[i, j] = np.sqrt(rest) if i == j else rest / lower[j, j]
    A = matrix.copy()
    for _ in range(2):  # L^-1 M, then the same of its transpose
        for i in range(size):
            for k in range(i):
                A[i] -= lower[i, k] * A[k]
            A[i] /= lower[i, i]
        A = A.swapaxes(0, 1).copy()
    for _ in range(SWEEPS):
        for p in range(size):
            for q in range(p + 1, size):
                _rotate(A, p, q)
    return np.sort(A[np.arange(size), np.arange(size)], axis=0)


def _rotate(A: Floats, p: int, q: int) -> None:
    """Make the entry (p, q) of symmetric matrices (n, n, members) zero by a rotation (Jacobi), in place."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        cotangent = (A[q, q] - A[p, p]) / (2.0 * A[p, q])
        t = np.where(cotangent < 0.0, -1.0, 1.0) / (np.abs(cotangent) + np.sqrt(1.0 + cotangent**2))
    t = np.where(A[p, q] == 0.0, 0.0, t)
    c = 1.0 / np.sqrt(1.0 + t**2)
    s = t * c
    A[p], A[q] = c * A[p] - s * A[q], s * A[p] + c * A[q]
    A[:, p], A[:, q] = c * A[:, p] - s * A[:, q], s * A[:, p] + c * A[:, q]
