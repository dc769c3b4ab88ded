"""Equation (17), x' = J(x) M x with any skew J: schemes that take it, and a bracket that is not linear."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U
from verification.measures import drift_bounds
from verification.schemes_under_test import schemes
from verification.systems_under_test import (
    full_matrix,
    without_jacobi,
)


@pytest.mark.parametrize("scheme", ["Splitting 2", "Composition of Splitting"])
def test_splitting_is_refused(scheme):
    with refused(ValueError, "Lie algebra"):
        co.integrate(without_jacobi().system, without_jacobi().x0, (0, 1), 0.1, schemes()[scheme])


@pytest.mark.parametrize("sign", [1, -1])
def test_function_and_structure_constants_agree(sign):
    """e(3) given as a function J(x), and as structure constants."""
    e3, M, x0 = co.algebras.e(3), full_matrix(9, 6), np.array([1.0, 0.5, -0.4, 0.7, -1.0, 0.3])

    def J(x):
        a = np.zeros((6, 6))
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            a[i, j], a[j, i] = x[k], -x[k]
            a[i, 3 + j], a[3 + j, i] = x[3 + k], -x[3 + k]
            a[j, 3 + i], a[3 + i, j] = -x[3 + k], x[3 + k]
        return a

    function = co.PoissonSystem(J, co.Quadratic(M), sign=sign)
    constants = co.LiePoissonSystem(e3, co.Quadratic(M), sign=sign)
    for method in (
        co.GaussLegendre(3),
        co.ModifiedGaussLegendre(2),
        co.IteratedGaussLegendre(2),
        co.ExplicitRungeKutta("rk4"),
    ):
        one, other = (co.integrate(s, x0, (0.0, 10.0), 0.1, method, save_every=100) for s in (function, constants))
        # Two roundings of the same run: the bound of one, twice, amplified by at most 16 in this time.
        bound = 32 * 4 * 6 * U * one.stats.evaluations * np.max(np.abs(one.x))
        assert np.max(np.abs(one.x - other.x)) <= bound


def quadratic_bracket(x):
    """Lotka-Volterra: J_ij = a_ij x_i x_j, a Poisson bracket that is not linear in x."""
    a = np.array([[0.0, 1.0, -1.0], [-1.0, 0.0, 1.0], [1.0, -1.0, 0.0]])
    J = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            J[i, j] = a[i, j] * x[i] * x[j]
    return J


def test_gauss_on_a_nonlinear_bracket():
    """A linear H is preserved, the Casimir x1 x2 x3 is not."""
    casimir = co.Polynomial({(1, 1, 1): 1})
    system = co.PoissonSystem(
        quadratic_bracket, co.Polynomial({(1, 0, 0): 1, (0, 1, 0): 1, (0, 0, 1): 1}), casimirs={"x1 x2 x3": casimir}
    )
    run = co.integrate(system, (1.0, 0.5, 0.7), (0.0, 50.0), 0.25, co.GaussLegendre(2), save_every=10)
    bounds = drift_bounds(run)
    assert run.drift()["energy"] <= bounds["energy"]
    assert run.drift()["x1 x2 x3"] > 1000 * bounds["x1 x2 x3"]
    assert run.drift()["x1 x2 x3"] < 1e-3
