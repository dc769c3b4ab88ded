"""Schemes and steps for an accuracy: reached against known motions, reproducible, described."""

import dataclasses
import math
import re

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.sensitive

BODY = co.systems.rigid_body(inertia=(1.0, 2.0, 3.0))
X0, SPAN = (1.0, 0.2, 0.5), (0.0, 40.0)
SO4 = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic([1.0, 0.5, 0.3, 0.2, 0.7, 0.9]), sign=-1)
X6 = (0.5, -0.3, 0.8, 0.1, 0.6, -0.2)
LINE = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
SINGLE = {
    "splitting": co.Splitting(order=6),
    "gauss": co.GaussLegendre(4),
    "taylor": co.Taylor(order=14),
    "own steps": co.Taylor(tolerance=1e-9),
}


# A rigid body with an accelerating clock: x(t) is that of the body after the time e^t - e^t0.
QUICKENING = co.Hamiltonian(
    lambda x, t: 0.5 * math.exp(t) * (x[0] ** 2 / 1.0 + x[1] ** 2 / 2.0 + x[2] ** 2 / 3.0),
    lambda x, t: math.exp(t) * np.array([x[0], x[1] / 2.0, x[2] / 3.0]),
)
DRIVEN = co.LiePoissonSystem(co.algebras.so(3), QUICKENING, sign=-1)
TODA, FAR = co.systems.toda(5), np.concatenate([np.zeros(5), np.full(4, 0.5)])
MOTIONS = {
    "body": (BODY, X0, (0.0, 40.0), lambda t0, t: BODY.exact(X0, t - t0)),
    "body backward": (BODY, X0, (24.0, -16.0), lambda t0, t: BODY.exact(X0, t - t0)),
    "fast clock": (DRIVEN, X0, (2.0, 2.5), lambda t0, t: BODY.exact(X0, math.exp(t) - math.exp(t0))),
    "slow clock": (DRIVEN, X0, (-3.0, -3.5), lambda t0, t: BODY.exact(X0, math.exp(t) - math.exp(t0))),
    "so(4)": (SO4, X6, (1.0, 31.0), None),
    "particles that fly apart": (TODA, FAR, (0.0, -60.0), None),
    "decay": (co.LiePoissonSystem(LINE, co.Quadratic(0.0, linear=[1.0, 0.0])), (0.0, 1e12), (0.0, 8.0), None),
}
OWN = [co.Taylor(tolerance=1e-9)]


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("accuracy", "methods"), [(1e-4, None), (1e-9, None), (1e-8, OWN), (1e-11, co.GaussLegendre(6))]
)
@pytest.mark.parametrize("name", MOTIONS)
def test_the_accuracy_is_reached(name, accuracy, methods):
    """Relative to the largest size of the motion, at the end, with the rounding of the steps."""
    system, x0, span, exact = MOTIONS[name]
    if methods is OWN and system is DRIVEN:  # series need polynomials
        methods = co.GaussLegendre(4)
    choice = co.choose(system, x0, span, accuracy, methods=methods)
    sol = co.integrate(system, x0, span, choice.step, choice.method, watch=False)
    if exact is None:
        wanted = co.integrate(system, x0, span, abs(span[1] - span[0]), co.Taylor(28, tolerance=1e-17)).x[-1]
    else:
        wanted = exact(*span)
    assert np.linalg.norm(sol.x[-1] - wanted) <= accuracy * np.max(np.linalg.norm(sol.x, axis=1)), str(choice)
    for each in (choice, *choice.others):
        assert 0.0 < each.roundoff <= each.error
    assert choice.error <= choice.accuracy == accuracy


@pytest.mark.parametrize("method", [co.GaussLegendre(2), co.Splitting(order=4)], ids=str)
def test_steps_are_not_much_smaller_than_needed(method):
    choice = co.choose(BODY, X0, SPAN, 1e-8, methods=method)
    error = np.linalg.norm(co.integrate(BODY, X0, SPAN, choice.step, method).x[-1] - BODY.exact(X0, 40.0))
    # With 60 % of them the error is above the accuracy.
    assert 1e-8 * 0.6 ** (2 * method.order) < error / np.linalg.norm(X0) <= 1e-8


