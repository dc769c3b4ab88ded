"""Sections 3 to 5 of the paper: its lemmas, examples and remarks, and its printed numbers."""

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from digests.systems_under_test import all_cases, cases
from matrix.references import rounding_of
from rounding import UNIT_ROUNDOFF as U

WITNESSES = ("so(4), diagonal", "e(3), full, axes permuted", "A3,7, full")


@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("case", [*WITNESSES, "skew J, no Jacobi identity"])
def test_step_is_m_orthogonal(case, s):
    """The step is B x with B^T M B = M, with B from the tableau, equations (6)-(8)."""
    system, x, _ = all_cases()[case]
    n, m, h = len(x), 2 * s, 0.1
    M = np.array([system.hamiltonian.gradient(unit) - system.hamiltonian.gradient(0 * unit) for unit in np.eye(n)])
    tableau = co.methods.gauss_tableau(s)
    b, a = tableau.scale * tableau.out, tableau.mix * tableau.scale
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


# Remark 3.1: Radau IIA on x' = f + lambda x, 0 = T - T(0) preserves the energy, but dissipates on its level set.


def square_after(method, h, t):
    body, x0 = co.systems.paper_rigid_body(), np.array([1.0, 2.0, 0.5])
    run = co.integrate(body, x0, (0.0, t), h, method, save_every=10**6)
    assert run.drift()["energy"] <= rounding_of(run)["energy"]
    return float(run.x[-1] @ run.x[-1])


def test_energy_is_preserved_and_the_square_is_lost():
    """To the printed digits: 5.25 becomes 5.24990 by Radau, and grows by the M-orthogonal midpoint at h = 0.1."""
    assert square_after(co.RadauEnergy(2), 0.1, 20.0) == pytest.approx(5.24990, abs=0.5e-5)
    for t, growth in ((100.0, 0.041), (1000.0, 0.333), (2000.0, 0.575)):
        assert square_after(co.ModifiedGaussLegendre(1), 0.1, t) - 5.25 == pytest.approx(growth, abs=0.5e-3)


DIAGONAL = ("so(3), diagonal", "A3,7, diagonal", "sl(2), diagonal", "so(4), diagonal")


def flow(system, i, t, x):
    """Return the flow of (12): x_i is constant, x(t) = exp(t m_ii x_i D_i) x."""
    unit = np.eye(system.dim)[i]
    rate = system.hamiltonian.gradient(x)[i]
    return expm(t * system.sign * rate * system.algebra.coadjoint(unit)) @ x


@pytest.mark.parametrize("case", DIAGONAL)
def test_steps_are_the_printed_products(case):
    """The first-order sweep, its adjoint, and the step of order 2 that they make."""
    system, x, _ = cases()[case]
    there, back = range(system.dim), range(system.dim)[::-1]
    steps = [
        (co.Splitting(order=1, parts="coordinates"), [(there, 0.1)]),
        (co.Splitting(order=1, adjoint=True, parts="coordinates"), [(back, 0.1)]),
        (co.Splitting(order=2, parts="coordinates"), [(there, 0.05), (back, 0.05)]),
    ]
    for method, sweeps in steps:
        expected = x
        for order, h in sweeps:
            for i in order:
                expected = flow(system, i, h, expected)
        found = co.stepper(system, method, 0.1)(x)
        # Two dozen matrix products of at most 6 dimensions, those of expm included.
        assert np.max(np.abs(found - expected)) <= 24 * 64 * U * np.max(np.abs(x))


MASSES = (1.0, 0.5, 1 / 3)
BODY = co.systems.paper_rigid_body(MASSES)
POINT = np.array([0.7, -1.2, 0.4])


def rotation(i, angle):
    c, s = np.cos(angle), np.sin(angle)
    j, k = (i + 1) % 3, (i + 2) % 3
    R = np.eye(3)
    R[j, j], R[j, k], R[k, j], R[k, k] = c, -s, s, c
    return R


def test_printed_composition_is_orthogonal():
    h, x, B = 0.1, POINT, np.eye(3)
    for i, fraction in ((0, 0.5), (1, 0.5), (2, 1.0), (1, 0.5), (0, 0.5)):
        R = rotation(i, fraction * h * MASSES[i] * x[i])
        x, B = R @ x, R @ B
    step = co.stepper(BODY, co.Splitting(order=2, parts="coordinates"), h)
    assert np.max(np.abs(step(POINT) - x)) <= 64 * U
    assert np.max(np.abs(B.T @ B - np.eye(3))) <= 64 * U
    # The group element of the step is B^T: A_(k+1) = A_k B^T.
    assert np.max(np.abs(step.group(POINT) - B.T)) <= 64 * U


