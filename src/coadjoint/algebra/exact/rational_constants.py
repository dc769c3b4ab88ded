"""Integer structure constants: recovery of the rational numbers that were rounded to the stored floats."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact.numbers import exact_numbers

MAX_DENOMINATOR = 10**6
# p/q is accepted if p q <= 2^45. About 0.3 * 2^45 / 2^52 such fractions round to the same float as a random number, so
# one random number in 400 is mistaken for a fraction; the Jacobi identity must then confirm all fractions together.
MAX_FRACTION_PRODUCT = 2**45


def as_fraction(value: float) -> Fraction | None:
    """Return the simple fraction that rounds to a float, or None: p/q with q <= 10^6 and p q <= 2^45, or an integer."""
    simple = Fraction(value).limit_denominator(MAX_DENOMINATOR)
    if float(simple) != value:
        return None
    plain = simple.denominator == 1 or abs(simple.numerator) * simple.denominator <= MAX_FRACTION_PRODUCT
    return simple if plain else None


def clear_denominators(values: list[Fraction]) -> NDArray[Any]:
    """Multiply fractions by their common denominator; return integers in the same ratios.

    Examples
    --------
    >>> clear_denominators([Fraction(1, 2), Fraction(1, 3)])
    array([3, 2], dtype=object)
    """
    common = math.lcm(*(value.denominator for value in values))
    return exact_numbers(value.numerator * (common // value.denominator) for value in values)


def jacobi_exact(triples: Triples, integers: NDArray[Any], dim: int) -> bool:
    """Return whether integer constants fulfil the Jacobi identity exactly.

    The trilinear form is evaluated at two seeded random triples of vectors with entries below 2^62; if it is not
    identically zero, both vanish with probability <= (3/2^62)^2 < 2^-120 (Schwartz and Zippel). Small constants pass by
    `check_jacobi`.
    """
    i, j, k, c = triples
    if integers.size == 0:
        return True
    largest = max(map(abs, integers.tolist()))
    # 64 u times the sum of at most 3 n products is below 1 (u = 2^-53)
    if 3 * dim * largest**2 < 2**47 and all(a == b for a, b in zip(integers.tolist(), c.tolist(), strict=True)):
        return True

    def bracket(u: NDArray[Any], v: NDArray[Any]) -> NDArray[Any]:
        result = np.zeros(dim, dtype=object)
        np.add.at(result, k, integers * (u[i] * v[j] - u[j] * v[i]))
        return result

    rng = np.random.default_rng(0)
    for _ in range(2):
        u, v, w = rng.integers(0, 2**62, size=(3, dim)).astype(object)
        if np.any(bracket(bracket(u, v), w) + bracket(bracket(v, w), u) + bracket(bracket(w, u), v) != 0):
            return False
    return True


def rational_constants(triples: Triples, dim: int) -> NDArray[Any] | None:
    """Return integers in the ratios of the simple fractions that the constants round, or None.

    Every constant must be the float nearest to a simple fraction (`as_fraction`), and the fractions must fulfil the
    Jacobi identity exactly. A common factor changes neither Casimirs nor ranks.
    """
    distinct, inverse = np.unique(triples.c, return_inverse=True)
    fractions = [as_fraction(value) for value in distinct.tolist()]
    known = [value for value in fractions if value is not None]
    if len(known) < len(fractions):
        return None
    integers = clear_denominators(known)[inverse]
    return integers if jacobi_exact(triples, integers, dim) else None


def dyadic_constants(triples: Triples, dim: int) -> NDArray[Any] | None:
    """Return integers in the exact ratios of the floats if they fulfil the Jacobi identity exactly, else None.

    Examples
    --------
    >>> dyadic_constants(Triples(*np.array([[0, 1], [2, 2], [0, 1]]), np.array([1.0, 0.375])), 3)
    array([8, 3], dtype=object)
    """
    distinct, inverse = np.unique(triples.c, return_inverse=True)
    integers = clear_denominators([Fraction(value) for value in distinct.tolist()])[inverse]
    return integers if jacobi_exact(triples, integers, dim) else None
