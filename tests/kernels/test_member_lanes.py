"""Members of an ensemble are lanes, and a trajectory alone has its stages as lanes: both have the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from test_runge_kutta import SCHEMES, systems

import coadjoint as co
from coadjoint.kernels.arrays import NamedArrays
from runs import STATE, run
from served import serves

pytestmark = pytest.mark.thinned(6)

MEMBERS = 35  # a whole block of lanes on every processor, and some that are left
METHODS = (
    *SCHEMES,
    co.GaussLegendre(4),
    co.GaussLegendre(8),
    co.GaussLegendre(20),
    co.Composition(co.GaussLegendre(2), (1.3, -1.6, 1.3)),
)


def some_states(x0, members=MEMBERS, spread=0.3):
    return x0 * (1 + spread * np.random.default_rng(0).standard_normal((members, len(x0))))


@pytest.mark.thinned(45)
@pytest.mark.parametrize("name", list(systems()))
@pytest.mark.parametrize("method", METHODS, ids=repr)
def test_members_have_the_bits_that_they_have_alone(name, method):
    system, x0 = systems()[name]
    if not serves(method, system):
        with pytest.raises(ValueError, match="take"):
            method.properties(system)
        return
    kind = method.properties(system).attitude
    how = {"attitude": "coadjoint" if system.algebra is not None and kind != "none" else False}
    states, h = some_states(x0), 0.02 if name in ("A3,7", "driven") else 0.1
    ensemble = co.integrate(system, states, (0.0, 12 * h), h, method, threads=1, **how)
    runs = [co.integrate(system, x, (0.0, 12 * h), h, method, **how) for x in states]
    for i, alone in enumerate(runs):
        assert np.array_equal(alone.x, ensemble.x[:, i])
        assert np.array_equal(alone.energy, ensemble.energy[:, i])
        assert how["attitude"] is False or np.array_equal(alone.attitude, ensemble.attitude[:, i])
    assert sum(alone.stats.iterations for alone in runs) == ensemble.stats.iterations
    assert sum(alone.stats.evaluations for alone in runs) == ensemble.stats.evaluations


@pytest.mark.parametrize("stages", [2, 3, 4, 5, 7, 8, 9, 12, 16, 17, 33])
@pytest.mark.parametrize("name", ["top", "quartic", "driven"])
def test_stages_as_lanes_are_the_plain_reading(name, stages):
    """Blocks of 4, 8 and 16 lanes, full and not: both round n products in each of the s stages, times h |f'| < 1."""
    system, x = systems()[name]
    method = co.GaussLegendre(stages)
    found, expected = co.stepper(system, method, 0.125)(x, 0.75), method.step(system, x, 0.75, 0.125)
    assert np.max(np.abs(found - expected)) <= 8 * len(x) * 2.0**-53 * np.max(np.abs(x))


@pytest.mark.parametrize("method", [co.GaussLegendre(1), co.GaussLegendre(3)], ids=repr)
def test_members_that_need_newton_or_fail_have_the_bits_that_they_have_alone(method):
    """Large steps on a noncompact orbit: some settle, some take Newton's method, some have no solution."""
    system, x0 = systems()["driven"]
    states, h, steps = some_states(x0), 0.25, 8
    state, _ = run([system], method, states, h, steps)
    ends = [run([system], method, states[i : i + 1], h, steps)[0] for i in range(MEMBERS)]
    assert 3 < np.count_nonzero(state["status"]) < MEMBERS - 3
    for i, alone in enumerate(ends):
        for name in ("status", "step", "iterations", "evaluations"):
            assert state[name][i] == alone[name][0], (i, name)
        assert np.array_equal(state["residual"][i], alone["residual"][0], equal_nan=True)
        assert all(np.array_equal(state[name][i], alone[name][0], equal_nan=True) for name in STATE)
        assert np.array_equal(state["worst"][i], alone["worst"][0])


