"""Example 3.1: on so(3) J(x) y = -J(y) x, so that freezing one factor preserves the energy, the other |x|^2."""

import numpy as np
import pytest

import coadjoint as co

from .measures import U, drift_bounds
from .systems_under_test import cases

M = np.diag([1.0, 0.5, 1 / 3])


def test_printed_structure_matrix():
    x = np.array([1.0, 2.0, 3.0])
    assert np.array_equal(co.algebras.so(3).structure_matrix(x), [[0, 3, -2], [-3, 0, 1], [2, -1, 0]])


@pytest.mark.parametrize(
    ("algebra", "holds"),
    [
        (co.algebras.so(3), True),
        (co.algebras.so(4), True),
        (co.algebras.e(3), False),
        (co.algebras.A3_7(2.0), False),
        (co.algebras.sl(2), False),
    ],
)
def test_antisymmetry_in_both_factors(algebra, holds):
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-1, 1, (2, algebra.dim))
    defect = np.max(np.abs(algebra.structure_matrix(x) @ y + algebra.structure_matrix(y) @ x))
    assert bool(defect <= 8 * algebra.dim * U) is holds
    # J(x) y = D_y x holds everywhere.
    assert np.max(np.abs(algebra.structure_matrix(x) @ y - algebra.coadjoint(y) @ x)) <= 8 * algebra.dim * U


@pytest.mark.parametrize(
    ("method", "keeps_energy", "keeps_casimirs"),
    [
        (co.GaussLegendre(1), True, True),
        (co.GaussLegendre(2), True, True),
        (co.ModifiedGaussLegendre(1), True, False),
        (co.ModifiedGaussLegendre(2), True, False),
        (co.ModifiedGaussLegendre(1, freeze="gradient"), False, True),
        (co.ModifiedGaussLegendre(2, freeze="gradient"), False, True),
    ],
)
@pytest.mark.parametrize("case", ["so(3), diagonal", "so(4), diagonal", "e(3), full, axes permuted"])
def test_frozen_factor_decides_the_preserved_invariant(case, method, keeps_energy, keeps_casimirs):
    system, x0, _ = cases()[case]
    run = co.integrate(system, x0, (0.0, 40.0), 0.2, method)
    bounds, drift = drift_bounds(run), run.drift()
    for name, keeps in [("energy", keeps_energy), *((c, keeps_casimirs) for c in system.casimirs)]:
        if keeps:
            assert drift[name] <= bounds[name]
        else:
            assert drift[name] > 1000 * bounds[name]


def cayley(A):
    one = np.eye(len(A))
    return np.linalg.solve(one - A / 2, one + A / 2)


def test_two_matrices_of_the_midpoint_rule_differ():
    """B x with an M-orthogonal B, and B' x with an orthogonal B'."""
    body, x, h = co.systems.paper_rigid_body(), np.array([1.0, 2.0, 0.5]), 0.3
    new = co.stepper(body, co.GaussLegendre(1), h)(x)
    middle = (x + new) / 2
    B_energy = cayley(h * body.structure_matrix(middle) @ M)
    B_momentum = cayley(h * body.algebra.coadjoint(M @ middle))
    for B, metric in ((B_energy, M), (B_momentum, np.eye(3))):
        assert np.max(np.abs(B @ x - new)) <= 64 * U * np.max(np.abs(x))
        assert np.max(np.abs(B.T @ metric @ B - metric)) <= 64 * U
    assert np.max(np.abs(B_energy.T @ B_energy - np.eye(3))) > 1e-2
    assert np.max(np.abs(B_momentum.T @ M @ B_momentum - M)) > 1e-2
