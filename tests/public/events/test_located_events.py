"""Events: location, counts, terminal events, failures, and no effect on the run."""

import math

import numpy as np
import pytest
from scipy.special import ellipk

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(3)

U = 2.0**-53
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
FLIPPING = (0.1, 1.0, 0.1)
METHODS = [
    co.Splitting(order=2),
    co.Splitting(order=4, compensated=True),
    co.GaussLegendre(stages=2),
    co.ExplicitRungeKutta("rk4"),
    co.Taylor(order=12),
]
NAMES = [str(method) for method in METHODS]


def period(x0, inertia):
    """Period of a free body by a complete elliptic integral (Landau and Lifshitz, Mechanics, section 37)."""
    one, two, three = inertia
    twice_energy, square = sum(x * x / i for x, i in zip(x0, inertia, strict=True)), float(np.dot(x0, x0))
    if square < twice_energy * two:
        one, three = three, one
    rate = np.sqrt((three - two) * (square - twice_energy * one) / (one * two * three))
    m = (two - one) * (twice_energy * three - square) / ((three - two) * (square - twice_energy * one))
    return 4.0 * ellipk(m) / rate


def harmonic(frequency=1.0, sign=1):
    """(x1, x2) turns at a constant rate: the solvable algebra of the plane's motions, closed form."""
    g = co.LieAlgebra.from_brackets(3, {(2, 0): {1: 1.0}, (2, 1): {0: -1.0}})
    return co.LiePoissonSystem(g, co.Quadratic(0.0, linear=[0.0, 0.0, frequency]), sign=sign)


def angle_of(system, x0):
    """Return the angular velocity of (x1, x2)."""
    x1, x2, _ = system.vector_field(np.asarray(x0, dtype=float))
    return (x0[0] * x2 - x0[1] * x1) / (x0[0] ** 2 + x0[1] ** 2)


@pytest.mark.parametrize("x0", [FLIPPING, (1.0, 0.2, 0.1), (0.1, 0.2, 1.0)])
def test_period_of_a_free_body(x0):
    T = period(x0, (1, 2, 3))
    h, steps = 0.1, int(1001.0 * T / 0.1)
    sol = co.integrate(
        BODY, x0, (0, steps * h), h, co.Taylor(order=24), save_every=steps, events=co.Event("x2", direction=1)
    )
    t = sol.events.t
    assert len(t) >= 1000
    # A relative error of some u a step makes times that wander; the mean period is a thousandth of that.
    assert abs((t[-1] - t[0]) / (len(t) - 1) - T) < 1e-12


@pytest.mark.parametrize("method", METHODS[:4], ids=NAMES[:4])
def test_event_times_have_the_order_of_the_scheme(method):
    x0, T = FLIPPING, period(FLIPPING, (1, 2, 3))
    errors = []
    for h in (1 / 4, 1 / 8, 1 / 16):
        t = co.integrate(BODY, x0, (0, 96), h, method, events=co.Event(1, direction=1)).events.t
        errors.append(abs(t[1] - t[0] - T))
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert slopes[-1] > method.order - 0.5


@pytest.mark.parametrize(
    "algebra", [co.algebras.so(3), co.algebras.e(3), co.algebras.copies(co.algebras.so(3), 3)], ids=repr
)
@pytest.mark.parametrize("span", [(1.0, 25.0), (25.0, 1.0)])
def test_series_with_further_products_find_all_crossings_of_a_step(algebra, span):
    """H = x3^4 / 4 turns x1 and x2 by x3^3 = 1: x1 = cos(t - t0) has more than one zero in a step of length 4."""
    n = algebra.dim
    H = co.Polynomial({tuple(4 * (k == 2) for k in range(n)): 0.25})
    x0 = np.array([1.0, 0.0, 1.0, *np.linspace(0.5, 1.0, n - 3)])
    first = co.Event(co.Polynomial({tuple(int(k == 0) for k in range(n)): 1.0}))
    sol = co.integrate(co.LiePoissonSystem(algebra, H), x0, span, 4.0, co.Taylor(24), events=first)
    zeros = np.pi * (np.arange(8) + 0.5)
    want = span[0] + np.sign(span[1] - span[0]) * zeros[zeros < 24.0]
    # The first term left out, in each of six steps.
    np.testing.assert_allclose(sol.events.t, want, rtol=0, atol=6 * 4.0**25 / math.factorial(25))


