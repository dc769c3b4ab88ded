"""Taylor polynomials of Python functions at a point, against those of polynomials, which are known."""

from fractions import Fraction
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.parts import taylor_shares
from coadjoint.program.parts.part import FunctionShare, PolynomialShare
from coadjoint.program.parts.taylor_shares import parts_at, taylor_polynomial
from coadjoint.systems.hamiltonians.terms import FunctionTerm


def drawn_polynomial(rng, m, degree):
    """Return {exponents: coefficient} with every monomial up to a degree."""
    exponents = [e for e in product(range(degree + 1), repeat=m) if sum(e) <= degree]
    return {e: float(rng.integers(1, 9)) * float(rng.choice([-0.25, 0.25])) for e in exponents}


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


@pytest.mark.parametrize("coordinates", [(0,), (4,), (3, 1), (0, 2, 4)])
def test_parts_have_polynomials_in_all_coordinates_with_the_derivatives_of_their_functions(coordinates):
    """Functions are replaced, in whatever order they have their coordinates; the other columns are kept."""
    rng = np.random.default_rng(len(coordinates))
    m, x = len(coordinates), rng.uniform(-2.0, 2.0, 5)
    monomials = drawn_polynomial(rng, m, 2)
    plain = PolynomialShare((1,), co.Polynomial({(0, 1, 0, 0, 0): 1}))
    columns = {name: object() for name in ("forms", "offset", "weights", "row", "share", "timed")}
    term = term_of(monomials, coordinates)
    made = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(taylor_shares, "Parts", lambda *given: made.append(given) or given)
        parts_at(SimpleNamespace(nonlinear_shares={7: FunctionShare(term), 2: plain}, **columns), x, 2)
    ((forms, offset, weights, row, nonlinear_shares, share, timed),) = made
    kept = {"forms": forms, "offset": offset, "weights": weights, "row": row, "share": share, "timed": timed}
    assert kept == columns and set(nonlinear_shares) == {7, 2} and nonlinear_shares[2] is plain
    assert nonlinear_shares[7].coordinates == tuple(coordinates)
    polynomial = nonlinear_shares[7].polynomial
    where = list(coordinates)
    for _ in range(3):
        other = rng.uniform(-2.0, 2.0, 5)
        change = float(polynomial(other)) - float(polynomial(x))
        assert change == pytest.approx(term.value(other[where]) - term.value(x[where]), abs=1e-12)
        gradient = np.zeros(5)
        gradient[where] = term.gradient(other[where])
        np.testing.assert_allclose(polynomial.gradient(other), gradient, rtol=0, atol=1e-12)


def altered(term, **functions):
    return FunctionTerm(
        term.coordinates, term.value, *(functions.get(n, getattr(term, n)) for n in ("gradient", "hessian"))
    )


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
        with pytest.raises(ValueError, match=r"derivatives of order 3 .* it is not analytic on circles"):
            taylor_polynomial(wrong, y, 3)
    for i in range(2):
        # Different on the real axis and off it, as of abs.
        wrong = altered(term, gradient=lambda y, i=i: term.gradient(y) + (np.arange(2) == i) * np.isrealobj(y))
        with pytest.raises(ValueError, match="it is not analytic on circles"):
            taylor_polynomial(wrong, y, 3)


def test_functions_of_many_coordinates_are_refused_before_they_are_evaluated():
    calls = []
    term = FunctionTerm(np.arange(6), np.sum, lambda y: calls.append(y) or np.ones(6), None)
    with pytest.raises(ValueError, match=r"a function of 6 coordinates would be evaluated at 262144 points .* order 3"):
        taylor_polynomial(term, np.ones(6), 3)
    assert len(calls) == 1
