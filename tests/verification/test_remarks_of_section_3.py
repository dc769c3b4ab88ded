"""Remarks 3.1 and 3.2: invariants of Radau methods, and orders at which modified and plain iterations lose invariants.

Remark 3.1: Radau IIA on x' = f + lambda x, 0 = T - T(0) preserves the energy, but dissipates on its level set; so does
an M-orthogonal scheme. Remark 3.2: what the modified scheme does not preserve exactly it preserves to O(h^m), and plain
iteration to O(h^(m+1)) or better.
"""

import numpy as np
import pytest

import coadjoint as co

from .measures import drift_bounds, five_errors, measured_order, order_of, step_counts
from .systems_under_test import cases

pytestmark = pytest.mark.thinned(3)

# Remark 3.1

BODY, START = co.systems.paper_rigid_body(), np.array([1.0, 2.0, 0.5])


def square_after(method, h, t):
    run = co.integrate(BODY, START, (0.0, t), h, method, save_every=10**6)
    assert run.drift()["energy"] <= drift_bounds(run)["energy"]
    return float(run.x[-1] @ run.x[-1])


def test_radau_preserves_energy_and_loses_the_square():
    # |x|^2 = 5.25 becomes 5.24990, to the digits printed.
    assert square_after(co.RadauEnergy(2), 0.1, 20.0) == pytest.approx(5.24990, abs=0.5e-5)


def test_m_orthogonal_scheme_dissipates_on_the_level_set():
    # Growth of |x|^2 = 5.25 for the M-orthogonal midpoint at h = 0.1, to the printed digits.
    for t, growth in ((100.0, 0.041), (1000.0, 0.333), (2000.0, 0.575)):
        assert square_after(co.ModifiedGaussLegendre(1), 0.1, t) - 5.25 == pytest.approx(growth, abs=0.5e-3)


# Remark 3.2

WITNESSES = ("so(4), diagonal", "e(3), full, axes permuted")
CHOICES = [(s, m) for s in (1, 2, 3) for m in range(1, 2 * s + 2)]


def fitted_drift(method, case, name, expected):
    """Return the order in h of the drift of an invariant over a fixed time."""
    system, x0, _ = cases()[case]
    # As finely as for an order above two, and more finely from six on.
    counts = step_counts(max(3, expected + 1))

    def drift(count):
        return co.integrate(system, x0, (0.0, 1.0), 1.0 / count, method).drift()[name]

    return order_of(*five_errors(1.0, counts, 2.0, drift), 1)


@pytest.mark.parametrize(("s", "m"), CHOICES)
@pytest.mark.parametrize("case", WITNESSES)
def test_quadratic_casimirs_of_the_m_orthogonal_scheme(case, s, m):
    for name in cases()[case].system.casimirs:
        found = fitted_drift(co.ModifiedGaussLegendre(s, iterations=m), case, name, m)
        assert found.slope > m - found.tolerance, (name, found)


@pytest.mark.parametrize(("s", "m"), CHOICES)
@pytest.mark.parametrize("case", WITNESSES)
def test_energy_of_the_scheme_with_frozen_gradient(case, s, m):
    found = fitted_drift(co.ModifiedGaussLegendre(s, iterations=m, freeze="gradient"), case, "energy", m)
    assert found.slope > m - found.tolerance, found


@pytest.mark.parametrize(("s", "m"), CHOICES)
@pytest.mark.parametrize("case", WITNESSES)
def test_order_of_plain_iteration(case, s, m):
    """Equation (6), with output from the m-th iterates: order min(m + 1, p)."""
    method = co.IteratedGaussLegendre(s, iterations=m)
    assert method.order == min(m + 1, 2 * s)
    found = measured_order(method, case)
    assert found.agrees_with(min(m + 1, 2 * s)), found


@pytest.mark.parametrize(("s", "m"), CHOICES)
@pytest.mark.parametrize("case", WITNESSES)
def test_energy_of_plain_iteration(case, s, m):
    found = fitted_drift(co.IteratedGaussLegendre(s, iterations=m), case, "energy", m + 1)
    assert found.slope > m + 1 - found.tolerance, found


@pytest.mark.parametrize("freeze", ["structure", "gradient"])
@pytest.mark.parametrize("case", WITNESSES)
def test_modified_midpoint_is_symmetric_to_order_four(case, freeze):
    """psi_(-h) psi_h - 1 = O(h^4) for (10)-(11), and not smaller."""
    system, x0, _ = cases()[case]
    method = co.ModifiedGaussLegendre(1, freeze=freeze)
    steps = [0.1 / 2 ** (k / 2) for k in range(5)]
    errors = []
    for h in steps:
        back = co.stepper(system, method, -h)(co.stepper(system, method, h)(x0))
        errors.append(float(np.max(np.abs(back - x0))))
    found = order_of(steps, errors, 1)
    assert found.agrees_with(4), found
