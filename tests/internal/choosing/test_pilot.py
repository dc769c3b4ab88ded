"""Pilot runs, samples of ensembles, growth and rounding of errors, and the work of steps, against known motions."""

import dataclasses
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import pilot as pilots
from coadjoint.choosing.accuracy import rounded_up
from coadjoint.choosing.candidates import sample_of, supported_candidates
from coadjoint.choosing.fitting import roundoff
from coadjoint.choosing.pilot import Pilot, PilotErrors
from coadjoint.kernels.interface import limit
from coadjoint.methods.protocol.cost_model import MIN_LANE_MEMBERS

X0 = np.array([1.0, 1.5, -0.5])
BODY = co.systems.rigid_body(1.0 / np.array([1.0, 0.5, 0.4]))


def quickening(x, t):
    return 0.5 * math.exp(t) * (x[0] * x[0] + 0.5 * x[1] * x[1] + 0.4 * x[2] * x[2])


def quickening_gradient(x, t):
    return math.exp(t) * np.array([x[0], 0.5 * x[1], 0.4 * x[2]])


# A rigid body with an accelerating clock: x(t) is that of the body after the time e^t - e^t0.
SYSTEM = co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(quickening, quickening_gradient), sign=-1)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("t0", [0.0, 1.25, -0.75])
@pytest.mark.parametrize("span", [1.5, -1.5])
def test_reference_is_the_exact_motion(t0, span):
    def exact(t):
        return BODY.exact(X0, np.exp(t) - math.exp(t0))

    pilot = Pilot(SYSTEM, X0[None], t0, span)
    times = t0 + span * np.arange(pilot.points + 1) / pilot.points
    found = pilot.reference[:, 0]
    # Its rounding, over some hundred steps of a path of length some tens.
    assert pilot.covers_span and np.max(np.abs(found - exact(times))) < 1e-12
    steps = pilot.comparable_steps(pilot.window / pilot.natural_step * 2)
    run = co.integrate(SYSTEM, X0, (t0, t0 + span), abs(span) / steps, co.GaussLegendre(2))
    apart = np.linalg.norm(run.x - exact(run.t), axis=1)[steps // 2 + 1 :] / np.linalg.norm(X0)
    # The error is that at some points of the second half, the end among them.
    assert apart[-1] * 0.999 <= pilot.trial(co.GaussLegendre(2), steps).error <= apart.max() * 1.001
    speeds = [np.linalg.norm(SYSTEM.vector_field(x, t)) for x, t in zip(found, times, strict=True)]
    assert pilot.speed == pytest.approx(max(speeds) / np.linalg.norm(X0), rel=0.1)


@pytest.mark.parametrize("members", [5, 256, 257, 700])
@pytest.mark.parametrize("span", [3.0, -3.0])
def test_sample_contains_the_hardest_members(span, members):
    """The larger a momentum is, the faster it turns. Of many members only some are compared."""
    sizes = np.random.default_rng(4).permutation(np.linspace(0.1, 3.0, members))
    ensemble = sizes[:, None] * X0
    compared = np.unique(np.linspace(0, members - 1, min(members, 256)).round().astype(int))
    hardest = set(compared[np.argsort(-sizes[compared])[:2]].tolist())
    _, found = sample_of(BODY, ensemble, 0.0, span)
    assert {int(np.flatnonzero(np.all(ensemble == x, axis=1))[0]) for x in found} >= {0, *hardest}


def test_rounding_far_below_the_accuracy_is_measured_once_unless_the_span_is_long(monkeypatch):
    """Over ten million windows the rounding of one is not negligible."""
    seen, short_run = [], pilots.short_run
    monkeypatch.setattr(pilots, "short_run", lambda *given: seen.append(given) or short_run(*given))

    def pilot_and_runs(span, **more):
        seen.clear()
        return Pilot(BODY, X0[None], 0.0, span, **more), len(seen)

    for span in (60.0, -60.0):
        (repeated, twice), (found, once) = pilot_and_runs(span), pilot_and_runs(span, accuracy=1e-6)
        assert twice == once + pilots.REPETITIONS
        assert np.array_equal(found.reference, repeated.reference) and found.sensitivity == repeated.sensitivity
        assert max(repeated.noise, found.noise) <= 2.0**-14 * 1e-6
    assert pilot_and_runs(1e9, accuracy=1e-6)[1] > pilot_and_runs(1e3, accuracy=1e-6)[1]


def test_sensitivity_matches_the_exact_motion():
    """Runs with the same steps are compared, so that the error of the steps does not count as growth."""
    pilot = Pilot(BODY, X0[None], 0.0, 200.0)
    direction = np.random.default_rng(pilots.SEED).standard_normal(3)
    small = 1e-6 * direction / np.linalg.norm(direction) * np.linalg.norm(X0)
    times = pilot.window * np.arange(pilot.points + 1) / pilot.points
    apart = np.linalg.norm(BODY.exact(X0 + small, times) - BODY.exact(X0, times), axis=1) / 1e-6 / np.linalg.norm(X0)
    for found, first, last in ((pilot.sensitivity.whole, 2, 1), (pilot.sensitivity.half, 4, 2)):
        largest = np.max(apart[pilot.points // first + 1 : pilot.points // last + 1])
        assert found == pytest.approx(largest, rel=1e-3)


@pytest.mark.parametrize("span", [50.0, -50.0, 0.3])
def test_natural_step_is_the_largest_accurate_halving(span):
    """Two steps of half the size agree with it; twice the step is wrong, or turns too far."""

    def apart(h):
        one, two = (co.integrate(BODY, X0, (0.0, h), abs(h) / n, pilots.REFERENCE, watch=False).x for n in (1, 2))
        return np.linalg.norm(one[-1] - two[-1]) / np.max(np.linalg.norm(two, axis=1))

    h = math.copysign(Pilot(BODY, X0[None], 0.0, span).natural_step, span)
    assert math.log2(span / h) == round(math.log2(span / h)) >= 0
    assert apart(h) <= pilots.STEP_AGREEMENT
    rate = np.linalg.norm(BODY.vector_field(X0)) / np.linalg.norm(X0)
    assert h == span or 2 * abs(h) * rate > pilots.MAX_INITIAL_ANGLE or apart(2 * h) > pilots.STEP_AGREEMENT


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0)])
@pytest.mark.parametrize("span", [1.0, -1.0])
def test_pilot_of_an_ensemble_measures_its_worst_member(order, span):
    """Members of very different sizes and speeds, one at rest."""
    members = np.array([[3.0, 2.0, -2.5], [0.1, 0.05, 0.2], [0.0, 0.4, 0.0]])
    alone = [Pilot(BODY, x[None], 0.0, span) for x in members]
    ensemble = Pilot(BODY, members[list(order)], 0.0, span)
    assert ensemble.natural_step == min(pilot.natural_step for pilot in alone)
    assert ensemble.speed == pytest.approx(max(pilot.speed for pilot in alone), rel=1e-12)
    np.testing.assert_allclose(ensemble.size, [alone[k].size[0] for k in order], rtol=1e-14)
    for method in (co.GaussLegendre(2), co.Splitting(order=2)):
        together, trials = ensemble.trial(method, 48), [pilot.trial(method, 48) for pilot in alone]
        np.testing.assert_allclose(together.growth, np.max([trial.growth for trial in trials], axis=0), rtol=1e-6)
        for name in ("iterations", "evaluations"):
            of_each = [getattr(trial, name) for trial in trials]
            assert getattr(together, name) == pytest.approx(np.mean(of_each), rel=0.3)


