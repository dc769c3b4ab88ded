"""Two lists of polynomial Casimirs: do they generate the same polynomials? In the same or in another basis."""

from fractions import Fraction

import numpy as np
from flint import fmpq, fmpq_mat

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
