"""Long runs and large steps: invariants drift like sqrt(t) with compensated sums, by Brouwer's law."""

from functools import cache

import numpy as np
import pytest

import coadjoint as co
from digests.systems_under_test import cases, full_matrix
from long import long_where
from matrix.references import rounding_of
from rounding import UNIT_ROUNDOFF as U

STEPS = 1_000_000
LONG = {"so(3), full, axes turned": 0.1, "so(4), diagonal": 0.1, "e(3), heavy top": 0.1, "sl(2), diagonal": 0.05}


def walk(run, size, per_step):
    """Return six standard deviations of a random walk with `per_step` roundings of u times size in each step."""
    return 6 * U * size * np.sqrt(per_step * run.stats.steps)


def sizes_of(run):
    """Return |gradient| |x| for each invariant."""
    gradients = {"energy": run.system.hamiltonian.gradient, **{k: C.gradient for k, C in run.system.casimirs.items()}}
    return {
        name: max(np.linalg.norm(gradient(x)) * np.linalg.norm(x) for x in run.x)
        for name, gradient in gradients.items()
    }


def long_run(case, method, steps=STEPS):
    system, x0, _ = cases()[case]
    return co.integrate(system, x0, (0.0, steps * LONG[case]), LONG[case], method, save_every=steps // 50)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("compensated", [True, False])
@pytest.mark.parametrize("case", LONG)
def test_casimirs_of_splitting_follow_brouwer_where_sums_are_compensated(case, compensated):
    """Else they stay within the linear bound, and the energy error does not grow in time, up to a factor of two."""
    run = long_run(case, co.Splitting(order=2, compensated=compensated))
    bounds = rounding_of(run)
    if compensated:
        # In each flow the sine and the cosine are rounded, and their products with the components; a compensated
        # update rounds only increments, smaller than x by |h D_u|, u = grad H.
        flows, slope = run.stats.evaluations / run.stats.steps, run.system.hamiltonian.gradient
        turn = max(run.step * np.linalg.norm(run.system.algebra.coadjoint(slope(x)), 2) for x in run.x)
        bounds = {name: turn * walk(run, size, 4 * flows) for name, size in sizes_of(run).items()}
    assert all(run.drift()[name] <= bounds[name] for name in run.system.casimirs)
    assert run.drift()["energy"].growth < 2


@pytest.mark.thinned(2)
@pytest.mark.parametrize("stages", [2, 4])
@pytest.mark.parametrize("case", ["so(3), full, axes turned", "so(4), diagonal"])
def test_quadratic_invariants_of_gauss_follow_brouwer(case, stages):
    run = long_run(case, co.GaussLegendre(stages), STEPS // 4)
    for name, size in sizes_of(run).items():
        # Each stage is settled to a few roundings of each component.
        assert run.drift()[name] <= walk(run, size, 16 * run.system.dim * stages), name


# Members of ensembles: over 100 times the time a random walk grows by 10, a bias by 100.
MEMBERS, FEWER, STEP = 64, 100_000, 0.1
MOST_GROWTH, MOST_BIAS = 20.0, 3.0
SYSTEMS = {
    "rigid body": co.systems.rigid_body(inertia=(1, 2, 3)),
    "heavy top": co.LiePoissonSystem(
        co.algebras.e(3), co.Quadratic([1.0, 0.8, 0.5, 0, 0, 0], linear=[0, 0, 0, 0.2, 0.1, 1.0])
    ),
    "so(4), diagonal": cases()["so(4), diagonal"].system,
    "so(4), full": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(full_matrix(4, 6))),
}


@cache
def ensemble(name, attitude):
    system = SYSTEMS[name]
    x0 = np.random.default_rng(5).normal(size=(MEMBERS, system.dim))
    method, options = co.Splitting(order=2, compensated=True), {"save_every": FEWER // 100, "watch": False}
    return co.integrate(system, x0, (0.0, FEWER * STEP), STEP, method, attitude=attitude, **options)


def follows_the_law(walk):
    return walk.growth <= MOST_GROWTH and abs(walk.bias) <= MOST_BIAS


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", long_where(["so(4), full"], SYSTEMS))
def test_casimirs_and_spatial_momentum_of_ensembles_follow_the_law(name):
    solution = ensemble(name, "coadjoint")
    walks = co.analysis.round_off(solution)
    assert all(follows_the_law(walks[casimir]) for casimir in SYSTEMS[name].casimirs), walks
    assert follows_the_law(co.analysis.spatial_momentum(solution))


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", long_where(["so(4), full"], SYSTEMS))
def test_group_elements_of_ensembles_follow_the_law(name):
    assert follows_the_law(co.analysis.orthogonality(ensemble(name, True), 3 if name == "heavy top" else None))


def test_criterion_detects_a_bias():
    steps = np.random.default_rng(2).choice([-1.0, 1.0], (10_000, MEMBERS))
    walks = [co.analysis.random_walk(np.cumsum(steps + bias, axis=0), 100) for bias in (0.0, 0.1)]
    assert [follows_the_law(walk) for walk in walks] == [True, False]


LARGE_STEPS = 1000
ELLIPTIC = (1.0, 0.0, -1.0)


def turning_systems():
    rng = np.random.default_rng(353)
    so3 = co.algebras.so(3)
    return {
        "one axis": co.LiePoissonSystem(so3, co.Quadratic([0.0, 0.0, 1.0])),
        "a body": co.LiePoissonSystem(so3, co.Quadratic([0.125, 0.0656, 1.2877]), -1),
        "so(4)": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(rng.uniform(0.5, 2, 6))),
        "su(3)": co.LiePoissonSystem(co.algebras.su(3), co.Quadratic(rng.uniform(0.5, 2, 8)), -1),
        # Two shears, up to a length of 2 a periodic map as well.
        "shears": co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic(np.zeros(3), linear=ELLIPTIC)),
    }


