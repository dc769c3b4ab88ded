"""Completed squares: a symmetric matrix as a sum of d_r l_r l_r^T, in rational arithmetic up to a moderate size."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF

# Single pivots need a diagonal entry of at least this fraction of the largest entry, which bounds the coefficients of
# the forms (Bunch and Parlett 1971, (1 + sqrt 17)/8).
MIN_PIVOT_RATIO = Fraction(41, 64)
# Above this size numerators become too large, and the reduction runs in the number type of its input.
MAX_RATIONAL_SIZE = 16


class Squares(NamedTuple):
    """Completed squares: x.M.x/2 + b.x = sum_r d_r (l_r.x)^2 / 2 + beta_r l_r.x, at most n of them.

    `forms` (r, n) has the l_r, `weights` the d_r (zero for a form that only carries a piece of b), `linear` the beta_r.
    `pivots` (r, 3) has the step of the reduction and its pivots, repeated if there is only one.
    """

    forms: NDArray[Any]
    weights: NDArray[Any]
    linear: NDArray[Any]
    pivots: NDArray[np.int64]


def complete_squares(matrix: NDArray[Any], linear: NDArray[Any]) -> Squares:
    """Complete the square for any symmetric matrix (Lagrange's reduction with symmetric pivoting).

    Eigenvectors are not used: they are irrational, not unique, and differ between platforms.
    """
    size = len(linear)
    exact = matrix.dtype == np.float64 and size <= MAX_RATIONAL_SIZE
    lift = np.vectorize(Fraction, otypes=[object]) if exact else np.copy
    residual, b = lift(matrix), lift(linear)
    # Each of n pivots rounds an entry three times.
    floor = 0 if exact or matrix.dtype == object else 4.0 * size * UNIT_ROUNDOFF * np.max(np.abs(matrix), initial=0.0)
    forms: list[NDArray[Any]] = []
    weights: list[Any] = []
    betas: list[Any] = []
    steps: list[tuple[int, int, int]] = []
    # The rows and columns of pivots are zero; they are removed once they are many.
    active, remaining = np.arange(size), size
    while remaining:
        if 4 * remaining <= 3 * len(active):
            rest = np.flatnonzero(~np.isin(active, [p for _, *pair in steps for p in pair]))
            active, residual = active[rest], residual[np.ix_(rest, rest)]
        best = int(np.argmax(np.abs(np.diagonal(residual))))
        row, column = divmod(int(np.argmax(np.abs(residual))), len(active))
        largest = abs(residual[row, column])
        if largest <= floor:
            break
        is_single = abs(residual[best, best]) * MIN_PIVOT_RATIO.denominator >= largest * MIN_PIVOT_RATIO.numerator
        local_pivots = [best] if is_single else [row, column]
        completed = _square(residual, best) if is_single else _pair(residual, row, column)
        new_betas = split_linear(b[active[local_pivots]], [form[local_pivots] for form, _ in completed])
        for (form, weight), beta in zip(completed, new_betas, strict=True):
            residual = residual - weight * np.multiply.outer(form, form)
            b[active] = b[active] - beta * form
            full_form = np.zeros(size, dtype=b.dtype)
            full_form[active] = form
            forms.append(full_form)
            weights.append(weight)
        betas.extend(new_betas)
        pivots = active[local_pivots].tolist()
        steps += [(len(steps), pivots[0], pivots[-1])] * len(completed)
        residual[local_pivots, :] = residual[:, local_pivots] = 0 * residual[0, 0]
        b[pivots] = 0 * b[0]
        remaining -= len(local_pivots)
    for k in np.flatnonzero(b != 0):
        form = 0 * b
        form[k] = form[k] + 1
        forms.append(form)
        weights.append(0 * b[k])
        betas.append(b[k])
        steps.append((len(steps), int(k), int(k)))
    stacked = np.array(forms, dtype=b.dtype).reshape(len(forms), size)
    pivoted = np.array(steps, dtype=np.int64).reshape(-1, 3)
    return Squares(stacked, np.array(weights, dtype=b.dtype), np.array(betas, dtype=b.dtype), pivoted)


def _square(residual: NDArray[Any], i: int) -> list[tuple[NDArray[Any], Any]]:
    return [(residual[i] / residual[i, i], residual[i, i])]


def _pair(residual: NDArray[Any], i: int, j: int) -> list[tuple[NDArray[Any], Any]]:
    """Return squares along e_i + e_j or e_i - e_j, then e_j, for a diagonal small against the entry (i, j).

    For the entry m and a zero diagonal, ((u + v)(u + v)^T - (u - v)(u - v)^T) m/2 with the rows m u and m v.
    """
    sign = 1 if (residual[i, i] + residual[j, j]) * residual[i, j] >= 0 else -1
    along = residual[i] + sign * residual[j]
    size = (along[i] + sign * along[j]) / 4
    first = along / (2 * size)
    rest = residual[j] - size * first[j] * first
    return [(first, size), (rest / rest[j], rest[j])]


def split_linear(b: Any, forms: Sequence[Any]) -> list[Any]:
    """Return beta with sum beta_r l_r = b, from the entries of b and the forms at the one or two pivots.

    Examples
    --------
    >>> split_linear([3.0, 1.0], [[1.0, 1.0], [-1.0, 1.0]])
    [2.0, -1.0]
    """
    if len(forms) == 1:
        return [b[0] / forms[0][0]]
    (p0, p1), (m0, m1), (b0, b1) = *forms, b
    determinant = p0 * m1 - p1 * m0
    return [(b0 * m1 - b1 * m0) / determinant, (p0 * b1 - p1 * b0) / determinant]
