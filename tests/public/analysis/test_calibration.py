"""Error bars and estimates on random cases with a known truth: too small fails, and so does too large.

The median of true errors over estimates must lie in a band. Each band is so narrow that estimates that are 8 times too
small or too large are outside of it, which is tested too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

import coadjoint as co
from long import long_where
from rounding import UNIT_ROUNDOFF as U

period = co.analysis.period
fit_order = co.analysis.fit_order
drift_of_series = co.analysis.drift_of_series

MEDIAN_OF_A_NORMAL = 0.6745
"""Of |z|, for a standard error that is right."""
SOME = 40


def body_of(rng: np.random.Generator):
    """Return a body with masses on three axes, so that no principal moment exceeds the sum of the others."""
    a, b, c = rng.uniform(0.3, 0.6), rng.uniform(0.8, 1.1), rng.uniform(1.3, 1.7)
    return co.systems.rigid_body((b + c, a + c, a + b))


def leads_with_noise():
    """The same of a phase error that is known, backward in time."""
    found = []
    for seed in range(SOME):
        rng = np.random.default_rng(100 + seed)
        t, slope = np.linspace(7.3, -rng.uniform(50, 500), rng.integers(300, 2000)), 0.1 * rng.normal()
        drift = drift_of_series(t, slope * t + 0.05 * rng.normal(size=len(t)))
        found.append(abs(drift.slope - slope) / drift.uncertainty)
    return np.array(found)


def frequencies_of_noise():
    """Lines of random frequency and phase in white noise, real and complex, forward and backward."""
    found = []
    for seed in range(SOME):
        rng = np.random.default_rng(200 + seed)
        count, sense = int(rng.integers(300, 900)), (-1.0) ** seed
        t = 7.3 + sense * rng.uniform(0.05, 0.4) * np.arange(count)
        w = rng.uniform(0.05, 0.45) * 2 * np.pi / abs(t[1] - t[0])
        signal = np.exp(1j * (w * t + rng.uniform(0, 6)))
        noise = rng.normal(size=(2, count)) * 10.0 ** rng.uniform(-6, -1)
        signal = signal + noise[0] + 1j * noise[1] if seed % 4 > 1 else signal.real + noise[0]
        lines = co.frequencies(t, signal, count=1)
        found.append(abs(lines.frequency[0] - w) / lines.uncertainty[0])
    return np.array(found)


def exponents_of_random_stretching():
    """Independent stretches with a known mean: the standard error of ten blocks, or the trend of the last half."""
    found = []
    for seed in range(SOME):
        rng = np.random.default_rng(300 + seed)
        steps = rng.normal(0.3, rng.uniform(0.5, 2.0), (400, 2))
        t = 7.3 + (-1.0) ** seed * np.arange(401.0)
        result = co.LyapunovExponents(t, np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), 2, "compiled")
        found += list(np.abs(result.exponents - 0.3) / result.uncertainty)
    return np.array(found)


@cache
def accurate_runs():
    """Return true errors over estimates, and over the expected errors of the choice, of random bodies."""
    estimated, expected = [], []
    methods = (co.Splitting(order=2), co.GaussLegendre(2), co.Splitting(order=4), co.ExplicitRungeKutta("rk4"))
    for seed in range(16):
        rng = np.random.default_rng(400 + seed)
        body = body_of(rng)
        x0, sense = rng.normal(size=3), (-1.0) ** seed
        end = 7.3 + sense * rng.uniform(10.0, 60.0)
        sol = co.integrate(body, x0, (7.3, end), accuracy=10.0 ** -rng.uniform(3, 7), method=methods[seed % 4])
        error = np.linalg.norm(sol.x[-1] - body.exact(x0, end - 7.3)) / np.linalg.norm(x0)
        estimated.append(error / sol.error_estimate())
        expected.append(error / sol.choice.error)
    return estimated, expected


def errors_at_the_end():
    return np.array(accurate_runs()[0])


def errors_expected_by_choices():
    return np.array(accurate_runs()[1])


def suggested_steps():
    """The energy that a step keeps, over the wanted bound: of order 2 an eightfold step changes it 64 times."""
    found = []
    for seed in range(12):
        rng = np.random.default_rng(500 + seed)
        body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(rng.uniform(0.3, 1.5, 3)), sign=-1)
        x0, wanted = rng.normal(size=3), 10.0 ** -rng.uniform(4, 7)
        method = co.Splitting(parts="coordinates")
        h = co.suggest_step(body, method, x0, wanted)
        sol = co.integrate(body, x0, (7.3, 7.3 - 2000 * h), h, method)
        found.append(np.sqrt(sol.drift()["energy"].absolute / wanted))
    return np.array(found)


def predicted_drifts():
    """The measured slope over the predicted one; and of the attitude."""
    found = []
    for seed in range(3):
        rng = np.random.default_rng(600 + seed)
        body = body_of(rng)
        x0, sense = rng.normal(size=3) + np.array([1.0, 0.0, 0.0]), (-1.0) ** seed
        H = co.modified_hamiltonian(body, co.Splitting(parts="coordinates"))
        predicted = co.predicted_drift(body, x0, modified=H, step=sense * 0.05, attitude=True)
        method = co.Splitting(parts="coordinates")
        sol = co.integrate(body, x0, (0.0, sense * 200.0), 0.05, method, save_every=9, attitude=True)
        found.append(co.phase_drift(sol).slope / predicted.slope)
        found.append(co.phase_drift(sol, of="attitude").slope / predicted.precession)
    return np.array(found)


ESTIMATES: dict[str, tuple[Callable[[], np.ndarray], float, float]] = {
    # An error bar that is the largest of several estimates, or has a term beside the scatter, is up to 3 times wide.
    "slope of a phase drift": (leads_with_noise, MEDIAN_OF_A_NORMAL / 3.0, MEDIAN_OF_A_NORMAL * 1.5),
    "frequency": (frequencies_of_noise, MEDIAN_OF_A_NORMAL / 3.0, MEDIAN_OF_A_NORMAL * 1.5),
    "Lyapunov exponent": (exponents_of_random_stretching, MEDIAN_OF_A_NORMAL / 3.0, MEDIAN_OF_A_NORMAL * 1.5),
    # Errors that follow the order are estimated with what a finer run leaves taken off.
    "error at the end": (errors_at_the_end, 0.93, 1.07),
    "expected error of a choice": (errors_expected_by_choices, 0.5, 1.5),
    "suggested step": (suggested_steps, 0.9, 1.1),
    "predicted drift": (predicted_drifts, 0.97, 1.03),
}


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", long_where(["predicted drift"], ESTIMATES))
def test_true_errors_over_estimates_are_near_one_on_both_sides(name):
    draw, low, high = ESTIMATES[name]
    ratios = draw()
    assert np.all(np.isfinite(ratios))
    assert low < np.median(ratios) < high, np.median(ratios)
    # A normal deviate is beyond four standard errors once in 16 000 cases, with ten blocks once in 300.
    assert np.quantile(ratios, 0.9) < 6.0 * high
    for factor in (8.0, 0.125):
        assert not low < np.median(ratios / factor) < high, "a wrong estimate would be noticed"


def test_round_off_is_estimated_within_a_factor():
    """Near round-off the error is a random walk; the rule is for the worst of four motions."""
    ratios = []
    for seed in range(6):
        rng = np.random.default_rng(700 + seed)
        body = body_of(rng)
        x0 = rng.normal(size=3)
        choice = co.choose(body, x0, (0.0, 60.0), 1e-12)
        sol = co.integrate(body, x0, (0.0, 60.0), accuracy=1e-12)
        error = np.linalg.norm(sol.x[-1] - body.exact(x0, 60.0)) / np.linalg.norm(x0)
        assert choice.roundoff > U
        ratios.append(error / max(choice.roundoff, U))
    assert 1.0 / 64.0 < np.median(ratios)
    assert max(ratios) < 1e-12 / U
