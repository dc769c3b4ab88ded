"""Cost model of the choice: predicted steps and costs, and the trials that it saves."""

from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import accuracy, system_cache
from coadjoint.choosing import pilot as pilots
from coadjoint.choosing.cost_model import (
    MAX_ADVANTAGE,
    NEAREST_DIVISOR,
    RELATED_DIVISOR,
    SeriesErrorModel,
    StepPredictor,
    series_error_model,
)
from coadjoint.choosing.pilot import Growth, Trial
from random_runs.algebras import some_algebra

BODY = co.systems.rigid_body((1, 2, 2.5))


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


def test_fits_with_errors_of_order_one_are_ignored():
    predictor = StepPredictor(lambda candidate: 1e-6, None)
    for fit in exact_fits(1e-6):
        fit.end = 1.0
        assert not predictor.add_fit(fit)
    assert predictor.predict_steps(Candidate(method=co.Taylor(12))) is None


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


def some_problems():
    rng = np.random.default_rng(7)
    yield BODY, (0.6, 0.0, 0.8), 100.0
    yield co.systems.toda(4), (-0.8, 0.1, -0.2, 0.9, 0.4, 0.35, 0.45), 5.0
    # A dense gradient on a solvable algebra in another basis: a Gauss method costs half of what a series does.
    other = np.random.default_rng(73)
    solvable = some_algebra(other)
    M = other.standard_normal((6, 6))
    yield co.LiePoissonSystem(solvable, co.Quadratic(M @ M.T / 6 + 0.3 * np.eye(6))), other.standard_normal(6), 5.0
    found = 0
    while found < 4:
        algebra = some_algebra(rng)
        if not 3 <= algebra.dim <= 8:
            continue
        found += 1
        M = np.diag(rng.uniform(0.5, 2.0, algebra.dim))
        x0 = rng.standard_normal(algebra.dim)
        system = co.LiePoissonSystem(algebra, co.Quadratic(M))
        speed = np.linalg.norm(system.vector_field(x0)) / np.linalg.norm(x0)
        yield system, x0, (-1) ** found * 20.0 / max(float(speed), 0.1)


@pytest.mark.long
def test_schemes_left_untried_are_not_cheaper(monkeypatch):
    """A search finds the steps of a scheme to about a third."""
    for system, x0, span in some_problems():
        for wanted in (1e-3, 1e-10):
            chosen = co.choose(system, x0, (0.0, span), wanted)
            with monkeypatch.context() as all_tried:
                all_tried.setattr(StepPredictor, "cost_lower_bound", lambda self, candidate: 0.0)
                thorough = co.choose(system, x0, (0.0, span), wanted)
            assert chosen.cost <= 1.35 * thorough.cost
            assert chosen.error <= wanted


def test_cheap_variable_steps_save_other_trials(monkeypatch):
    """Particles fly apart: variable steps are so much longer that few other schemes are worth a trial."""
    tried = []

    def counted(pilot, candidate, *rest):
        tried.append(candidate.method)
        return fit(pilot, candidate, *rest)

    fit = accuracy.fit
    monkeypatch.setattr(accuracy, "fit", counted)
    for wanted in (1e-6, 1e-9):
        tried.clear()
        chosen = co.choose(co.systems.toda(4), (-0.8, 0.1, -0.2, 0.9, 0.4, 0.35, 0.45), (0.0, 80.0), wanted)
        assert chosen.method.own_steps
        # Two series determine the error model; 18 other candidates remain.
        assert 2 <= len(tried) <= 6


def test_error_model_takes_any_two_distant_orders():
    fits = [fit_of(p, 50.0 * 1e6 ** (1.0 / p), 1e-6) for p in (6, 8, 10, 12)]
    assert series_error_model(fits[:2]) is None and series_error_model([fits[0], fits[0], fits[1]]) is None
    assert series_error_model(fits).steps(16, 1e-6) == pytest.approx(50.0 * 1e6 ** (1.0 / 16))


def test_related_schemes_differ_only_in_order():
    """Splittings of other families need other steps; all series are related, also user-defined ones."""

    class Mine(co.Taylor):
        """A user-defined series."""

    def related(known, other):
        predictor = StepPredictor(lambda candidate: 1e-6, None)
        for fit in [*exact_fits(1e-6), fit_of(known.order, 1e5, 1e-6, known)]:
            predictor.add_fit(fit)
        return bool(predictor._related_fits(Candidate(method=other)))

    assert related(co.GaussLegendre(8), co.GaussLegendre(6)) and related(co.Splitting(order=10), co.Splitting(order=4))
    assert not related(co.Splitting(scheme="yoshida4"), co.Splitting(scheme="blanes_moan4"))
    assert not related(co.Splitting(order=4), co.Splitting(scheme="blanes_moan4"))
    assert not related(co.GaussLegendre(2), co.Splitting(order=4))
    assert related(co.Taylor(12), Mine(10)) and related(Mine(12), co.Taylor(10))
    first = co.Splitting(order=2)
    assert not related(first.composed((0.5, 0.5)), first.composed((0.25, 0.5, 0.25)))
    orders = [Mine(16), Mine(8), co.Taylor(12)]
    assert isinstance(co.choose(BODY, (0.6, 0.0, 0.8), (0, 30), 1e-6, methods=orders).method, co.Taylor)


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


def test_trial_with_few_steps_predicts_nothing():
    """One step more or less is a large part of them."""
    trial = fit_of(20, 3, 1e-9, co.Taylor(20, tolerance=1e-10))
    assert StepPredictor(lambda candidate: 1e-9, trial).predict_steps(Candidate(method=co.Taylor(16))) is None
    for span, wanted in ((0.3, 1e-13), (1.0, 1e-14)):
        choice = co.choose(co.systems.rigid_body((1, 2, 3)), (1.0, 0.2, 0.5), (0, span), wanted)
        assert round(span / choice.step) <= 2


@pytest.mark.parametrize("wanted", [1e-3, 1e-6, 1e-9])
def test_choice_takes_few_trials(monkeypatch, wanted):
    """Most of the 21 candidates are left out."""
    seen = []

    def counted(*given):
        seen.append(given)
        return short_run(*given)

    short_run = pilots.short_run
    monkeypatch.setattr(pilots, "short_run", counted)
    counts = []
    for system, x0, span in some_problems():
        seen.clear()
        co.choose(system, x0, (0.0, span), wanted)
        counts.append(len(seen))
    assert np.median(counts) <= 24


def test_cache_does_not_change_choices():
    first = co.choose(BODY, (0.6, 0.0, 0.8), (0, 50), 1e-7)
    co.choose(BODY, (0.1, 2.0, 0.3), (50, 0), 1e-4)
    again = co.choose(BODY, (0.6, 0.0, 0.8), (0, 50), 1e-7)
    new = co.choose(co.systems.rigid_body((1, 2, 2.5)), (0.6, 0.0, 0.8), (0, 50), 1e-7)
    assert first == again == new and first.others == again.others == new.others
    for method in (
        co.Taylor(6),
        co.Taylor(24),
        co.Taylor(24, projected=False),
        co.GaussLegendre(2),
        co.GaussLegendre(6),
    ):
        own, alone = (
            co.choose(system, (0.6, 0.0, 0.8), (0, 50), 1e-7, methods=method)
            for system in (BODY, co.systems.rigid_body((1, 2, 2.5)))
        )
        assert own == alone


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