@pytest.mark.parametrize(
    "method",
    [
        co.GaussLegendre(3),
        co.ModifiedGaussLegendre(2),
        co.ModifiedGaussLegendre(2, freeze="gradient"),
        co.IteratedGaussLegendre(2),
        co.ExplicitRungeKutta("rk4"),
    ],
    ids=repr,
)
@pytest.mark.parametrize("h", [0.1, 2.5])
def test_members_with_constants_of_their_own(method, h):
    """With the larger step some of them take Newton's method."""
    inertias = np.random.default_rng(4).uniform(0.5, 2.0, (MEMBERS, 3))
    bodies = [co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(1 / inertia)) for inertia in inertias]
    representation = "coadjoint" if method.properties(bodies[0]).attitude != "none" else None
    states = some_states(np.array([1.0, 2.0, 0.5]))
    state, saved = run(bodies, method, states, h, 10, representation=representation)
    for i, body in enumerate(bodies):
        alone, own = run([body], method, states[i : i + 1], h, 10, representation=representation)
        assert all(np.array_equal(state[name][i], alone[name][0], equal_nan=True) for name in STATE)
        # what is watched has the constants of a member as well, from its start on
        assert np.array_equal(saved["values"][1, i], own["values"][1, 0], equal_nan=True)


CUTS = (1, 2, 7, 40)


@pytest.mark.parametrize("members", [1, 5])
@pytest.mark.parametrize(
    "method", [co.GaussLegendre(2), co.GaussLegendre(8), co.ModifiedGaussLegendre(2, freeze="gradient")], ids=repr
)
def test_cut_and_resumed_runs_have_the_same_bits(method, members):
    """What is kept between calls is all there is: copied, and handed to a loop that knows nothing else."""
    system, x0 = systems()["top"]
    states = some_states(x0, members)
    for how in ({}, {"fractions": (1.3, -1.6, 1.3)}):
        whole, _ = run([system], method, states, 0.1, 60, representation="coadjoint", **how)
        cut, _ = run([system], method, states, 0.1, 60, representation="coadjoint", cuts=CUTS, **how)
        resumed, _ = run(
            [system],
            method,
            states,
            0.1,
            60,
            representation="coadjoint",
            cuts=CUTS,
            keep=NamedArrays.copy,
            **how,
        )
        for other in (cut, resumed):
            assert all(np.array_equal(whole[name], other[name], equal_nan=True) for name in STATE)


def test_the_memory_matters():
    """The control: a run that forgets its slopes between calls comes to the same states, but with more iterations."""
    system, x0 = systems()["top"]
    method, states = co.GaussLegendre(8), x0[None]

    def forgetful(state):
        state["memory"][:] = np.nan
        return state

    whole, _ = run([system], method, states, 0.1, 60)
    other, _ = run([system], method, states, 0.1, 60, cuts=tuple(range(1, 60)), keep=forgetful)
    assert np.max(np.abs(whole["momenta"] - other["momenta"])) < 1e-12
    assert whole["iterations"][0] < 0.75 * other["iterations"][0]


def test_trust_that_is_too_great_is_lost_again():
    """What a step need not test is one iteration less after each step that needed fewer: 12, 11, ... where 6 are."""
    system, x0 = systems()["top"]
    method, states = co.GaussLegendre(8), x0[None]

    def trusting(state):
        state["memory"][:, 1] = 12.0
        return state

    whole, _ = run([system], method, states, 0.1, 60)
    other, _ = run([system], method, states, 0.1, 60, cuts=(20,), keep=trusting)
    assert np.max(np.abs(whole["momenta"] - other["momenta"])) < 1e-13
    assert whole["iterations"][0] < other["iterations"][0] < whole["iterations"][0] + 12 * 13 // 2


@pytest.mark.parametrize("method", [co.GaussLegendre(2), co.GaussLegendre(6)], ids=repr)
def test_trust_does_not_change_when_a_step_is_settled(method):
    """Iterations that are not tested would not have been the last: there are as many as where all are tested."""
    system, x0 = systems()["top"]
    states = some_states(x0)

    def doubting(state):
        state["memory"][:, 1] = 0.0
        return state

    whole, _ = run([system], method, states, 0.1, 60)
    other, _ = run([system], method, states, 0.1, 60, cuts=tuple(range(1, 60)), keep=doubting)
    assert np.max(np.abs(whole["momenta"] - other["momenta"])) < 1e-12
    assert abs(np.sum(whole["iterations"]) / np.sum(other["iterations"]) - 1) < 0.03


def test_a_stepper_that_failed_serves_again():
    system, x0 = systems()["driven"]
    step = co.stepper(system, co.GaussLegendre(3), 0.5)
    before = step(0.1 * x0)
    with pytest.raises(co.IntegrationError):
        step(100.0 * x0)
    assert np.array_equal(step(0.1 * x0), before)
