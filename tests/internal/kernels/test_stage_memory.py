"""What loops of stages keep between calls: all of it, and its effect on the number of iterations."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.arrays import Extent, Layout, NamedArrays
from coadjoint.kernels.loop import MemberBatch, StopFlag, scheme_memory
from coadjoint.kernels.tables.invariants import watch_tables
from coadjoint.kernels.tables.recording import schedule_of
from coadjoint.kernels.tables.runge_kutta import RUNGE_KUTTA_LOOP, runge_kutta_tables

H = co.Quadratic([1.0, 0.5, 0.4, 0.0, 0.0, 0.0], linear=[0.0, 0.0, 0.0, 0.75, 0.5, 1.0])
TOP, X0 = co.LiePoissonSystem(co.algebras.e(3), H, sign=-1), np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8])
STATE = ("momenta", "errors", "groups", "group_errors", "memory")


def some_states(members=35, spread=0.3):
    return X0 * (1 + spread * np.random.default_rng(0).standard_normal((members, len(X0))))


def run(method, x0, h, steps, *, cuts=(), keep=None, representation=None, fractions=(1.0,)):
    """Return the state at the end of a run that is cut into several calls.

    `keep` is called with the state between calls, and returns the one that the next call works with.
    """
    found = runge_kutta_tables(TOP, method, representation, fractions)
    watch = watch_tables(TOP, TOP.casimirs)
    (members, n), d = x0.shape, found.tables.group.size
    layout = Layout(Extent(members, 2, n, d * d, 1 + len(TOP.casimirs), scheme_memory(RUNGE_KUTTA_LOOP, found.tables)))
    saved, state = NamedArrays(layout.saved), NamedArrays(layout.state)
    state["momenta"][:], state["groups"][:] = x0, np.eye(d).ravel()
    member_batch = MemberBatch(RUNGE_KUTTA_LOOP, found.tables, watch.tables, 0, members, 0)
    for k0, k1 in pairwise([0, *cuts, steps]):
        member_batch.advance(layout, schedule_of(0.0, h, steps, steps, True), saved, state, k0, k1, StopFlag())
        if keep is not None:
            state = keep(state)
    return state


def test_the_memory_matters():
    """The control: a run that forgets its slopes between calls comes to the same states, but with more iterations."""
    method, states = co.GaussLegendre(8), X0[None]

    def forgetful(state):
        state["memory"][:] = np.nan
        return state

    whole = run(method, states, 0.1, 60)
    other = run(method, states, 0.1, 60, cuts=tuple(range(1, 60)), keep=forgetful)
    assert np.max(np.abs(whole["momenta"] - other["momenta"])) < 1e-12
    assert whole["iterations"][0] < 0.75 * other["iterations"][0]


def test_trust_that_is_too_great_is_lost_again():
    """What a step need not test is one iteration less after each step that needed fewer: 12, 11, ... where 6 are."""
    method, states = co.GaussLegendre(8), X0[None]

    def trusting(state):
        state["memory"][:, 1] = 12.0
        return state

    whole = run(method, states, 0.1, 60)
    other = run(method, states, 0.1, 60, cuts=(20,), keep=trusting)
    assert np.max(np.abs(whole["momenta"] - other["momenta"])) < 1e-13
    assert whole["iterations"][0] < other["iterations"][0] < whole["iterations"][0] + 12 * 13 // 2


@pytest.mark.parametrize("method", [co.GaussLegendre(2), co.GaussLegendre(6)], ids=repr)
def test_trust_does_not_change_when_a_step_is_settled(method):
    """Iterations that are not tested would not have been the last: there are as many as where all are tested."""
    states = some_states()

    def doubting(state):
        state["memory"][:, 1] = 0.0
        return state

    whole = run(method, states, 0.1, 60)
    other = run(method, states, 0.1, 60, cuts=tuple(range(1, 60)), keep=doubting)
    assert np.max(np.abs(whole["momenta"] - other["momenta"])) < 1e-12
    assert abs(np.sum(whole["iterations"]) / np.sum(other["iterations"]) - 1) < 0.03
