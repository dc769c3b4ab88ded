"""The estimated error of a run: what it is compared with, whose it is, and when there is none."""

import copy
import pickle

import numpy as np
import pytest

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

pytestmark = pytest.mark.thinned(1)

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = (1.0, 0.2, 0.5)


def test_a_perfect_drift_does_not_hide_the_error():
    sol = co.integrate(BODY, (0.3, 1.0, 0.2), (0, 100), 2.0, co.Taylor(order=4))
    error = np.linalg.norm(sol.x[-1] - BODY.exact((0.3, 1.0, 0.2), 100.0)) / np.linalg.norm((0.3, 1.0, 0.2))
    assert sol.drift()["energy"] < 1e-14 and error > 5e-3
    assert error / 10 < sol.error_estimate() < 10 * error


def test_of_batches_by_their_own_systems():
    bodies = [co.systems.rigid_body(inertia=(1.0, 2.0, third)) for third in (1.5, 2.0, 2.5)]
    sol = co.integrate(co.batch(bodies), X0, (0, 20), 0.1)
    errors = [np.linalg.norm(sol.x[-1, m] - body.exact(X0, 20.0)) / np.linalg.norm(X0) for m, body in enumerate(bodies)]
    assert sol.error_estimate() == pytest.approx(errors, rel=0.1)


def test_of_matrices_and_forces():
    fluid = co.systems.sphere_euler(N=5)
    numbers = np.random.default_rng(1).normal(size=fluid.dim)
    damped = BODY.with_forces(co.forces.LinearDamping(0.1))
    for system, x0, step in ((damped, np.array(X0), 0.1), (fluid, fluid.matrices(numbers), 0.05)):
        sol = co.integrate(system, x0, (0, 5), step, save_every=10)
        better = co.integrate(system, x0, (0, 5), step / 16, save_every=160)
        size = np.max(np.linalg.norm(better.x.reshape(len(better.t), -1), axis=1))
        error = np.linalg.norm(sol.x[-1] - better.x[-1]) / size
        assert sol.error_estimate() == pytest.approx(error, rel=0.1)


def test_noise_is_refused_by_name():
    spins = co.systems.spin_lattice("ring", 4).with_forces(co.forces.HeatBath(0.1, temperature=0.5, seed=1))
    sol = co.integrate(spins, np.tile((0.0, 0.6, 0.8), 4), (0, 1), 0.1)
    with refused(TypeError, "random forces"):
        sol.error_estimate()
    with refused(TypeError, "random forces"):
        sol.step_error()


@pytest.mark.thinned(1)
@pytest.mark.parametrize("span", [(0.0, 60.0), (2.0, -58.0)])
@pytest.mark.parametrize("method", [None, co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(2)])
@pytest.mark.parametrize("accuracy", [1e-2, 1e-5])
def test_truncation_is_told_to_a_few_percent(accuracy, method, span):
    """The error of the finer run is known by the order, of which the next term is a fraction of the error."""
    sol = co.integrate(BODY, X0, span, accuracy=accuracy, method=method, save_every=7)
    error = np.linalg.norm(sol.x[-1] - BODY.exact(X0, span[1] - span[0])) / np.linalg.norm(X0)
    assert sol.error_estimate() == pytest.approx(error, rel=0.1)
    assert sol.error_estimate() <= accuracy and 0.25 * error < sol.choice.error < 4.0 * error


@pytest.mark.parametrize("time", [20.0, -20.0])
def test_relative_to_the_largest_momentum_on_the_way(time):
    """x2 = exp(-t): of what dies the error is told in parts of the start, of what grows in parts of the end."""
    dying = co.LiePoissonSystem(
        co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}}), co.Quadratic([0.0, 0.0], linear=[1.0, 0.0]), sign=1
    )
    assert dying.vector_field((0.0, 1.0))[1] == -1.0
    sol = co.integrate(dying, (0.0, 1.0), (0, time), accuracy=1e-6, method=co.GaussLegendre(2))
    error = abs(sol.x[-1, 1] - np.exp(-time)) / max(1.0, np.exp(-time))
    assert sol.error_estimate() == pytest.approx(max(error, UNIT_ROUNDOFF), rel=0.1)
    assert np.ptp(sol.x) > 0.99


def test_of_driven_systems_at_their_own_times():
    spin = co.systems.spin_lattice("chain", 1, field=lambda t: (0.9 * np.cos(2.0 * t), 0.9 * np.sin(2.0 * t), -1.0))
    span = (4.0, -2.0)
    driven = co.integrate(spin, (0.6, 0.0, 0.8), span, accuracy=1e-5, method=co.Splitting(order=2), save_every=9)
    better = co.integrate(spin, (0.6, 0.0, 0.8), span, 6.0 / 1024, co.GaussLegendre(4), save_every=64)
    assert driven.error_estimate() == pytest.approx(np.linalg.norm(driven.x[-1] - better.x[-1]), rel=0.1)


def test_of_members_by_their_own_sizes_in_any_order():
    states = np.array([[1.0, 0.2, 0.5], [0.002, 0.001, 0.003], [2.0, 1.0, -1.5], [0.3, -0.2, 0.6]])[::-1]
    sol = co.integrate(BODY, states, (4.0, 14.0), accuracy=1e-4, method=co.Splitting(order=2))
    exact = np.array([BODY.exact(x, 10.0) for x in states])
    errors = np.linalg.norm(sol.x[-1] - exact, axis=1) / np.linalg.norm(states, axis=1)
    assert errors.max() > 1e3 * errors.min()
    assert sol.error_estimate() == pytest.approx(errors, rel=0.1)


def test_it_does_not_depend_on_how_one_looked():
    runs = [
        co.integrate(BODY, X0, (0, 60), accuracy=1e-9, **options)
        for options in ({}, {"watch": False}, {"save_every": 10**6}, {"attitude": True, "method": None})
    ]
    told = [run.error_estimate() for run in runs[:3]]
    assert told[0] == told[1] == told[2]
    assert 0.0 < runs[3].error_estimate() <= 1e-9


@pytest.mark.parametrize("times", [(3.0, 17.7, 41.3), (60.0,), (0.0, 5.0)])
def test_at_the_last_of_the_times_that_were_asked_for(times):
    sol = co.integrate(BODY, X0, (0, 60), accuracy=1e-6, t_eval=times, method=co.Splitting(order=4))
    error = np.linalg.norm(sol.x[-1] - BODY.exact(X0, times[-1])) / np.linalg.norm(X0)
    assert sol.error_estimate() == pytest.approx(error, rel=0.1)


def test_round_off_is_said_and_not_zero():
    """At rest, and where every step is exact, at least the rounding of a state is left."""
    for x0 in ((0.0, 0.0, 0.0), (0.0, 0.0, 2.0)):
        assert co.integrate(BODY, x0, (0, 40), accuracy=1e-6).error_estimate() == UNIT_ROUNDOFF
    spinning = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.0, 0.0, 0.0], linear=[0.0, 0.0, 1.0]))
    assert UNIT_ROUNDOFF <= co.integrate(spinning, X0, (0, 40), accuracy=1e-9).error_estimate() < 1e-13
    assert co.integrate(BODY, X0, (3, 3), accuracy=1e-6).error_estimate() == 0.0


def test_a_copy_has_it_too():
    sol = co.integrate(BODY, X0, (0, 20), accuracy=1e-6)
    late = pickle.loads(pickle.dumps(sol))
    told = sol.error_estimate()
    assert late.error_estimate() == told == copy.deepcopy(sol).error_estimate()
    assert late.choice == sol.choice and sol.choice.method == sol.method
