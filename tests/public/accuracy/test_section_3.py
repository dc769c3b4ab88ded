"""Section 3 of the paper: Lemma 3.1 (orders, invariants), Example 3.1 (either factor frozen), Remarks 3.1 and 3.2."""

import numpy as np
import pytest

import coadjoint as co
from digests.measures import drift_bounds, five_errors, measured_order, order_of, step_counts
from digests.systems_under_test import all_cases, cases
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(3)

WITNESSES = ("so(4), diagonal", "e(3), full, axes permuted", "A3,7, full")
CHOICES = [(s, m) for s in (1, 2, 3) for m in range(1, 2 * s + 2)]
FREEZES = ("structure", "gradient")


@pytest.mark.thinned(9)
@pytest.mark.parametrize("kind", [*FREEZES, "plain"])
@pytest.mark.parametrize(("s", "m"), CHOICES)
@pytest.mark.parametrize("case", WITNESSES)
def test_order_is_the_smaller_of_m_and_p(case, s, m, kind):
    """Of m + 1 and p in plain iteration, equation (6), with output from the m-th iterates."""
    method, order = (
        (co.IteratedGaussLegendre(s, iterations=m), m + 1)
        if kind == "plain"
        else (co.ModifiedGaussLegendre(s, iterations=m, freeze=kind), m)
    )
    assert method.order == min(order, 2 * s)
    found = measured_order(method, case)
    assert found.agrees_with(min(order, 2 * s)), found


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
    assert run.drift()["energy"] <= drift_bounds(run)["energy"]
    return float(run.x[-1] @ run.x[-1])


def test_energy_is_preserved_and_the_square_is_lost():
    """To the printed digits: 5.25 becomes 5.24990 by Radau, and grows by the M-orthogonal midpoint at h = 0.1."""
    assert square_after(co.RadauEnergy(2), 0.1, 20.0) == pytest.approx(5.24990, abs=0.5e-5)
    for t, growth in ((100.0, 0.041), (1000.0, 0.333), (2000.0, 0.575)):
        assert square_after(co.ModifiedGaussLegendre(1), 0.1, t) - 5.25 == pytest.approx(growth, abs=0.5e-3)


# Remark 3.2: what the modified scheme does not preserve exactly it preserves to O(h^m), and plain iteration to
# O(h^(m+1)) or better.


def fitted_drift(method, case, name, expected):
    """Return the order in h of the drift of an invariant over a fixed time."""
    system, x0, _ = cases()[case]
    # As finely as for an order above two, and more finely from six on.
    counts = step_counts(max(3, expected + 1))

    def drift(count):
        return co.integrate(system, x0, (0.0, 1.0), 1.0 / count, method).drift()[name]

    return order_of(*five_errors(1.0, counts, 2.0, drift), 1)


@pytest.mark.parametrize("kind", [*FREEZES, "plain"])
@pytest.mark.parametrize(("s", "m"), CHOICES)
@pytest.mark.parametrize("case", WITNESSES[:2])
def test_orders_of_the_invariants_that_are_lost(case, s, m, kind):
    if kind == "plain":
        method, order, names = co.IteratedGaussLegendre(s, iterations=m), m + 1, ["energy"]
    else:
        method, order = co.ModifiedGaussLegendre(s, iterations=m, freeze=kind), m
        names = ["energy"] if kind == "gradient" else cases()[case].system.casimirs
    for name in names:
        found = fitted_drift(method, case, name, order)
        assert found.slope > order - found.tolerance, (name, found)


@pytest.mark.parametrize("freeze", FREEZES)
@pytest.mark.parametrize("case", WITNESSES[:2])
def test_modified_midpoint_is_symmetric_to_order_four(case, freeze):
    """psi_(-h) psi_h - 1 = O(h^4) for (10)-(11), and not smaller."""
    system, x0, _ = cases()[case]
    method = co.ModifiedGaussLegendre(1, freeze=freeze)
    steps = [0.1 / 2 ** (k / 2) for k in range(5)]
    errors = [np.max(np.abs(co.stepper(system, method, -h)(co.stepper(system, method, h)(x0)) - x0)) for h in steps]
    found = order_of(steps, errors, 1)
    assert found.agrees_with(4), found
