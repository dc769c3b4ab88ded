"""Prepared runs: the results of `integrate`, without set-up, in several threads."""

import copy
import dataclasses
import pickle
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

BODY = co.systems.rigid_body((1, 2, 3))
X = np.array([0.1, 1.0, 0.2])
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


CHAIN = co.systems.toda(4)
CHAIN_X = np.array([0.3, -0.2, 0.1, -0.2, 0.5, 0.6, 0.4])
LATER_CALLS = [
    (BODY, co.Splitting(order=4), X, 3),
    (BODY, co.GaussLegendre(2), X, 2),
    (co.systems.heavy_top((1, 2, 3)), co.Taylor(12), np.array([0.1, 0.3, 0.2, 0.0, 0.6, 0.8]), 4),
    (CHAIN, co.Taylor(10, tolerance=1e-6), CHAIN_X, 1),
]


@pytest.mark.parametrize(("system", "method", "x0", "save_every"), LATER_CALLS)
@pytest.mark.parametrize("watch", [False, True])
def test_later_calls_have_every_attribute_of_the_first(system, method, x0, save_every, watch):
    """Calls with the times of the call before take a short way, on which records are made lazily."""
    ready, given = co.prepare(system, method, 0.125, watch=watch), x0.copy()
    others = [1.1 * x0, 0.9 * x0]
    for other in others:  # of the arrays of earlier calls nothing is left
        ready.run(other, (0.5, 2.0), save_every)
    span = (0.5, 2.0)
    first = co.integrate(system, x0, span, 0.125, method, save_every=save_every, watch=watch)
    later = [ready.run(given, span, save_every) for _ in range(3)]
    given[:] = np.nan  # a solution has a copy
    for sol in (*later, copy.copy(later[0]), pickle.loads(pickle.dumps(later[1]))):
        for name in ("t", "x", "x0", "energy"):
            assert np.array_equal(getattr(sol, name), getattr(first, name)), name
        for name in ("casimirs", "initial"):
            ours, theirs = getattr(sol, name), getattr(first, name)
            assert list(ours) == list(theirs) and all(np.array_equal(ours[key], theirs[key]) for key in theirs), name
        for name in "watched step save_every t_span asked_span attitude carried failed events".split():
            assert getattr(sol, name) == getattr(first, name), name
        assert sol.system is system or sol.system.name == system.name
        assert sol.stats.steps == 12 and sol.stats.evaluations == first.stats.evaluations
        assert sol.stats.iterations == first.stats.iterations and 0.0 < sol.stats.seconds <= sol.stats.elapsed
        assert sol.drift() == first.drift() and not sol.work and not sol.observed and sol.incomplete is None
    assert np.array_equal(ready.end(x0, span), first.x[-1])


@pytest.mark.parametrize("position", range(3))
@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("method", [co.Splitting(), co.GaussLegendre(2), co.Taylor(8)])
def test_later_calls_refuse_states_that_are_not_finite(method, value, position):
    ready, span, bad = co.prepare(BODY, method, 0.125), (0.0, 1.0), X.copy()
    bad[position] = value
    expected = ready.run(X, span).x[-1]
    for _ in range(2):
        for call in (ready.run, ready.end):
            with refused(ValueError, "x0", "NaN"):
                call(bad, span)
        assert np.array_equal(ready.run(X, span).x[-1], expected) and np.array_equal(ready.end(X, span), expected)


def test_later_calls_fail_as_the_first():
    found = []
    ready = co.prepare(BODY, co.Taylor(16), 50.0)  # far beyond the radius of convergence
    for _ in range(3):
        with pytest.raises(co.IntegrationError) as caught:
            ready.run(X, (0.0, 500.0))
        found.append(caught.value)
    assert len({(str(error), error.step) for error in found}) == 1
    partial = [error.partial for error in found]
    for sol in partial[1:]:
        assert np.array_equal(sol.x, partial[0].x, equal_nan=True) and sol.incomplete == "failed"
    with pytest.raises(co.IntegrationError, match=str(found[0])[:20]):
        ready.end(X, (0.0, 500.0))