def test_every_member_reaches_the_accuracy():
    """Of an ensemble of momenta of all sizes, some of them at rest or almost so."""
    ensemble = np.array([[1.0, 1e-6, 1e-6], [0.0, 0.0, 2.0], [0.0, 0.0, 0.0], *np.outer([0.1, 3.0, 0.9], X0)])
    for span in (SPAN, (3.0, -7.0)):
        sol = co.integrate(BODY, ensemble, span, accuracy=1e-8, watch=False)
        for end, x0 in zip(sol.x[-1], ensemble, strict=True):
            assert np.linalg.norm(end - BODY.exact(x0, span[1] - span[0])) <= 1e-8 * np.linalg.norm(x0)


@pytest.mark.parametrize(("start", "span"), [(0.0, 10.0), (1e-12, -10.0), (1e-300, 10.0)])
def test_accuracy_from_a_tiny_start(start, span):
    """x'' = -x with a constant force, from rest: the initial rate, speed over size, is useless."""
    energy = co.Quadratic(np.eye(2), linear=[1.0, 0.5])
    system = co.PoissonSystem(lambda x: np.array([[0.0, 1.0], [-1.0, 0.0]]), energy, name="driven")
    end = co.integrate(system, (start, 0.0), (0.0, span), accuracy=1e-8).x[-1]
    exact = np.array([np.cos(span) + 0.5 * np.sin(span) - 1.0, 0.5 * np.cos(span) - np.sin(span) - 0.5])
    assert np.linalg.norm(end - exact) < 1e-8 * 3.0


def test_compensated_sums_where_rounding_requires_them():
    """Small steps of a low order over a long time: uncompensated, rounding alone would exceed the accuracy."""
    methods = [co.Splitting(order=4), co.Splitting(order=6)]
    loose, tight = (co.choose(BODY, X0, (0, 400), accuracy, methods=methods) for accuracy in (1e-6, 2e-12))
    assert loose.method.compensated is None and tight.method.compensated is True
    run = co.integrate(BODY, X0, (0, 400), tight.step, tight.method, watch=False)
    assert np.linalg.norm(run.x[-1] - BODY.exact(X0, 400.0)) <= 2e-12 * np.linalg.norm(X0)
    ensemble = np.array(X0) * (1.0 + 0.01 * np.random.default_rng(0).standard_normal((40, 3)))
    with refused(ValueError, "float64"):
        co.choose(BODY, ensemble, (0.0, 300.0), 1e-12, methods=[co.Splitting(order=10, compensated=False)])


def test_choices_do_not_depend_on_earlier_calls_or_options_of_the_run():
    before, after = (co.systems.rigid_body(inertia=(1.0, 2.0, 3.0)) for _ in range(2))
    first = co.choose(before, X0, SPAN, 1e-7)
    turned = co.choose(before, X0, SPAN, 1e-7, attitude=True)
    co.choose(before, (0.1, 2.0, 0.3), (50, 0), 1e-4)
    assert co.choose(after, X0, SPAN, 1e-7, attitude=True) == turned and co.choose(after, X0, SPAN, 1e-7) == first
    again = co.choose(before, X0, SPAN, 1e-7)
    assert again == first and again.others == first.others
    for options in ({}, {"watch": False}, {"save_every": 7}, {"threads": 2}):
        run = co.integrate(BODY, X0, SPAN, accuracy=1e-7, **options)
        assert (run.method, run.step, run.stats.steps) == (first.method, first.step, round(40.0 / first.step))
    costs = [each.cost for each in (first, *first.others)]
    assert costs == sorted(costs)


@pytest.mark.parametrize("method", SINGLE)
def test_a_given_scheme_is_kept_whatever_the_direction_and_the_start(method):
    """-x(-t) solves the equations of x(t), so that both need the same steps."""
    starts = ((X0, SPAN), (-np.array(X0), (24.0, -16.0)), (X0, (-1024.0, -984.0)))
    forward, *others = (co.choose(BODY, x0, span, 1e-8, methods=SINGLE[method]) for x0, span in starts)
    for choice in (forward, *others):
        assert type(choice.method) is type(SINGLE[method])
        assert choice.method == SINGLE[method] or method == "own steps"  # of which the tolerance is chosen
        # The growth of small changes is measured along directions that are not mirrored.
        assert (choice.step, choice.cost) == pytest.approx((forward.step, forward.cost), rel=0.05)


