"""Polynomial Casimirs compared with linear algebra modulo a prime: how many there are, and what they generate."""

from fractions import Fraction
from itertools import combinations_with_replacement

import numpy as np
from flint import fmpq, fmpq_mat, nmod_mat
from lie_algebras import constants_of

import coadjoint as co

PRIME = 2**31 - 1
"""Products of two residues fit in int64. A minor that is not zero vanishes at random points with probability 1e-6."""


def generated(generators, degree):
    """All products of a degree, with repetition, of homogeneous polynomials."""
    if not generators:
        return []
    first, rest = generators[0], list(generators[1:])
    result, power = [], co.Polynomial({(0,) * first.dim: 1})
    for used in range(0, degree + 1, first.degree):
        result += [power * other for other in generated(rest, degree - used)] if used < degree else [power]
        power = power * first
    return result


def rank(polynomials):
    """Dimension of the span."""
    places = {e: at for at, e in enumerate(sorted({e for p in polynomials for e in p.monomials}))}
    if not places:
        return 0
    matrix = fmpq_mat(len(polynomials), len(places))
    for row, polynomial in enumerate(polynomials):
        for exponents, value in polynomial.monomials.items():
            matrix[row, places[exponents]] = fmpq(Fraction(value).numerator, Fraction(value).denominator)
    return matrix.rank()


def assert_annihilated(g, polynomial):
    """J(x) grad C(x) = 0 exactly, as polynomials, every derivation written out."""
    total = [{} for _ in range(g.dim)]
    slopes = [polynomial.derivative(i).monomials for i in range(g.dim)]
    c = constants_of(g)
    for i, j, k in zip(*np.nonzero(c), strict=True):
        value = Fraction(c[i, j, k]).limit_denominator(10**6)
        for e, slope in slopes[j].items():
            shifted = e[:k] + (e[k] + 1,) + e[k + 1 :]
            total[i][shifted] = total[i].get(shifted, 0) + value * slope
    assert not any(value for derivative in total for value in derivative.values())


def residue(value):
    exact = Fraction(value).limit_denominator(10**6) if isinstance(value, float) else Fraction(value)
    return exact.numerator * pow(exact.denominator, -1, PRIME) % PRIME


def casimir_count(g, degree):
    """Dimension of the Casimirs of a degree: polynomials C with u . J(x) grad C(x) = 0 at random u and x."""
    n, rng = g.dim, np.random.default_rng(degree)
    c = np.vectorize(residue, otypes=[np.int64])(constants_of(g))
    chosen = list(combinations_with_replacement(range(n), degree))
    exponents = np.array([np.bincount(one, minlength=n) for one in chosen])
    points = len(chosen) + 5
    x, u = rng.integers(0, PRIME, (2, points, n))
    v = np.zeros((points, n), dtype=np.int64)
    for i, j, k in zip(*np.nonzero(c), strict=True):
        v[:, j] = (v[:, j] + u[:, i] * x[:, k] % PRIME * c[i, j, k]) % PRIME
    powers = [np.ones_like(x)]
    for _ in range(degree):
        powers.append(powers[-1] * x % PRIME)
    powers = np.stack(powers)  # (degree + 1, points, n)
    rows = np.zeros((points, len(chosen)), dtype=np.int64)
    for j in range(n):
        term = v[:, j, None] * exponents[:, j] % PRIME
        for m in range(n):
            term = term * powers[np.maximum(exponents[:, m] - (m == j), 0), :, m].T % PRIME
        rows = (rows + term) % PRIME
    return len(chosen) - nmod_mat(points, len(chosen), rows.ravel().tolist(), PRIME).rank()


def independent_count(polynomials):
    """How many of the polynomials are functionally independent: the rank of their gradients at a random point."""
    if not polynomials:
        return 0
    n = polynomials[0].dim
    x = np.random.default_rng(0).integers(0, PRIME, n).tolist()
    flat = [_at(p.derivative(i), x) for p in polynomials for i in range(n)]
    return nmod_mat(len(polynomials), n, flat, PRIME).rank()


def _at(polynomial, x):
    total = 0
    for exponents, coefficient in polynomial.monomials.items():
        term = residue(coefficient)
        for value, power in zip(x, exponents, strict=True):
            term = term * pow(value, power, PRIME) % PRIME if power else term
        total += term
    return total % PRIME
