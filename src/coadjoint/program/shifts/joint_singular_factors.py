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
            factors.append(_beyond(bound, partial(_sign_of_quotient, block[0, 0], of_block[0, 0]), agreement))
            continue
        estimates = _eigenvalues(block, of_block)
        for k in range(len(own)):
            zero = _zero(block, of_block, estimates[k], scale, k, agreement)
            factors.append(_beyond(bound, partial(_sign, zero, block, of_block), agreement))
    return np.sort(sign * np.array(factors), axis=0)


def _beyond(bound: Floats, sign_at: Callable[[Floats], tuple[Floats, Masks]], agreement: Agreement) -> Floats:
    """Return the float beyond a zero, between -bound and bound, by the bisections of `singular_factors`.

    `sign_at` is that of a point minus the zero, and whether it is certain.
    """
    low, high, every = -bound, bound.copy(), np.ones(len(bound), dtype=bool)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        sign, certain = sign_at(middle)
        every &= certain
        above = sign > 0.0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    agreement.require(every)
    return high


def _sign(zero: Bounded, matrix: Floats, casimir: Floats, point: Floats) -> tuple[Floats, Masks]:
    # Exact where the sign is not obvious.
    beyond = (point - zero.high) - zero.low
    certain = np.abs(beyond) > zero.error
    near = np.flatnonzero(~certain)
    if len(near) and len(matrix) <= 3:
        singular = _is_singular(matrix[..., near], casimir, point[near])
        beyond[near[singular]], certain[near[singular]] = 0.0, True
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


def _zero(
    matrix: Floats, casimir: Floats, estimate: Floats, scale: Floats, below: int, agreement: Agreement
) -> Bounded:
    """Return the zero of det(M - c C) above `below` others, known to within `RADIUS`."""
    order = _pivot_order(matrix[..., 0] - estimate[0] * casimir)
    ends = [Bounded.of(estimate + end * OFFSET * scale) for end in (-1.0, 1.0)]
    pivots = [_elimination(matrix, casimir, one, order)[1] for one in ends]
    zero = ends[0] + (ends[1] - ends[0]) * (pivots[0] / (pivots[0] - pivots[1]))
    center = Bounded(zero.high, zero.low, np.zeros_like(scale))
    for end in (0, 1):
        shift = Bounded.of((2.0 * end - 1.0) * RADIUS * scale)
        negative, _, certain = _elimination(matrix, casimir, center + shift, order)
        agreement.require(certain & (negative == below + end))
    return Bounded(zero.high, zero.low, RADIUS * scale * (1.0 + 2.0**-20))


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
    matrix: Floats, casimir: Floats, factor: Bounded, order: list[int]
) -> tuple[NDArray[np.int64], Bounded, NDArray[np.bool_]]:
    """Return how many zeros of det(M - c C) are below c, the last pivot of M - c C, and whether the number is certain.

    By Sylvester's law of inertia, as many pivots are negative.
    """
    first, second = np.triu_indices(len(matrix))
    rows = np.array(order)
    given = matrix[rows[first], rows[second]]
    upper = Bounded.of(given) - factor * Bounded.of(casimir[rows[first], rows[second]][:, None])
    at = np.zeros((len(matrix), len(matrix)), dtype=np.int64)
    at[first, second] = at[second, first] = np.arange(len(first))
    negative, certain = np.zeros(matrix.shape[-1], dtype=np.int64), np.ones(matrix.shape[-1], dtype=bool)
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
