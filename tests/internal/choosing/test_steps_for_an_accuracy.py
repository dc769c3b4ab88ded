"""Numbers of steps that schemes need, fitted to errors of trials and predicted from others of their family."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import families, fitting
from coadjoint.choosing import pilot as pilots
from coadjoint.choosing.fitting import ROUNDING_MARGIN, StepFit, confirmed_fit, roundoff
from coadjoint.choosing.fitting import fit as fit_steps
from coadjoint.choosing.pilot import PilotErrors, Trial

NOISE = 1e-13
BODY = co.systems.rigid_body((1, 2, 2.5))
TODA = (-0.8, 0.1, -0.2, 0.9, 0.4, 0.35, 0.45)


class FixedErrors(SimpleNamespace):
    """A pilot run of a scheme whose errors are `error(steps)`."""

    noise, reference_steps, span = NOISE, 200, 1.0
    sensitivity = PilotErrors(1.0, 1.0, 1.0)
    speed = window = 1.0

    @property
    def covers_span(self):
        return self.windows == 1.0

    @property
    def share(self):
        return 1.0 if self.covers_span else 0.5

    def comparable_steps(self, steps, finer=True):
        return max(1, int(steps) if not finer else -int(-steps // 1))

    def trial(self, method, steps):
        self.tried.append(steps)
        error = self.error(steps)
        return None if error is None else Trial(steps, PilotErrors(error, error, error), 1.0, 8.0)


def found_of(error, steps, windows=1.0, **changed):
    pilot = FixedErrors(error=error, windows=windows, tried=[])
    candidate = {"method": co.Taylor(16), "cost": lambda trial: 1.0, "share": 1.0, "flows": 0, "summed_exactly": True}
    candidate = SimpleNamespace(**{**candidate, "growth": lambda p, t: windows, **changed})
    return StepFit(pilot, candidate, steps, 0.0, Trial(steps, PilotErrors(0.0, 0.0, 0.0), 1.0, 8.0))


def fitted(error, order, goal, limit=math.inf, windows=1.0, share=1.0):
    """Fit from 40 steps in each window; errors at the end are those of a window times the number of windows."""
    found = found_of(error, 1, windows, method=co.Taylor(order), share=share)
    return fit_steps(found.pilot, found.candidate, goal, limit, 40.0 * windows)


@pytest.mark.parametrize("windows", [1.0, 3.0])
@pytest.mark.parametrize("ratio", [0.5, 0.99, 1.01, 2.0])
def test_measured_rounding_stays_below_the_accuracy(ratio, windows):
    """Large steps may amplify rounding: 7/8 of the accuracy, the reference may have the rest, or more steps."""
    required = 4.0 * NOISE
    seen = 7 / 8 * required * ratio / windows
    found = confirmed_fit(found_of(lambda steps: seen * (100 / steps) ** 16, int(100 * windows), windows), required)
    if ratio < 1.0:
        assert found.steps == 100 * windows and found.pilot.tried == [100]
    else:
        assert found.steps > 100 * windows and found.error <= required
        assert seen * (100 * windows / found.steps) ** 16 * windows <= 7 / 8 * required


@pytest.mark.thinned(1)
@pytest.mark.parametrize("steps", [9, 10, 11])
def test_a_confirmed_error_is_that_of_the_steps_of_the_run(steps):
    """Over three windows, each tried with the whole number of steps below a third of them."""
    wanted = 3e-3 * (9.0 / steps) ** 16
    found = confirmed_fit(found_of(lambda tried: 1e-3 * (3.0 / tried) ** 16, steps, 3.0), wanted / 0.3)
    assert found.steps == steps and found.error == pytest.approx(wanted, rel=1e-12) and found.pilot.tried == [3]


@pytest.mark.parametrize("windows", [1.0, 3.0])
def test_rounding_that_remains_too_large_is_reported(windows):
    """More steps do not help; the error is the accuracy at which the fit is accepted."""

    def confirmed(required):
        return confirmed_fit(found_of(lambda steps: 3.0 * NOISE, int(100 * windows), windows), required)

    found = confirmed(3.0 * NOISE)
    assert found.error > 3.0 * NOISE and len(found.pilot.tried) == 6
    assert confirmed(1.001 * found.error).pilot.tried == [100]


@pytest.mark.parametrize("windows", [1.0, 4.0])
def test_failed_or_inaccurate_run_gets_more_steps(windows):
    """It ends below the accuracy, with the error of a trial with as many steps, and not with far too many."""
    for error, most in (
        (lambda steps: None if steps < 130 else 1e-12, 1.25 * 130),
        (lambda steps: 1e-4 * (100 / steps) ** 16, 1.1 * 100 * 1e2 ** (1 / 16) * windows),
    ):
        found = confirmed_fit(found_of(error, int(100 * windows), windows), 4e-6)
        per_window = found.steps / windows
        assert found.pilot.tried[0] == 100 and per_window <= most
        assert error(per_window) * windows <= 4e-6
        assert found.error == pytest.approx(error(per_window) * windows, rel=0.25)
    # Ten windows with 85.7 steps in each: the trial fails with 85, and 86 would not show it.
    found = confirmed_fit(found_of(lambda steps: None if steps <= 85 else 1e-9, 857, windows=10.0), 4e-6)
    assert found.pilot.tried[0] == 85 and found.steps > 1000
    assert found.steps / 10.0 >= max(found.pilot.tried)


@pytest.mark.parametrize("order", [4, 16])
@pytest.mark.parametrize(("windows", "least", "most"), [(1.0, 0.3, 0.9), (4.0, 0.15, 0.45)])
@pytest.mark.parametrize("start", [0.6, 1.0, 1.7])
def test_errors_use_what_is_allowed(start, windows, least, most, order):
    """Whatever the fit was; beyond the window only half of it, since growth is extrapolated."""

    def error(steps):
        return (60 / steps) ** order

    needed = 60 * (1e-6 / windows) ** (-1.0 / order) * windows
    found = confirmed_fit(found_of(error, int(start * needed), windows, method=co.Taylor(order)), 1e-6)
    assert least * 1e-6 <= found.error <= most * 1e-6 and len(found.pilot.tried) <= 4
    # Where the error jumps, it is nearly the least number of steps that serves.
    found = confirmed_fit(found_of(lambda steps: 1e-9 if steps > 100 else 1e-3, int(150 * windows), windows), 1e-6)
    assert 100 < found.steps / windows <= 120


@pytest.mark.parametrize("windows", [1.0, 3.0, 1000.0])
def test_steps_stay_away_from_the_stability_limit(windows):
    """Up to 60 steps fail; beyond them the error is zero, or follows the order from an error below the goal."""
    found = fitted(lambda steps: None if steps <= 60 else 1e-40, 6, 1e-10, windows=windows)
    tried = found.pilot.tried
    failed = max(steps for steps in tried if steps <= 60)
    assert tried[0] == 40 and 1.5 * failed <= found.steps / windows <= 2.0 * 60 and len(tried) <= 10
    # Noise of a 256th part is assumed where nothing is seen, and more steps have smaller errors.
    assert 0.0 < found.error <= 16.0 * NOISE * windows
    for order in (2, 6):

        def error(steps, order=order):
            return None if steps <= 60 else 1e-8 * (60 / steps) ** order

        found = fitted(error, order, 1e-3, windows=windows)
        assert found.steps > 60 * windows
        assert found.error == pytest.approx(error(found.steps / windows) * windows, rel=1e-9)


@pytest.mark.parametrize("windows", [1.0, 3.0, 1000.0])
@pytest.mark.parametrize("order", [6, 24])
def test_step_count_follows_the_order(order, windows):
    found = fitted(lambda steps: (60 / steps) ** order, order, 1e-6, windows=windows)
    needed = 60 * (1e-6 / windows) ** (-1.0 / order) * windows
    assert needed * (1.0 - 1e-9) <= found.steps <= 1.02 * needed + 1
    per_window = found.steps / windows
    assert found.error <= 1e-6 * (1.0 + 1e-9)
    assert found.error == pytest.approx((60 / per_window) ** order * windows, rel=1e-9)
    assert found.end == pytest.approx((60 / found.trial.steps) ** order * windows)


@pytest.mark.parametrize("windows", [1.0, 3.0])
@pytest.mark.parametrize("share", [1.0, 0.125])
def test_expensive_scheme_is_abandoned(windows, share):
    tried, limit = [], 20.0 * windows * share
    given = {"windows": windows, "share": share}
    assert fitted(lambda steps: tried.append(steps) or 0.9, 16, 1e-6, limit=limit, **given) is None
    assert tried == [40]
    # The limit is exceeded by 1 + 6/16 at most: there 40 steps are still worth another trial.
    assert fitted(lambda steps: tried.append(steps) or 0.9, 16, 1e-6, limit=2.0 * limit, **given) is None
    assert tried[:3] == [40, 40, 80]
    needed = 60 * (1e-6 / windows) ** (-1.0 / 16)
    for times, abandoned in ((4.0, True), (5.0, needed > 1.375 * 100.0), (10.0, False)):
        found = fitted(lambda steps: (60 / steps) ** 16, 16, 1e-6, limit=times * limit, **given)
        assert found.cost == found.steps * share and (len(found.pilot.tried) < 3) == abandoned, found.pilot.tried


def test_slowly_converging_stages_get_more_steps():
    """With 80 steps the stages iterate too long to be affordable, with 160 they do not."""
    found = found_of(
        lambda steps: 0.9 if steps < 100 else (60 / steps) ** 12, 1,
        method=co.GaussLegendre(6), cost=lambda trial: trial.iterations,
    )  # fmt: skip
    seen = found.pilot.trial
    found.pilot.trial = lambda method, steps: seen(method, steps)._replace(iterations=20.0 if steps < 100 else 1.0)
    fit = fit_steps(found.pilot, found.candidate, 1e-6, 300.0, 40.0)
    assert fit is not None and fit.cost <= 300.0


@pytest.mark.parametrize("windows", [1.0, 1000.0])
@pytest.mark.parametrize("seen", [1e-9, 1e-16])
@pytest.mark.parametrize("method", [co.Taylor(tolerance=1e-12), co.Taylor(16)], ids=str)
def test_rounding_of_variable_steps_includes_the_trial(method, seen, windows):
    """The excess of its error over that of the tolerance, if that is above the modelled rounding."""
    fit = found_of(None, 40, windows, method=method)
    trial = fit.trial._replace(growth=PilotErrors(0.1 * seen, 0.5 * seen, seen))
    found = StepFit(fit.pilot, fit.candidate, 40, 0.25 * seen * windows, trial)
    model = roundoff(fit.pilot, 40, 0, True, windows, ROUNDING_MARGIN)
    assert found.end == pytest.approx(seen * windows)
    assert found.roundoff == pytest.approx(max(0.75 * seen * windows, model) if method.own_steps else model)
    assert (0.75 * seen * windows > model) == (seen == 1e-9)


def test_families_differ_in_order_only():
    methods = [co.Splitting(order=4), co.Taylor(8), co.GaussLegendre(2), co.Splitting(order=4, compensated=True)]
    methods += [co.Taylor(12), co.Taylor(tolerance=1e-6), co.Splitting(order=6), co.Taylor(6, projected=False)]
    methods += [co.Splitting(scheme="blanes_casas_murua6"), co.RadauEnergy(2), co.GaussLegendre(5)]
    groups = families.families([SimpleNamespace(method=method) for method in methods])
    numbers = [[methods.index(each.method) for each in group] for group in groups]
    assert numbers == [[0, 6], [1, 4], [2, 10], [3], [5], [7], [8], [9]]


@pytest.mark.parametrize("goal", [1e-2, 1e-8])
@pytest.mark.parametrize(("c", "r"), [(1.0, 1.0), (0.1, 0.25), (50.0, 3.0)])
def test_steps_of_a_family_follow_from_two_orders(c, r, goal):
    """Errors of order p are c (h / r)^p: two fits give both constants."""

    def needed(order):
        return (c / goal) ** (1.0 / order) / r * 1e6

    # One step more or less than needed has another error.
    fits = [found_of(None, round(1.1 * needed(p)), method=co.Taylor(p)) for p in (8, 16)]
    fits = [replace(each, error=goal * 1.1**-each.candidate.method.order) for each in fits]
    for order in (4, 12, 24):
        candidate = SimpleNamespace(method=co.Taylor(order), cost=lambda trial: trial.evaluations, share=0.5)
        assert families.predicted_steps(candidate, fits, goal) == pytest.approx(needed(order), rel=1e-3)
        # The evaluations of a step are in proportion to the order.
        nearest = 8 if order < 12 else 16
        cost = 0.5 * 8.0 * order / nearest * needed(order)
        assert order == 12 or families.predicted_cost(candidate, fits, goal) == pytest.approx(cost, rel=1e-3)
        if c == 1.0:  # which is assumed of a single one
            assert families.predicted_steps(candidate, fits[:1], goal) == pytest.approx(needed(order), rel=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("wanted", [1e-3, 1e-10])
def test_schemes_left_untried_are_not_cheaper(monkeypatch, wanted):
    """A search finds the steps of a scheme to about a third."""
    solvable = co.LiePoissonSystem(co.algebras.get("A5,40"), co.Quadratic(np.eye(5) + 0.2))
    problems = (BODY, (0.6, 0.0, 0.8), 100.0), (co.systems.toda(4), TODA, 5.0), (solvable, np.linspace(-1, 1, 5), -5.0)
    for system, x0, span in problems:
        chosen = co.choose(system, x0, (0.0, span), wanted)
        with monkeypatch.context() as all_tried:
            all_tried.setattr(families, "predicted_cost", lambda *given, **named: 0.0)
            thorough = co.choose(system, x0, (0.0, span), wanted)
        assert chosen.cost <= 1.35 * thorough.cost and chosen.error <= wanted


def test_few_trials_and_short_runs_are_made(monkeypatch):
    """Most of the 21 candidates are left out."""
    made = dict.fromkeys(("short_run", "fit", "_tolerance_trial"), 0)

    def count(module, name):
        def counted(*given):
            made[name] += 1
            return real(*given)

        real = getattr(module, name)
        monkeypatch.setattr(module, name, counted)

    for place in ((pilots, "short_run"), (families, "fit"), (fitting, "_tolerance_trial")):
        count(*place)
    choice = co.choose(BODY, (0.6, 0.3, 0.8), (0.0, 200.0), 1e-6)
    assert not choice.method.own_steps and made["_tolerance_trial"] <= 3 and made["short_run"] <= 30
    made["fit"] = 0
    # Particles fly apart: variable steps are so much longer that few other schemes are worth a trial.
    assert co.choose(co.systems.toda(4), TODA, (0.0, 80.0), 1e-6).method.own_steps and 2 <= made["fit"] <= 6
