"""Functional independence of polynomials: the rank of their gradients."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from coadjoint.algebra.exact.modular import random_prime
from coadjoint.algebra.polynomials.polynomial import Polynomial


def independent_count(polynomials: Sequence[Polynomial], seed: int = 0) -> int:
    """Return how many of the polynomials are functionally independent: the generic rank of their gradients, exactly.

    The larger rank at two seeded random points modulo random 62-bit primes: never too large; a nonzero minor of degree
    D vanishes at both with probability <= (D/2^61)^2 < 2^-60 for D < 2^31 (Schwartz and Zippel).
    """
    dims = sorted({polynomial.dim for polynomial in polynomials})
    if len(dims) > 1:
        raise ValueError(f"polynomials must have the same number of coordinates, not {dims[0]} and {dims[-1]}")
    if not polynomials:
        return 0
    from flint import nmod_mat

    rng = np.random.default_rng(seed)
    gradients = [[polynomial.derivative(i) for i in range(dims[0])] for polynomial in polynomials]
    ranks = []
    for _ in range(2):
        prime = random_prime(rng)
        x = rng.integers(0, prime, size=dims[0]).tolist()
        flat = [_value(part, x, prime) for row in gradients for part in row]
        ranks.append(nmod_mat(len(polynomials), dims[0], flat, prime).rank())
    return max(ranks)


def _value(polynomial: Polynomial, x: list[int], prime: int) -> int:
    """Return the value of a polynomial modulo a prime."""
    total = 0
    for exponents, coefficient in polynomial.monomials.items():
        exact = Fraction(coefficient)
        term = exact.numerator * pow(exact.denominator, -1, prime)
        for value, power in zip(x, exponents, strict=True):
            term = term * pow(value, power, prime) % prime if power else term
        total += term
    return total % prime
