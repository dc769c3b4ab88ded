"""Pilot runs, samples of ensembles, growth and rounding of errors, and the work of steps, against known motions."""

import dataclasses
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import pilot as pilots
from coadjoint.choosing.candidates import supported_candidates
from coadjoint.choosing.measured_work import with_measured_work
from coadjoint.choosing.member_sample import sample_of
from coadjoint.choosing.pilot import Growth, Pilot, Trial
from coadjoint.choosing.roundoff import roundoff
from coadjoint.choosing.unreached import rounded_up
from coadjoint.kernels.interface import limit
from coadjoint.methods.protocol.cost_model import (
    FUNCTION_COST,
    MIN_LANE_MEMBERS,
    MULTIPLICATION_COST,
    iteration_work,
    newton_work,
)

X0 = np.array([1.0, 1.5, -0.5])
MASSES = np.array([1.0, 0.5, 0.4])


def quickening(x, t):
    return 0.5 * math.exp(t) * (x[0] * x[0] + 0.5 * x[1] * x[1] + 0.4 * x[2] * x[2])


def quickening_gradient(x, t):
    return math.exp(t) * np.array([x[0], 0.5 * x[1], 0.4 * x[2]])


BODY = co.systems.rigid_body(1.0 / MASSES)
# A rigid body with an accelerating clock: x(t) is that of the body after the time e^t - e^t0.
SYSTEM = co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(quickening, quickening_gradient), sign=-1)


def exact(t0, t, x0=X0):
    return BODY.exact(x0, np.exp(t) - math.exp(t0))