@pytest.mark.parametrize("method", SINGLE)
def test_copies_of_a_state_get_its_choice(method):
    """Lanes make many members of a splitting cheaper for each."""
    one, many = (co.choose(BODY, x0, SPAN, 1e-8, methods=SINGLE[method]) for x0 in (X0, [X0] * 7))
    if method == "own steps":  # trials of several members need not stop at one tolerance
        assert many.step == pytest.approx(one.step, rel=0.25) and many.cost == pytest.approx(one.cost, rel=0.25)
    else:
        assert (many.method, many.step, many.cost) == (one.method, one.step, pytest.approx(one.cost))


def test_lanes_make_splittings_cheaper():
    costs = [co.choose(BODY, [X0] * n, SPAN, 1e-6, methods=co.Splitting(order=6)).cost for n in (1, 2, 40)]
    assert costs[1] == pytest.approx(costs[0]) and costs[2] < 0.5 * costs[0]


def test_particles_that_fly_apart_get_variable_steps():
    """A constant step must resolve the encounter over the whole run."""
    choice = co.choose(TODA, FAR, (0.0, 200.0), 1e-9)
    assert isinstance(choice.method, co.Taylor) and choice.method.tolerance is not None
    constant = [other for other in choice.others if getattr(other.method, "tolerance", None) is None]
    assert all(other.cost > 1.5 * choice.cost for other in constant)
    exact = co.integrate(TODA, FAR, (0.0, 60.0), 60.0, co.Taylor(28, tolerance=1e-17), watch=False).x[-1]
    for accuracy in (1e-4, 1e-8):
        sol = co.integrate(TODA, FAR, (0.0, 60.0), accuracy=accuracy, method=co.Taylor(tolerance=1e-3))
        error = np.linalg.norm(sol.x[-1] - exact) / np.max(np.linalg.norm(sol.x, axis=1))
        assert error / 10 < sol.error_estimate() < 10 * error


def test_processed_splittings_cost_less():
    splittings = [co.Splitting(order=p) for p in (6, 8, 10)]
    processed = [co.Splitting(scheme=f"blanes_casas_murua{p}") for p in (6, 8, 10)]
    plain, both = (co.choose(BODY, X0, (0, 200), 1e-9, methods=each) for each in (splittings, splittings + processed))
    assert both.method in processed and both.cost < plain.cost
    assert co.choose(BODY, X0, (0, 200), 1e-9, processed=True).cost <= co.choose(BODY, X0, (0, 200), 1e-9).cost


def test_schemes_without_the_attitude_are_left_out():
    """Gauss methods carry no rotation matrices of so(4), but splittings and Taylor series do."""
    unable = [co.GaussLegendre(4), co.RadauEnergy(2)]
    with refused(ValueError, "attitude", "spatial momentum"):
        co.choose(SO4, X6, (0, 10), 1e-8, methods=unable, attitude=True)
    assert isinstance(co.choose(SO4, X6, (0, 10), 1e-8, methods=unable).method, co.GaussLegendre)
    assert isinstance(co.choose(SO4, X6, (0, 10), 1e-8, attitude=True).method, co.Taylor | co.Splitting)
    carried = co.integrate(BODY, X0, SPAN, accuracy=1e-8, attitude=True)
    assert np.linalg.norm(carried.attitude[-1] @ carried.x[-1] - X0) < 1e-8 * np.linalg.norm(X0)
    turned, plain = (
        co.choose(BODY, X0, SPAN, 1e-7, attitude=a, methods=co.Splitting(order=6)) for a in ("coadjoint", False)
    )
    assert turned.cost > 1.01 * plain.cost and turned.step == plain.step


def test_spans_and_states_without_motion():
    assert len(co.integrate(BODY, X0, (3, 3), accuracy=1e-6).t) == 1
    empty = co.choose(BODY, X0, (-3.5, -3.5), 1e-7, methods=[co.GaussLegendre(4), co.Splitting(order=4)])
    assert (empty.method, empty.step, empty.error, empty.cost) == (co.GaussLegendre(4), 1.0, 0.0, 0.0)
    for x0 in ((0.0, 0.0, 0.0), (0.0, 0.0, 2.0)):
        assert np.array_equal(co.integrate(BODY, x0, SPAN, accuracy=1e-6).x[-1], x0)
    spinning = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(np.zeros(3), linear=[0.0, 0.0, 1.0]))
    choice = co.choose(spinning, X0, SPAN, 1e-9)
    assert choice.step == 40.0 and isinstance(choice.method, co.Splitting)


