"""Choices for ensembles, for spans in both directions and from any start, and for runs with group elements."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import accuracy
from coadjoint.choosing import member_sample as sampling
from coadjoint.choosing import pilot as pilots
from coadjoint.choosing.candidates import supported_candidates
from coadjoint.choosing.member_sample import sample_of
from coadjoint.choosing.pilot import Growth, Pilot, Trial
from coadjoint.choosing.roundoff import roundoff
from coadjoint.kernels.interface import limit
from coadjoint.methods.protocol.cost_model import MIN_LANE_MEMBERS, newton_work

X0 = (1.0, 0.2, 0.5)
SPAN = (0.0, 40.0)
SINGLE = {
    "splitting": co.Splitting(order=6),
    "gauss": co.GaussLegendre(4),
    "taylor": co.Taylor(order=14),
    "own steps": co.Taylor(tolerance=1e-9),
}


def new_body():
    return co.systems.rigid_body(inertia=(1.0, 2.0, 3.0))


def rising():
    """x1' = x1 x2, x2' = x1^2; from (0.5, 0.9) it blows up shortly after t = 1."""
    algebra = co.LieAlgebra.from_brackets(2, {(0, 1): {0: 1.0}})
    return co.LiePoissonSystem(algebra, co.Quadratic([-1.0, 1.0]), name="rising")


BODY = new_body()
RISING = rising()


# Caches and earlier calls


@pytest.mark.parametrize("method", SINGLE)
def test_group_element_cost_does_not_depend_on_earlier_calls(method):
    before, after = new_body(), new_body()
    options = {"methods": SINGLE[method]}
    turned = co.choose(before, X0, SPAN, 1e-7, attitude=True, **options)
    plain = co.choose(before, X0, SPAN, 1e-7, **options)
    assert co.choose(after, X0, SPAN, 1e-7, **options) == plain
    assert co.choose(after, X0, SPAN, 1e-7, attitude=True, **options) == turned
    coadjoint = co.choose(after, X0, SPAN, 1e-7, attitude="coadjoint", **options)
    assert min(turned.cost, coadjoint.cost) > 1.01 * plain.cost
    assert turned.method == coadjoint.method == plain.method and turned.step == plain.step


def test_wrong_initial_group_element_is_refused():
    for methods in (None, co.Splitting(order=4)):
        with pytest.raises(ValueError, match="attitude"):
            co.choose(BODY, X0, SPAN, 1e-6, attitude=np.diag([1.0, 1.0, -1.0]), methods=methods)


# Directions, and spans that do not begin at zero


@pytest.mark.parametrize("method", SINGLE)
def test_backward_run_gets_the_choice_of_its_mirror_image(method):
    """-x(-t) solves the equations of x(t), so that both need the same steps."""
    forward = co.choose(BODY, X0, (0.0, 40.0), 1e-8, methods=SINGLE[method])
    mirrored = co.choose(BODY, -np.array(X0), (24.0, -16.0), 1e-8, methods=SINGLE[method])
    shifted = co.choose(BODY, X0, (-1024.0, -984.0), 1e-8, methods=SINGLE[method])
    for other in (mirrored, shifted):
        assert other.step > 0.0
        assert other.method == forward.method or method == "own steps"  # of which the tolerance is chosen
        # The growth of small changes is measured along directions that are not mirrored.
        assert other.step == pytest.approx(forward.step, rel=0.05) and other.cost == pytest.approx(
            forward.cost, rel=0.05
        )


@pytest.mark.parametrize(("t0", "direction", "number"), [(5.0, 1.0, 0), (-7.0, -1.0, 3), (0.0, -1.0, 6)])
def test_blow_up_time_is_named_for_any_member(t0, direction, number):
    """x2^2 - x1^2 = c^2 gives x2 = c coth(c (T - t)), so T = artanh(c / x2) / c."""
    c = math.sqrt(0.9**2 - 0.5**2)
    end = math.atanh(c / 0.9) / c
    members = np.tile([[0.0, 0.1]], (7, 1)) * np.linspace(1.0, 2.0, 7)[:, None]
    members[number] = direction * np.array([0.5, 0.9])
    with pytest.raises(ValueError, match="blows up") as refused:
        co.choose(RISING, members, (t0, t0 + 10.0 * direction), 1e-6)
    found = float(re.search(r"near t = (\S+),", str(refused.value))[1])
    assert found == pytest.approx(t0 + direction * end, abs=0.2)
    # Without this member the others, at rest, are no problem.
    members[number] = [0.0, 0.1]
    assert co.choose(RISING, members, (t0, t0 + 10.0 * direction), 1e-6).error < 1e-6


@pytest.mark.parametrize("span", [(0.0, 40.0), (100.0, 60.0), (-3.0, 37.0)])
@pytest.mark.parametrize(
    "methods",
    [
        [co.Splitting(order=4), co.GaussLegendre(4)],
        [co.Splitting(order=4), co.Splitting(order=6)],
        co.Splitting(order=4),
    ],
    ids=["two kinds", "one kind", "one"],
)
def test_refusal_names_an_attainable_accuracy(span, methods):
    with pytest.raises(ValueError, match="float64") as refused:
        co.choose(BODY, X0, span, 1e-17, methods=methods)
    message = str(refused.value)
    assert ("with any scheme over the time 40;" if isinstance(methods, list) else f"with {methods} over") in message
    assert "over the time 40;" in message
    least = float(re.search(r"(\S+) is the least", message)[1])
    # The steps, and with them the rounding, depend weakly on the accuracy.
    assert co.choose(BODY, X0, span, 1.25 * least, methods=methods).error <= 1.25 * least
    if isinstance(methods, list):  # one scheme takes fewer steps for a larger error, with less rounding
        with pytest.raises(ValueError, match="is the least"):
            co.choose(BODY, X0, span, 0.5 * least, methods=methods)


# Ensembles


# A field along the third axis turns large and small momenta alike: relative errors depend on directions alone.
FIELD = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.03, 0.02, 0.01], linear=[0.0, 0.0, 4.0]))


def ensemble_of(members, seed):
    """Momenta of sizes from 0.01 to 10, some of them almost along a principal axis."""
    rng = np.random.default_rng(seed)
    found = rng.standard_normal((members, 3))
    near = rng.permutation(members)[: members // 2]
    found[near] *= [1.0, 1e-3, 1e-4]
    sizes = 10.0 ** rng.uniform(-2.0, 1.0, members)
    return found / np.linalg.norm(found, axis=1)[:, None] * sizes[:, None]


def tilted(members, seed):
    """Momenta at different angles with the third axis; those that are nearer to it are larger."""
    distances = np.random.default_rng(seed).permutation(np.linspace(0.1, 0.9, members))
    across, up = distances, np.sqrt(1.0 - distances**2)
    return (np.stack([0.6 * across, 0.8 * across, up], axis=1).T * 0.01 / distances**3).T


@pytest.mark.parametrize("system", [BODY, FIELD], ids=["body", "field"])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("span", [2.0, -2.0])
def test_sample_has_the_largest_relative_errors(seed, span, system):
    """Errors from runs with 128 and 256 steps over the time in which the fastest member moves 16 sizes."""
    ensemble = ensemble_of(23, seed) if system is BODY else tilted(23, seed)
    sizes = np.linalg.norm(ensemble, axis=1)
    rate = max(np.linalg.norm(system.vector_field(x)) / size for x, size in zip(ensemble, sizes, strict=True))
    time = math.copysign(min(abs(span), 16.0 / rate), span)
    coarse, fine = (
        co.integrate(system, ensemble, (3.0, 3.0 + time), abs(time) / n, co.GaussLegendre(2), watch=False).x
        for n in (128, 256)
    )
    errors = np.max(np.linalg.norm(coarse - fine[::2], axis=2), axis=0) / sizes
    # Beyond the third member of the sample, errors that differ by rounding alone may change places.
    order = np.argsort(-errors)
    assert errors[order[2]] > 1.001 * errors[order[3]]
    if system is FIELD:
        assert set(order[:3]) != set(np.argsort(-errors * sizes)[:3])
    expected = sorted({0, *order[:3].tolist()})
    np.testing.assert_array_equal(sample_of(system, ensemble, 3.0, span), ensemble[expected])


@pytest.mark.parametrize("span", [1000.0, -1000.0, 1e-3])
def test_sample_is_screened_along_the_run(span, monkeypatch):
    seen = []
    short_run = sampling.short_run

    def recorded(system, method, momenta, t0, time, steps):
        seen.append((t0, time, steps))
        return short_run(system, method, momenta, t0, time, steps)

    monkeypatch.setattr(sampling, "short_run", recorded)
    ensemble = ensemble_of(9, 1)
    sample_of(BODY, ensemble, -2.5, span)
    rate = max(np.linalg.norm(BODY.vector_field(x)) / np.linalg.norm(x) for x in ensemble)
    assert [(t0, steps) for t0, _, steps in seen] == [(-2.5, 128), (-2.5, 256)]
    for _, time, _ in seen:
        assert time == pytest.approx(math.copysign(min(abs(span), 16.0 / rate), span), rel=1e-12)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
@pytest.mark.parametrize("span", [1.0, -1.0])
def test_pilot_of_an_ensemble_measures_its_worst_member(order, span):
    """Members of very different speeds, one at rest."""
    members = np.array([[3.0, 2.0, -2.5], [0.1, 0.05, 0.2], [0.0, 0.4, 0.0]])
    alone = [Pilot(BODY, x[None], 0.0, span) for x in members]
    ensemble = Pilot(BODY, members[list(order)], 0.0, span)
    assert ensemble.covers_span and all(pilot.covers_span for pilot in alone)
    assert ensemble.natural_step == min(pilot.natural_step for pilot in alone)
    assert ensemble.speed == pytest.approx(max(pilot.speed for pilot in alone), rel=1e-12)
    np.testing.assert_allclose(ensemble.size, [alone[k].size[0] for k in order], rtol=1e-14)
    for method in (co.GaussLegendre(2), co.Splitting(order=2)):
        together, trials = ensemble.trial(method, 48), [pilot.trial(method, 48) for pilot in alone]
        np.testing.assert_allclose(together.growth, np.max([trial.growth for trial in trials], axis=0), rtol=1e-6)
        for name in ("iterations", "evaluations"):
            of_each = [getattr(trial, name) for trial in trials]
            assert getattr(together, name) == pytest.approx(np.mean(of_each), rel=0.3)
        assert together.error > 10 * min(trial.error for trial in trials)


def test_sensitivity_is_that_of_the_worst_member():
    """Near the middle axis small changes grow like exp(t size / sqrt(3)), near the others they do not grow."""
    calm, unstable = [1.0, 1e-3, 1e-3], [1e-9, 1.0, 1e-9]
    for members in ([calm, unstable], [unstable, calm]):
        pilot = Pilot(BODY, np.array(members), 0.0, 12.0)
        # A half of exp(12 / sqrt(12)) at least, along a random direction a tenth of it.
        assert pilot.sensitivity.whole > 0.05 * math.exp(12.0 / math.sqrt(12.0))
        assert Pilot(BODY, np.array([calm]), 0.0, 12.0).sensitivity.whole < 10.0


@pytest.mark.parametrize("members", [MIN_LANE_MEMBERS - 1, MIN_LANE_MEMBERS])
def test_lanes_make_splittings_cheaper(members):
    ensemble = np.tile(X0, (members, 1))
    many, one = (co.choose(BODY, x0, SPAN, 1e-6, methods=co.Splitting(order=6)) for x0 in (ensemble, X0))
    assert many.step == one.step
    if members < MIN_LANE_MEMBERS:
        assert many.cost == pytest.approx(one.cost)
    else:
        assert many.cost < 0.5 * one.cost


def test_linear_systems_of_newtons_method_are_counted():
    (candidate,) = supported_candidates(BODY, [co.GaussLegendre(4)], X0, False, strict=True)
    without = Trial(10, Growth(0.0, 0.0, 0.0), 3.0, 12.0)
    added = candidate.cost(without._replace(newton=True)) - candidate.cost(without)
    assert added == pytest.approx(newton_work(3, 4.0)) and added > 0.0


def test_trial_records_newtons_method(monkeypatch):
    pilot = Pilot(BODY, np.array([X0]), 0.0, 4.0)
    for used in (False, True):
        monkeypatch.setattr(pilots, "took_newton", lambda method, memory, used=used: used)
        assert pilot.trial(co.GaussLegendre(2), 48).newton is used


@pytest.mark.thinned(2)
@pytest.mark.parametrize("members", [1, MIN_LANE_MEMBERS - 1, MIN_LANE_MEMBERS, 3 * MIN_LANE_MEMBERS])
def test_lanes_need_many_members_of_small_dimension(members):
    widest = limit("WIDEST")
    for copies in (1, widest // 3, widest // 3 + 1):
        many = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), copies), co.Quadratic(np.ones(3 * copies)))
        x0 = np.ones((members, 3 * copies))
        (candidate,) = supported_candidates(many, [co.GaussLegendre(2)], x0, False, strict=True)
        assert candidate.in_lanes is (members >= MIN_LANE_MEMBERS and 3 * copies <= widest)
        assert candidate.share == (candidate.work.in_lanes if candidate.in_lanes else 1.0)


# The last confirmation


def test_scheme_that_confirmation_makes_expensive_is_replaced(monkeypatch):
    methods = [co.Splitting(order=p) for p in (4, 6, 8)]
    plain = co.choose(BODY, X0, SPAN, 1e-8, methods=methods)
    confirmed = []

    def expensive(found, goal, required):
        confirmed.append((found.candidate.method, goal, required))
        return replace(found, steps=100 * found.steps) if found.candidate.method == plain.method else found

    monkeypatch.setattr(accuracy, "confirmed_fit", expensive)
    choice = co.choose(BODY, X0, SPAN, 1e-8, methods=methods)
    assert [method for method, _, _ in confirmed] == [plain.method, choice.method] and choice.method != plain.method
    costs = [each.cost for each in (choice, *choice.others)]
    assert costs == sorted(costs) and len(costs) == len(plain.others) + 1
    for _, goal, required in confirmed:
        assert 0.0 < goal < required == 1e-8


def test_choice_text_compares_costs():
    choice = co.choose(BODY, X0, SPAN, 1e-7)
    name, times = re.search(r"; next (.*) at (\S+) times that$", str(choice)).groups()
    assert name == str(choice.others[0].method)
    assert float(times) == pytest.approx(choice.others[0].cost / choice.cost, rel=0.05)


# Rounding


@pytest.mark.parametrize("compensated", [False, True])
@pytest.mark.parametrize("order", [2, 4])
def test_rounding_bound_of_plain_and_compensated_sums(order, compensated):
    """Steps are powers of two: after the way back, the difference is rounding."""
    states = np.random.default_rng(6).standard_normal((6, 3))
    method = co.Splitting(order=order, compensated=compensated)
    span, step = 64.0, 2.0**-6
    there = co.integrate(BODY, states, (0, span), step, method, watch=False).x[-1]
    back = co.integrate(BODY, there, (span, 0), step, method, watch=False).x[-1]
    found = np.max(np.linalg.norm(back - states, axis=1) / np.linalg.norm(states, axis=1))
    pilot = Pilot(BODY, states, 0.0, span)
    rows = method.program(BODY).rows.section
    expected = roundoff(pilot, round(span / step), int(rows[2] - rows[1]), compensated, pilot.windows)
    # Twice as many steps, whose errors grow on the way back as they did on the way there.
    assert 0.0 < found <= 2.0 * pilot.sensitivity.whole * expected
    other = roundoff(pilot, round(span / step), int(rows[2] - rows[1]), not compensated, pilot.windows)
    assert (other > expected) == compensated


@pytest.mark.parametrize("compensated", [False, True])
def test_rounded_coefficients_accumulate_like_a_random_walk(compensated):
    """As many flows in all, in longer compositions: three roundings along the path, times the root of their number."""
    pilot = SimpleNamespace(noise=0.0, speed=2.0, window=5.0, sensitivity=Growth(1.0, 1.0, 1.0))
    for windows in (1.0, 10.0):
        one, four, nine = (
            roundoff(pilot, 36_000 // flows, flows, compensated, windows) * 2.0**53 for flows in (1, 4, 9)
        )
        path = 2.0 * 5.0 * windows
        assert four - one == pytest.approx(3.0 * path) and nine - one == pytest.approx(6.0 * path)
        stages = roundoff(pilot, 36_000, 0, compensated, windows) * 2.0**53
        assert stages == pytest.approx(1.0 + path + 0.1 * math.sqrt(36_000) * windows)


def test_rounding_grows_with_steps_and_time():
    pilot = Pilot(BODY, np.array([X0]), 0.0, 1e4)
    for flows, compensated in ((0, True), (0, False), (5, False), (5, True)):
        found = [roundoff(pilot, n, flows, compensated, pilot.windows) for n in (10**4, 10**6, 10**8)]
        assert min(found) >= pilot.noise
        # Compensated sums of smaller increments round less; others add errors up, at least like the root of the number.
        if flows and compensated:
            assert found == sorted(found, reverse=True)
        else:
            assert found[2] > 5.0 * found[1] > found[0]
        longer = [roundoff(pilot, 10**6, flows, compensated, k * pilot.windows) for k in (1.0, 10.0, 100.0)]
        assert longer[2] > 9.0 * longer[1] > 80.0 * 0.9 * longer[0] / 2.0
        assert roundoff(pilot, 10**6, flows, compensated, pilot.windows, margin=1e9) == pytest.approx(
            1e9 * pilot.noise * pilot.sensitivity.factor(pilot.windows)
        )