SPIRAL, WEIGHTS = 2.0, (1.0, 2.0, 0.01)
ONES, SPAN, STEP = np.array([1.0, 1.0, 1.0]), (0.0, 20.0), 0.01
SYSTEM = co.systems.paper_a37(SPIRAL, WEIGHTS)


def test_orbits_are_heteroclinic():
    """x3 falls from +X to -X with X = sqrt(2 H / m33), and (x1, x2) -> 0."""
    run = co.integrate(SYSTEM, ONES, (0.0, 60.0), STEP, co.Splitting(order=4))
    assert np.all(np.diff(run.x[:, 2]) <= 1e-12)
    assert run.x[-1, 2] == pytest.approx(-np.sqrt(2 * 1.505 / 0.01), rel=1e-6)
    assert np.max(np.abs(run.x[-1, :2])) < 1e-6


X0, H = np.array([1.0, 10.0, 1.0]), 0.1
TIMES = (1.0, 2.0, 5.0, 10.0, 20.0)


def angle_between(A, B):
    R = A.T @ B
    axial = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(np.linalg.norm(axial) / 2, (np.trace(R) - 1) / 2))


def carried(method, t, h=H, x0=X0, system=BODY):
    return co.integrate(system, x0, (0.0, t), h, method, attitude=True)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("method", "errors"),
    [
        (co.GaussLegendre(1), (0.152, 0.280, 0.678, 1.39, 2.73)),
        (co.ModifiedGaussLegendre(1, freeze="gradient"), (0.092, 0.189, 1.58, 2.40, 2.67)),
        (co.Splitting(order=2, parts="coordinates"), (0.020, 0.008, 0.107, 0.198, 0.146)),
    ],
)
def test_attitude_errors_match_the_paper(method, errors):
    run = carried(method, 20.0)
    for t, printed in zip(TIMES, errors, strict=True):
        exact = BODY.exact(X0, t, attitude=True)[1]
        found = angle_between(exact, run.attitude[round(t / H)])
        # Half a unit of the last digit printed, or 2 per cent.
        half_digit = 0.5e-3 if printed < 1 else 0.5e-2
        assert abs(found - printed) <= max(half_digit, 0.02 * printed), (t, found, printed)


def test_first_entry_of_the_attitude_for_both_signs():
    for system, printed in (
        (BODY, 0.0720212720707),
        (co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(MASSES), sign=-1), -0.404281810695),
    ):
        run = carried(co.GaussLegendre(4), 10.0, 0.01, system=system)
        # Half a unit of the last digit printed, and 4 s = 8th order at h = 0.01 below that.
        assert run.attitude[-1, 0, 0] == pytest.approx(printed, abs=1e-12)


GENTLE, FINE = np.array([1.0, 2.0, 0.5]), 0.05


@pytest.mark.parametrize(
    ("method", "errors"),
    [
        (co.GaussLegendre(1), (0.0038, 0.038, 0.38)),
        (co.Splitting(order=2, parts="coordinates"), (0.00023, 0.0019, 0.019)),
    ],
)
def test_phase_error_of_the_attitude_grows_linearly(method, errors):
    """For splitting about twenty times more slowly."""
    run = co.integrate(BODY, GENTLE, (0.0, 500.0), FINE, method, save_every=100, attitude=True)
    for t, printed in zip((5.0, 50.0, 500.0), errors, strict=True):
        exact = BODY.exact(GENTLE, t, attitude=True)[1]
        found = angle_between(exact, run.attitude[round(t / (100 * FINE))])
        # Two digits printed: half a unit of the second.
        assert abs(found - printed) <= 0.5 * 10 ** (np.floor(np.log10(printed)) - 1), (t, found)


def test_order_of_the_parts_changes_the_error_tenfold():
    printed = {"123": 1.1e-3, "132": 2.3e-3, "231": 2.3e-3, "312": 2.6e-3, "321": 5.7e-3, "213": 1.1e-2}
    exact = BODY.exact(GENTLE, 20.0, attitude=True)[1]
    for order, error in printed.items():
        parts = tuple((int(i) - 1,) for i in order)
        method = co.Splitting(order=2, parts=parts)
        run = co.integrate(BODY, GENTLE, (0.0, 20.0), FINE, method, save_every=400, attitude=True)
        # Two digits printed: within 5 per cent.
        assert angle_between(run.attitude[-1], exact) == pytest.approx(error, rel=0.05), order