def test_the_text_of_a_choice_contains_its_numbers():
    other = co.Choice(co.GaussLegendre(3), 0.5, 1e-5, 1e-6, 1e-9, 700.0)
    choice = co.Choice(co.Splitting(order=4), 0.0123456789, 2.5e-5, 3.75e-6, 4.26e-9, 200.0, (other,))
    text = str(choice)
    for part in (choice.method, "0.0123457", "3.8e-06", "2.5e-05", "4.3e-09", "2e+02", other.method, "3.5 times"):
        assert str(part) in text
    assert "\n" not in text and "next" not in str(dataclasses.replace(choice, others=()))


# x1' = x1 x2, x2' = x1^2: x2^2 - x1^2 = c^2 gives x2 = c coth(c (T - t)), so T = artanh(c / x2) / c.
RISING = co.LiePoissonSystem(
    co.LieAlgebra.from_brackets(2, {(0, 1): {0: 1.0}}), co.Quadratic([-1.0, 1.0]), name="rising"
)


@pytest.mark.parametrize(("t0", "direction", "number"), [(5.0, 1.0, 0), (-7.0, -1.0, 3), (0.0, -1.0, 6)])
def test_a_blow_up_is_refused_with_its_time(t0, direction, number):
    c = math.sqrt(0.9**2 - 0.5**2)
    members = np.tile([[0.0, 0.1]], (7, 1)) * np.linspace(1.0, 2.0, 7)[:, None]
    members[number] = direction * np.array([0.5, 0.9])
    with refused(ValueError, "rising", "t_span") as caught:
        co.choose(RISING, members, (t0, t0 + 10.0 * direction), 1e-6)
    found = float(re.search(r"near t = (\S+),", str(caught.value))[1])
    assert found == pytest.approx(t0 + direction * math.atanh(c / 0.9) / c, abs=0.2)
    # Without this member the others, at rest, are no problem; nor is a shorter time.
    assert co.choose(RISING, members[number], (t0, t0 + direction), 1e-6).error < 1e-6
    members[number] = [0.0, 0.1]
    assert co.choose(RISING, members, (t0, t0 + 10.0 * direction), 1e-6).error < 1e-6


@pytest.mark.parametrize(
    ("methods", "span"),
    [([co.Splitting(order=4), co.GaussLegendre(4)], (0.0, 40.0)), (co.Splitting(order=4), (100.0, 60.0))],
    ids=["several", "one backward"],
)
def test_a_refusal_names_the_least_accuracy(span, methods):
    several = isinstance(methods, list)
    with refused(ValueError, "float64", "any scheme" if several else methods, "time 40") as caught:
        co.choose(BODY, X0, span, 1e-17, methods=methods)
    least = float(re.search(r"(\S+) is the least", str(caught.value))[1])
    # The steps, and with them the rounding, depend weakly on the accuracy.
    assert co.choose(BODY, X0, span, 1.25 * least, methods=methods).error <= 1.25 * least
    if several:  # one scheme takes fewer steps for a larger error, with less rounding
        with refused(ValueError, "is the least"):
            co.choose(BODY, X0, span, 0.5 * least, methods=methods)


def on_sphere(count, seed=1994):
    found = np.random.default_rng(seed).standard_normal((count, 3))
    return found / np.linalg.norm(found, axis=1)[:, None]


SAMPLE = on_sphere(12, seed=1993)


