"""Derivatives of the times and states of crossings, and of runs that they end, against differences of whole runs."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.parameters import with_parameters

WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
# So small that no crossing appears or moves over a saved point.
DISTANCE = 2.0**-12
# Rounding of the crossings over the distance, and of differences along a step for their rates.
DIFFERENCE_ERROR = 2.0**10 * UNIT_ROUNDOFF / DISTANCE
H = 0.1

BODY = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
TOP = co.systems.heavy_top(inertia=(1.0, 2.0, 2.5), lever=(0.1, 0.2, 1.0))
X = np.array([1.0, 0.2, 0.5])
PAIR = np.array([X, [0.5, 0.3, 0.9]])
X6 = np.array([0.3, 1.0, 0.2, 0.1, 0.4, 0.9])
END = co.Event("x2", terminal=True)
BATCH = co.batch([BODY, co.systems.rigid_body(inertia=(1.0, 2.0, 2.7))])

DRIVEN = co.LiePoissonSystem(
    co.algebras.so(3),
    co.Quadratic([1.0, 0.5, 0.4])
    + co.Separable({0: (lambda y, t: np.cos(3 * t) * y, lambda y, t: np.cos(3 * t), lambda y, t: 0 * y)}),
    name="driven",
)


def moving(x, t):
    return x[1] * x[2] - 0.1 * t


def turning(x, t):
    """A component along an axis that turns, so that its gradient depends on the time."""
    return np.cos(0.5 * t) * x[1] + np.sin(0.5 * t) * x[2]


CASES = {
    "forward": (BODY, co.Splitting(order=4), X, (0.5, 20.5), {"events": END, "save_every": 3}, False),
    "backward": (BODY, co.Splitting(), X, (0.5, -19.5), {"events": END, "t_eval": [0.43, -0.2, -1.5, -8.0]}, False),
    "attitude": (BODY, co.Splitting(order=4), X, (0.5, 20.5), {"events": END}, True),
    "moving": (
        BODY,
        co.GaussLegendre(2),
        X,
        (0.5, 20.5),
        {"events": [co.Event(moving), co.Event("x2", count=2, terminal=True)], "save_every": 7},
        False,
    ),
    "turning": (
        BODY,
        co.GaussLegendre(2),
        X,
        (0.5, 10.5),
        {"events": co.Event(turning, count=2, terminal=True), "save_every": 7},
        False,
    ),
    "polynomial": (
        BODY,
        co.Splitting(order=4),
        X,
        (0.5, 5.5),
        {"events": co.Event(co.Polynomial({(0, 1, 1): 1.0, (1, 0, 0): -0.03}))},
        False,
    ),
    "stepwise": (TOP, co.Taylor(order=8), X6, (0.0, 2.0), {"events": co.Event(2)}, False),
    "driven": (DRIVEN, co.GaussLegendre(2), X, (0.5, 5.5), {"events": co.Event("x2"), "save_every": 7}, False),
    "ensemble": (BODY, co.Splitting(order=4), PAIR, (0.5, 20.5), {"events": END, "save_every": 3}, False),
    "batch": (BATCH, co.Splitting(order=4), PAIR, (0.5, 20.5), {"events": END, "save_every": 3}, True),
    "none": (BODY, co.Splitting(), X, (0.0, 0.1), {"events": END}, False),
}


def moved(system, values):
    if not isinstance(system, type(BATCH)):
        return with_parameters(system, values) if values else system
    return co.batch([with_parameters(s, {k: v[m] for k, v in values.items()}) for m, s in enumerate(system)])


def outputs(result):
    found = {name: getattr(result, name) for name in ("x", "energy", "attitude")}
    events = result.events if isinstance(result.events, dict) else {k: getattr(result.events, k) for k in ("t", "x")}
    return {name: one for name, one in found.items() if one is not None}, events


@pytest.mark.parametrize("name", CASES)
def test_derivatives_of_crossings_are_those_of_runs(name):
    system, method, x0, span, options, attitude = CASES[name]
    rng, ready = np.random.default_rng(5), co.prepare(system, method, H, attitude=attitude)
    plain = ready.run(x0, span, **options)
    sol, pullback = ready.vjp(x0, span, **options)
    assert np.array_equal(sol.t, plain.t) and np.array_equal(sol.x, plain.x, equal_nan=True)
    series, events = outputs(sol)
    assert (len(events["t"]) > 0) == (name != "none")
    # Members of ensembles that have ended are NaN.
    weights = {k: np.where(np.isfinite(one), rng.standard_normal(one.shape), 0.0) for k, one in series.items()}
    of_events = {k: rng.standard_normal(one.shape) for k, one in events.items()}
    gradient = pullback(**weights, events=of_events)
    directions = {"x0": rng.standard_normal(x0.shape)}
    directions |= {k: rng.standard_normal(v.shape) for k, v in ready.parameters.items()}
    _, tangents = ready.jvp(x0, span, directions, **options)
    assert tangents.x.shape == sol.x.shape and tangents.events["x"].shape == sol.events.x.shape

    def functional(result):
        series, events = outputs(result)
        total = sum(np.sum(one[weights[k] != 0.0] * weights[k][weights[k] != 0.0]) for k, one in series.items())
        return total + sum(np.sum(one * of_events[k]) for k, one in events.items())

    def after(by):
        values = {k: v + by * directions[k] for k, v in ready.parameters.items()}
        other = co.prepare(moved(system, values), method, H, attitude=attitude)
        return functional(other.run(x0 + by * directions["x0"], span, **options))

    differences = sum(w * (after(k * DISTANCE) - after(-k * DISTANCE)) / DISTANCE for k, w in enumerate(WEIGHTS, 1))
    backward = sum(np.sum(gradient[k] * direction) for k, direction in directions.items())
    size = sum(np.sum(np.abs(gradient[k] * direction)) for k, direction in directions.items())
    assert abs(backward - functional(tangents)) <= 2.0**12 * UNIT_ROUNDOFF * size
    assert abs(backward - differences) <= DIFFERENCE_ERROR * size


def test_the_time_of_a_crossing_follows_the_closed_form():
    """A body that spins about a symmetry axis with the rate w crosses x1 = 0 at a quarter turn, pi / (2 w)."""
    body = co.systems.rigid_body(inertia=(1.0, 1.0, 2.0))
    ready = co.prepare(body, co.Splitting(order=8), 0.05)
    # x1 + i x2 turns with the rate x3 (1/I3 - 1/I1) = -x3/2.
    sol, tangents = ready.jvp([1.0, 0.0, 1.0], (0.0, 5.0), {"x0": np.eye(3)}, events=co.Event("x1"))
    np.testing.assert_allclose(sol.events.t, [np.pi], rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.abs(tangents.events["t"]), [[0.0, 2.0, np.pi]], rtol=0, atol=1e-11)


@pytest.mark.parametrize("end", [5.0, 5.2, 8.0])
def test_tangents_after_the_end_of_a_member_are_those_of_no_state(end):
    body = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
    ready = co.prepare(body, co.Splitting(order=4), 0.1, attitude=True)
    x0 = np.array([[1.0, 0.2, 0.5], [0.5, 0.3, 0.9], [0.9, -0.1, 0.4]])
    event = co.Event("x2", terminal=True)
    sol, tangents = ready.jvp(x0, (0, end), {"x0": np.ones((3, 3))}, save_every=4, events=event)
    assert np.isnan(sol.x[-1]).any()
    for m in range(3):
        gone = np.isnan(sol.x[:, m, 0])
        assert np.isnan(tangents.x[gone, m]).all() and np.isfinite(tangents.x[~gone, m]).all()
        assert np.isnan(tangents.energy[gone, m]).all() and np.isfinite(tangents.energy[~gone, m]).all()
        assert np.isnan(tangents.attitude[gone, m]).all() and np.isfinite(tangents.attitude[~gone, m]).all()


def test_observed_quantities_of_the_time_move_with_the_crossing_that_ends_a_run():
    body = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
    observe = {"clock": lambda x, t: t, "both": lambda x, t: x[0] * t**2, "state": lambda x: x[2] ** 2}
    ready = co.prepare(body, co.Splitting(order=4), step=0.05, observe=observe)
    event, x0 = co.Event(lambda x: x[1] + 0.2, terminal=True), np.array([1.0, 0.2, 0.5])
    sol, pullback = ready.vjp(x0, (1.0, 21.0), save_every=7, events=event)
    assert sol.events.ends(1)[0] < 20.0
    weights = {name: np.random.default_rng(k).standard_normal(len(sol.t)) for k, name in enumerate(observe)}
    found = pullback(observed=weights)["x0"]

    def total(x):
        run = ready.run(x, (1.0, 21.0), save_every=7, events=event)
        return sum(weights[name] @ run.observed[name] for name in observe)

    h = 2.0**-12
    nodes, factors = (1, 2, 3, 4), (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    for i, unit in enumerate(np.eye(3)):
        pairs = zip(nodes, factors, strict=True)
        wanted = sum(w / h * (total(x0 + k * h * unit) - total(x0 - k * h * unit)) for k, w in pairs)
        assert abs(found[i] - wanted) < 1e-8 * np.abs(found).max()


def without(series, gone, value):
    """Return cotangents with other values where a member has ended."""
    return {k: np.where(gone.reshape(*gone.shape, *[1] * (one.ndim - 2)), value, one) for k, one in series.items()}


@pytest.mark.parametrize("end", [5.0, 5.2, 8.0])
def test_cotangents_after_the_end_of_a_member_do_not_count(end):
    """They are those of no state, and may be NaN like the states."""
    rng = np.random.default_rng(3)
    ready = co.prepare(BODY, co.Splitting(order=4), 0.1, attitude=True)
    x0 = np.array([[1.0, 0.2, 0.5], [0.5, 0.3, 0.9], [0.9, -0.1, 0.4]])
    sol, pullback = ready.vjp(x0, (0, end), save_every=4, events=END)
    gone = np.isnan(sol.x[..., 0])
    assert gone.any()
    weights = {name: rng.standard_normal(getattr(sol, name).shape) for name in ("x", "energy", "attitude")}
    wanted = pullback(**without(weights, gone, 0.0))
    for given in (weights, without(weights, gone, np.nan)):
        found = pullback(**given)
        assert all(np.array_equal(found[name], value) for name, value in wanted.items())


def test_events_of_a_pullback_without_them_are_refused():
    ready = co.prepare(BODY, co.Splitting(), H)
    _, pullback = ready.vjp(X, (0.0, 1.0))
    with pytest.raises(ValueError, match="give events= to vjp"):
        pullback(events={"t": []})
    for x0, wrong in ((X, (2,)), ([X, X], (3,))):
        _, pullback = ready.vjp(x0, (0.0, 20.0), events=END)
        with pytest.raises(ValueError, match=rf"t of events has the shape \({wrong[0]},\)"):
            pullback(events={"t": np.ones(wrong)})
        with pytest.raises(ValueError, match="unknown result of events 'time'"):
            pullback(events={"time": [1.0]})