def test_events_at_both_ends_of_the_span():
    system = harmonic()
    sol = co.integrate(system, (0.0, 1.0, 0.0), (0, 6), 0.5, events=co.Event("x1"))
    assert abs(sol.events.t - np.pi).max() < 32 * U and len(sol.events) == 1
    # g(t) = t - 2: the grid point belongs to the step that ends there.
    for end in (2.0, 3.0):
        sol = co.integrate(system, (1.0, 0.0, 0.0), (0, end), 0.5, events=co.Event(lambda x, t: t - 2.0))
        assert sol.events.t.tolist() == [2.0]
    assert len(co.integrate(system, (1.0, 0.0, 0.0), (2, 3), 0.5, events=co.Event(lambda x, t: t - 2.0)).events) == 0


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("t0", [0.0, 5.0, -1.5])
def test_error_names_the_first_undefined_event(way, t0):
    """The later one is given first."""

    def later(x, t):
        return np.sqrt(9.0 - (t - t0) ** 2) - 10.0

    def first(x, t):
        return np.sqrt(4.0 - (t - t0) ** 2) - 10.0

    events = [co.Event("x2"), co.Event(later, name="later"), co.Event(first, name="first")]
    for x0, who in ((FLIPPING, ""), (np.tile(FLIPPING, (3, 1)), r" for 3 of 3 members \(first: member 0\)")):
        words = rf"step 17, .*event first .* t = {t0 + 2.125 * way:g}.*{who}$"
        with pytest.raises(co.IntegrationError, match=words) as failure:
            co.integrate(BODY, x0, (t0, t0 + 8 * way), 0.125, events=events)
        assert failure.value.step == 17 and failure.value.time == t0 + 2.0 * way


@pytest.mark.parametrize("members", [None, 2])
def test_crossings_of_the_failed_step_are_dropped(members):
    """x2 falls through zero in the step after which the root is undefined."""
    x0 = np.array([0.01, 1.0, 0.01]) if members is None else np.array([[0.01, 1.0, 0.01], [0.0, 0.0, 1.0]])
    events = [co.Event("x2"), co.Event(lambda x: np.sqrt(x[1]) + 1.0, name="root")]
    with refused(co.IntegrationError, "event root") as caught:
        co.integrate(co.systems.rigid_body((1, 2, 3)), x0, (0, 30), 0.05, co.Splitting(order=4), events=events)
    assert len(caught.value.partial.events) == 0


def test_second_crossing_within_a_step_ends_the_run():
    system, start, h = harmonic(), np.array([np.cos(2.3), -np.sin(2.3), 0.0]), 0.5
    c = np.cos(1e-3)
    event = co.Event(co.Polynomial({(1, 0, 0): 1.0, (0, 0, 0): -c}), terminal=True, count=2)
    sol = co.integrate(system, start, (0, 30), h, events=event)
    turn = np.sign(angle_of(system, start))
    first = (2.3 if turn > 0 else 2 * np.pi - 2.3) + 1e-3
    assert abs(sol.t[-1] - first) < 1e-9 and len(sol.events) == 2
    assert np.isfinite(sol.x).all() and sol.t[-2] < first <= sol.t[-2] + h
    several = co.integrate(system, np.array([start, -start, start]), (0, 30), h, events=event)
    assert np.array_equal(several.events.of(2).t, sol.events.t)


def test_selections_of_crossings_are_complete():
    x0 = np.array(FLIPPING) + np.linspace(0, 0.3, 5)[:, None]
    events = [
        co.Event("x3"),
        co.Event("x2", count=2, terminal=True, name="flip"),
        co.Event(lambda x, t: x[0] - 0.01 * t),
    ]
    found = co.integrate(BODY, x0, (0, 40), 0.125, events=events, attitude=True).events
    assert found.names == ("x3", "flip", "event 2") and found.asked == tuple(events)
    ends = found.ends(5)
    assert np.isfinite(ends).all() and repr(found).startswith(
        f"<crossings of x3: {len(found['x3'])}, flip: 10, event 2: "
    )
    for k, name in enumerate(found.names):
        for some in (found[name], found[k]):
            assert some.which.tolist() == [k] * len(some) and len(some) == np.count_nonzero(found.which == k) > 0
    picked = [found.of(3), found["flip"], found.chosen(found.member > 2), found.chosen(np.arange(len(found)))]
    for some in picked:
        assert (some.names, some.coordinates, some.asked) == (found.names, ("x1", "x2", "x3"), found.asked)
        rows = [
            np.flatnonzero((found.t == t) & (found.member == m))[0] for t, m in zip(some.t, some.member, strict=True)
        ]
        for name in ("x", "which", "direction", "attitude"):
            assert np.array_equal(getattr(some, name), getattr(found, name)[rows]), name
    assert np.array_equal(picked[-1].ends(5), ends) and np.array_equal(found.of(3).ends(5)[3:4], ends[3:4])
    assert np.array_equal(found["flip"].ends(5), ends)
    for wrong in (3, -1, "x1"):
        with refused(ValueError, "event"):
            found[wrong]
    with refused(TypeError, "event"):
        iter(found)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("span", [(0.0, 32.0), (32.0, 0.0)])
