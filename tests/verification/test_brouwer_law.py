"""Brouwer's law: round-off of 64 members grows like a random walk, without bias."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.round_off import orthogonality, random_walk, round_off, spatial_momentum
from long import long_where

from .systems_under_test import cases, full_matrix

MEMBERS, STEPS, STEP = 64, 100_000, 0.1
# A random walk over 100 times the time grows by 10, a bias by 100.
MOST_GROWTH, MOST_BIAS = 20.0, 3.0
E3 = co.algebras.get("e(3)")
SYSTEMS = {
    "rigid body": co.systems.rigid_body(inertia=(1, 2, 3)),
    "heavy top": co.LiePoissonSystem(E3, co.Quadratic([1.0, 0.8, 0.5, 0, 0, 0], linear=[0, 0, 0, 0.2, 0.1, 1.0])),
    "so(4), diagonal": cases()["so(4), diagonal"].system,
    "so(4), full": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(full_matrix(4, 6))),
    "so(3), full": co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(full_matrix(3, 3))),
}
COMPENSATED = co.Splitting(order=2, compensated=True)


def ensemble(name, method, steps=STEPS, **options):
    system = SYSTEMS[name]
    x0 = np.random.default_rng(5).normal(size=(MEMBERS, system.dim))
    span = (0.0, steps * STEP)
    return co.integrate(system, x0, span, STEP, method, save_every=steps // 100, watch=False, **options)


def follows_the_law(walk):
    return walk.growth <= MOST_GROWTH and abs(walk.bias) <= MOST_BIAS


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", long_where(["so(4), full"], SYSTEMS))
def test_casimirs_of_compensated_splitting_follow_the_law(name):
    walks = round_off(ensemble(name, COMPENSATED))
    for casimir in SYSTEMS[name].casimirs:
        assert follows_the_law(walks[casimir]), (casimir, walks[casimir])


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", long_where(["so(4), full"], SYSTEMS))
def test_group_elements_of_splitting_follow_the_law(name):
    solution = ensemble(name, COMPENSATED, attitude=True)
    walk = orthogonality(solution, 3 if name == "heavy top" else None)
    assert follows_the_law(walk), walk


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", long_where(["so(4), full"], SYSTEMS))
def test_spatial_momentum_of_splitting_follows_the_law(name):
    solution = ensemble(name, COMPENSATED, attitude="coadjoint")
    walk = spatial_momentum(solution)
    assert follows_the_law(walk), walk


def test_criterion_detects_a_bias():
    steps = np.random.default_rng(2).choice([-1.0, 1.0], (10_000, MEMBERS))
    walks = [random_walk(np.cumsum(steps + bias, axis=0), 100) for bias in (0.0, 0.1)]
    assert [follows_the_law(walk) for walk in walks] == [True, False]