@pytest.mark.parametrize(
    ("method", "span"), [(None, SPAN), (co.GaussLegendre(4), (40.0, 0.0)), (co.Taylor(tolerance=1e-9), SPAN)], ids=str
)
def test_runs_prepared_for_an_accuracy_reach_it_for_every_state(method, span):
    """States like the sample share its step; faster ones get their own choice, and change nothing for later ones."""
    ready, time = co.prepare(BODY, method, accuracy=1e-8, x0=SAMPLE, t_span=span), span[1] - span[0]
    first, states = ready.run(SAMPLE[0], span), on_sphere(8)
    shared = [ready.run(x0, span) for x0 in states]
    assert sum(run.step == first.step for run in shared) >= 6
    for x0, run in zip(states, shared, strict=True):
        assert np.linalg.norm(run.x[-1] - BODY.exact(x0, time)) <= 1e-8
        assert np.array_equal(ready.end(x0, span), run.x[-1])
        assert np.array_equal(co.integrate(BODY, x0, span, run.step, run.method).x[-1], run.x[-1])
    for x0 in 9.0 * on_sphere(2):
        found, once = ready.run(x0, span), co.integrate(BODY, x0, span, accuracy=1e-8, method=method)
        assert np.linalg.norm(found.x[-1] - BODY.exact(x0, time)) <= 1e-8 * 9.0
        assert (found.method, found.step) == (once.method, once.step) != (first.method, first.step)
        assert np.array_equal(found.x[-1], once.x[-1])
    mixed = np.array([SAMPLE[0], 9.0 * SAMPLE[1]])
    assert np.max(np.abs(ready.end(mixed, span) - [BODY.exact(x, time) for x in mixed])) <= 9e-8
    assert np.array_equal(ready.run(SAMPLE[0], span).x, first.x)
    for x0 in ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        np.testing.assert_allclose(ready.end(x0, span), x0, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("span", [(3.0, 43.0), (40.0, 0.0)])
def test_own_choices_keep_settings_and_arguments(span):
    settings = {"attitude": True, "watch": False, "observe": {"height": lambda x: x[2]}, "threads": 1}
    ready = co.prepare(BODY, None, accuracy=1e-7, x0=SAMPLE[:4], t_span=span, **settings)
    x0, given = 9.0 * SAMPLE[5], {"attitude": np.diag([1.0, -1.0, -1.0])}
    times = span[0] + math.copysign(1.0, span[1] - span[0]) * np.array([2.0, 17.5])
    for options in ({"save_every": 3}, {"t_eval": times}, {"events": co.Event("x2", terminal=True)}):
        found = ready.run(x0, span, **given, **options)
        once = co.integrate(BODY, x0, span, found.step, found.method, **{**settings, **given}, **options)
        assert all(np.array_equal(getattr(found, name), getattr(once, name)) for name in ("t", "x", "attitude"))
        assert np.array_equal(found.observed["height"], once.observed["height"])
        assert found.step != ready.run(SAMPLE[0], span).step


def test_systems_in_time_are_checked_at_their_time():
    """Later steps are larger ones."""
    ready = co.prepare(DRIVEN, accuracy=1e-8, x0=SAMPLE[:3], t_span=(0, 1))
    for t0, t1 in ((0.0, 1.0), (3.0, 3.5)):
        wanted = BODY.exact(SAMPLE[4], math.exp(t1) - math.exp(t0))
        assert np.linalg.norm(ready.end(SAMPLE[4], (t0, t1)) - wanted) <= 1e-8


def test_prepared_runs_read_changed_arguments_again():
    x0, span = np.array(X0), [0.0, 10.0]
    run = co.prepare(BODY, accuracy=1e-6, x0=[x0.copy()], t_span=(0.0, 10.0))
    first = run.run(x0, span)
    end = first.x[-1].copy()
    x0 *= 1.0625
    moved = run.run(x0, span)
    assert np.array_equal(first.x[0], X0) and np.array_equal(moved.x[0], x0)
    assert np.abs(moved.x[-1] - end).max() > 1e-3
    span[1] = 1000.0
    with refused(ValueError, "1000"):
        run.run(x0, span)


@pytest.mark.parametrize("scale", [2.0**332, 2.0**510])
def test_motions_are_chosen_for_where_squares_of_their_speed_overflow(scale):
    """The field is finite, up to 1e307: the same motion in other units of time."""
    body, x0 = co.systems.rigid_body((1, 2, 3)), np.array([0.3, 1.0, 0.2])
    plain, fast = (co.integrate(body, s * x0, (0, 10 / s), accuracy=1e-6) for s in (1.0, scale))
    np.testing.assert_allclose(fast.x[-1] / scale, plain.x[-1], rtol=0, atol=2e-6)
