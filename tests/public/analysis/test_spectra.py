"""Signals of runs, autocorrelations with known functions and errors, and structure factors of lattices of spins."""

from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import stdtrit

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
    assert found.window[0] >= 5 * found.time[0]


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
    x0 = co.thermal_states(spin.unforced, 0.4, 40, sweeps=1, seed=1).x
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


def nearly_up(sites, members=2, size=1e-3, seed=1):
    tilt = np.random.default_rng(seed).normal(scale=size, size=(members, sites, 2))
    up = np.sqrt(1.0 - np.sum(tilt**2, axis=2, keepdims=True))
    return np.concatenate([tilt, up], axis=2).reshape(members, -1)


def lattice_run(lattice, x0, span=60.0, step=0.025, every=8):
    return co.integrate(lattice, x0, (0, span), step, method=co.SphericalMidpoint(), save_every=every)


def waves(name, shape, **options):
    """Return the structure factor of small deviations of all spins from the third axis."""
    lattice = co.systems.spin_lattice(name, shape, periodic=True, **options)
    return co.spectra.structure_factor(lattice_run(lattice, nearly_up(lattice.dim // 3)))


def peaks(S):
    """Transverse components; every frequency, positive and negative."""
    return S.omega[np.argmax(S.components[:2].sum(axis=0), axis=1)]


@pytest.mark.parametrize(
    ("options", "gap", "bond"),
    [
        ({"field": (0.0, 0.0, 0.8)}, 0.8, 1.0),
        ({"on_site": (0.0, 0.0, 0.4), "exchange": 0.7}, 0.8, 0.7),
        ({"tensor": (1.0, 1.0, 1.3)}, 0.6, 1.0),
    ],
)
def test_spin_waves_of_a_chain(options, gap, bond):
    """omega = 2 J (1 - cos q), with the gap of a field B, of 2 K on site, or of 2 J for each unit of the exchange."""
    S = waves("chain", 24, **options)
    omega = gap + 2.0 * bond * (1.0 - np.cos(2.0 * np.pi * S.q[:, 0]))
    bin_width = S.omega[1] - S.omega[0]
    assert np.all(np.abs(np.abs(peaks(S)) - omega) < 0.6 * bin_width)
    assert len(S.q) == 25 and S.q[-1, 0] == 1.0 and np.allclose(S.distance, 2 * np.pi * S.q[:, 0])


def test_waves_travel_along_q():
    """Dzyaloshinskii-Moriya coupling D along the spins: omega = B + 2 J (1 - cos q) + 2 D sin q, not even in q."""
    ring = co.systems.spin_lattice("chain", 16, periodic=True, dm=(0.0, 0.0, 0.3), field=(0.0, 0.0, 1.0))
    S = co.spectra.structure_factor(lattice_run(ring, nearly_up(16)), path=(-0.5, 0.5))
    q = 2.0 * np.pi * S.q[:, 0]
    positive = S.omega > 0.0
    found = S.omega[positive][np.argmax(S.components[0][:, positive], axis=1)]
    expected = 1.0 + 2.0 * (1.0 - np.cos(q)) + 0.6 * np.sin(q)
    assert np.all(np.abs(found - expected) < 0.6 * (S.omega[1] - S.omega[0]))


def test_spin_waves_of_moments_have_the_published_sign():
    """Tutorial 8 of Sunny.jl: omega = 2 |B| (1 - sin q D/B) of moments mu = -2 S in H = D z . S x S - B . mu."""
    D, B = 0.2, 0.8
    for sense in (-1, 1):
        # Spins S = -m in the field -2 B, and, mirrored, spins along 2 B.
        ring = co.systems.spin_lattice("ring", 16, exchange=0.0, dm=(0.0, 0.0, D), field=(0.0, 0.0, sense * 2 * B))
        S = co.spectra.structure_factor(lattice_run(ring, sense * nearly_up(16)), path=(-0.5, 0.5))
        q, positive = 2.0 * np.pi * S.q[:, 0], S.omega > 0.0
        found = S.omega[positive][np.argmax(S.components[0][:, positive], axis=1)]
        wanted = 2 * B * (1 + sense * np.sin(q) * D / B)
        assert np.all(np.abs(found - wanted) < 0.6 * (S.omega[1] - S.omega[0]))


def test_static_structure_factor_of_cold_spins_is_that_of_equipartition():
    """kT / omega(q) for each transverse component, of states at a temperature, at every time of the lattice_run."""
    kT, B, members = 0.002, 0.5, 150
    ring = co.systems.spin_lattice("ring", 12, field=(0.0, 0.0, B))
    states = co.thermal_states(ring, kT, members, sweeps=300, seed=3, x0=nearly_up(12, 1)[0])
    S = co.spectra.structure_factor(lattice_run(ring, states.x, span=20.0), path=(1 / 12, 1 / 2))
    omega = B + 2.0 * (1.0 - np.cos(2.0 * np.pi * S.q[:, 0]))
    transverse = S.components[:2].sum(axis=(0, 2)) * (S.omega[1] - S.omega[0])
    assert np.allclose(transverse, 2.0 * kT / omega, rtol=5 / np.sqrt(2 * members), atol=0)
    assert np.allclose(S.static, transverse, rtol=0.02)
    # The exponential distribution of intensities at a wave vector has its mean as its standard deviation.
    top = np.argmax(S.intensity, axis=1)
    relative = (S.error / S.intensity)[np.arange(len(top)), top]
    assert np.all(np.abs(relative * np.sqrt(members) - 1.0) < 0.35)


def test_picture_has_the_corners_of_the_path():
    S = waves("square", (4, 4), field=(0.0, 0.0, 0.5))
    axes = S.plot().axes[0]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["(0, 0)", "(1/2, 0)", "(1/2, 1/2)", "(0, 0)"]
    colours = axes.collections[0].get_array()
    assert colours.shape == (np.sum(S.omega >= 0), 7)
    brightest = S.omega[S.omega >= 0][np.argmax(colours, axis=0)]
    assert np.allclose(brightest[1:-1], np.abs(peaks(S))[1:-1])
    # Frequencies up to a little above the highest that is visible at any wave vector.
    top = 10 * np.median(S.intensity[:, S.omega >= 0].max(axis=1))
    visible = S.omega[np.any(S.intensity > 1e-4 * top, axis=0)].max()
    assert axes.get_ylim() == (0.0, pytest.approx(min(S.omega[-1], 1.15 * visible)))
    assert visible > brightest.max() and colours.max() <= top and colours.min() >= 0.99e-4 * top
    assert repr(S).startswith("<structure factor of 7 wave vectors")


def test_pictures_of_one_wave_vector_and_of_spins_at_rest():
    """Spins along a field do not move: nothing is visible away from the static line, and nothing at all at q = 1/2."""
    ring = co.systems.spin_lattice("ring", 8, field=(0.0, 0.0, 1.0))
    up = np.tile([0.0, 0.0, 1.0], 8)
    S = co.spectra.structure_factor(lattice_run(ring, up, 8.0), path=[1 / 2])
    assert np.all(S.intensity < 1e-20)
    axes = S.plot().axes[0]
    left, right = axes.get_xlim()
    assert (left, right) == (-0.5, 0.5) and axes.get_ylim()[1] == pytest.approx(1.15 * S.omega[S.omega >= 0][1])
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["1/2"]


def test_members_and_backward_runs_agree():
    # Between its ends are wave vectors that differ from their opposites, and so from runs in the other direction.
    lattice, path = co.systems.spin_lattice("square", (4, 3), periodic=True), [(0, 0), (0.25, 1 / 3), (0.5, 1)]
    x0 = np.random.default_rng(4).normal(size=(3, 36))
    sol = lattice_run(lattice, x0, span=8.0)
    S = co.spectra.structure_factor(sol, path)
    single = [co.spectra.structure_factor(lattice_run(lattice, x, span=8.0), path) for x in x0]
    intensities = np.array([one.intensity for one in single])
    assert np.allclose(S.intensity, intensities.mean(axis=0), rtol=1e-11)
    factor = stdtrit(2, 0.9772498680518208) / 2  # Student's, of two errors
    assert np.allclose(S.error, factor * intensities.std(axis=0, ddof=1) / np.sqrt(3), rtol=1e-9)
    assert np.all(np.isnan(single[0].error)) and np.allclose(S.static, np.mean([one.static for one in single], axis=0))
    back = co.integrate(lattice, sol.x[-1], (8, 0), 0.025, method=co.SphericalMidpoint(), save_every=8)
    again = co.spectra.structure_factor(back, path, "boxcar")
    assert np.allclose(again.intensity, co.spectra.structure_factor(sol, path, None).intensity, rtol=1e-8)
