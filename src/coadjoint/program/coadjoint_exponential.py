"""Coadjoint action in closed form, exp(D_v) x with D_v x = sign J(x) v, for arrays of JAX and PyTorch."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import SEED

# Largest dimension in which closed forms are looked for, and zero for them, relative to the terms.
MOST_COORDINATES, ZERO = 32, 1e-12
SERIES = 8  # terms of functions of an argument below one, which are 1/20! then
Square = tuple[NDArray[np.float64], int]


def common_square(algebra: Any) -> Square | None:
    """Return a matrix B, and p = 1 or 2, with D_v (D_v^2 - z)^p = 0 and z = v . B v for all v; or None."""
    if algebra.dim > MOST_COORDINATES:
        return None
    n, (i, j, k, c) = algebra.dim, algebra.triples
    each = np.zeros((n, n, n))  # of the direction, row and column of D
    np.add.at(each, (np.append(j, i), np.append(i, j), np.append(k, k)), np.append(c, -c))
    traces = np.einsum("aij,bji->ab", each, each)
    directions = np.random.default_rng(SEED).uniform(-1.0, 1.0, (3, n))
    for count, p in product(range(2, n + 1, 2), (1, 2)):  # of nonzero eigenvalues
        square = traces / count
        for v in directions:
            D, z = np.einsum("a,aij->ij", v, each), v @ square @ v
            size = np.max(np.abs(D @ D), initial=0.0) + abs(z)
            rest = D @ np.linalg.matrix_power(D @ D - z * np.eye(n), p)
            if np.max(np.abs(rest), initial=0.0) > ZERO * size ** (p + 0.5):
                break
        else:
            return square, p
    return None


def exponential(
    xp: Any, grad: Callable[..., Any], times: Callable[[Any, Any], Any], square: tuple[Any, int], v: Any, x: Any
) -> Any:
    """Return exp(D_v) x as a sum of powers, where D (D^2 - z)^p = 0 and z = v . square v, with p = 1 or 2.

    `xp` and `grad` are the functions of arrays, and the derivative, of a library; ``times(x, v)`` is D_v x.
    """
    matrix, p = square
    z = v @ matrix @ v
    powers = [x]
    for _ in range(2 * p + 1):
        powers.append(times(powers[-1], v))
    total = x + powers[1]
    # The even and the odd part are functions of D^2, equal to 1 at 0, which are known at z, for p = 2 with slopes.
    for first in (0, 1):
        rest = _remainder(xp, z, first)
        if p == 1:
            total = total + rest * powers[first + 2]
        else:
            slope = grad(lambda z, first=first: _remainder(xp, z, first))(z)
            total = total + (rest - z * slope) * powers[first + 2] + slope * powers[first + 4]
    return total


def _remainder(xp: Any, z: Any, first: int) -> Any:
    """Return (cosh(w) - 1)/w^2, or (sinh(w) - w)/w^3 if `first` is 1, as a function of z = w^2 of either sign."""
    small, size = xp.abs(z) < 1.0, xp.abs(xp.where(xp.abs(z) < 1.0, 1.0, z))
    near = xp.where(small, z, 0.0)
    series = xp.zeros_like(z)
    for k in range(SERIES, -1, -1):
        series = series * near + 1.0 / math.factorial(2 * k + 2 + first)
    w = xp.sqrt(size)
    grown = xp.where(z > 0.0, w, 0.0)
    if first:
        far = xp.where(z < 0.0, (w - xp.sin(w)) / (w * size), (xp.sinh(grown) - w) / (w * size))
    else:
        far = xp.where(z < 0.0, 2.0 * (xp.sin(0.5 * w) / w) ** 2, 2.0 * (xp.sinh(0.5 * grown) / w) ** 2)
    return xp.where(small, series, far)
