"""Signals of runs against the arrays they stand for, and autocorrelations with known functions, errors and times."""

from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)

autocorrelation = co.spectra.autocorrelation
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
STARTS = np.array([[1.0, 0.2, 0.5], [0.1, 1.0, 0.2]])
OPTIONS = {"save_every": 3, "attitude": True, "observe": {"x3": lambda x: x[..., 2]}}
SAVED = 21


@cache
def run(several, on_grid, sense=1.0):
    """Return a run of 60 or 61 steps, of which every third is saved."""
    span = (2.0, 2.0 + sense * (6.0 if on_grid else 6.1))
    return co.integrate(BODY, STARTS if several else STARTS[1], span, 0.1, **OPTIONS)


KINDS = {
    "momentum": (None, lambda sol: sol.x),
    "attitude": ("attitude", lambda sol: sol.attitude.reshape(*sol.x.shape[:-1], 9)),
    "energy": ("energy", lambda sol: sol.energy),
    "observed": ("x3", lambda sol: sol.x[..., 2]),
    "component": (1, lambda sol: sol.x[..., 1]),
    "function": (lambda x: x[..., 0] ** 2, lambda sol: sol.x[..., 0] ** 2),
    "complex function": (lambda x: x[..., :2] * (1 - 2j), lambda sol: sol.x[..., :2] * (1 - 2j)),
}


@pytest.mark.parametrize(("on_grid", "sense"), [(True, -1.0), (False, 1.0)])
@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_its_array(kind, several, on_grid, sense):
    """With 61 steps the last saved one is off the grid, and left out."""
    signal, array = KINDS[kind]
    sol = run(several, on_grid, sense)
    samples = np.asarray(array(sol))[:SAVED]
    if several and kind in ("energy", "observed", "component", "function"):
        samples = samples[..., None]  # of samples, the last axis is that of channels
    plain = autocorrelation(sol.t[:SAVED], samples)
    for given in (signal, array(sol)):
        found = autocorrelation(sol, given)
        assert np.array_equal(found.t, plain.t)
        np.testing.assert_array_equal(np.ravel(found.mean), np.ravel(plain.mean))
        np.testing.assert_array_equal(np.ravel(found.values), np.ravel(plain.values))


@pytest.mark.parametrize("start", [0.0, 5.0, -3.0])
@pytest.mark.parametrize("step", [0.1, -0.1])
def test_only_the_last_time_may_be_off_the_grid(start, step):
    t = start + step * np.arange(64)
    for place in (0, 1, 20, 62):
        moved = t.copy()
        moved[place] += 1e-9
        with refused(ValueError, "equidistant"):
            co.frequencies(moved, np.cos(t), count=1)
    for last in (t[-1] + 0.04, t[-1] - 0.04):
        longer = np.append(t, last + step)
        assert np.isfinite(co.frequencies(longer, np.cos(longer), count=1).frequency).all()
        with refused(ValueError, "at least 64"):
            co.frequencies(np.append(t[:-1], last), t, count=1)
    assert np.isfinite(co.frequencies(t, np.cos(t), count=1).frequency).all()


def test_what_is_no_signal_is_refused():
    t = np.arange(16.0)
    spoiled = np.zeros((16, 2))
    spoiled[2, 1] = np.nan
    failed = co.integrate(BODY, STARTS, (0.0, 2.0), 0.1)
    failed.failed[1] = True
    for given, named in (
        ((t, spoiled), ["signal[2, 1]"]),
        ((np.ones(16), t), ["equidistant"]),
        ((t, np.zeros((16, 0))), ["at least one"]),
        ((run(True, False), np.zeros(21)), ["(22, members)"]),
        ((run(False, False), np.zeros((21, 2, 3))), ["(22,)"]),
        ((run(True, False), 3), ["0 to 2", "3"]),
        ((run(True, False), -1), ["0 to 2", "-1"]),
        ((run(True, False), "x4"), ["'attitude', 'energy', 'x3'"]),
        ((failed,), ["member 1"]),
        ((t[:9], t[:9]), ["at least 16"]),
        ((t, t, -1.0), ["window"]),
        ((t, np.ones(5)), ["(5,)"]),
    ):
        with refused(ValueError, *named):
            autocorrelation(*given)


def autoregressive(a, count, members=1, seed=1):
    """Stationary series (count, members) with x' = a x + noise, of variance 1 / (1 - a^2)."""
    noise = np.random.default_rng(seed).normal(size=(count, members))
    noise[0] /= np.sqrt(1.0 - a**2)
    return lfilter([1.0], [1.0, -a], noise, axis=0)


@pytest.mark.parametrize("a", [0.0, 0.6, 0.95])
def test_autoregressive_process(a):
    """Function a^k, integrated time (1 + a) / (1 - a) / 2, for one series and for members of it."""
    tau, t = 0.5 * (1 + a) / (1 - a), np.arange(4000) * 0.25
    found = autocorrelation(t, autoregressive(a, 4000, 40)[:, :, None])
    assert found.time.shape == (1,) and abs(found.time[0] - 0.25 * tau) < 4 * found.error[0] < 0.25 * tau
    assert np.allclose(found.values[:12, 0], a ** np.arange(12.0), rtol=0, atol=0.03)
    assert found.t[1] == 0.25 and len(found.t) == 2001 and found.values[0, 0] == 1.0
    assert 5 * found.time[0] <= found.window[0] < 5 * found.time[0] + 0.5