@pytest.mark.parametrize("count", [None, 2, 3])
def test_members_that_cross_less_often_than_the_count_go_on_to_the_end(span, count):
    x0 = np.array(FLIPPING) + np.linspace(0, 0.3, 5)[:, None]
    every = co.integrate(BODY, x0, span, 0.125, events=co.Event("x2")).events
    sol = co.integrate(BODY, x0, span, 0.125, save_every=8, events=co.Event("x2", count=count, terminal=True))
    times = [every.of(m).t for m in range(5)]
    assert min(map(len, times)) < 3 <= max(map(len, times))
    expected = [t[(count or 1) - 1] if len(t) >= (count or 1) else np.nan for t in times]
    assert np.array_equal(sol.events.ends(5), expected, equal_nan=True)
    on = np.isnan(expected)
    assert np.array_equal(np.isfinite(sol.x[-1]).all(axis=-1), on)
    if on.any():
        assert np.array_equal(sol.at(span[1]).x, sol.x[-1], equal_nan=True)


@pytest.mark.parametrize("method", [METHODS[0], METHODS[3]], ids=str)
def test_members_that_end_keep_the_deviations_of_their_last_steps(method):
    """Members side by side end in the middle of tenths, in which others go on: all of their energies count."""
    x0 = np.array(FLIPPING) + np.linspace(0, 0.3, 5)[:, None]
    sol = co.integrate(BODY, x0, (0, 32), 0.125, method, events=co.Event("x2", count=2, terminal=True))
    assert np.isfinite(sol.events.ends(5)).tolist() == [False, True, True, True, True]
    steps = np.rint(sol.t / 0.125).astype(int)
    tenth, deviations = np.maximum(steps - 1, 0) * 10 // 256, np.abs(sol.energy - sol.energy[0])
    expected = [np.nan_to_num(deviations[tenth == k]).max(axis=0) for k in range(10)]
    assert np.array_equal(sol.drift(relative=False)["energy"].tenths.T, expected)


RATES = np.add.outer(np.arange(4.0), np.arange(4.0))


def test_event_functions_of_matrices():
    s = co.MatrixSystem(co.MatrixAlgebra("so", 4), lambda W: W * RATES)
    rng = np.random.default_rng(3)
    A = rng.standard_normal((4, 4))
    event = co.Event(lambda W: W[0, 1])
    sol = co.integrate(s, A - A.T, (0, 10), 0.0625, events=event)
    plain = co.integrate(s, A - A.T, (0, 10), 0.0625)
    assert np.array_equal(sol.x, plain.x)
    signs = np.sign(plain.x[:, 0, 1])
    assert len(sol.events) >= np.count_nonzero(signs[1:] != signs[:-1]) > 0
    assert abs(sol.events.x[:, 0, 1]).max() < 64 * U * abs(A).max()


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.GaussLegendre(3), co.Taylor(order=12)], ids=str)
@pytest.mark.parametrize("direction", [-1, 0, 1])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_zero_at_a_step_is_one_crossing(method, direction, sense):
    """x1 moves by exactly 1/4 in a step: it is zero after four of eight steps."""
    line = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1.0}})
    system = co.LiePoissonSystem(line, co.Quadratic(0.0, linear=[0.0, sense, 0.0]))
    run = co.integrate(system, (-sense, 0.0, 1.0), (0.0, 2.0), 0.25, method, events=[co.Event(0, direction=direction)])
    wanted = [] if direction == -sense else [1.0]
    assert run.events.t.tolist() == wanted and run.events.direction.tolist() == [int(sense)] * len(wanted)


def test_a_pair_that_ends_members_in_another_order_leaves_their_earlier_points():
    """The loops have other members side by side, and repeat the last steps once the pair is found in one of them."""

    def pair(x, t):
        return (t - 75.1) ** 2 - 0.001

    event, plate = co.Event(pair, terminal=True), co.systems.rigid_body(inertia=(1, 1, 2))
    bodies = [(BODY, plate)[m % 2] for m in range(5)]
    x0 = np.multiply.outer(np.linspace(0.5, 1.0, 5), FLIPPING)
    together = co.integrate(co.batch(bodies), x0, (0, 100), 0.25, events=event)
    for m, body in enumerate(bodies):
        alone = co.integrate(body, x0[m], (0, 100), 0.25, events=event)
        assert abs(alone.t[-1] - (75.1 - np.sqrt(0.001))) < 1e-12
        np.testing.assert_array_equal(together.x[: len(alone.t) - 1, m], alone.x[:-1])
        assert np.isnan(together.x[len(alone.t) - 1 :, m]).all()
