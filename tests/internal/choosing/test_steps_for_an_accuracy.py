"""Numbers of steps that schemes need, fitted to errors of trials and predicted from other schemes."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import accuracy, system_cache, tolerances
from coadjoint.choosing import pilot as pilots
from coadjoint.choosing.cost_model import (
    MAX_ADVANTAGE,
    NEAREST_DIVISOR,
    RELATED_DIVISOR,
    SeriesErrorModel,
    StepPredictor,
    series_error_model,
)
from coadjoint.choosing.fitting import Fit, confirmed_fit
from coadjoint.choosing.fitting import fit as fit_steps
from coadjoint.choosing.pilot import Growth, Trial
from coadjoint.choosing.roundoff import ROUNDING_MARGIN, roundoff

NOISE = 1e-13
BODY = co.systems.rigid_body((1, 2, 2.5))
TODA = (-0.8, 0.1, -0.2, 0.9, 0.4, 0.35, 0.45)


class FixedErrors(SimpleNamespace):
    """A pilot run of a scheme whose errors are `error(steps)`."""

    noise, natural_step, span = NOISE, 0.01, 1.0
    sensitivity = Growth(1.0, 1.0, 1.0)
    speed = window = 1.0

    @property
    def covers_span(self):
        return self.windows == 1.0

    def comparable_steps(self, steps, finer=True):
        return max(1, int(steps) if not finer else -int(-steps // 1))

    def trial(self, method, steps):
        self.tried.append(steps)
        error = self.error(steps)
        return None if error is None else Trial(steps, Growth(error, error, error), 1.0, 8.0)


def found_of(error, steps, windows=1.0):
    pilot = FixedErrors(error=error, windows=windows, tried=[])
    candidate = SimpleNamespace(
        method=co.Taylor(16),
        cost=lambda trial: 1.0,
        share=1.0,
        flows=0,
        summed_exactly=True,
        growth=lambda p, t: windows,
    )
    return Fit(pilot, candidate, steps, 0.0, Trial(steps, Growth(0.0, 0.0, 0.0), 1.0, 8.0))


@pytest.mark.parametrize("windows", [1.0, 3.0])
@pytest.mark.parametrize("ratio", [0.5, 0.99, 1.01, 2.0])
def test_measured_rounding_stays_below_the_accuracy(ratio, windows):
    """Large steps may amplify rounding: 7/8 of the accuracy, the reference may have the rest, or more steps."""
    required = 4.0 * NOISE
    seen = 7 / 8 * required * ratio / windows
    fitted_run = found_of(lambda steps: seen * (100 / steps) ** 16, int(100 * windows), windows)
    found = confirmed_fit(fitted_run, NOISE, required)
    if ratio < 1.0:
        assert found.steps == 100 * windows and found.pilot.tried == [100]
    else:
        assert found.steps > 100 * windows and found.error <= required
        assert seen * (100 * windows / found.steps) ** 16 * windows <= 7 / 8 * required


@pytest.mark.parametrize("windows", [1.0, 3.0])
def test_rounding_that_remains_too_large_is_reported(windows):
    """More steps do not help; the error is the accuracy at which the fit is accepted."""

    def confirmed(required):
        return confirmed_fit(found_of(lambda steps: 3.0 * NOISE, int(100 * windows), windows), NOISE, required)

    found = confirmed(3.0 * NOISE)
    assert found.error > 3.0 * NOISE and len(found.pilot.tried) == 6
    assert confirmed(1.001 * found.error).pilot.tried == [100]


def test_confirmation_is_no_finer_than_the_run():
    """Ten windows with 85.7 steps in each: the trial fails with 85, and 86 would not show it."""
    found = confirmed_fit(found_of(lambda steps: None if steps <= 85 else 1e-9, 857, windows=10.0), 1e-6, 4e-6)
    assert found.pilot.tried[0] == 85 and found.steps > 1000
    assert found.steps / 10.0 >= max(found.pilot.tried)


@pytest.mark.parametrize("windows", [1.0, 4.0])
def test_failed_or_inaccurate_run_gets_more_steps(windows):
    """It ends below the bound, with the error of a trial with as many steps, and not with far too many."""
    for error in (lambda steps: None if steps < 130 else 1e-12, lambda steps: 1e-4 * (100 / steps) ** 16):
        found = confirmed_fit(found_of(error, int(100 * windows), windows), 1e-6, 4e-6)
        per_window = found.steps / windows
        assert found.pilot.tried[0] == 100 and found.pilot.tried == sorted(found.pilot.tried)
        assert error(per_window) * windows <= 2e-6
        assert (
            per_window <= 1.25 * 130
            if found.error < 1e-11 * windows
            else per_window <= 1.1 * 100 * 1e2 ** (1 / 16) * windows
        )
        assert found.error == pytest.approx(error(per_window) * windows, rel=0.25)


def fitted(error, order, goal, limit=math.inf, windows=1.0, share=1.0):
    """Fit from 40 steps in each window; errors at the end are those of a window times the number of windows."""
    found = found_of(error, 1, windows)
    candidate = SimpleNamespace(**{**vars(found.candidate), "method": co.Taylor(order), "share": share})
    return fit_steps(found.pilot, candidate, goal, limit, 40.0 * windows)


@pytest.mark.parametrize("windows", [1.0, 3.0, 1000.0])
def test_steps_stay_away_from_the_stability_limit(windows):
    """Up to 60 steps fail, and beyond them the error is zero."""
    found = fitted(lambda steps: None if steps <= 60 else 1e-40, 6, 1e-10, windows=windows)
    tried = found.pilot.tried
    assert tried[0] == 40
    failed = max(steps for steps in tried if steps <= 60)
    assert 1.5 * failed <= found.steps / windows <= 2.0 * 60
    assert len(tried) <= 10
    # Noise of a 256th part is assumed where nothing is seen, and more steps have smaller errors.
    assert 0.0 < found.error <= 16.0 * NOISE * windows


@pytest.mark.parametrize("windows", [1.0, 3.0])
@pytest.mark.parametrize("order", [2, 6])
def test_error_of_steps_that_stability_requires_follows_the_order(order, windows):
    """The goal alone would take fewer steps than the 60 that fail."""

    def error(steps):
        return None if steps <= 60 else 1e-8 * (60 / steps) ** order

    found = fitted(error, order, 1e-6, windows=windows)
    assert found.steps > 60 * windows
    assert found.error == pytest.approx(error(found.steps / windows) * windows, rel=1e-9)


@pytest.mark.parametrize("windows", [1.0, 3.0, 1000.0])
@pytest.mark.parametrize("order", [6, 24])
def test_step_count_follows_the_order(order, windows):
    found = fitted(lambda steps: (60 / steps) ** order, order, 1e-6, windows=windows)
    needed = 60 * (1e-6 / windows) ** (-1.0 / order) * windows
    assert needed * (1.0 - 1e-9) <= found.steps <= 1.02 * needed + 1
    per_window = found.steps / windows
    assert found.error <= 1e-6 * (1.0 + 1e-9) and found.error == pytest.approx(
        (60 / per_window) ** order * windows, rel=1e-9
    )
    ratio = per_window / found.trial.steps
    assert found.extrapolated == pytest.approx(max(ratio, 1.0 / ratio)) and found.extrapolated >= 1.0
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
    found = fitted(lambda steps: (60 / steps) ** 16, 16, 1e-6, limit=5.0 * limit, **given)
    needed = 60 * (1e-6 / windows) ** (-1.0 / 16)
    assert found.abandoned == (needed > 1.375 * 100.0) and found.cost == found.steps * share
    found = fitted(lambda steps: (60 / steps) ** 16, 16, 1e-6, limit=4.0 * limit, **given)
    assert found.abandoned and found.cost == found.steps * share
    assert not fitted(lambda steps: (60 / steps) ** 16, 16, 1e-6, limit=10.0 * limit, **given).abandoned


def test_slowly_converging_stages_get_more_steps():
    """With 80 steps the stages iterate too long to be affordable, with 160 they do not."""

    def cost(trial):
        return trial.iterations

    pilot = FixedErrors(error=lambda steps: 0.9 if steps < 100 else (60 / steps) ** 12, windows=1.0, tried=[])
    seen = pilot.trial
    pilot.trial = lambda method, steps: seen(method, steps)._replace(iterations=20.0 if steps < 100 else 1.0)
    candidate = SimpleNamespace(**{**vars(found_of(None, 1).candidate), "method": co.GaussLegendre(6), "cost": cost})
    found = fit_steps(pilot, candidate, 1e-6, 300.0, 40.0)
    assert found is not None and not found.abandoned and found.cost <= 300.0


@pytest.mark.parametrize("windows", [1.0, 3.0, 1000.0])
@pytest.mark.parametrize("seen", [1e-9, 1e-16])
@pytest.mark.parametrize("own", [True, False])
def test_rounding_of_variable_steps_includes_the_trial(own, seen, windows):
    """The excess of its error over that of the tolerance, if that is above the modelled rounding."""
    fit = found_of(None, 40, windows)
    method = co.Taylor(tolerance=1e-12) if own else co.Taylor(16)
    candidate = SimpleNamespace(**{**vars(fit.candidate), "method": method})
    trial = fit.trial._replace(growth=Growth(0.1 * seen, 0.5 * seen, seen))
    found = Fit(fit.pilot, candidate, 40, 0.25 * seen * windows, trial)
    model = roundoff(fit.pilot, 40, 0, True, windows, ROUNDING_MARGIN)
    assert found.end == pytest.approx(seen * windows)
    assert found.roundoff == pytest.approx(max(0.75 * seen * windows, model) if own else model)
    assert (0.75 * seen * windows > model) == (seen == 1e-9)


class Candidate(SimpleNamespace):
    """A candidate, one step of which costs its iterations times the evaluations of each."""

    share = 1.0

    def cost(self, trial):
        return trial.evaluations


def fit_of(order, steps, error, method=None, iterations=1.0, newton=False):
    method = method or co.Taylor(order)
    trial = Trial(int(steps), Growth(error, error, error), iterations, iterations * order / 2, newton)
    return SimpleNamespace(
        candidate=Candidate(method=method), steps=steps, error=error, end=error, trial=trial, extrapolated=1.0
    )


def exact_fits(goal):
    """With c = 3 and T / r = 50 the error of N steps is 3 (50 / N)^p."""
    return [fit_of(p, 50.0 * (3.0 / goal) ** (1.0 / p), goal) for p in (16, 8)]


def test_error_model_reproduces_an_exact_law():
    fits = [fit_of(p, 80.0 + p, 3.0 * (50.0 / (80.0 + p)) ** p) for p in (16, 8)]
    model = SeriesErrorModel(*fits)
    for p, goal in ((6, 1e-3), (12, 1e-9), (24, 1e-12)):
        steps = model.steps(p, goal)
        assert 3.0 * (50.0 / steps) ** p == pytest.approx(goal, rel=1e-9)


def test_predictions_from_the_error_model_alone():
    predictor = StepPredictor(lambda candidate: 1e-6, None)
    series, gauss = (Candidate(method=m) for m in (co.Taylor(12), co.GaussLegendre(6)))
    assert predictor.predict_steps(series) is None and predictor.cost_lower_bound(gauss) == 0.0
    assert [predictor.add_fit(fit) for fit in exact_fits(1e-6)] == [False, True]
    steps = 50.0 * (3.0 / 1e-6) ** (1.0 / 12)
    assert (
        predictor.predict_steps(series) == pytest.approx(steps)
        and steps / MAX_ADVANTAGE < predictor.predict_steps(gauss) < steps
    )
    # Six stages, ten rounds, and a quarter of the steps.
    assert predictor.cost_lower_bound(gauss) == pytest.approx(steps / MAX_ADVANTAGE * 10 * 6)
    assert not predictor.add_fit(fit_of(12, 1000, 1e-6))


@pytest.mark.parametrize("backward", [False, True])
def test_predictions_from_related_schemes(backward):
    """A Gauss method took half the steps of the law in 20 rounds: others do about the same."""
    predictor = StepPredictor(lambda candidate: 1e-6, None)
    law = [50.0 * (3.0 / 1e-6) ** (1.0 / p) for p in (16, 12, 8)]
    related = [
        fit_of(16, 0.5 * law[0], 1e-6, co.GaussLegendre(8), iterations=20.0),
        fit_of(8, 3.0 * law[2], 1e-6, co.GaussLegendre(4), iterations=30.0, newton=True),
    ]
    for fit in [*exact_fits(1e-6), *(related[::-1] if backward else related)]:
        predictor.add_fit(fit)
    gauss = Candidate(method=co.GaussLegendre(6))
    # A fit that needed Newton's method does not count for others.
    assert predictor.predict_steps(gauss) == pytest.approx(0.5 * law[1])
    assert predictor.cost_lower_bound(gauss) == pytest.approx(0.5 * law[1] * 20 * 6 / RELATED_DIVISOR)
    # Among series the nearest order decides: one of order 20 took twice the steps of the law.
    predictor.add_fit(fit_of(20, 100.0 * (3.0 / 1e-6) ** (1.0 / 20), 1e-6))
    assert predictor.predict_steps(Candidate(method=co.Taylor(24))) == pytest.approx(100.0 * (3.0 / 1e-6) ** (1.0 / 24))
    assert predictor.predict_steps(Candidate(method=co.Taylor(12))) == pytest.approx(law[1])
    costs = [predictor.cost_lower_bound(Candidate(method=co.Taylor(p))) for p in (24, 12)]
    assert costs[0] == pytest.approx(100.0 * (3.0 / 1e-6) ** (1.0 / 24) * 12 / NEAREST_DIVISOR)
    assert costs[1] == pytest.approx(law[1] * 6 / NEAREST_DIVISOR)
    waiting = [Candidate(method=m) for m in (co.GaussLegendre(6), co.Taylor(24), co.Taylor(12), co.Splitting())]
    order = [waiting[k] for k in (2, 1, 0, 3)]
    assert predictor.cheapest_first(waiting) == order


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_predicted_costs_scale_with_the_share(share):
    """In an ensemble a member has a share of the cost: of each scheme its own, not that of related schemes."""
    predictor = StepPredictor(lambda candidate: 1e-6, None)
    related = fit_of(10, 1000.0, 1e-6, co.Splitting(order=10))
    for fit in [*exact_fits(1e-6), related]:
        predictor.add_fit(fit)
    for method in (co.Taylor(12), co.Splitting(order=8), co.GaussLegendre(6)):
        alone, among = Candidate(method=method), Candidate(method=method, share=share)
        assert predictor.cost_lower_bound(among) == pytest.approx(share * predictor.cost_lower_bound(alone))
        assert predictor.predict_steps(among) == predictor.predict_steps(alone)


def test_predictions_use_the_goal_of_each_scheme():
    predictor = StepPredictor(lambda candidate: 1e-6 / candidate.method.order**2, None)
    for fit in exact_fits(1e-6):
        predictor.add_fit(fit)

    def law(p):
        return 50.0 * (3.0 * p**2 / 1e-6) ** (1.0 / p)

    predictor.add_fit(fit_of(16, 2.0 * law(16), 1e-6 / 256, co.GaussLegendre(8)))
    assert predictor.predict_steps(Candidate(method=co.GaussLegendre(4))) == pytest.approx(2.0 * law(8))
    assert predictor.cost_lower_bound(Candidate(method=co.GaussLegendre(4))) == pytest.approx(
        2.0 * law(8) * 4 / RELATED_DIVISOR
    )
    assert predictor.cost_lower_bound(Candidate(method=co.Splitting(order=4))) == pytest.approx(
        law(4) / MAX_ADVANTAGE * 4 * 2
    )


def test_variable_step_trial_predicts_steps_of_series():
    """Both have errors c (h / r)^p; constant steps are some more."""
    goal = 1e-9
    trial = fit_of(20, 40.0 * goal ** (-1.0 / 20), goal, co.Taylor(20, tolerance=1e-10))
    predictor = StepPredictor(lambda candidate: goal, trial)
    assert 1.0 < predictor.predict_steps(Candidate(method=co.Taylor(16))) / (40.0 * goal ** (-1.0 / 16)) < 1.5
    assert predictor.predict_steps(Candidate(method=co.Taylor(8))) is None
    assert predictor.predict_steps(Candidate(method=co.GaussLegendre(8))) is None


def test_error_model_needs_two_distant_orders():
    near = [fit_of(16, 100, 1e-9), fit_of(14, 110, 1e-9)]
    assert series_error_model(near) is None and series_error_model(near[:1]) is None
    others = [fit_of(16, 100, 1e-9, co.GaussLegendre(8)), fit_of(8, 300, 1e-9, co.GaussLegendre(4))]
    assert series_error_model(others) is None
    assert series_error_model([*others, near[0], fit_of(8, 300, 0.0)]) is not None
    own = fit_of(8, 300, 1e-9, co.Taylor(8, tolerance=1e-6))
    assert (
        series_error_model([near[0], own]) is None
        and series_error_model([near[0], own, fit_of(8, 300, 1e-9)]) is not None
    )


def test_far_extrapolated_fits_weaken_cost_bounds():
    costs = []
    for times in (1.0, 4.0):
        predictor = StepPredictor(lambda candidate: 1e-6, None)
        related = fit_of(10, 1000.0, 1e-6, co.Splitting(order=10))
        related.extrapolated = times
        for fit in [*exact_fits(1e-6), related]:
            predictor.add_fit(fit)
        costs.append(predictor.cost_lower_bound(Candidate(method=co.Splitting(order=8))))
    assert costs[1] == pytest.approx(costs[0] / 2.0) and costs[1] > 0.0


@pytest.mark.long
@pytest.mark.parametrize("wanted", [1e-3, 1e-10])
def test_schemes_left_untried_are_not_cheaper(monkeypatch, wanted):
    """A search finds the steps of a scheme to about a third."""
    solvable = co.LiePoissonSystem(co.algebras.get("A5,40"), co.Quadratic(np.eye(5) + 0.2))
    problems = (BODY, (0.6, 0.0, 0.8), 100.0), (co.systems.toda(4), TODA, 5.0), (solvable, np.linspace(-1, 1, 5), -5.0)
    for system, x0, span in problems:
        chosen = co.choose(system, x0, (0.0, span), wanted)
        with monkeypatch.context() as all_tried:
            all_tried.setattr(StepPredictor, "cost_lower_bound", lambda self, candidate: 0.0)
            thorough = co.choose(system, x0, (0.0, span), wanted)
        assert chosen.cost <= 1.35 * thorough.cost and chosen.error <= wanted


def test_few_trials_and_short_runs_are_made(monkeypatch):
    """Most of the 21 candidates are left out; variable steps get one trial where constant ones cost half as much."""
    made = {"runs": 0, "fits": 0, "tolerances": 0}

    def count(module, name, key):
        real = getattr(module, name)

        def counted(*given):
            made[key] += 1
            return real(*given)

        monkeypatch.setattr(module, name, counted)

    count(pilots, "short_run", "runs")
    count(accuracy, "fit", "fits")
    count(tolerances, "variable_step_trial", "tolerances")
    choice = co.choose(co.systems.rigid_body((1, 2, 2.5)), (0.6, 0.3, 0.8), (0.0, 200.0), 1e-6)
    assert not choice.method.own_steps and made["tolerances"] == 1 and made["runs"] <= 30
    made["fits"] = 0
    # Particles fly apart: variable steps are so much longer that few other schemes are worth a trial.
    assert co.choose(co.systems.toda(4), TODA, (0.0, 80.0), 1e-6).method.own_steps
    assert 2 <= made["fits"] <= 6


def test_cache_is_bounded(monkeypatch):
    made = []
    monkeypatch.setattr(system_cache, "MAX_ENTRIES", 3)
    for key in (1, 2, 3, 4, 4, 1):
        system_cache.cached_for_system(BODY, ("test", key), lambda key=key: made.append(key))
    assert made[-2:] == [4, 1]
    assert len(system_cache._cache_of(BODY)) <= 3
    made.clear()
    for _ in range(2):
        system_cache.cached_for_system(BODY, ("test", []), lambda: made.append(0))
    assert made == [0, 0]
