"""Remark 3.1: Radau IIA on x' = f + lambda x, 0 = T - T(0) keeps the energy but dissipates on its level set.

And what the remark misses: so does an M-orthogonal scheme.
"""

import numpy as np
import pytest

import coadjoint as co

from .measures import drift_bounds
from .systems_under_test import cases

BODY, START = co.systems.paper_rigid_body(), np.array([1.0, 2.0, 0.5])


def square_after(method, h, t):
    run = co.integrate(BODY, START, (0.0, t), h, method, save_every=10**6)
    assert run.drift()["energy"] <= drift_bounds(run)["energy"]
    return float(run.x[-1] @ run.x[-1])


def test_radau_keeps_the_energy_and_loses_the_square():
    # |x|^2 = 5.25 becomes 5.24990, to the digits printed.
    assert square_after(co.RadauEnergy(2), 0.1, 20.0) == pytest.approx(5.24990, abs=0.5e-5)


def test_radau_on_six_dimensions_keeps_the_energy_and_loses_both_casimirs():
    system, x0, _ = cases()["so(4), diagonal"]
    run = co.integrate(system, x0, (0.0, 20.0), 0.1, co.RadauEnergy(2))
    bounds = drift_bounds(run)
    assert run.drift()["energy"] <= bounds["energy"]
    assert all(run.drift()[name] > 1000 * bounds[name] for name in system.casimirs)


def test_energy_is_kept_where_it_is_not_quadratic():
    system, x0, _ = cases()["e(3), polynomial potential"]
    run = co.integrate(system, x0, (0.0, 20.0), 0.05, co.RadauEnergy(2))
    assert run.drift()["energy"] <= drift_bounds(run)["energy"]


def test_m_orthogonality_does_not_exclude_dissipation_on_the_level_set():
    # Growth of |x|^2 = 5.25 for the M-orthogonal midpoint at h = 0.1, to the printed digits.
    for t, growth in ((100.0, 0.041), (1000.0, 0.333), (2000.0, 0.575)):
        assert square_after(co.ModifiedGaussLegendre(1), 0.1, t) - 5.25 == pytest.approx(growth, abs=0.5e-3)