@pytest.mark.thinned(6)
@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("h", [0.3, 0.9, 1.2, 1.7, 3.1])
@pytest.mark.parametrize("name", list(turning_systems()))
def test_large_steps_grow_only_round_off(name, h, sense):
    """Alone and in an ensemble; one rounding for each flow and step."""
    if name == "shears" and h > 2.0:
        pytest.skip("two shears are hyperbolic at this step")
    system = turning_systems()[name]
    states = np.random.default_rng(4).standard_normal((9, system.dim))
    span, scheme = (0.0, sense * LARGE_STEPS * h), co.Splitting(parts="coordinates", compensated=True)
    ensemble = co.integrate(system, states, span, h, scheme, attitude="coadjoint", save_every=LARGE_STEPS)
    K, x = ensemble.attitude, ensemble.x
    spatial = np.einsum("kmij,kmj->kmi", K, x)
    size = np.linalg.norm(K[-1], axis=(1, 2)) * np.linalg.norm(x[-1], axis=1)
    bound = LARGE_STEPS * (2 * system.dim + 2) * U
    assert np.max(np.linalg.norm(spatial[-1] - spatial[0], axis=1) / size) < bound
    for name_of, values in ensemble.casimirs.items():
        casimir = system.casimirs[name_of]
        for m in range(len(states)):
            scale = max(np.linalg.norm(casimir.gradient(state)) * np.linalg.norm(state) for state in x[:, m])
            assert abs(values[-1, m] - values[0, m]) < bound * scale
    alone = co.integrate(system, states[3], span, h, scheme, attitude="coadjoint", save_every=LARGE_STEPS)
    assert np.array_equal(alone.attitude, K[:, 3]) and np.array_equal(alone.x, x[:, 3])


@pytest.mark.thinned(3)
@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("attitude", [False, "coadjoint"])
@pytest.mark.parametrize("members", [200, 13])
def test_outputs_that_overflow_are_left_out(attitude, members):
    """Whether a state is saved or watched changes no other one.

    The steps are far too large: outputs of the processor overflow, and the kernel of the scheme goes on.
    """
    g, rng = co.algebras.get("A4,8"), np.random.default_rng(0)
    B = rng.standard_normal((g.dim, g.dim))
    system = co.LiePoissonSystem(g, co.Quadratic((B + B.T) / 4 + np.eye(g.dim)))
    x0 = (rng.standard_normal((200, g.dim)) * np.geomspace(1.0, 60.0, 200)[:, None])[:: 200 // members]
    given = (0.0, 1.2), 0.1, co.Splitting(scheme="blanes_casas_murua10")

    def run(start=x0, **options):
        try:
            return co.integrate(system, start, *given, attitude=attitude, threads=1, **options)
        except co.IntegrationError as error:
            return error.partial

    whole = run(watch=False)
    lost = ~np.isfinite(whole.x).all(axis=2)
    returns = (lost[:-1] & ~lost[1:]).any(axis=0)
    assert returns.any() or members < 200, "no output overflows alone"
    assert (lost == np.isnan(whole.x).any(axis=2)).all() and (lost == np.isnan(whole.energy)).all()
    assert (whole.failed == lost.any(axis=0)).all()
    watched = run(watch=True)
    np.testing.assert_array_equal(watched.x, whole.x)
    np.testing.assert_array_equal(watched.failed, whole.failed)
    if attitude:
        np.testing.assert_array_equal(watched.attitude, whole.attitude)
        assert (lost == np.isnan(whole.attitude).any(axis=(2, 3))).all()
    for save_every in (5, 7):
        for watch in (False, True):
            sparse = run(save_every=save_every, watch=watch)
            saved = [*range(0, 12, save_every), 12]
            np.testing.assert_array_equal(sparse.x, whole.x[saved])
            assert (sparse.failed == (lost[saved].any(axis=0) | lost[-1])).all()
    for m in [*np.flatnonzero(returns), 0, len(x0) - 1][:6]:
        for watch in (False, True):
            alone = run(x0[m], watch=watch)
            kept = len(alone.t)
            assert kept == (np.argmax(lost[:, m]) if lost[:, m].any() else 13)
            np.testing.assert_array_equal(alone.x, whole.x[:kept, m])
            sparse = run(x0[m], watch=watch, save_every=5)
            np.testing.assert_array_equal(sparse.x, whole.x[[0, 5, 10, 12], m][: len(sparse.t)])
