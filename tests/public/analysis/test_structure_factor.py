"""Structure factors: linear spin waves, equipartition, sums over frequencies, paths, members, refusals, pictures."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused


def nearly_up(sites, members=2, size=1e-3, seed=1):
    tilt = np.random.default_rng(seed).normal(scale=size, size=(members, sites, 2))
    up = np.sqrt(1.0 - np.sum(tilt**2, axis=2, keepdims=True))
    return np.concatenate([tilt, up], axis=2).reshape(members, -1)


def run(lattice, x0, span=60.0, step=0.025, every=8):
    return co.integrate(lattice, x0, (0, span), step, method=co.SphericalMidpoint(), save_every=every)


def waves(name, shape, **options):
    """Return the structure factor of small deviations of all spins from the third axis."""
    lattice = co.systems.spin_lattice(name, shape, periodic=True, **options)
    return co.spectra.structure_factor(run(lattice, nearly_up(lattice.dim // 3)))


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
    S = co.spectra.structure_factor(run(ring, nearly_up(16)), path=(-0.5, 0.5))
    q = 2.0 * np.pi * S.q[:, 0]
    positive = S.omega > 0.0
    found = S.omega[positive][np.argmax(S.components[0][:, positive], axis=1)]
    expected = 1.0 + 2.0 * (1.0 - np.cos(q)) + 0.6 * np.sin(q)
    assert np.all(np.abs(found - expected) < 0.6 * (S.omega[1] - S.omega[0]))


def test_static_structure_factor_of_cold_spins_is_that_of_equipartition():
    """kT / omega(q) for each transverse component, of states at a temperature, at every time of the run."""
    kT, B, members = 0.002, 0.5, 150
    ring = co.systems.spin_lattice("ring", 12, field=(0.0, 0.0, B))
    states = co.thermal_states(ring, kT, members, sweeps=300, seed=3, x0=nearly_up(12, 1)[0])
    S = co.spectra.structure_factor(run(ring, states.x, span=20.0), path=(1 / 12, 1 / 2))
    omega = B + 2.0 * (1.0 - np.cos(2.0 * np.pi * S.q[:, 0]))
    transverse = S.components[:2].sum(axis=(0, 2)) * (S.omega[1] - S.omega[0])
    assert np.allclose(transverse, 2.0 * kT / omega, rtol=5 / np.sqrt(2 * members), atol=0)
    assert np.allclose(S.static, transverse, rtol=0.02)
    # The exponential distribution of intensities at a wave vector has its mean as its standard deviation.
    top = np.argmax(S.intensity, axis=1)
    relative = (S.error / S.intensity)[np.arange(len(top)), top]
    assert np.all(np.abs(relative * np.sqrt(members) - 1.0) < 0.35)


def test_what_has_no_structure_factor_is_refused_by_name():
    ring, complete = co.systems.spin_lattice("ring", 6), co.systems.spin_lattice("complete", 4)
    of_five = co.LiePoissonSystem(ring.algebra, ring.hamiltonian, layout={"lattice": "chain", "shape": 5})
    two = co.batch([ring, co.systems.spin_lattice("chain", 6)])
    x0, times = nearly_up(6), {"t_eval": np.linspace(0, 1, 9) ** 2}
    for named, system, states, step, options in (
        (["no lattice"], complete, nearly_up(4)[0], 0.05, {}),
        (["at least 8"], ring, x0[0], 0.25, {}),
        (["equidistant"], ring, x0[0], 0.05, times),
        (["5 sites", "18"], of_five, x0[0], 0.05, {}),
        (["different lattices"], two, x0, 0.05, {}),
    ):
        sol = co.integrate(system, states, (0, 1), step, **options)
        with refused(ValueError, *named):
            co.spectra.structure_factor(sol)
    sol = co.integrate(ring, x0[0], (0, 1), 0.05)
    with refused(ValueError, "window", "'hannn'"):
        co.spectra.structure_factor(sol, window="hannn")
    with pytest.raises(TypeError):
        co.spectra.structure_factor(sol.x)


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
    S = co.spectra.structure_factor(run(ring, up, 8.0), path=[1 / 2])
    assert np.all(S.intensity < 1e-20)
    axes = S.plot().axes[0]
    left, right = axes.get_xlim()
    assert (left, right) == (-0.5, 0.5) and axes.get_ylim()[1] == pytest.approx(1.15 * S.omega[S.omega >= 0][1])
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["1/2"]


def test_members_and_backward_runs_agree():
    # Between its ends are wave vectors that differ from their opposites, and so from runs in the other direction.
    lattice, path = co.systems.spin_lattice("square", (4, 3), periodic=True), [(0, 0), (0.25, 1 / 3), (0.5, 1)]
    x0 = np.random.default_rng(4).normal(size=(3, 36))
    sol = run(lattice, x0, span=8.0)
    S = co.spectra.structure_factor(sol, path)
    single = [co.spectra.structure_factor(run(lattice, x, span=8.0), path) for x in x0]
    intensities = np.array([one.intensity for one in single])
    assert np.allclose(S.intensity, intensities.mean(axis=0), rtol=1e-11)
    assert np.allclose(S.error, intensities.std(axis=0, ddof=1) / np.sqrt(3), rtol=1e-9)
    assert np.all(np.isnan(single[0].error)) and np.allclose(S.static, np.mean([one.static for one in single], axis=0))
    back = co.integrate(lattice, sol.x[-1], (8, 0), 0.025, method=co.SphericalMidpoint(), save_every=8)
    again = co.spectra.structure_factor(back, path, "boxcar")
    assert np.allclose(again.intensity, co.spectra.structure_factor(sol, path, None).intensity, rtol=1e-8)