@pytest.mark.parametrize(
    ("system", "method"),
    [
        (BODY, co.Splitting(order=4, compensated=True)),
        (BODY, co.Splitting(order=2, rotation="rational")),
        (BODY, co.Splitting(order=2, parts="free_body")),
        (co.systems.spin_lattice("chain", 4, field=lambda t: [0.0, t, 0.1]), co.Splitting(order=2)),
        (co.systems.spin_lattice("chain", 4), co.Splitting(order=2, parts="bonds")),
    ],
    ids=str,
)
def test_runs_in_the_other_direction_are_those_prepared_for_it(system, method):
    x0 = np.linspace(0.2, 1.1, system.dim)
    first, fresh = (co.prepare(system, method, 0.1, attitude="coadjoint") for _ in range(2))
    first.run(x0, (1.0, 1.7))
    sols = [ready.run(x0, (1.0, 0.3)) for ready in (first, fresh)]
    for name in ("x", "attitude", "energy"):
        np.testing.assert_array_equal(getattr(sols[0], name), getattr(sols[1], name))
    np.testing.assert_allclose(first.run(sols[0].x[-1], (0.3, 1.0)).x[-1], x0, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    "method", [co.Splitting(order=4), co.GaussLegendre(3), co.RadauEnergy(2), co.Taylor(6)], ids=str
)
def test_threads_share_a_prepared_run(method):
    ready = co.prepare(BODY, method, 0.01, observe={"x1": lambda x: x[0]}, threads=1)
    states = X * np.linspace(0.5, 2.0, 8)[:, None]
    expected = [co.integrate(BODY, x, (0, 5), 0.01, method, save_every=50) for x in states]
    found, gate = {}, threading.Barrier(len(states))

    def work(m):
        gate.wait()
        for span in ((0, -0.01), (0, 5), (0, 5)):
            found[m] = ready.run(states[m], span, 50)

    with ThreadPoolExecutor(len(states)) as pool:
        list(pool.map(work, range(len(states))))
    for m, once in enumerate(expected):
        assert np.array_equal(found[m].x, once.x) and np.array_equal(found[m].energy, once.energy)


def test_initial_group_element_per_run():
    ready = co.prepare(BODY, None, 0.1, attitude=True)
    turned = ready.run(X, (0, 1), attitude=QUARTER)
    assert np.array_equal(turned.attitude, co.integrate(BODY, X, (0, 1), 0.1, attitude=QUARTER).attitude)
    assert np.array_equal(ready.run(X, (0, 1)).attitude[0], np.eye(3))
    for wrong in (True, "coadjoint"):
        with refused(ValueError, "attitude", wrong):
            ready.run(X, (0, 1), attitude=wrong)
    with refused(ValueError, "attitude", "prepare"):
        co.prepare(BODY, None, 0.1).run(X, (0, 1), attitude=QUARTER)
    with refused(ValueError, "attitude", "(2, 2)"):
        ready.run(X, (0, 1), attitude=np.eye(2))


def test_attributes_of_solutions_are_lazy_and_cached():
    """In any order, after other runs, and after the states are overwritten."""
    ready = co.prepare(BODY, co.Splitting(order=4), 0.1, attitude=True, observe={"x1": lambda x: x[0]})
    parts = "t energy casimirs attitude attitude0 initial observed t_span step save_every watched".split()
    for x in (X, np.array([X, 2 * X])):
        sol, other = ready.run(x, (0, 1), 4), ready.run(x, (0, 1), 4)
        at_once = {name: getattr(other, name) for name in parts}
        sol.x[:] = 0.0
        ready.run(2 * x, (0, 1), 4)
        for name in reversed(parts):
            np.testing.assert_equal(getattr(sol, name), at_once[name])
            assert getattr(sol, name) is getattr(sol, name)
        np.testing.assert_array_equal(copy.deepcopy(other).x, other.x)