def test_sensitivity_is_that_of_the_worst_member():
    """Near the middle axis small changes grow like exp(t size / sqrt(12)), near the others they do not grow."""
    calm, unstable = [1.0, 1e-3, 1e-3], [1e-9, 1.0, 1e-9]
    for members in ([calm, unstable], [unstable, calm]):
        # A half of exp(12 / sqrt(12)) at least, along a random direction a tenth of it.
        assert Pilot(BODY, np.array(members), 0.0, 12.0).sensitivity.whole > 0.05 * math.exp(12.0 / math.sqrt(12.0))
    assert Pilot(BODY, np.array([calm]), 0.0, 12.0).sensitivity.whole < 10.0


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
    pilot, rows = Pilot(BODY, states, 0.0, span), method.flow_table(BODY).stages.section

    def model(compensated, steps=4096, windows=pilot.windows):
        return roundoff(pilot, steps, int(rows[2] - rows[1]), compensated, windows)

    # Twice as many steps, whose errors grow on the way back as they did on the way there.
    assert 0.0 < found <= 2.0 * pilot.sensitivity.whole * model(compensated)
    assert (model(not compensated) > model(compensated)) == compensated
    # Errors add up like the root of the number of steps at least; compensated sums of smaller increments round less.
    one, many = (model(compensated, steps, 1.0) for steps in (10**6, 10**8))
    assert many <= one if compensated else many > 5.0 * one
    assert model(compensated, 10**6, 1000.0) > 90.0 * model(compensated, 10**6, 10.0)


