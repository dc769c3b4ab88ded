"""Number of steps that a scheme needs, fitted to errors of trials."""

import math
from types import SimpleNamespace

import pytest

import coadjoint as co
from coadjoint.choosing.fitting import Fit, confirmed_fit, fit
from coadjoint.choosing.pilot import Growth, Trial
from coadjoint.choosing.roundoff import ROUNDING_MARGIN, roundoff

pytestmark = pytest.mark.sensitive

NOISE = 1e-13


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


def test_error_of_a_few_roundings_is_accepted():
    found = confirmed_fit(found_of(lambda steps: 3.0 * NOISE, 100), NOISE, 4.0 * NOISE)
    assert found.steps == 100 and found.pilot.tried == [100]


def test_error_above_rounding_is_corrected():
    """An error of 8 roundings still shows in the reference."""
    found = confirmed_fit(found_of(lambda steps: 8.0 * NOISE * (100 / steps) ** 16, 100), NOISE, 4.0 * NOISE)
    assert (found.steps > 100 and found.error <= 2.0 * NOISE) or found.trial.error <= 4.0 * NOISE
    assert 8.0 * (100 / found.steps) ** 16 <= 4.0


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


@pytest.mark.parametrize("windows", [1.0, 3.0])
def test_expected_error_is_that_of_the_actual_steps(windows):
    found = confirmed_fit(found_of(lambda steps: 1e-7 * (100 / steps) ** 16, 302, windows=windows), 1e-6, 4e-6)
    per_window = 302 / windows
    assert found.steps == 302 and found.error == pytest.approx(1e-7 * (100 / per_window) ** 16 * windows)


def fitted(error, order, goal, limit=math.inf, windows=1.0, share=1.0):
    """Fit from 40 steps in each window; errors at the end are those of a window times the number of windows."""
    found = found_of(error, 1, windows)
    candidate = SimpleNamespace(**{**vars(found.candidate), "method": co.Taylor(order), "share": share})
    return fit(found.pilot, candidate, goal, limit, 40.0 * windows)


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
    found = fit(pilot, candidate, 1e-6, 300.0, 40.0)
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
