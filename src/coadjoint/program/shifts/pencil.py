"""Singular values c of a matrix pencil M - c C, in integer arithmetic, with the same floats on every machine."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.parts.squares import complete_squares

BISECTIONS = 64  # of an interval of floats: to the last bit


def singular_factors(matrix: NDArray[np.float64], casimir: NDArray[np.float64]) -> tuple[float, ...]:
    """Return the c with M - c C singular, for symmetric M and definite C; there a completed square vanishes.

    The real zeros of det(M - c C) are counted in integers and bracketed by bisection; each result is the float beyond
    the zero. Empty if C is not definite, or if M is diagonal, where the diagonal gives the factors.
    """
    if not np.any(matrix - np.diag(np.diag(matrix))):
        return ()
    size = len(matrix)
    sign, smallest = _definiteness(casimir.tobytes(), size)
    if sign == 0:
        return ()
    bound = 2.0 * size**2 * float(np.max(np.abs(matrix))) / smallest
    polynomial = _determinant(matrix, sign * casimir)
    factors = []
    for count in range(1, size + 1):
        low, high = -bound, bound
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            previous = low, high
            low, high = (low, middle) if _zeros_below(polynomial, middle) >= count else (middle, high)
            if (low, high) == previous:
                break
        factors.append(sign * high)
    return tuple(sorted(factors))


@lru_cache(maxsize=64)
def _definiteness(entries: bytes, size: int) -> tuple[int, float]:
    """Return +1 or -1 for a definite matrix and 0 for any other, and the smallest absolute pivot."""
    matrix = np.frombuffer(entries).reshape(size, size)
    lift = np.vectorize(Fraction, otypes=[object])
    weights = list(complete_squares(lift(matrix), lift(np.zeros(size))).weights)
    signs = {weight > 0 for weight in weights}
    if len(weights) < size or len(signs) != 1:
        return 0, 0.0
    return (1 if weights[0] > 0 else -1), min(float(abs(weight)) for weight in weights)


def _determinant(matrix: NDArray[np.float64], casimir: NDArray[np.float64]) -> list[int]:
    """Return integer coefficients of a multiple of det(M - c C), by interpolation at c = 0, 1, ..., n."""
    size = len(matrix)
    pairs = [Fraction(value) for value in [*matrix.ravel().tolist(), *casimir.ravel().tolist()]]
    scale = math.lcm(*(value.denominator for value in pairs))
    integers = [int(value * scale) for value in pairs]
    M, C = (np.array(part, dtype=object).reshape(size, size) for part in (integers[: size**2], integers[size**2 :]))
    values = [_bareiss((M - c * C).tolist()) for c in range(size + 1)]
    # Newton's forward differences, times n!: sum_k d_k c (c - 1) ... (c - k + 1) n!/k!
    coefficients, falling = [0] * (size + 1), [1]
    for k in range(size + 1):
        factor = math.factorial(size) // math.factorial(k) * values[0]
        for power, value in enumerate(falling):
            coefficients[power] += factor * value
        values = [b - a for a, b in pairwise(values)]
        falling = [a - k * b for a, b in zip([0, *falling], [*falling, 0], strict=True)]
    return coefficients


def _bareiss(rows: list[list[int]]) -> int:
    """Return the determinant of an integer matrix by fraction-free elimination (Bareiss 1968)."""
    sign, previous_pivot = 1, 1
    for k in range(len(rows) - 1):
        pivot = next((r for r in range(k, len(rows)) if rows[r][k]), None)
        if pivot is None:
            return 0
        if pivot != k:
            rows[k], rows[pivot], sign = rows[pivot], rows[k], -sign
        for r in range(k + 1, len(rows)):
            rows[r] = [
                (a * rows[k][k] - rows[r][k] * b) // previous_pivot for a, b in zip(rows[r], rows[k], strict=True)
            ]
        previous_pivot = rows[k][k]
    return sign * rows[-1][-1]


def _zeros_below(polynomial: list[int], point: float) -> int:
    """Count the zeros below a point, for a polynomial with real zeros only.

    Zeros above are sign changes of the coefficients shifted to the point (Descartes' rule, exact for real zeros).
    """
    numerator, denominator = point.as_integer_ratio()
    degree = len(polynomial) - 1
    about = [value * denominator ** (degree - power) for power, value in enumerate(polynomial)]
    for start in range(degree):
        for power in range(degree - 1, start - 1, -1):
            about[power] += numerator * about[power + 1]
    signs = [value > 0 for value in about if value]
    at_point = next(power for power, value in enumerate(about) if value)
    return degree - at_point - sum(a != b for a, b in pairwise(signs))
