"""Poincare sections: the crossings of each member alone, invariants, plots and arguments."""

import numpy as np
import pytest

import coadjoint as co
from long import long_beyond
from refusals import refused
from rounding import UNIT_ROUNDOFF as U


def starts(members, seed=1):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(members, 3))
    return np.hstack([rng.normal(size=(members, 3)), axis / np.linalg.norm(axis, axis=1)[:, None]])


METHODS = [co.Splitting(order=4), co.GaussLegendre(2), co.Taylor(order=12)]


@pytest.mark.parametrize("method", long_beyond(1, METHODS), ids=str)
def test_members_end_after_the_given_crossings(method):
    top, x0 = co.systems.kovalevskaya_top(), starts(40)
    found = co.poincare_section(top, x0, co.Event(1, direction=1), (0, 400), 0.125, method, crossings=7)
    assert (found.counts == 7).sum() > 30 and found.x.shape == (40, 7, 6)
    sol = co.integrate(top, x0, (0, 400), 0.125, method, save_every=3200, events=co.Event(1, direction=1, count=7))
    assert np.array_equal(found.events.t, sol.events.t) and np.array_equal(found.events.x, sol.events.x)
    for m in (0, 11, 39):
        alone = co.poincare_section(top, x0[m], co.Event(1, direction=1), (0, 400), 0.125, method, crossings=7)
        assert np.array_equal(alone.events.x, found.events.of(m).x)
    there = np.isfinite(found.t)
    assert np.array_equal(there, np.arange(7) < found.counts[:, None])
    assert np.all(np.diff(found.t, axis=1)[there[:, 1:]] > 0) and np.isnan(found.x[~there]).all()


def test_casimirs_are_preserved_on_the_section():
    top = co.systems.kovalevskaya_top()
    found = co.poincare_section(top, starts(12), co.Event(1, direction=1), (0, 200), 0.0625, co.Splitting(order=4))
    x = found.events.x
    for name, casimir in top.casimirs.items():
        at_start = np.array([casimir(x0) for x0 in starts(12)])[found.events.member]
        values = np.array([casimir(one) for one in x])
        # 3200 steps of some twelve turns, each of which rounds.
        assert abs(values - at_start).max() < 3200 * 12 * U * max(1.0, abs(at_start).max()), name
    assert abs(x[:, 1]).max() < 64 * U * abs(x).max()


def test_plots_and_refusals_of_sections():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    found = co.poincare_section(body, [(0.1, 1.0, 0.1), (0.2, 1.0, 0.1)], co.Event("x2"), (0, 100), 0.125)
    figure = found.plot()
    (axes,) = figure.axes
    assert axes.get_xlabel() == "$x_{1}$" and axes.get_ylabel() == "$x_{3}$"
    assert sum(len(line.get_xdata()) for line in axes.lines) == len(found.events)
    assert found.plot(components=("x3", 0)).axes[0].get_xlabel() == "$x_{3}$"
    with refused(ValueError, "x9"):
        found.plot(components=("x3", "x9"))
    with refused(ValueError, "no crossings"):
        co.poincare_section(body, (1.0, 0.2, 0.1), co.Event(0), (0, 1), 0.125).plot()
    with refused(TypeError, "Event"):
        co.poincare_section(body, (1.0, 0.2, 0.1), "x2", (0, 1), 0.125)
    with refused(ValueError, "crossings", "0"):
        co.poincare_section(body, (1.0, 0.2, 0.1), co.Event(0), (0, 1), 0.125, crossings=0)


def test_members_without_crossings_have_empty_rows():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    x0, rest = np.array([0.1, 1.0, 0.1]), np.array([0.0, 0.0, 1.0])
    event, given = co.Event("x2"), ((3.0, 63.0), 0.125)
    own = co.poincare_section(body, x0, event, *given)
    assert own.x.shape[:2] == (1, len(own.events)) and own.counts.tolist() == [len(own.events)] and len(own.events) > 1
    found = co.poincare_section(body, [rest, x0, rest, x0, rest, rest], event, *given)
    assert found.counts.tolist() == [0, *own.counts, 0, *own.counts, 0, 0]
    for m in range(6):
        if m in (1, 3):
            assert np.array_equal(found.x[m], own.x[0]) and np.array_equal(found.t[m], own.t[0])
        else:
            assert np.isnan(found.x[m]).all() and np.isnan(found.t[m]).all()
    none = co.poincare_section(body, [rest, rest], event, *given)
    assert none.x.shape == (2, 0, 3) and none.t.shape == (2, 0) and none.counts.tolist() == [0, 0]
    assert co.poincare_section(body, rest, event, *given).counts.tolist() == [0]
    assert repr(found) == f"<section: {2 * len(own.events)} crossings of x2 by 6 members>"


def test_sections_are_runs_that_end_at_the_last_crossing():
    body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), [(0.1, 1.0, 0.1)] * 2
    found = co.poincare_section(
        body, x0, co.Event("x2", -1, name="down"), (1, 101), 0.125, co.GaussLegendre(2), crossings=2
    )
    ended = co.Event("x2", -1, count=2, terminal=True, name="down")
    sol = co.integrate(body, x0, (1, 101), 0.125, co.GaussLegendre(2), events=ended, watch=False)
    assert np.array_equal(found.events.t, sol.events.t) and np.array_equal(found.events.x, sol.events.x)
    assert found.events.names == sol.events.names == ("down",) and found.counts.tolist() == [2, 2]
    chosen = co.poincare_section(body, x0, co.Event("x2", -1), (1, 21), accuracy=1e-6, method=co.GaussLegendre(2))
    exact = co.poincare_section(body, x0, co.Event("x2", -1), (1, 21), 2.0**-7, co.GaussLegendre(4))
    assert len(chosen.events) and np.abs(chosen.events.x - exact.events.x).max() < 1e-5
