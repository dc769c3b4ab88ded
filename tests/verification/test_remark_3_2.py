"""Remark 3.2: what the modified scheme does not keep exactly it keeps to O(h^m), and plain iteration to O(h^(m+1)) or
better.
"""

import numpy as np
import pytest

import coadjoint as co

from .measures import U, drift_bounds, measured_order, order_of
from .systems_under_test import cases

pytestmark = pytest.mark.thinned(3)

WITNESSES = ("so(4), diagonal", "e(3), full, axes permuted")
CHOICES = [(s, m) for s in (1, 2, 3) for m in range(1, 2 * s + 2)]


def fitted_drift(method, case, name, expected):
    """Return the order at which the drift of an invariant over a fixed time vanishes."""
    system, x0, _ = cases()[case]
    steps, errors = [], []
    # Quarter powers of 2 where high orders leave too few half powers above round-off.
    density = 4 if expected >= 6 else 2
    for k in range(8 * density, 2 * density - 1, -1):
        count = round(2 ** (k / density))
        run = co.integrate(system, x0, (0.0, 1.0), 1.0 / count, method)
        # Round-off of the drift itself: an unbiased walk stays well below the one-sided bound.
        if run.drift()[name] > 64 * U * (8 + 2 * count**0.5):
            steps.insert(0, 1.0 / count)
            errors.insert(0, float(run.drift()[name]))
        if len(errors) == 5:
            break
    assert len(errors) == 5
    return order_of(steps, errors, 1)


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


@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("case", WITNESSES)
def test_gauss_legendre_itself_keeps_quadratic_casimirs(case, s):
    system, x0, _ = cases()[case]
    run = co.integrate(system, x0, (0.0, 100.0), 0.1, co.GaussLegendre(s), save_every=50)
    bounds = drift_bounds(run)
    assert all(run.drift()[name] <= bounds[name] for name in system.casimirs)


@pytest.mark.parametrize(("s", "m"), CHOICES)
@pytest.mark.parametrize("case", WITNESSES)
def test_order_of_plain_iteration(case, s, m):
    """Equation (6), output from the m-th iterates: order min(m + 1, p), so that m = p - 1 suffices."""
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
def test_modified_midpoint_is_symmetric_up_to_order_four_only(case, freeze):
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
