"""Are polynomials functions of each other? The rank of their gradients."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from coadjoint.algebra.modular import random_prime
from coadjoint.algebra.polynomial import Polynomial


def independent_count(polynomials: Sequence[Polynomial], seed: int = 0) -> int:
    """Return how many of the polynomials are functionally independent: the rank of their gradients at a generic point.

    Coefficients are taken as the exact numbers that they are, floats too. The rank is the larger one at two random
    points (seeded), each modulo its own random prime of 62 bits. It is never too large; a minor of degree D that is not
    zero vanishes at both with probability at most (D/2^61)^2, below 2^-60 for every D < 2^31 (Schwartz and Zippel).

    Parameters
    ----------
    polynomials : sequence of Polynomial
        In the same number of coordinates.
    seed : int, optional

    Returns
    -------
    int

    Raises
    ------
    ValueError
        The polynomials have different numbers of coordinates.

    Examples
    --------
    >>> x, y = Polynomial.variable(0, 2), Polynomial.variable(1, 2)
    >>> independent_count([x, x * y, y]), independent_count([x + y, (x + y) ** 2])
    (2, 1)
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