def test_error_bars_hold():
    """Deviations of the time and of the mean, in units of their errors, have the width one in any unit of time."""
    a, runs, spacing = 0.8, 300, 0.125
    series = autoregressive(a, 3000, runs, seed=5)
    found = autocorrelation(spacing * np.arange(3000), series)  # every run a channel
    times = (found.time - 4.5 * spacing) / found.error
    means = found.mean / found.mean_error
    assert 0.8 < times.std() < 1.2 and abs(times.mean()) < 0.4
    assert 0.88 < means.std() < 1.12 and found.values.shape == (1501, runs)


def test_members_are_pooled():
    """Products of all members with the deviations from the common mean."""
    series = autoregressive(0.5, 64, 3)
    found = autocorrelation(np.arange(64.0), series[:, :, None])
    deviations = series - series.mean()
    direct = [np.mean(deviations[k:] * deviations[: 64 - k]) for k in range(33)]
    assert np.allclose(found.values[:, 0], np.array(direct) / direct[0], rtol=0, atol=1e-13)
    assert np.isclose(found.mean[0], series.mean(), rtol=1e-13)
    one = autocorrelation(np.arange(64.0), series[:, 0])
    assert isinstance(one.time, float) and one.values.shape == (33,)
    assert repr(one).startswith("<autocorrelation: integrated time")


def test_lags_of_a_backward_series_are_those_of_the_forward_one():
    t, series = 0.25 * np.arange(400), autoregressive(0.6, 400)[:, 0]
    forward, backward = autocorrelation(t, series), autocorrelation(3.0 - t, series)
    assert np.array_equal(backward.t, forward.t) and backward.t[1] == 0.25
    assert (backward.time, backward.error, backward.window) == (forward.time, forward.error, forward.window)
    assert np.array_equal(backward.values, forward.values) and backward.error > 0


def test_complex_rotation_that_decays():
    a = 0.9 * np.exp(0.4j)
    noise = np.random.default_rng(2).normal(size=(2, 60000))
    found = autocorrelation(np.arange(60000), lfilter([1.0], [1.0, -a], noise[0] + 1j * noise[1]))
    assert np.allclose(found.values[:20], (a ** np.arange(20)).real, rtol=0, atol=0.03)


def test_free_spin_in_a_heat_bath():
    """Rotational diffusion: exp(-2 alpha kT t) for each component."""
    spin = co.systems.spin_lattice([], 1).with_forces(co.forces.HeatBath(0.5, temperature=0.4, seed=3))
    x0 = co.thermal_states(spin.system, 0.4, 40, sweeps=1, seed=1).x
    sol = co.integrate(spin, x0, (0, 200), 0.1)
    found = autocorrelation(sol)
    assert np.allclose(found.values[:30], np.exp(-0.4 * found.t[:30])[:, None], rtol=0, atol=0.06)
    # The sum of an exponential by the trapezoidal rule.
    assert np.all(np.abs(found.time - 0.05 / np.tanh(0.02)) < 4 * found.error) and np.all(found.error < 0.25)
    assert np.all(np.abs(found.mean) < 4 * found.mean_error)


def test_series_without_an_integrated_time():
    t = np.arange(64.0)
    constant = autocorrelation(t, np.full(64, 3.0))
    assert np.isnan(constant.time) and np.all(np.isnan(constant.values)) and constant.mean == 3.0
    short = autocorrelation(t, np.cumsum(np.ones(64)), window=10.0)
    assert np.isnan(short.time) and np.isnan(short.window) and short.values[0] == 1.0


@pytest.mark.parametrize("members", [1, 3])
def test_errors_are_those_of_madras_and_sokal(members):
    """By the window, the time, the variance and the number of samples, each from the numbers that are returned."""
    rng, spacing, count = np.random.default_rng(3), 0.25, 3000
    noise = rng.normal(size=(count, members))
    series = lfilter([1], [1, -0.7], noise, axis=0) + 2.0
    found = co.spectra.autocorrelation(5.0 + spacing * np.arange(count), series[:, :, None], window=6.0)
    (time,), (error,), (window,) = found.time, found.error, found.window
    steps = window / spacing
    assert steps == round(steps) and found.t[round(steps)] == window
    assert time == pytest.approx(spacing * (found.values[: round(steps) + 1, 0].sum() - 0.5), rel=1e-12)
    # The first lag of at least six times.
    sums = spacing * (np.cumsum(found.values[:, 0]) - 0.5)
    assert np.argmax(found.t >= 6.0 * sums) == round(steps)
    assert error == pytest.approx(time * np.sqrt(2 * (2 * steps + 1) / (count * members)), rel=1e-12)
    variance = np.mean((series - series.mean()) ** 2)
    assert found.mean == pytest.approx([series.mean()], rel=1e-12)
    wanted = np.sqrt(2 * time / spacing * variance / (count * members))
    assert found.mean_error == pytest.approx([wanted], rel=1e-12)
