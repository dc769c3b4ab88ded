"""Section 3: Lemma 3.1 (order min(m, 2 s), energy) and Example 3.1 (either factor frozen) of the paper."""

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