def test_solutions_of_many_members():
    """So many that what belongs to single members is not kept."""
    sol, one = co.integrate(BODY, np.tile(X, (2**13, 1)), (0, 1), 0.1), co.integrate(BODY, X, (0, 1), 0.1)
    assert sol.stats.evaluations == 2**13 * one.stats.evaluations and not sol.failed.any()
    assert np.array_equal(sol.drift()["energy"].tenths[-1], one.drift()["energy"].tenths)


@pytest.mark.parametrize("size", [1e-200, 1.0, 1e200])
def test_nearly_singular_group_element_is_refused(size):
    ready = co.prepare(BODY, co.Splitting(order=2), 0.1, attitude=True)
    random = np.random.default_rng(3).standard_normal((3, 3))
    nearly = random.copy()
    nearly[2] = nearly[0] - nearly[1]
    nearly[2, 2] += 2.0**-53
    with refused(ValueError, "attitude", "singular"):
        ready.run(X, (0, 1), attitude=size * nearly)
    with refused(ValueError, "attitude", "singular"):
        ready.run(X, (0, 1), attitude=0.0 * random)
    steep = size * np.diag([1.0, 1.0, 1e-14])
    with refused(ValueError, "attitude", "rigid_body", "orthogonal"):
        ready.run(X, (0, 1), attitude=steep)
    # It is an element of the group of all matrices with positive determinant.
    every = co.LiePoissonSystem(co.algebras.gl(3), co.Quadratic(np.arange(1.0, 10.0)), casimirs={})
    whole = co.integrate(every, np.full(9, 0.1), (0, 1), 0.1, attitude=steep)
    assert np.array_equal(whole.attitude[0], steep)


@pytest.mark.parametrize("member", [0, 1, 2])
@pytest.mark.parametrize("attitude", [True, "coadjoint"])
def test_wrong_group_element_of_any_member_is_refused(member, attitude):
    ready, x = co.prepare(BODY, None, 0.1, attitude=attitude), np.array([X, -X, 2 * X])
    wrong = [(np.zeros((3, 3)), "singular"), (np.diag([1.0, 0.0, 1.0]), "singular"), (2.0 * np.eye(3), "no element")]
    wrong += [(np.diag([1.0, 1.0, np.nan]), "contains NaN"), (np.diag([1.0, 1.0, -1.0]), "no element")]
    for element, words in wrong:
        elements = np.stack([np.eye(3), QUARTER, QUARTER.T])
        assert ready.run(x, (0, 0.1), attitude=elements).attitude.shape == (2, 3, 3, 3)
        elements[member] = element
        with refused(ValueError, words):
            ready.run(x, (0, 0.1), attitude=elements)


def test_group_elements_are_copied():
    elements = np.stack([np.linalg.matrix_power(QUARTER, m) for m in range(3)])
    x, given = X * np.linspace(1, 2, 3)[:, None], elements.copy()
    listed = co.prepare(BODY, None, 0.1, attitude=given.tolist())
    for ready in (listed, co.prepare(BODY, None, 0.1, attitude=given)):
        given[:] = np.eye(3)
        assert np.array_equal(ready.run(x, (0, 1)).attitude[0], elements)
    # The second state is outside of the sample, and gets its own choice.
    given = elements[1].copy()
    ready = co.prepare(BODY, accuracy=1e-6, x0=X, t_span=(0, 2), attitude=given)
    given[:] = np.eye(3)
    for start in (X, 9.0 * X):
        assert np.array_equal(ready.run(start, (0, 2)).attitude[0], elements[1])


def test_solutions_are_frozen_and_name_missing_attributes():
    sol = co.integrate(BODY, X, (0, 1), 0.1)
    with refused(AttributeError, "momentum", "x"):
        _ = sol.momentum
    with pytest.raises(dataclasses.FrozenInstanceError):
        sol.x = X
