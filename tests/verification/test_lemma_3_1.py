"""Lemma 3.1: m - 1 iterations and one linear system give order min(m, 2 s) and preserve the energy."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.numerics.gauss_coefficients import gauss_legendre

from .measures import U, drift_bounds, measured_order
from .systems_under_test import all_cases, cases, full_matrix

pytestmark = pytest.mark.thinned(3)

WITNESSES = ("so(4), diagonal", "e(3), full, axes permuted", "A3,7, full")
CHOICES = [(s, m) for s in (1, 2, 3) for m in range(1, 2 * s + 2)]
FREEZES = ("structure", "gradient")


@pytest.mark.thinned(9)
@pytest.mark.parametrize("freeze", FREEZES)
@pytest.mark.parametrize(("s", "m"), CHOICES)
@pytest.mark.parametrize("case", WITNESSES)
def test_order_is_the_smaller_of_m_and_p(case, s, m, freeze):
    method = co.ModifiedGaussLegendre(s, iterations=m, freeze=freeze)
    assert method.order == min(m, 2 * s)
    found = measured_order(method, case)
    assert found.agrees_with(min(m, 2 * s)), found


@pytest.mark.parametrize(("s", "m"), CHOICES)
@pytest.mark.parametrize("case", [*WITNESSES, "skew J, no Jacobi identity"])
def test_energy_is_exact_for_every_m(case, s, m):
    system, x0, _ = all_cases()[case]
    run = co.integrate(system, x0, (0.0, 100.0), 0.1, co.ModifiedGaussLegendre(s, iterations=m), save_every=50)
    assert run.drift()["energy"] <= drift_bounds(run)["energy"]


@pytest.mark.parametrize(("s", "m"), CHOICES)
@pytest.mark.parametrize("case", WITNESSES[:2])
def test_frozen_gradient_preserves_quadratic_casimirs(case, s, m):
    system, x0, _ = cases()[case]
    method = co.ModifiedGaussLegendre(s, iterations=m, freeze="gradient")
    run = co.integrate(system, x0, (0.0, 100.0), 0.1, method, save_every=50)
    bounds = drift_bounds(run)
    assert all(run.drift()[name] <= bounds[name] for name in system.casimirs)


@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("case", [*WITNESSES, "skew J, no Jacobi identity"])
def test_step_is_m_orthogonal(case, s):
    """The step is B x with B^T M B = M, with B from the tableau, equations (6)-(8)."""
    system, x, _ = all_cases()[case]
    n, m, h = len(x), 2 * s, 0.1
    M = np.array([system.hamiltonian.gradient(unit) - system.hamiltonian.gradient(0 * unit) for unit in np.eye(n)])
    _, b, mu = gauss_legendre(s)
    a = mu * b
    X = [x] * s
    for _ in range(m - 1):
        f = [system.vector_field(Xj) for Xj in X]
        X = [x + h * sum(a[i, j] * f[j] for j in range(s)) for i in range(s)]
    W = [h * system.sign * system.structure_matrix(Z) @ M for Z in X]
    coupled = np.eye(s * n) - np.block([[a[i, j] * W[j] for j in range(s)] for i in range(s)])
    stages = np.linalg.solve(coupled, np.vstack([np.eye(n)] * s))
    B = np.eye(n) + sum(b[j] * W[j] @ stages[j * n : (j + 1) * n] for j in range(s))
    # Sums of s n products of entries of size |B|^2 |M|, and a well-conditioned solution of s n equations.
    bound = 64 * s * n * U * np.linalg.norm(B) ** 2 * np.linalg.norm(M)
    assert np.max(np.abs(B.T @ M @ B - M)) <= bound
    step = co.stepper(system, co.ModifiedGaussLegendre(s), h)
    assert np.max(np.abs(step(x) - B @ x)) <= bound * np.linalg.norm(x)


def modified_midpoint(system, M, x, h, freeze):
    """Equations (10)-(11) by hand, in both forms."""
    X = x + h / 2 * system.vector_field(x)
    A = system.structure_matrix(X) @ M if freeze == "structure" else system.algebra.coadjoint(M @ X)
    A, one = system.sign * A, np.eye(len(x))
    return np.linalg.solve(one - h / 2 * A, (one + h / 2 * A) @ x)


@pytest.mark.parametrize("freeze", FREEZES)
def test_equations_10_and_11_are_one_stage_twice_iterated(freeze):
    for algebra, n, sign in ((co.algebras.e(3), 6, -1), (co.algebras.A3_7(2.0), 3, 1), (co.algebras.so(4), 6, 1)):
        M = full_matrix(7, n)
        system = co.LiePoissonSystem(algebra, co.Quadratic(M), sign=sign)
        step = co.stepper(system, co.ModifiedGaussLegendre(1, iterations=2, freeze=freeze), 0.1)
        x = np.linspace(-1.0, 0.7, n)
        for _ in range(5):
            by_hand = modified_midpoint(system, M, x, 0.1, freeze)
            # One linear system of n equations near the unit matrix.
            assert np.max(np.abs(step(x) - by_hand)) <= 64 * n * U * np.max(np.abs(x))
            x = by_hand


@pytest.mark.parametrize("freeze", FREEZES)
@pytest.mark.parametrize(("s", "m"), CHOICES)
def test_work_of_a_step_is_fixed(s, m, freeze):
    counts = set()
    for case in WITNESSES:
        for h in (0.01, 0.1, 0.4):
            system, x0, _ = cases()[case]
            method = co.ModifiedGaussLegendre(s, iterations=m, freeze=freeze)
            run = co.integrate(system, x0, (0.0, 4 * h), h, method)
            counts.add(run.stats.evaluations / run.stats.steps)
    assert len(counts) == 1
