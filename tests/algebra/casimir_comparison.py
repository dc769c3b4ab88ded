"""Comparison of polynomial Casimirs, in the same or in another basis: generated polynomials, independence."""

from fractions import Fraction

import numpy as np
from flint import fmpq, fmpq_mat, nmod_mat

from coadjoint.algebra.exact.ranks import random_prime
from coadjoint.algebra.polynomials.polynomial import Polynomial


def generated(generators, degree):
    """All products of a degree, with repetition, of homogeneous polynomials."""
    if not generators:
        return []
    first, rest = generators[0], list(generators[1:])
    result, power = [], Polynomial({(0,) * first.dim: 1})
    for used in range(0, degree + 1, first.degree):
        result += [power * other for other in generated(rest, degree - used)] if used < degree else [power]
        power = power * first
    return result


def rank(polynomials):
    places = {e: at for at, e in enumerate(sorted({e for p in polynomials for e in p.monomials}))}
    if not places:
        return 0
    matrix = fmpq_mat(len(polynomials), len(places))
    for row, polynomial in enumerate(polynomials):
        for exponents, value in polynomial.monomials.items():
            matrix[row, places[exponents]] = fmpq(Fraction(value).numerator, Fraction(value).denominator)
    return matrix.rank()


def assert_same_span(found, known, max_degree=4):
    """In each degree both lists generate the same space; and no member of `found` is a combination of the others."""
    for degree in range(1, max_degree + 1):
        here, there = generated(list(found), degree), generated(list(known), degree)
        assert rank(here) == rank(there) == rank(here + there), f"degree {degree}"
        lower = generated([p for p in found if p.degree < degree], degree)
        assert rank(here) == rank(lower) + sum(p.degree == degree for p in found)


def assert_annihilated(g, polynomial):
    """J(x) grad C(x) = 0 exactly, as polynomials, every derivation written out."""
    exact = [Fraction(c).limit_denominator(10**6) for c in g.triples.c.tolist()]
    total = [{} for _ in range(g.dim)]
    slopes = [polynomial.derivative(i).monomials for i in range(g.dim)]
    for i, j, k, c in zip(*(column.tolist() for column in g.triples[:3]), exact, strict=True):
        for row, slope, sign in ((i, slopes[j], c), (j, slopes[i], -c)):
            for e, value in slope.items():
                shifted = e[:k] + (e[k] + 1,) + e[k + 1 :]
                total[row][shifted] = total[row].get(shifted, 0) + sign * value
    assert not any(value for derivative in total for value in derivative.values())


def substituted(polynomial, q):
    """C(q x')."""
    n = polynomial.dim
    x, zero = [Polynomial.variable(j, n) for j in range(n)], Polynomial({}, dim=n)
    lines = [sum((x[j] * q[i, j] for j in range(n) if q[i, j]), start=zero) for i in range(n)]
    total = Polynomial({}, dim=n)
    for exponents, value in polynomial.monomials.items():
        term = Polynomial({(0,) * n: value})
        for line, power in zip(lines, exponents, strict=True):
            term = term * line**power
        total = total + term
    return total


def rational_change(n, rng):
    """A random matrix of determinant 1/4, with halves in it."""
    entries = np.array([Fraction(-1), Fraction(0), Fraction(1, 2), Fraction(1)], dtype=object)
    chosen = rng.integers(0, 4, size=(n, n))
    full = 3.0 / n  # few enough entries that the constants keep denominators below 10^6
    lower = np.where(np.tri(n, k=-1, dtype=bool) & (rng.random((n, n)) < full), entries[chosen], Fraction(0))
    upper = np.where(np.tri(n, k=-1, dtype=bool).T & (rng.random((n, n)) < full), entries[chosen], Fraction(0))
    one = np.array([[Fraction(int(i == j)) for j in range(n)] for i in range(n)], dtype=object)
    one[0, 0] = Fraction(1, 2)
    return (lower + one) @ (upper + one)


def independent_count(polynomials, seed=0):
    """Return how many of the polynomials are functionally independent: the generic rank of their gradients, exactly.

    The larger rank at two seeded random points modulo random 62-bit primes: never too large; a nonzero minor of degree
    D vanishes at both with probability <= (D/2^61)^2 < 2^-60 for D < 2^31 (Schwartz and Zippel).
    """
    dims = sorted({polynomial.dim for polynomial in polynomials})
    if len(dims) > 1:
        raise ValueError(f"polynomials must have the same number of coordinates, not {dims[0]} and {dims[-1]}")
    if not polynomials:
        return 0
    rng = np.random.default_rng(seed)
    gradients = [[polynomial.derivative(i) for i in range(dims[0])] for polynomial in polynomials]
    ranks = []
    for _ in range(2):
        prime = random_prime(rng)
        x = rng.integers(0, prime, size=dims[0]).tolist()
        flat = [value_modulo(part, x, prime) for row in gradients for part in row]
        ranks.append(nmod_mat(len(polynomials), dims[0], flat, prime).rank())
    return max(ranks)


def value_modulo(polynomial, x, prime):
    """Return the value of a polynomial modulo a prime."""
    total = 0
    for exponents, coefficient in polynomial.monomials.items():
        exact = Fraction(coefficient)
        term = exact.numerator * pow(exact.denominator, -1, prime)
        for value, power in zip(x, exponents, strict=True):
            term = term * pow(value, power, prime) % prime if power else term
        total += term
    return total % prime