@pytest.mark.parametrize("windows", [1.0, 10.0])
def test_rounded_coefficients_accumulate_like_a_random_walk(windows):
    """As many flows in all, in longer compositions: three roundings along the path, times the root of their number."""
    pilot = SimpleNamespace(noise=0.0, speed=2.0, window=5.0, sensitivity=PilotErrors(1.0, 1.0, 1.0))

    def units(flows, compensated, steps=36_000):
        return roundoff(pilot, steps // max(flows, 1), flows, compensated, windows) * 2.0**53

    path, walk = 2.0 * 5.0 * windows, math.sqrt(36_000) * windows
    for compensated in (False, True):
        one, four, nine = (units(flows, compensated) for flows in (1, 4, 9))
        assert (four - one, nine - one) == pytest.approx((3.0 * path, 6.0 * path))
        assert units(0, compensated) == pytest.approx(1.0 + path + 0.1 * walk)
    # Each flow rounds by half a unit of its increment, and the sum, if plain, with a bias.
    share = 4.0 * path / 36_000
    assert units(1, True) == pytest.approx(1.0 + 3.0 * path + 0.5 * walk * share)
    assert units(1, False) == pytest.approx(1.0 + 3.0 * path + 0.5 * walk + 7e-4 * 36_000 * windows)


@pytest.mark.parametrize(("span", "step"), [(100.0, 0.01), (400.0, 0.02)])
def test_rounding_model_is_accurate_within_a_factor(span, step):
    """Compensated against plain sums of the same steps differ by the rounding of the plain ones."""
    states = np.random.default_rng(2).standard_normal((8, 3))
    methods = [co.Splitting(order=4, compensated=compensated) for compensated in (False, True)]
    plain, exact = (co.integrate(BODY, states, (0, span), step, method, watch=False).x[-1] for method in methods)
    found = np.linalg.norm(plain - exact, axis=1) / np.linalg.norm(states, axis=1)
    rows, pilot = methods[0].flow_table(BODY).stages.section, Pilot(BODY, states, 0.0, span)
    expected = roundoff(pilot, round(span / step), int(rows[2] - rows[1]), False, pilot.windows)
    # Not below what is there, and above the root mean square by no more than it takes to be on the safe side.
    assert np.max(found) <= expected <= 50 * math.sqrt(np.mean(found**2))


def test_growth_is_extrapolated():
    """A constant error grows linearly, quadratic growth is continued, and a burst grows by its last power."""
    for growth, given, factor in (
        ((0.0, 0.0, 0.0), (100.0,), 1.0),
        ((1.0, 1.0, 1.0), (1.0,), 1.0),
        ((1.0, 1.0, 1.0), (9.0,), 9.0),
        ((1.0, 1.0, 1.0), (9.0, 2.0), 81.0),
        ((1.0, 4.0, 16.0), (3.0,), 9.0),
        ((1.0, 2.0, 200.0), (2.0,), 200.0 ** (4 / 3)),
        ((1.0, 1e3, 1e6), (1e6,), math.inf),
        # An error that appears only now is no growth, unless it grows much in the last half.
        ((1.0, 0.0, 35.0), (3.0,), 3.0),
        ((0.0, 5.0, 80.0), (3.0,), 3.0),
    ):
        assert PilotErrors(*growth).factor(*given) == pytest.approx(factor)
        assert PilotErrors(*(2.0**-60 * value for value in growth)).factor(*given) == pytest.approx(factor)
    assert PilotErrors(1.0, 6.0, 36.0).factor(3.0, 2.0) == PilotErrors(1.0, 6.0, 36.0).factor(3.0)
    assert PilotErrors(0.0, 1.0, 40.0).factor(3.0) > 9.0


@pytest.mark.parametrize("value", [1.0, 9.99e-7, 1.0000001e-9, 2.5e-9, 2.51e-13, 9.91e-3, 1e-16])
def test_least_accuracy_is_rounded_up_to_two_digits(value):
    assert value <= float(rounded_up(value)) * (1.0 + 2.0**-50) <= 1.1 * value * (1.0 + 2.0**-48)
    assert re.fullmatch(r"\d\.\de[+-]\d\d", rounded_up(value))


@dataclasses.dataclass(frozen=True)
class InPython(co.methods.StepMethod):
    """The midpoint rule."""

    order, explicit, symmetric, compiles = 2, False, True, False

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    def step(self, system, x, t, h):
        y = x
        for _ in range(12):
            y = x + h * system.vector_field((x + y) / 2, t + h / 2)
        return y


class Declared(InPython):
    def work(self, system, group=None):
        return co.methods.Work(lambda iterations, evaluations: 1234.0)


def test_steps_in_python_are_counted_as_calls():
    """Without a clock, so that the choice is the same under any load; `work` overrides the estimate."""

    def cost(method):
        (found,) = supported_candidates(BODY, [method], X0, False, strict=True)
        return found.work.cost(1.0, 2.0)

    assert cost(Declared()) == 1234.0 and cost(InPython()) > 50 * cost(co.Kahan())
    assert cost(co.Composition(InPython(), (0.75, -0.5, 0.75))) == 3 * cost(InPython())
    choice = co.choose(BODY, X0, (0.0, 10.0), 1e-3, methods=[InPython(), co.GaussLegendre(1)])
    assert choice.method == co.GaussLegendre(1) and all(other.cost > 5 * choice.cost for other in choice.others)
