"""Pilot runs against known motions, with the direction and the start time of the run."""

import math

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import pilot as pilots
from coadjoint.choosing.member_sample import sample_of
from coadjoint.choosing.pilot import Pilot
from coadjoint.methods.gauss_legendre import GaussLegendre

MASSES = np.array([1.0, 0.5, 0.4])
X0 = np.array([1.0, 1.5, -0.5])


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
    trial = pilot.trial(GaussLegendre(2), steps)
    run = co.integrate(SYSTEM, X0, (t0, t0 + span), abs(span) / steps, GaussLegendre(2))
    apart = np.linalg.norm(run.x - exact(t0, run.t), axis=1)[steps // 2 + 1 :] / np.linalg.norm(X0)
    # The error is that at some points of the second half, the end among them.
    assert apart[-1] * 0.999 <= trial.error <= apart.max() * 1.001
    speeds = [np.linalg.norm(SYSTEM.vector_field(x, t)) for x, t in zip(found, times, strict=True)]
    assert pilot.speed == pytest.approx(max(speeds) / np.linalg.norm(X0), rel=0.1)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("t0", [2.0, -3.0])
@pytest.mark.parametrize("span", [0.5, -0.5])
def test_choice_depends_on_the_time(t0, span):
    """The clock is seven times as fast at t = 2 as at 0, and 20 times as slow at -3."""
    ensemble = np.array([[1.0, 1e-6, 1e-6], [1e-6, 1e-6, 2.0], *np.outer([0.1, 0.2, 0.9, 1.0, 0.3], X0)])
    for method in (co.GaussLegendre(4), co.GaussLegendre(2)):
        choice = co.choose(SYSTEM, ensemble, (t0, t0 + span), 1e-8, methods=method)
        ends = co.integrate(SYSTEM, ensemble, (t0, t0 + span), choice.step, method, watch=False).x[-1]
        errors = [np.linalg.norm(end - exact(t0, t0 + span, x)) for end, x in zip(ends, ensemble, strict=True)]
        relative = np.max(errors / np.linalg.norm(ensemble, axis=1))
        assert relative <= 1e-8
        # Not by far more steps than are needed: with 60 % of them the error is above the accuracy.
        assert relative > 1e-8 * 0.6 ** (2 * method.order) or choice.step == abs(span)


@pytest.mark.parametrize("sizes", [(1.0, 1e-3), (1e3, 1.0), (1.0, 1e-6, 30.0)])
def test_errors_are_relative_to_each_member(sizes):
    """All but the second rest on an axis, whatever their size."""
    ensemble = np.array([[size, 0.0, 0.0] for size in sizes])
    ensemble[1] = sizes[1] * X0
    stiff = co.systems.rigid_body(sizes[1] / MASSES)
    pilot = Pilot(stiff, ensemble, 0.0, 1.5)
    steps = pilot.comparable_steps(pilot.window / pilot.natural_step * 2)
    run = co.integrate(stiff, ensemble[1], (0.0, pilot.window), pilot.window / steps, GaussLegendre(2))
    apart = np.linalg.norm(run.x - stiff.exact(ensemble[1], run.t), axis=1) / np.linalg.norm(ensemble[1])
    assert apart[-1] * 0.999 <= pilot.trial(GaussLegendre(2), steps).error <= apart.max() * 1.001


def test_natural_step_depends_on_the_direction():
    forward, backward = (Pilot(SYSTEM, X0[None], 2.0, span).natural_step for span in (2.0, -4.0))
    assert backward >= 2.0 * forward


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


def test_reference_is_refined_only_as_needed(monkeypatch):
    pilot, seen = runs_of(monkeypatch, BODY, X0[None], 0.0, 60.0)
    steps = [count for method, count in seen if count > 2]
    coarse, fine = pilot.reference_steps // 2, pilot.reference_steps
    repeated = [fine + k * pilot.points for k in range(1, pilots.REPETITIONS + 1)]
    assert steps == [coarse, fine, coarse, *repeated]
    times = 60.0 * np.arange(pilot.points + 1) / pilot.points
    assert np.max(np.abs(pilot.reference[:, 0] - BODY.exact(X0, times))) < 1e-13


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


@pytest.mark.thinned(6)
@pytest.mark.parametrize("start", [0.0, 1e-12, 1e-300])
@pytest.mark.parametrize("span", [10.0, -10.0])
def test_natural_step_from_a_tiny_start(start, span):
    """x'' = -x with a constant force, from rest: the initial rate, speed over size, is useless."""
    system = co.PoissonSystem(
        lambda x: np.array([[0.0, 1.0], [-1.0, 0.0]]), co.Quadratic(np.eye(2), linear=[1.0, 0.5]), name="driven"
    )
    pilot = Pilot(system, np.array([[start, 0.0]]), 0.0, span)
    assert 0.5 <= pilot.natural_step <= 5.0
    choice = co.choose(system, (start, 0.0), (0.0, span), 1e-8)
    end = co.integrate(system, (start, 0.0), (0.0, span), choice.step, choice.method).x[-1]
    exact = np.array([np.cos(span) + 0.5 * np.sin(span) - 1.0, 0.5 * np.cos(span) - np.sin(span) - 0.5])
    assert np.linalg.norm(end - exact) < 1e-8 * 3.0
