"""Long runs: invariants drift like sqrt(t) with compensated sums (Brouwer's law), else at most linearly."""

from functools import cache

import numpy as np
import pytest

import coadjoint as co
from digests.measures import drift_bounds
from digests.systems_under_test import cases, full_matrix
from long import long_where
from rounding import UNIT_ROUNDOFF

STEPS = 1_000_000
LONG = {"so(3), full, axes turned": 0.1, "so(4), diagonal": 0.1, "e(3), heavy top": 0.1, "sl(2), diagonal": 0.05}


def walk(run, size, per_step):
    """Return six standard deviations of a random walk with `per_step` roundings of u times size in each step."""
    return 6 * UNIT_ROUNDOFF * size * np.sqrt(per_step * run.stats.steps)


def sizes_of(run):
    """Return |gradient| |x| for each invariant."""
    gradients = {"energy": run.system.hamiltonian.gradient, **{k: C.gradient for k, C in run.system.casimirs.items()}}
    return {
        name: max(np.linalg.norm(gradient(x)) * np.linalg.norm(x) for x in run.x)
        for name, gradient in gradients.items()
    }


def turn_of_a_step(run):
    """Return |h D_u|, u = grad H: a compensated update rounds only increments, smaller than x by this factor."""
    system = run.system
    return max(run.step * np.linalg.norm(system.algebra.coadjoint(system.hamiltonian.gradient(x)), 2) for x in run.x)


def long_run(case, method, steps=STEPS):
    system, x0, _ = cases()[case]
    return co.integrate(system, x0, (0.0, steps * LONG[case]), LONG[case], method, save_every=steps // 50)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("compensated", [True, False])
@pytest.mark.parametrize("case", LONG)
def test_casimirs_of_splitting_follow_brouwer_where_sums_are_compensated(case, compensated):
    """Else they stay within the linear bound, and the energy error does not grow in time, up to a factor of two."""
    run = long_run(case, co.Splitting(order=2, compensated=compensated))
    bounds = drift_bounds(run)
    if compensated:
        # In each flow the sine and the cosine are rounded, and their products with the components.
        flows, turn = run.stats.evaluations / run.stats.steps, turn_of_a_step(run)
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
