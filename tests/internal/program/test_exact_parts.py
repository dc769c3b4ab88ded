"""Completed squares are exact in rationals, and to round-off where those stop; Taylor polynomials of functions."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.parts.part_polynomials import taylor_polynomial
from coadjoint.program.parts.squares import (
    MAX_RATIONAL_SIZE,
    _Reduction,
    complete_squares,
    sparse_squares,
)
from coadjoint.program.sparse_rows import SparseRows
from coadjoint.systems.hamiltonians.terms import FunctionTerm
from refusals import refused

U = 2.0**-53


def symmetric(seed, n, diagonal=True):
    A = np.random.default_rng(seed).standard_normal((n, n))
    M = A + A.T
    return M if diagonal else M - np.diag(np.diag(M))


def singular(seed, n, rank):
    """Integer entries, so that the rank is exact."""
    L = np.random.default_rng(seed).integers(-3, 4, (n, rank)).astype(float)
    return L @ np.diag([1.0, -2.0, 3.0, -1.0][:rank]) @ L.T


MATRICES = {
    "definite": symmetric(1, 4) @ symmetric(1, 4),
    "indefinite": symmetric(2, 5),
    "one coordinate": np.array([[-0.3]]),
    "zero diagonal": symmetric(3, 5, diagonal=False),
    "zero diagonal, odd rank": np.array([[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]]),
    "tiny diagonal": symmetric(4, 4, diagonal=False) + 1e-17 * np.diag([1.0, -2.0, 3.0, 1.0]),
    "rank 2 of 5": singular(5, 5, 2),
    "rank 3 of 6": singular(6, 6, 3),
    "zero": np.zeros((3, 3)),
    "largest rational": symmetric(7, MAX_RATIONAL_SIZE),
    "graded": np.diag([1e-8, 1.0, 1e8]) @ symmetric(8, 3) @ np.diag([1e-8, 1.0, 1e8]),
}


def fractions(array):
    return np.vectorize(Fraction, otypes=[object])(array)


def total(squares):
    """Return sum d l l^T, its size (the sum of absolute values), and sum beta l."""
    outer = [d * np.multiply.outer(form, form) for form, d in zip(squares.forms, squares.weights, strict=True)]
    linear = [beta * form for form, beta in zip(squares.forms, squares.linear, strict=True)]
    return sum(outer, 0), sum((abs(o) for o in outer), 0), sum(linear, 0)


@pytest.mark.parametrize("with_linear", [False, True])
@pytest.mark.parametrize("name", MATRICES)
def test_reconstruction_is_exact_in_rationals(name, with_linear):
    M = MATRICES[name]
    n = len(M)
    b = np.random.default_rng(9).standard_normal(n) if with_linear else np.zeros(n)
    squares = complete_squares(M, b)
    assert len(squares.forms) <= n
    matrix, _, linear = total(squares)
    assert np.all(fractions(M) - matrix == 0)
    assert np.all(fractions(b) - linear == 0)


@pytest.mark.parametrize("kind", ["definite", "indefinite", "zero diagonal", "singular"])
def test_reconstruction_in_floats(kind):
    """Above the rational size: each of r updates rounds three times, so 4 r u times all that was added up."""
    n = MAX_RATIONAL_SIZE + 5
    made = {
        "definite": lambda: symmetric(11, n) @ symmetric(11, n),
        "indefinite": lambda: symmetric(12, n),
        "zero diagonal": lambda: symmetric(13, n, diagonal=False),
        "singular": lambda: singular(14, n, 4),
    }
    M = made[kind]()
    M = (M + M.T) / 2
    b = np.random.default_rng(15).standard_normal(n)
    squares = complete_squares(M, b)
    assert squares.forms.dtype == np.float64
    if kind == "singular":
        # What is left after four squares is rounding, below the floor 4 n u max|M|, and must not become a square.
        assert np.count_nonzero(squares.weights) == 4
    matrix, size, linear = total(squares)
    floor = 4 * n * U * abs(M).max()
    assert np.all(abs(matrix - M) <= 4 * n * U * (size + abs(M)) + floor)
    linear_size = sum(abs(beta * form) for form, beta in zip(squares.forms, squares.linear, strict=True))
    assert np.all(abs(linear - b) <= 4 * n * U * (linear_size + abs(b)))


def triangular_product(last):
    """A matrix of 20 rows with the squares 1, ..., 1 and a last one, all in whole numbers but that."""
    L = np.tril(np.random.default_rng(8).integers(-1, 2, (20, 20)), -1) + np.eye(20)
    return L @ np.diag([*[1.0] * 19, last]) @ L.T


def squares_by_rows(matrix, linear):
    rows = [np.flatnonzero(row).tolist() for row in matrix]
    values = [[float(row[k]) for k in own] for row, own in zip(matrix, rows, strict=True)]
    found = _Reduction(SparseRows.of_lists(rows, values), linear).squares()
    forms = np.zeros((len(found.weights), len(linear)))
    forms[found.forms.owner, found.forms.coordinate] = found.forms.value
    return forms, found.weights


@pytest.mark.sensitive
@pytest.mark.parametrize(
    "complete", [lambda *given: complete_squares(*given)[:2], squares_by_rows], ids=["dense", "sparse"]
)
def test_squares_of_many_coordinates_leave_out_what_is_rounding_and_nothing_else(complete):
    """Above 16 coordinates squares are completed in floats: n u times the largest entry is rounding."""
    singular = triangular_product(0.0)
    floor = 4 * 20 * U * np.abs(singular).max()
    forms, weights = complete(singular, np.zeros(20))
    assert len(weights) == 19
    for small in (16 * floor, 256 * floor):
        # The last square stands at the last coordinate alone.
        matrix = triangular_product(0.0)
        matrix[-1, -1] += small
        forms, weights = complete(matrix, np.zeros(20))
        assert np.abs(np.einsum("r,ri,rj->ij", weights, forms, forms) - matrix).max() <= floor


def drawn_polynomial(rng, m, degree):
    """Return {exponents: coefficient} with every monomial up to a degree."""
    exponents = [e for e in product(range(degree + 1), repeat=m) if sum(e) <= degree]
    return {e: float(rng.integers(1, 9)) * float(rng.choice([-0.25, 0.25])) for e in exponents}


def altered(term, **functions):
    return FunctionTerm(
        term.coordinates, term.value, *(functions.get(n, getattr(term, n)) for n in ("gradient", "hessian"))
    )


def term_of(monomials, coordinates, hessian=True, scalar=False):
    """Return a polynomial as a term of Python functions, also for complex numbers."""
    m = len(coordinates)

    def derivative(y, *orders):
        total = 0.0 * y[0]
        for exponents, value in monomials.items():
            left, factor = list(exponents), value
            for i in orders:
                factor, left[i] = factor * left[i], left[i] - 1
            if factor:
                total = total + factor * np.prod([y[i] ** e for i, e in enumerate(left)])
        return total

    def read(y):
        return np.atleast_1d(y)

    def gradient(y):
        found = np.array([derivative(read(y), i) for i in range(m)])
        return found[0] if scalar else found

    def curvature(y):
        found = np.array([[derivative(read(y), i, j) for j in range(m)] for i in range(m)])
        return found[0, 0] if scalar else found

    return FunctionTerm(
        np.array(coordinates),
        lambda y: derivative(read(y)),
        gradient,
        curvature if hessian else None,
        scalar=scalar,
    )


def shifted(monomials, y):
    """Return the coefficients about y, exactly rounded."""
    m = len(y)
    total = co.Polynomial({}, dim=m)
    for exponents, value in monomials.items():
        term = co.Polynomial({(0,) * m: Fraction(value)})
        for i, e in enumerate(exponents):
            term = term * (co.Polynomial.variable(i, m) + Fraction(float(y[i]))) ** e
        total = total + term
    return {e: float(c) for e, c in total.monomials.items() if sum(e)}


@pytest.mark.thinned(16)
@pytest.mark.parametrize("hessian", [True, False])
@pytest.mark.parametrize("size", [0.3, 1.0, 20.0])
@pytest.mark.parametrize(("m", "highest"), [(1, 1), (1, 2), (1, 5), (2, 2), (2, 4), (3, 2)])
def test_the_coefficients_of_a_polynomial(m, highest, size, hessian):
    """Up to any degree, below that of the polynomial and above it, near zero and far from it."""
    rng = np.random.default_rng(10 * m + highest)
    monomials, y = drawn_polynomial(rng, m, highest), size * rng.uniform(-1.0, 1.0, m)
    known = shifted(monomials, y)
    for degree in range(1, highest + 2 if m < 3 else highest + 1):
        term = term_of(monomials, range(m), hessian, scalar=m == 1)
        found = taylor_polynomial(term, y, degree)
        wanted = {e for e in product(range(degree + 1), repeat=m) if 0 < sum(e) <= degree}
        assert set(found) == wanted
        # The first two derivatives are those that were given; others have ten digits of the largest on the circles.
        far = max(1.0, np.max(np.abs(y)))
        scale = max(abs(c) * far ** sum(e) for e, c in known.items())
        for e in wanted:
            given = sum(e) == 1 or (degree == 2 and hessian)
            allowed = 64 * 2.0**-53 if given else 1e-9
            assert abs(found[e] - known.get(e, 0.0)) * far ** sum(e) <= allowed * scale, (e, degree)


@pytest.mark.parametrize("y", [(0.5, 0.25), (3.0, -7.0)])
def test_derivatives_that_contradict_each_other_are_refused(y):
    """The values on the circles are compared with the slope and the second derivatives, each of them."""
    y = np.array(y)
    term = term_of(drawn_polynomial(np.random.default_rng(5), 2, 3), range(2))
    taylor_polynomial(term, y, 3)
    for i, j in product(range(2), repeat=2):
        change = np.zeros((2, 2))
        change[i, j] = 1.0
        wrong = altered(term, hessian=lambda y, change=change: term.hessian(y) + change)
        with refused(ValueError, "order 3", "analytic"):
            taylor_polynomial(wrong, y, 3)
    for i in range(2):
        # Different on the real axis and off it, as of abs.
        wrong = altered(term, gradient=lambda y, i=i: term.gradient(y) + (np.arange(2) == i) * np.isrealobj(y))
        with refused(ValueError, "analytic"):
            taylor_polynomial(wrong, y, 3)


def test_functions_of_many_coordinates_are_refused_before_they_are_evaluated():
    calls = []
    term = FunctionTerm(np.arange(6), np.sum, lambda y: calls.append(y) or np.ones(6), None)
    with refused(ValueError, "6 coordinates", "262144", "order 3"):
        taylor_polynomial(term, np.ones(6), 3)
    assert len(calls) == 1


@pytest.mark.parametrize("side", [1, -1])
def test_a_pair_is_squared_along_the_better_diagonal(side):
    """Of e_i + e_j and e_i - e_j the first square is taken along the one where it is at least half of the entry."""
    rng = np.random.default_rng(18)
    for n in (2, MAX_RATIONAL_SIZE + 4):
        for entry in (1.0, -1.0):
            M = np.zeros((n, n))
            M[0, 1] = M[1, 0] = entry
            M[[0, 1], [0, 1]] = side * entry * rng.uniform(0.3, 0.6, 2)
            rows = SparseRows.of_lists(
                [[0, 1], [0, 1], *[[]] * (n - 2)], [M[0, :2].tolist(), M[1, :2].tolist(), *[[]] * (n - 2)]
            )
            for squares in (complete_squares(M, np.zeros(n)), sparse_squares(rows, np.zeros(n))):
                assert len(squares.weights) == 2
                assert abs(squares.weights[0]) >= 0.5
                assert np.sign(float(squares.weights[0])) == side * entry
