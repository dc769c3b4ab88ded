"""Limits of schemes: representations of Gauss methods, linear brackets of Kahan's, spins of the midpoint."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

GAUSS = (co.GaussLegendre(2), co.ModifiedGaussLegendre(1, freeze="gradient"))


def attitude_run(method, algebra, representation):
    H = co.Quadratic(np.linspace(1.0, 2.0, algebra.dim))
    system = co.LiePoissonSystem(algebra, H, representation=representation)
    return co.integrate(system, np.full(algebra.dim, 0.1), (0, 0.1), 0.05, method, attitude=True)


@pytest.mark.parametrize("method", GAUSS, ids=repr)
def test_gauss_accepts_turned_coadjoint_matrices_with_more_rows(method):
    """The sum of the coadjoint and the trivial representation, in another basis."""
    so4 = co.algebras.so(4)
    D = np.zeros((6, 7, 7))
    D[:, :6, :6] = [so4.coadjoint(e) for e in np.eye(6)]
    turn = np.eye(7) + np.triu(np.full((7, 7), 0.5), 1)
    sol = attitude_run(method, so4, np.linalg.inv(turn) @ D @ turn)
    kept = np.linalg.solve(turn, np.eye(7)) @ np.append(sol.x0, 0.0)
    moved = sol.attitude[-1] @ np.linalg.solve(turn, np.append(sol.x[-1], 0.0))
    assert np.abs(moved - kept).max() < 1e-14


def bent_body(off):
    """Return the J(x) of so(3) with a part of second degree, of which the largest share of J is `off`.

    The largest at the points at which Kahan's method tries whether J is linear.
    """
    draw = np.random.default_rng(1993)
    shares = []
    for size in (1.0, 1.0, 32.0):
        a, b = size * draw.standard_normal((2, 3))
        shares.append(2.0 * abs(a[2] * b[2]) / max(np.abs(point).max() for point in (a, b, a + b)))
    bent = off / max(shares)

    def J(x):
        z = x[2] + bent * x[2] ** 2
        return np.array([[0 * z, -z, x[1]], [z, 0 * z, -x[0]], [-x[1], x[0], 0 * z]])

    return co.PoissonSystem(J, co.Quadratic((1.0, 2.0, 3.0)))


def test_kahan_takes_linear_structure_matrices_to_rounding():
    """J(a + b) is J(a) + J(b) within 64 n times the unit roundoff."""
    rounding = 64 * 3 * 2.0**-53
    co.Kahan().properties(bent_body(0.5 * rounding))
    with refused(ValueError, "Kahan"):
        co.Kahan().properties(bent_body(2.0 * rounding))


def test_spins_have_equal_brackets_to_rounding():
    """Within eight times the unit roundoff."""

    def run(off):
        algebra = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1.0}, (1, 2): {0: 1.0}, (2, 0): {1: 1.0 + off}})
        system = co.LiePoissonSystem(algebra, co.Quadratic((1.0, 2.0, 3.0)))
        return co.integrate(system, (1, 2, 3), (0, 0.1), 0.1, co.SphericalMidpoint())

    run(4 * 2.0**-53)
    with refused(ValueError, "SphericalMidpoint", "spins"):
        run(16 * 2.0**-53)
