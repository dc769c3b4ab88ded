"""Splittings of polynomials whose monomials couple coordinates that do not commute, on any algebra."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from refusals import refused

ALGEBRAS = {
    "so(3)": co.algebras.so(3),
    "so(4)": co.algebras.so(4),
    "sl(2)": co.algebras.sl(2),
    "se(3)": co.algebras.se(3),
    "so(3) in another basis": co.algebras.change_of_basis(
        co.algebras.so(3), np.array([[1.0, 0.3, 0.0], [0.2, 1.1, -0.4], [0.0, 0.5, 0.9]])
    ),
}


def polynomial(n, degree, seed):
    """Return a polynomial with monomials of coordinates drawn at random, and all squares."""
    rng = np.random.default_rng(seed)
    monomials = {tuple(2 * int(i == k) for i in range(n)): 0.5 + rng.random() for k in range(n)}
    for _ in range(4):
        exponents = np.bincount(rng.integers(0, n, degree), minlength=n)
        monomials[tuple(exponents.tolist())] = float(rng.standard_normal())
    return co.Polynomial(monomials)


@pytest.mark.parametrize("degree", [3, 4, 6])
@pytest.mark.parametrize("name", ALGEBRAS)
def test_order_casimirs_and_bracket(name, degree):
    """Errors fall with the order; Casimirs and the bracket are those of exact flows."""
    algebra = ALGEBRAS[name]
    n = algebra.dim
    system = co.LiePoissonSystem(algebra=algebra, hamiltonian=polynomial(n, degree, degree))
    x0 = 0.6 * np.cos(1.0 + np.arange(n))
    exact = solve_ivp(lambda t, x: system.vector_field(x), (0, 0.5), x0, method="DOP853", rtol=1e-13, atol=1e-14)
    method = co.Splitting(order=4)
    errors = []
    for h in (0.05, 0.025):
        sol = co.integrate(system, x0, (0, 0.5), h, method)
        errors.append(np.abs(sol.x[-1] - exact.y[:, -1]).max())
        assert all(drift < 1e-12 for which, drift in sol.drift().items() if which != "energy")
    assert 3.5 < np.log2(errors[0] / errors[1]) < 4.6, errors
    assert co.analysis.poisson_defect(co.stepper(system, method, 0.05), x0).poisson


def test_rounded_coefficients_that_cancel_leave_no_part():
    """Powers whose coefficients cancel but for rounding are left out."""

    def parts(H):
        return len(co.Splitting(order=2).flow_table(co.LiePoissonSystem(co.algebras.so(3), H)).parts)

    assert parts(co.Polynomial("x1^4 + x2^2*x3^2", dim=3)) == 5  # x1, and x2, x3, x2 + x3, x2 - x3
    # x1^3 x2 and x1 x2^3 have the powers of x1 + x2 and x1 - x2 in common, beside two of their own each.
    for other, expected in ((-0.3, 4), (-(0.1 + 0.2), 4), (-0.3 * (1 + 1e-14), 6)):
        assert parts(co.Polynomial({(3, 1, 0): 0.3, (1, 3, 0): other})) == expected


def test_derivatives_by_coefficients_that_several_powers_share():
    """The monomials of (x1 - x2)^4 are in six powers, and the derivative by one of them is that of the motion."""
    monomials = dict(co.Polynomial("(x1 - x2)^4", dim=3).monomials)
    x0, direction, method = np.array([0.3, -0.5, 0.8]), np.array([1.0, -0.4, 0.7]), co.Splitting(order=6)

    def end(moved):
        H = co.Polynomial({**monomials, (3, 1, 0): float(monomials[3, 1, 0]) + moved})
        system = co.LiePoissonSystem(algebra=co.algebras.so(3), hamiltonian=H)
        return co.prepare(system, method, step=0.005)

    _, pullback = end(0.0).vjp(x0, (0, 0.5), save_every=100)
    gradient = pullback(x=np.stack([np.zeros(3), direction]))
    ahead, behind = (end(e).end(x0, (0, 0.5)) @ direction for e in (1e-4, -1e-4))
    found = gradient["coefficients"][list(monomials).index((3, 1, 0))]
    assert abs(found - (ahead - behind) / 2e-4) < 1e-6 * abs(found)


def test_degrees_that_are_refused():
    seventh = co.LiePoissonSystem(algebra=co.algebras.so(3), hamiltonian=co.Polynomial("x1^6*x2", dim=3))
    with refused(ValueError, "x1^6*x2", "degree above 6", "commute", "GaussLegendre"):
        co.integrate(seventh, np.ones(3), (0, 1), 0.1, co.Splitting(order=2))
    commuting = co.LiePoissonSystem(algebra=co.algebras.so(3), hamiltonian=co.Polynomial("x1^8 + x2^7", dim=3))
    assert co.integrate(commuting, 0.5 * np.ones(3), (0, 1), 0.1, co.Splitting(order=2)).drift()["|x|^2"] < 1e-13
