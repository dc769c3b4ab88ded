"""Runge-Kutta methods: steps of the loops and of `Method.step`, round-off, large systems, iterations."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from stage_systems import spin_chain, systems

import coadjoint as co
from rounding import UNIT_ROUNDOFF as U


def test_round_off_of_gauss_8_has_no_bias():
    """At t = 20000 a random walk: with plainly rounded coefficients the energy is off by 3e-13, with one sign."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    run = co.integrate(body, (1.0, 2.0, 0.5), (0.0, 20000.0), 0.25, co.GaussLegendre(8), save_every=10**6)
    assert run.drift()["energy"] < 2 * U * run.energy[0] * math.sqrt(run.stats.steps)


@pytest.mark.parametrize("stages", [2, 3, 4, 5, 7, 8, 9, 12, 16, 17, 33])
@pytest.mark.parametrize("name", ["top", "quartic", "driven"])
def test_any_number_of_stages(name, stages):
    """Blocks of 4, 8 and 16 lanes, full and not: both round n products in each of the s stages, times h |f'| < 1."""
    system, x = systems()[name]
    method = co.GaussLegendre(stages)
    found, expected = co.stepper(system, method, 0.125)(x, 0.75), method.step(system, x, 0.75, 0.125)
    assert np.max(np.abs(found - expected)) <= 8 * len(x) * U * np.max(np.abs(x))


@pytest.mark.parametrize("freeze", ["structure", "gradient"])
def test_large_systems_are_solved_without_a_matrix(freeze):
    """A chain of 60 spins, 180 unknowns: iterated; 12 spins, 36 unknowns: by factors. Both keep their invariant."""
    for spins in (60, 12):
        system, x0 = spin_chain(spins)
        method = co.ModifiedGaussLegendre(1, freeze=freeze)
        found = co.stepper(system, method, 0.1)(x0)
        assert np.max(np.abs(found - method.step(system, x0, 0.0, 0.1))) < 64 * U
        run = co.integrate(system, x0, (0.0, 10.0), 0.1, method, save_every=100)
        size = 3 * spins
        kept = "energy" if freeze == "structure" else "S"
        lost = "S" if freeze == "structure" else "energy"
        assert run.drift()[kept] < 6 * 4 * size * U * math.sqrt(100)
        assert run.drift()[lost] > 1e-6


def test_an_equilibrium_stays():
    """All corrections vanish at once: no iteration is left hanging, and no step is lost."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    for x0 in ((0.0, 0.0, 2.0), (0.0, 0.0, 0.0)):
        run = co.integrate(body, x0, (0.0, 1.0), 0.1, co.GaussLegendre(3))
        assert np.array_equal(run.x[-1], x0)
        assert run.stats.iterations == 10


def test_components_of_different_size_are_all_converged():
    """|x1| = 1e6 against 1e-3: the small component is as accurate, relatively, as where it stands alone."""
    rows = [(0, 1, 2, 1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0), (3, 4, 5, 1.0), (4, 5, 3, 1.0), (5, 3, 4, 1.0)]
    system = co.LiePoissonSystem(co.LieAlgebra(rows, dim=6), co.Quadratic([1e-6, 2e-6, 3e-6, 1e3, 2e3, 3e3]))
    large, small = np.array([1.0, 0.5, -0.75]) * 1e6, np.array([0.5, 1.0, -0.25]) * 1e-3
    found = co.stepper(system, co.GaussLegendre(4), 0.5)(np.concatenate([large, small]))
    with mpmath.workdps(40):
        x = np.array([mpmath.mpf(v) for v in np.concatenate([large, small])], dtype=object)
        exact = co.GaussLegendre(4).step(system, x, 0, 0.5)
    error = np.array([float(v) for v in exact - found])
    assert np.max(np.abs(error[:3])) < 32 * U * 1e6
    assert np.max(np.abs(error[3:])) < 32 * U * 1e-3


def test_slopes_of_the_step_before_save_iterations():
    """Against steps each of which begins without them."""
    (system, x0), method = systems()["top"], co.GaussLegendre(8)
    run, alone = co.integrate(system, x0, (0.0, 6.0), 0.1, method), 0
    for x in run.x[:-1]:
        step = co.integrate(system, x, (0.0, 0.1), 0.1, method)
        alone += step.stats.iterations
    assert run.stats.iterations < 0.75 * alone
