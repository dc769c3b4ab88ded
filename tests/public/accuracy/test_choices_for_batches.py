"""A scheme and a step for an accuracy, of systems that differ in their parameters."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

STATE = np.array([0.3, -0.2, 1.0, 0.1, 0.4, 0.9])
TOPS = [co.systems.heavy_top(inertia=(1.0, 1.2, 0.6 + 0.05 * k)) for k in range(20)]


def rotor(third):
    return co.systems.rigid_body(inertia=(1.0, 1.5, third))


def errors_of(sol, systems, span):
    """Errors of the momenta at the end, relative to the largest ones."""
    found = []
    for m, system in enumerate(systems):
        exact = co.integrate(
            system, sol.x[0, m], span, abs(span[1] - span[0]) / 4096, co.GaussLegendre(8), save_every=32
        )
        largest = np.max(np.linalg.norm(exact.x, axis=1))
        found.append(np.linalg.norm(sol.x[-1, m] - exact.x[-1]) / largest)
    return found


@pytest.mark.parametrize("accuracy", [1e-4, 1e-9])
@pytest.mark.parametrize("span", [(0.0, 12.0), (2.0, -9.0)])
@pytest.mark.parametrize("method", [None, co.Splitting(order=4), co.GaussLegendre(3)])
def test_every_member_has_the_accuracy(accuracy, span, method):
    sol = co.integrate(co.batch(TOPS), STATE, span, accuracy=accuracy, method=method)
    errors = errors_of(sol, TOPS, span)
    assert max(errors) <= accuracy
    # An error of one member that is far below would be a step that is far too small.
    assert max(errors) >= 1e-4 * accuracy
    assert method is None or type(sol.method) is type(method)


def test_the_choice_is_for_the_member_that_needs_the_smallest_step():
    """The last of 300 bodies turns 40 times as fast as the others; alone it needs about the same step."""
    bodies = [rotor(2.0 + 0.001 * k) for k in range(299)] + [co.systems.rigid_body(inertia=(1 / 40, 1.5 / 40, 2 / 40))]
    x0 = (0.3, 1.0, 0.2)
    options = {"accuracy": 1e-7, "methods": co.GaussLegendre(4)}
    together = co.choose(co.batch(bodies), x0, (0, 20), **options)
    slow, fast = (co.choose(bodies[m], x0, (0, 20), **options) for m in (0, -1))
    assert slow.step > 10 * fast.step
    assert fast.step / 1.5 < together.step < 1.5 * fast.step


@pytest.mark.parametrize(("seed", "members", "span", "accuracy"), [(0, 25, (1, -34), 1e-8), (13, 40, (0, 40), 1e-6)])
@pytest.mark.thinned(2)
def test_errors_that_grow_late_are_met(seed, members, span, accuracy):
    """The target is a third of the accuracy, and twice that is accepted. Irregular motions have the largest errors."""
    rng = np.random.default_rng(seed)
    drawn = [(tuple(rng.uniform(1, 1.9, 3)), tuple(rng.normal(size=3))) for _ in range(members)]
    tops = [co.systems.heavy_top(inertia=inertia, lever=lever) for inertia, lever in drawn]
    states = rng.normal(size=(members, 6))
    sol = co.integrate(co.batch(tops), states, span, accuracy=accuracy, method=co.GaussLegendre(2))
    assert max(errors_of(sol, tops, span)) <= 2 / 3 * accuracy


def test_a_field_that_is_not_finite_is_found_in_its_member():
    systems = [
        co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(4, 0, 0): size, (0, 2, 0): 1.0}))
        for size in (1.0, 1e307)
    ]
    with refused(ValueError, "not finite"):
        co.choose(co.batch(systems), (10.0, 1.0, 1.0), (0, 1), 1e-6)


def test_equal_members_have_the_choice_of_one_system():
    states = [(0.3, 1.0, 0.2), (1.0, 0.1, 0.4), (0.2, 0.3, 1.0), (0.5, 0.5, 0.5)]
    body = rotor(2.0)
    alone, together = (co.choose(system, states, (0, 30), 1e-8) for system in (body, co.batch([body] * 4)))
    assert str(together) == str(alone)


def test_families_take_every_system_from_every_state():
    thirds, states = [2.25, 2.375, 2.5], [(0.1, 1.0, 0.1), (1.0, 0.1, 0.1)]
    sol = co.integrate(co.batch(rotor, third=thirds), states, (0, 15), accuracy=1e-8)
    systems = [rotor(third) for third in thirds for _ in states]
    assert sol.x.shape[1:] == (6, 3) and max(errors_of(sol, systems, (0, 15))) <= 1e-8


def test_an_attitude_is_counted():
    sol = co.integrate(co.batch([rotor(2.0), rotor(2.5)]), (0.3, 1.0, 0.2), (0, 10), accuracy=1e-8, attitude=True)
    assert sol.attitude.shape[1:] == (2, 3, 3)


def test_prepared_runs_of_a_batch_check_each_member():
    batch = co.batch(TOPS)
    ready = co.prepare(batch, accuracy=1e-8, x0=STATE, t_span=(0, 10), method=co.GaussLegendre(4))
    assert ready.serves(STATE) and not ready.serves(4 * STATE)
    fast = np.tile(STATE, (len(TOPS), 1))
    fast[7] *= 12
    assert not ready.serves(fast)
    sol = ready.run(fast, (0, 10))
    assert sol.choice.step < ready.choice.step
    assert max(errors_of(sol, TOPS, (0, 10))) <= 1e-8
    np.testing.assert_array_equal(ready.end(fast, (0, 10)), sol.x[-1])


def test_members_that_a_scheme_does_not_support_are_named():
    dense = co.Polynomial("x1^5*x2*x3 + x1^2", dim=3)
    systems = [co.LiePoissonSystem(co.algebras.so(3), H) for H in (co.Quadratic([1.0, 2.0, 3.0]), dense)]
    batch = co.batch(systems)
    with refused(ValueError, "Splitting"):
        co.choose(batch, (0.3, 1.0, 0.2), (0, 10), 1e-8, methods=co.Splitting())


def test_forces_and_matrices_are_refused_as_alone():
    damped = rotor(2.0).with_forces(co.forces.LinearDamping(0.1))
    with refused(TypeError, "has forces"):
        co.choose(co.batch([damped, damped]), (0.3, 1.0, 0.2), (0, 10), 1e-8)
