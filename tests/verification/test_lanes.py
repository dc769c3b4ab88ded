"""Members in lanes have the bits of single runs: states, invariants, drifts and failures."""

import numpy as np
import pytest

import coadjoint as co

from .systems_under_test import all_cases, cases

pytestmark = pytest.mark.thinned(6)

STEP, STEPS, EVERY = 0.0625, 40, 8
METHODS = {
    "plain": co.Splitting(order=2),
    "compensated": co.Splitting(order=2, compensated=True),
    "coordinates": co.Splitting(order=2, parts="coordinates"),
    "processed": co.Splitting(scheme="blanes_casas_murua6"),
    "rational": co.Splitting(order=2, rotation="rational"),
}


def ensemble_around(x0, members):
    return x0 * (1.0 - 0.9 * np.arange(members)[:, None] / members)


def tenths(solution):
    return np.stack([solution.drift()[name].tenths for name in ("energy", *solution.casimirs)], axis=-2)


def assert_same(ensemble, member, alone):
    assert np.array_equal(ensemble.x[:, member], alone.x)
    assert np.array_equal(ensemble.energy[:, member], alone.energy)
    for name, values in alone.casimirs.items():
        assert np.array_equal(ensemble.casimirs[name][:, member], values)
    assert np.array_equal(tenths(ensemble)[member], tenths(alone))
    if alone.attitude is not None:
        assert np.array_equal(ensemble.attitude[:, member], alone.attitude)


def serves(method, system, x0):
    try:
        co.stepper(system, method, STEP)(x0)
    except (ValueError, TypeError):
        return False
    return True


PAIRS = [(m, c) for m in METHODS for c in cases() if serves(METHODS[m], *cases()[c][:2])]


@pytest.mark.thinned(32)
@pytest.mark.parametrize(("method", "case"), PAIRS)
@pytest.mark.parametrize("watch", [True, False])
def test_member_in_lanes_equals_its_single_run(method, case, watch):
    system, x0, _ = all_cases()[case]
    attitude = METHODS[method].properties(system).attitude != "none" and "coadjoint"

    def run(x):
        span = (0.0, STEPS * STEP)
        return co.integrate(
            system, x, span, STEP, METHODS[method], save_every=EVERY, watch=watch, attitude=attitude, threads=1
        )

    states = ensemble_around(x0, 35)
    ensemble = run(states)
    for member in (0, 1, 15, 16, 31, 32, 34):
        assert_same(ensemble, member, run(states[member]))


def test_compensated_group_elements_of_a_processed_scheme():
    """Its finish, of many flows, starts from the rounding errors of the step, whatever was saved before."""
    system, x0, _ = cases()["e(3), heavy top"]
    states, span = ensemble_around(x0, 3), (0.0, STEPS * STEP)
    method = co.Splitting(scheme="blanes_casas_murua6", compensated=True)
    ensemble = co.integrate(system, states, span, STEP, method, save_every=EVERY, attitude=True)
    for member, state in enumerate(states):
        assert_same(ensemble, member, co.integrate(system, state, span, STEP, method, save_every=EVERY, attitude=True))
        often = co.integrate(system, state, span, STEP, method, attitude=True)
        assert np.array_equal(often.attitude[::EVERY], ensemble.attitude[:, member])


@pytest.mark.parametrize("members", [1, 2, 3, 4, 31, 32, 33, 64, 67])
def test_ensembles_of_any_size(members):
    system, x0, _ = cases()["e(3), heavy top"]
    states = ensemble_around(x0, members)
    span = (0.0, STEPS * STEP)
    ensemble = co.integrate(system, states, span, STEP, save_every=EVERY)
    for member in range(members):
        assert_same(ensemble, member, co.integrate(system, states[member], span, STEP, save_every=EVERY))


def test_angles_of_any_size_in_lanes():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    sizes = np.array([1e-200, 1e-9, 0.1, 1.0, 8.0, 1e3, 1e7, 1e12])
    states = np.multiply.outer(np.repeat(sizes, 5), [0.3, -1.0, 0.7])
    ensemble = co.integrate(body, states, (0.0, 20.0), 1.0)
    for member in range(0, len(states), 5):
        assert_same(ensemble, member, co.integrate(body, states[member], (0.0, 20.0), 1.0))


@pytest.mark.parametrize("compensated", [False, True])
def test_batch_with_more_members_than_lanes(compensated):
    inertias = [(1.5, 2.0 + 0.01 * k, 3.5) for k in range(70)]
    bodies = [co.systems.rigid_body(inertia=inertia) for inertia in inertias]
    states = ensemble_around(np.array([0.3, 1.0, -0.4]), len(bodies))
    span, method = (0.0, STEPS * STEP), co.Splitting(order=2, compensated=compensated)
    together = co.integrate(co.batch(bodies), states, span, STEP, method, save_every=EVERY, attitude=True)
    for member in (0, 15, 16, 31, 32, 33, 63, 64, 69):
        alone = co.integrate(bodies[member], states[member], span, STEP, method, save_every=EVERY, attitude=True)
        assert_same(together, member, alone)


def growing_element():
    """Return a system and a state at rest, of which the group element grows."""
    g = co.algebras.get("so(2,1)")
    boost = np.eye(3)[int(np.argmax([np.abs(np.linalg.eigvals(g.coadjoint(e)).real).max() for e in np.eye(3)]))]
    system = co.LiePoissonSystem(g, co.Quadratic(0.0, linear=boost))
    return system, next(e for e in np.eye(3) if not np.any(system.vector_field(e)))


def overflow_of(system, x0, method, **options):
    with pytest.raises(co.IntegrationError, match="overflowed") as raised:
        co.integrate(system, x0, (0, 800), 1.0, method, attitude="coadjoint", **options)
    return raised.value


@pytest.mark.parametrize(
    "method", [co.Splitting(order=2, parts="coordinates"), co.GaussLegendre(3), co.Taylor(12)], ids=str
)
def test_overflow_of_a_group_element_names_its_step(method):
    system, still = growing_element()
    seen = set()
    for save_every, watch, members in ((1, True, 1), (1, False, 5), (7, True, 5), (50, False, 1), (10**6, True, 5)):
        options = {"save_every": save_every, "watch": watch}
        seen.add(overflow_of(system, np.tile(still, (members, 1)), method, **options).step)
    assert len(seen) == 1 and 700 < seen.pop() < 720  # log of the largest float64 is 709.8


@pytest.mark.parametrize("save_every", [1, 3, 50])
@pytest.mark.parametrize("watch", [True, False])
def test_overflowing_group_element_is_not_saved(save_every, watch):
    system, still = growing_element()
    x = still * np.array([1.0, 2.0, 3.0])[:, None]

    method, options = co.Splitting(order=2, parts="coordinates"), {"save_every": save_every, "watch": watch}
    together = overflow_of(system, x, method, **options)
    first = np.flatnonzero(together.partial.t < together.step)[-1] + 1
    assert np.isfinite(together.partial.attitude[:first]).all() and np.isfinite(together.partial.x[:first]).all()
    assert np.isnan(together.partial.attitude[first:]).all() and np.isnan(together.partial.x[first:]).all()
    for member in range(3):
        alone = overflow_of(system, x[member : member + 1], method, **options)
        assert alone.step == together.step
        assert np.array_equal(alone.partial.x[:, 0], together.partial.x[:, member], equal_nan=True)
        assert np.array_equal(alone.partial.attitude[:, 0], together.partial.attitude[:, member], equal_nan=True)
