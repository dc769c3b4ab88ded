"""Iterations of stages end at the round-off of each coordinate, whatever the size of the others."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

import coadjoint as co
from rounding import UNIT_ROUNDOFF as U

RATIOS = (1.0, 1e4, 1e8, 1e12)
TWO_SPINS = co.algebras.copies(co.algebras.so(3), 2)
STRONG, WEAK = np.array([0.6, -0.9, 1.1]), np.array([-0.4, 0.8, 0.7])


def coupled_spins(ratio):
    """A weak spin that turns fast in the field of a strong one, which it hardly moves."""
    M = np.zeros((6, 6))
    M[:3, 3:] = M[3:, :3] = np.diag([1.0, 0.8, 0.6])
    M[:3, :3] = np.diag([0.3, 0.5, 0.9])
    return co.LiePoissonSystem(TWO_SPINS, co.Quadratic(M / ratio)), np.concatenate([ratio * STRONG, WEAK])


def two_bodies(ratio):
    """Two free bodies, of which the small one turns faster."""
    moments = np.concatenate([np.array([0.1, 0.2, 0.3]) / ratio, [0.6, 1.05, 1.65]])
    return co.LiePoissonSystem(TWO_SPINS, co.Quadratic(moments)), np.concatenate([ratio * STRONG, WEAK])


def long_lever(ratio):
    """A body in a fluid with a large linear momentum."""
    moments = np.concatenate([[0.4, 0.7, 1.1], np.array([0.3, 0.5, 0.45]) / ratio**2])
    return co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(moments)), np.concatenate([WEAK, ratio * STRONG])


def sum_of_algebras(ratio):
    """A state of su(3) beside a body; each moves alone."""
    g = co.algebras.direct_sum(co.algebras.su(3), co.algebras.so(3))
    moments = np.concatenate([np.linspace(0.3, 1.0, 8) / ratio, [0.4, 0.7, 1.1]])
    return co.LiePoissonSystem(g, co.Quadratic(moments)), np.concatenate([ratio * np.linspace(-1.0, 0.9, 8), WEAK])


MIXED = {f.__name__: f for f in (coupled_spins, two_bodies, long_lever, sum_of_algebras)}
ROUNDINGS = 20  # of a step: of the sums, and of some ten terms of the slopes, times a step of less than one


def groups(system):
    return slice(0, system.dim - 3), slice(system.dim - 3, None)


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("name", MIXED)
@pytest.mark.parametrize("method", [co.GaussLegendre(1), co.GaussLegendre(3)], ids=str)
def test_small_coordinates_beside_large_ones_in_50_digits(method, name, ratio):
    system, x0 = MIXED[name](ratio)
    h, steps = 0.5, 2
    with mpmath.workdps(50):
        exact = np.array([mpmath.mpf(float(v)) for v in x0])
        for k in range(steps):
            exact = method.step(system, exact, mpmath.mpf(k * h), mpmath.mpf(h))
    alone = co.integrate(system, x0, (0.0, steps * h), h, method).x[-1]
    members = np.array([x0, 0.5 * x0, x0, 1.5 * x0])
    np.testing.assert_array_equal(co.integrate(system, members, (0.0, steps * h), h, method).x[-1, 2], alone)
    plain = x0
    for k in range(steps):
        plain = method.step(system, plain, k * h, h)
    for found in (alone, plain):
        for part in groups(system):
            error = np.abs((found - exact)[part]).astype(float).max()
            assert error < steps * ROUNDINGS * U * np.abs(x0[part]).max()


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("name", ["coupled_spins", "two_bodies", "long_lever"])
@pytest.mark.parametrize("h", [3.0, 9.0])
@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
def test_small_coordinates_by_newton(name, ratio, h):
    """The midpoint rule at steps where function iteration diverges: its defect in each coordinate, in 50 digits."""
    system, x0 = MIXED[name](ratio)
    x1 = co.integrate(system, x0, (0.0, h), h, co.GaussLegendre(1)).x[-1]
    with mpmath.workdps(50):
        start, end = (np.array([mpmath.mpf(float(v)) for v in x]) for x in (x0, x1))
        defect = end - start - h * system.vector_field((start + end) / 2, 0.0)
    for part in groups(system):
        size = max(np.abs(x0[part]).max(), np.abs(x1[part]).max())
        assert np.abs(defect[part]).astype(float).max() < ROUNDINGS * h * U * size


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("stages", [1, 2, 3, 5])
@pytest.mark.parametrize("h", [0.25, 1.0])
def test_corrections_that_vanish_in_turns(stages, ratio, h):
    """A spin turns about x1, from an axis: x2 moves x3, which moves x2. The other spin rests."""
    moments = np.array([0.4, 0.7, 1.1, 0.0, 0.0, 0.0]) / ratio
    system = co.LiePoissonSystem(TWO_SPINS, co.Quadratic(moments, linear=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]))
    x0, method = np.array([ratio, 0.0, 0.0, 0.0, 0.0, 1.0]), co.GaussLegendre(stages)
    with mpmath.workdps(50):
        exact = method.step(system, np.array([mpmath.mpf(float(v)) for v in x0]), mpmath.mpf(0), mpmath.mpf(h))
    for found in (co.integrate(system, x0, (0.0, h), h, method).x[-1], method.step(system, x0, 0.0, h)):
        assert np.abs(found - exact)[3:].astype(float).max() < 8 * U


def in_a_cancelling_force():
    """A body, and p that it turns: p x dH/dp vanishes, except for round-off that is a thousandth of the momentum.

    One coefficient is the next float: products that cancel identically would be left out.
    """
    inertia, P, rate, h = np.array([0.7, 1.0, 1.2]), 1e6, 0.1, 0.25
    strength = 1e-3 * rate / (h * U * P**4)
    terms = {}
    for i in range(3):
        terms[tuple(2 * (j == i) for j in range(6))] = 0.5 / inertia[i]
        for j in range(i, 3):
            powers = [0] * 6
            powers[3 + i] += 2
            powers[3 + j] += 2
            terms[tuple(powers)] = strength * (0.25 if i == j else 0.5)
    terms[tuple(powers)] = np.nextafter(terms[tuple(powers)], np.inf)
    system = co.LiePoissonSystem(co.algebras.e(3), co.Polynomial(terms), sign=-1)
    return system, np.concatenate([rate * WEAK, P * STRONG]), inertia, h


@pytest.mark.parametrize(
    "method", [co.GaussLegendre(1), co.GaussLegendre(2), co.GaussLegendre(3), co.RadauEnergy(2)], ids=str
)
@pytest.mark.filterwarnings("ignore:rounding changes")
def test_corrections_that_are_round_off_of_large_terms(method):
    """Corrections of p stagnate far above its own round-off; the body turns as without the force, up to round-off."""
    system, x0, inertia, h = in_a_cancelling_force()
    steps = 40
    run = co.integrate(system, x0, (0.0, steps * h), h, method)
    members = co.integrate(system, np.array([x0, x0, x0, 2.0 * x0]), (0.0, steps * h), h, method)
    np.testing.assert_array_equal(members.x[:, 1], run.x)
    free = co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(np.concatenate([1.0 / inertia, np.zeros(3)])), sign=-1)
    wanted = co.integrate(free, x0, (0.0, steps * h), h, method)
    rate = np.abs(x0[:3]).max()
    # The round-off of each step is about a thousandth of the momentum, and so may be the next corrections.
    assert np.abs(run.x[:, :3] - wanted.x[:, :3]).max() < 0.01 * steps * rate
    assert np.abs(run.x[1:, :3] - wanted.x[1:, :3]).max() > 1e-6 * rate, "nothing but round-off of p is left"
    assert np.abs(run.x[1, :3] - method.step(system, x0, 0.0, h)[:3]).max() < 0.03 * rate


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("method", [co.GaussLegendre(2), co.RadauEnergy(2), co.SphericalMidpoint()], ids=str)
def test_divergence_is_not_taken_for_round_off(method):
    """At steps of many turns the stages of a field that depends on the state have no solution that is found."""
    ring = co.systems.spin_lattice([(0, 1), (1, 2), (2, 3), (3, 0)], 4, tensor=(1.0, 0.7, 0.4))
    system = ring if isinstance(method, co.SphericalMidpoint) else co.systems.rigid_body()
    rng = np.random.default_rng(1)
    failed = 0
    for _ in range(5):
        try:
            run = co.integrate(system, 50.0 * rng.standard_normal(system.dim), (0.0, 40.0), 20.0, method)
        except co.IntegrationError as error:
            failed += 1
            assert not error.residual < 1e-3
        else:
            for casimir in run.casimirs.values():
                np.testing.assert_allclose(casimir, casimir[0], rtol=1e-9)
    assert failed or isinstance(method, co.GaussLegendre)