@pytest.mark.thinned(4)
@pytest.mark.parametrize("t0", [0.0, 1.25, -0.75])
@pytest.mark.parametrize("span", [1.5, -1.5])
def test_reference_is_the_exact_motion(t0, span):
    pilot = Pilot(SYSTEM, X0[None], t0, span)
    assert pilot.covers_span
    times = t0 + span * np.arange(pilot.points + 1) / pilot.points
    found = pilot.reference[:, 0]
    # Its rounding, over some hundred steps of a path of length some tens.
    assert np.max(np.abs(found - exact(t0, times))) < 1e-12
    steps = pilot.comparable_steps(pilot.window / pilot.natural_step * 2)
    trial = pilot.trial(co.GaussLegendre(2), steps)
    run = co.integrate(SYSTEM, X0, (t0, t0 + span), abs(span) / steps, co.GaussLegendre(2))
    apart = np.linalg.norm(run.x - exact(t0, run.t), axis=1)[steps // 2 + 1 :] / np.linalg.norm(X0)
    # The error is that at some points of the second half, the end among them.
    assert apart[-1] * 0.999 <= trial.error <= apart.max() * 1.001
    speeds = [np.linalg.norm(SYSTEM.vector_field(x, t)) for x, t in zip(found, times, strict=True)]
    assert pilot.speed == pytest.approx(max(speeds) / np.linalg.norm(X0), rel=0.1)


@pytest.mark.parametrize("sizes", [(1.0, 1e-3), (1e3, 1.0), (1.0, 1e-6, 30.0)])
def test_errors_are_relative_to_each_member(sizes):
    """All but the second rest on an axis, whatever their size."""
    ensemble = np.array([[size, 0.0, 0.0] for size in sizes])
    ensemble[1] = sizes[1] * X0
    stiff = co.systems.rigid_body(sizes[1] / MASSES)
    pilot = Pilot(stiff, ensemble, 0.0, 1.5)
    steps = pilot.comparable_steps(pilot.window / pilot.natural_step * 2)
    run = co.integrate(stiff, ensemble[1], (0.0, pilot.window), pilot.window / steps, co.GaussLegendre(2))
    apart = np.linalg.norm(run.x - stiff.exact(ensemble[1], run.t), axis=1) / np.linalg.norm(ensemble[1])
    assert apart[-1] * 0.999 <= pilot.trial(co.GaussLegendre(2), steps).error <= apart.max() * 1.001


@pytest.mark.parametrize("members", [5, 40, 256, 257, 700])
@pytest.mark.parametrize("span", [3.0, -3.0])
def test_sample_contains_the_hardest_members(span, members):
    """The larger a momentum is, the faster it turns. Of many members only some are compared."""
    rng = np.random.default_rng(4)
    sizes = rng.permutation(np.linspace(0.1, 3.0, members))
    ensemble = sizes[:, None] * X0
    compared = np.unique(np.linspace(0, members - 1, min(members, 256)).round().astype(int))
    hardest = set(compared[np.argsort(-sizes[compared])[:2]].tolist())
    found = sample_of(BODY, ensemble, 0.0, span)
    chosen = {int(np.flatnonzero(np.all(ensemble == x, axis=1))[0]) for x in found}
    assert 0 in chosen and chosen >= hardest


def runs_of(monkeypatch, *given, **more):
    """Return a pilot, and the schemes and steps of its runs."""
    seen = []

    def counted(system, method, *rest):
        seen.append((method, rest[3]))
        return short_run(system, method, *rest)

    short_run = pilots.short_run
    with monkeypatch.context() as counting:
        counting.setattr(pilots, "short_run", counted)
        return Pilot(*given, **more), seen


@pytest.mark.parametrize("span", [60.0, -60.0])
def test_rounding_far_below_the_accuracy_is_measured_once(monkeypatch, span):
    repeated, twice = runs_of(monkeypatch, BODY, X0[None], 0.0, span)
    found, once = runs_of(monkeypatch, BODY, X0[None], 0.0, span, accuracy=1e-6)
    assert len(twice) == len(once) + pilots.REPETITIONS
    assert np.array_equal(found.reference, repeated.reference) and found.sensitivity == repeated.sensitivity
    assert max(repeated.noise, found.noise) <= 2.0**-14 * 1e-6


def test_rounding_is_measured_again_over_long_spans(monkeypatch):
    """Over ten million windows the rounding of one is not negligible."""
    _, long = runs_of(monkeypatch, BODY, X0[None], 0.0, 1e9, accuracy=1e-6)
    _, short = runs_of(monkeypatch, BODY, X0[None], 0.0, 1e3, accuracy=1e-6)
    assert len(long) > len(short)


def test_sensitivity_matches_the_exact_motion():
    """Runs with the same steps are compared, so that the error of the steps does not count as growth."""
    pilot = Pilot(BODY, X0[None], 0.0, 200.0)
    rng = np.random.default_rng(pilots.SEED)
    direction = rng.standard_normal((1, 3))
    small = 1e-6 * direction / np.linalg.norm(direction) * np.linalg.norm(X0)
    times = pilot.window * np.arange(pilot.points + 1) / pilot.points
    apart = np.linalg.norm(BODY.exact(X0 + small[0], times) - BODY.exact(X0, times), axis=1) / 1e-6 / np.linalg.norm(X0)
    assert pilot.sensitivity.whole == pytest.approx(np.max(apart[pilot.points // 2 + 1 :]), rel=1e-3)
    assert pilot.sensitivity.half == pytest.approx(
        np.max(apart[pilot.points // 4 + 1 : pilot.points // 2 + 1]), rel=1e-3
    )


def test_fitting_step_counts_share_points():
    pilot = Pilot(BODY, X0[None], 0.0, 200.0)
    for steps in np.geomspace(0.3, 5000.0, 60):
        up, down = pilot.comparable_steps(steps), pilot.comparable_steps(steps, finer=False)
        assert down <= max(1.0, steps) <= max(1.0, up) <= 1.3 * max(1.0, steps) + 1
        assert down >= 0.7 * steps - 1 and down >= 1
        for number in (up, down):
            assert math.gcd(number, pilot.points) >= min(number, 12)


@pytest.mark.parametrize("span", [50.0, -50.0, 0.3])
def test_natural_step_is_the_largest_accurate_halving(span):
    """Two steps of half the size agree with it; twice the step is wrong, or turns too far."""
    pilot = Pilot(BODY, X0[None], 0.0, span)

    def apart(h):
        one, two = (co.integrate(BODY, X0, (0.0, h), abs(h) / n, pilots.REFERENCE, watch=False).x for n in (1, 2))
        return np.linalg.norm(one[-1] - two[-1]) / np.max(np.linalg.norm(two, axis=1))

    h = math.copysign(pilot.natural_step, span)
    assert math.log2(span / h) == round(math.log2(span / h)) >= 0
    assert apart(h) <= pilots.STEP_AGREEMENT
    rate = np.linalg.norm(BODY.vector_field(X0)) / np.linalg.norm(X0)
    assert h == span or 2 * abs(h) * rate > pilots.MAX_INITIAL_ANGLE or apart(2 * h) > pilots.STEP_AGREEMENT


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


def test_linear_systems_of_newtons_method_are_counted():
    (candidate,) = supported_candidates(BODY, [co.GaussLegendre(4)], X0, False, strict=True)
    without = Trial(10, Growth(0.0, 0.0, 0.0), 3.0, 12.0)
    added = candidate.cost(without._replace(newton=True)) - candidate.cost(without)
    assert added == pytest.approx(newton_work(3, 4.0)) and added > 0.0


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


def test_rounding_model_is_accurate_within_a_factor():
    """Compensated against plain sums of the same steps differ by the rounding of the plain ones."""
    states = np.random.default_rng(2).standard_normal((8, 3))
    for span, step in ((100.0, 0.01), (400.0, 0.02)):
        plain, compensated = (
            co.integrate(BODY, states, (0, span), step, co.Splitting(order=4, compensated=c), watch=False).x[-1]
            for c in (False, True)
        )
        found = np.linalg.norm(plain - compensated, axis=1) / np.linalg.norm(states, axis=1)
        rows = co.Splitting(order=4).program(BODY).rows.section
        pilot = Pilot(BODY, states, 0.0, span)
        expected = roundoff(pilot, round(span / step), int(rows[2] - rows[1]), False, pilot.windows)
        # Not below what is there, and above the root mean square by no more than it takes to be on the safe side.
        assert np.max(found) <= expected <= 50 * math.sqrt(np.mean(found**2))


def test_growth_is_extrapolated():
    assert Growth(1.0, 1.0, 1.0).factor(1.0) == 1.0
    assert Growth(0.0, 0.0, 0.0).factor(100.0) == 1.0
    # A constant error is taken to grow linearly; quadratic growth is continued; a burst grows by its last power.
    assert Growth(1.0, 1.0, 1.0).factor(9.0) == 9.0
    assert Growth(1.0, 4.0, 16.0).factor(3.0) == pytest.approx(9.0)
    assert Growth(1.0, 2.0, 200.0).factor(2.0) == pytest.approx(200.0 ** (4 / 3))
    assert Growth(1.0, 1e3, 1e6).factor(1e6) == math.inf
    assert Growth(1.0, 1.0, 1.0).factor(9.0, 2.0) == 81.0
    assert Growth(1.0, 6.0, 36.0).factor(3.0, 2.0) == Growth(1.0, 6.0, 36.0).factor(3.0)


def test_cost_weights_match_measured_times():
    """A rotation takes 11 ns, eight stages in three dimensions 15 to 20, a step of a series of order 16 90 to 130."""
    plain, sums = (co.Splitting(order=2, compensated=c).work(BODY).cost(0.0, 0.0) for c in (False, True))
    assert plain == pytest.approx(2.0) and 2.0 < sums < 3.0
    beam = co.systems.vlasov_moments(4, "1/2*x20 + 1/8*x20^2 + 1/64*x40")
    assert 200 / 11 < co.Splitting(order=2, compensated=False).work(beam).cost(0.0, 0.0) < 400 / 11
    assert 15 / 11 < iteration_work(BODY, 8.0, None) < 20 / 11
    assert 90 / 11 < co.Taylor(16).work(BODY).cost(1.0, 16.0) < 130 / 11
    assert iteration_work(BODY, 8.0, None) < iteration_work(BODY, 8.0, "coadjoint")
    assert iteration_work(BODY, 9.0, None) > 1.5 * iteration_work(BODY, 8.0, None)


def test_functions_of_the_user_are_counted():
    """The same energy as numbers and as functions: one call for each flow and each evaluation of the field."""
    numbers = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]))
    terms = {i: (lambda y, m=m: 0.5 * m * y * y, lambda y, m=m: m * y) for i, m in enumerate((1.0, 0.5, 0.25))}
    functions = co.LiePoissonSystem(co.algebras.so(3), co.Separable(terms))
    method = co.Splitting(parts="coordinates", compensated=False)
    section = method.program(functions).rows.section
    count = int(section[2] - section[1])
    plain, called = (method.work(system).cost(0.0, 0.0) for system in (numbers, functions))
    wanted, margin = count * (FUNCTION_COST - MULTIPLICATION_COST), 2 * count * MULTIPLICATION_COST
    assert called - plain == pytest.approx(wanted, abs=margin)
    apart = iteration_work(functions, 8.0, None) - iteration_work(numbers, 8.0, None)
    assert apart > 8.0 * 3 * FUNCTION_COST * 0.9


@pytest.mark.parametrize("quarter", [0.0, 1e-12, 1.0, 5.0, 40.0])
@pytest.mark.parametrize("half", [0.0, 1e-12, 1.0, 6.0, 50.0])
@pytest.mark.parametrize("whole", [0.0, 1e-12, 1.0, 35.0, 400.0])
def test_growth_factor_is_monotone_and_scale_invariant(quarter, half, whole):
    growth, small = Growth(quarter, half, whole), Growth(*(2.0**-60 * value for value in (quarter, half, whole)))
    windows = (1.0, 1.5, 2.0, 10.0, 1e3, 1e9)
    for least in (1.0, 2.0):
        factors = [growth.factor(count, least) for count in windows]
        assert factors == sorted(factors) == [small.factor(count, least) for count in windows] and factors[0] == 1.0
        if whole > 0.0:
            assert all(found >= count**least * (1 - 1e-12) for found, count in zip(factors, windows, strict=True))
            # An error that appears only now is no growth, unless it grows much in the last half.
            if half == 0.0 or (quarter == 0.0 and whole <= 16.0 * half):
                assert factors == [count**least for count in windows]
        else:
            assert set(factors) == {1.0}


ROUND_NUMBERS = [1.0, 9.99e-7, 1.0000001e-9, 2.5e-9, 2.51e-13, 9.91e-3, 1e-16]


@pytest.mark.parametrize("value", [*ROUND_NUMBERS, *10.0 ** np.linspace(-17, -1, 40)])
def test_least_accuracy_is_rounded_up_to_two_digits(value):
    assert value <= float(rounded_up(value)) * (1.0 + 2.0**-50) <= 1.1 * value * (1.0 + 2.0**-48)
    assert re.fullmatch(r"\d\.\de[+-]\d\d", rounded_up(value))


class Midpoint(co.methods.StepMethod):
    order, explicit, symmetric = 2, False, True

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    def step(self, system, x, t, h):
        y = x
        for _ in range(12):
            y = x + h * system.vector_field((x + y) / 2, t + h / 2)
        return y


@dataclasses.dataclass(frozen=True)
class InPython(Midpoint):
    compiles = False


@dataclasses.dataclass(frozen=True)
class Repeated(InPython):
    """The same step after idle evaluations of the field."""

    times: int = 0

    def step(self, system, x, t, h):
        for _ in range(self.times):
            system.vector_field(x, t)
        return Midpoint.step(self, system, x, t, h)


@dataclasses.dataclass(frozen=True)
class Declared(InPython):
    def work(self, system, group=None):
        return co.methods.Work(lambda iterations, evaluations: 1234.0)


@dataclasses.dataclass(frozen=True)
class Failing(InPython):
    def step(self, system, x, t, h):
        return x * np.nan


def cost_of(method, span=20.0):
    """Return the work of a step, and whether it was measured."""
    pilot = Pilot(BODY, np.array([[1.0, 0.2, 0.5]]), 0.0, span)
    (counted,) = supported_candidates(BODY, [method], (1.0, 0.2, 0.5), False, strict=True)
    measured = with_measured_work(pilot, counted)
    return measured.work.cost(1.0, 2.0), measured is not counted


def test_steps_of_the_user_are_ranked_by_their_time():
    """And all others by counted operations."""
    one, measured = cost_of(InPython())
    assert measured and 5 < cost_of(Repeated(240))[0] / one < 60
    c1 = 1 / (2 - 2 ** (1 / 3))
    triple, measured = cost_of(co.Composition(InPython(), (c1, 1 - 2 * c1, c1)))
    assert measured and 1.5 < triple / one < 6.0
    for span in (-20.0, 1e-3):
        assert cost_of(InPython(), span)[0] > 100.0
    for method in (co.Splitting(), co.GaussLegendre(2), co.Taylor(8), co.Kahan(), Declared(), Failing()):
        assert not cost_of(method)[1], method
    assert cost_of(Declared())[0] == 1234.0
