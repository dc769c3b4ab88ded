"""Structure factors: linear spin waves, equipartition, sums over frequencies, paths, members, refusals, pictures."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.reciprocal_path import reciprocal_path
from coadjoint.pictures.structure_factor import corner_name
from coadjoint.systems.lattices.geometry import CELL_GEOMETRY, cell_coordinates, lattice_positions, reciprocal_edges
from coadjoint.systems.lattices.neighbours import graph

WINDOWS = ["hann", "boxcar", None, "blackmanharris", ("kaiser", 6.0)]


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


def test_spin_waves_of_a_square_lattice_in_a_field():
    S = waves("square", (8, 8), field=(0.0, 0.0, 0.5))
    q = 2.0 * np.pi * S.q
    omega = 0.5 + 2.0 * np.sum(1.0 - np.cos(q), axis=1)
    assert np.all(np.abs(np.abs(peaks(S)) - omega) < 0.6 * (S.omega[1] - S.omega[0]))
    assert S.corners.tolist() == [0, 4, 8, 12] and np.max(omega) == 8.5


def test_waves_travel_along_q():
    """Dzyaloshinskii-Moriya coupling D along the spins: omega = B + 2 J (1 - cos q) + 2 D sin q, not even in q."""
    ring = co.systems.spin_lattice("chain", 16, periodic=True, dm=(0.0, 0.0, 0.3), field=(0.0, 0.0, 1.0))
    S = co.spectra.structure_factor(run(ring, nearly_up(16)), path=(-0.5, 0.5))
    q = 2.0 * np.pi * S.q[:, 0]
    positive = S.omega > 0.0
    found = S.omega[positive][np.argmax(S.components[0][:, positive], axis=1)]
    expected = 1.0 + 2.0 * (1.0 - np.cos(q)) + 0.6 * np.sin(q)
    assert np.all(np.abs(found - expected) < 0.6 * (S.omega[1] - S.omega[0]))


def test_two_bands_of_a_honeycomb():
    """omega = J (3 +- |f|), f = sum over neighbours of exp(i q . r), at positions in space."""
    S = waves("honeycomb", (6, 6), field=(0.0, 0.0, 0.2))
    positions = lattice_positions("honeycomb", (6, 6))
    _, edges = graph("honeycomb", (6, 6), False)
    bonds = (positions[edges[:, 1]] - positions[edges[:, 0]]) * np.where(edges[:, :1] % 2, -1.0, 1.0)
    bonds = np.unique(bonds.round(9), axis=0)
    assert len(bonds) == 3 and np.allclose(np.linalg.norm(bonds, axis=1), 1.0)
    f = np.exp(1j * S.q @ reciprocal_edges("honeycomb") @ bonds.T).sum(axis=1)
    bands = 0.2 + 3.0 + np.multiply.outer(np.abs(f), (-1.0, 1.0))
    distance = np.abs(np.abs(peaks(S))[:, None] - bands).min(axis=1)
    assert np.all(distance < 0.6 * (S.omega[1] - S.omega[0]))


@pytest.mark.parametrize("name", CELL_GEOMETRY)
def test_bonds_of_a_lattice_have_length_one(name):
    shape = (4,) * len(CELL_GEOMETRY[name].edges)
    shape = shape[0] if len(shape) == 1 else shape
    _, edges = graph("chain" if name == "ring" else name, shape, False)
    positions = lattice_positions(name, shape)
    assert np.allclose(np.linalg.norm(positions[edges[:, 0]] - positions[edges[:, 1]], axis=1), 1.0, rtol=1e-14)
    coordinates = cell_coordinates(name, shape)
    assert np.allclose(coordinates @ np.array(CELL_GEOMETRY[name].edges), positions, rtol=0, atol=1e-14)


def test_static_structure_factor_of_cold_spins_is_that_of_equipartition():
    """kT / omega(q) for each transverse component, of states at a temperature, at every time of the run."""
    kT, B, members = 0.002, 0.5, 400
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


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("name", ["chain", "kagome"])
def test_sum_over_frequencies_is_the_equal_time_structure_factor(name, window):
    shape = 7 if name == "chain" else (3, 4)
    lattice = co.systems.spin_lattice(name, shape, periodic=True, dm=(0.1, 0.2, 0.3))
    x0 = np.random.default_rng(3).normal(size=(3, lattice.dim))
    sol = run(lattice, x0, span=6.0)
    path = (-2 / 7, 3 / 7) if name == "chain" else ((0.0, -0.5), (1 / 3, 0.25), (1.0, 1.0))
    S = co.spectra.structure_factor(sol, path, window)
    assert np.allclose(S.intensity.sum(axis=1) * (S.omega[1] - S.omega[0]), S.static, rtol=1e-12)
    assert np.allclose(S.components.sum(axis=0), S.intensity, rtol=1e-14) and np.all(S.intensity >= 0.0)
    edges = np.array(CELL_GEOMETRY[name].edges)
    q = S.q @ (2 * np.pi * np.linalg.inv(edges @ edges.T) @ edges)
    spins = sol.x.reshape(*sol.x.shape[:2], -1, 3)
    sums = np.einsum("tmia,ik->tmka", spins, np.exp(-1j * lattice_positions(name, shape) @ q.T))
    equal_time = np.sum(np.abs(sums) ** 2, axis=3) / spins.shape[2]
    from scipy.signal import get_window

    weight = get_window("boxcar" if window is None else window, len(sol.t)) ** 2
    assert np.allclose(S.static, np.average(equal_time.mean(axis=1), axis=0, weights=weight), rtol=1e-11)


def test_members_backward_runs_and_parts_agree(monkeypatch):
    from coadjoint.analysis import structure_factor

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
    monkeypatch.setattr(structure_factor, "NUMBERS_AT_ONCE", 36 * 7)
    assert np.allclose(co.spectra.structure_factor(sol, path).intensity, S.intensity, rtol=1e-11)


def test_paths_take_every_wave_vector_on_their_lines():
    line = reciprocal_path("square", (12, 6), [(0, 0), (0.5, 0), (0.5, 0.5), (0, 0)])
    assert (line.q * (12, 6)).round(12).tolist()[:8] == [[k, 0] for k in range(7)] + [[6, 1]]
    assert line.corners.tolist() == [0, 6, 9, 12] and np.allclose(np.diff(line.distance)[:6], np.pi / 6)
    assert len(reciprocal_path("chain", 9, None).q) == 10 and reciprocal_path("ring", 6, [0.5]).q.tolist() == [[0.5]]
    assert reciprocal_path("triangular", (6, 6), None).q.shape == (7, 2)
    K = (2 / 3, 1 / 3) @ reciprocal_edges("triangular")
    assert np.allclose(np.linalg.norm(K), 4 * np.pi / 3)
    for shape, path, words in (
        ((5, 5), None, r"the usual path has the corner \(0.5, 0.0\), which does not fit \(5, 5\) cells"),
        ((4, 4), [(0, 0), (0.3, 0)], "path has the corner"),
        ((4, 4), [0.0, 0.5], r"path has shape \(2,\); give corners \(corners, 2\)"),
        ((4, 4), np.zeros((0, 2)), "path has shape"),
    ):
        with pytest.raises(ValueError, match=words):
            reciprocal_path("square", shape, path)


@pytest.mark.parametrize(("lattice", "edge"), [("triangular", 1.0), ("honeycomb", np.sqrt(3.0)), ("kagome", 2.0)])
def test_distances_along_a_path_are_those_in_space(lattice, edge):
    """Gamma, M, K, Gamma: the reciprocal edges are oblique, and sqrt(3) times as long as the sides of the zone."""
    line, reciprocal = reciprocal_path(lattice, (6, 6), None), 4.0 * np.pi / np.sqrt(3.0) / edge
    lengths = reciprocal * np.array([1.0 / 2.0, 1.0 / np.sqrt(12.0), 1.0 / np.sqrt(3.0)])
    assert np.allclose(np.diff(line.distance[line.corners]), lengths, rtol=1e-14)


def test_what_has_no_structure_factor_is_refused_by_name():
    ring = co.systems.spin_lattice("ring", 6)
    sol = co.integrate(ring, nearly_up(6)[0], (0, 1), 0.05)
    complete = co.systems.spin_lattice("complete", 4)
    wrong = {
        "no lattice in space": co.integrate(complete, nearly_up(4)[0], (0, 1), 0.05),
        "at least 8 equidistant": co.integrate(ring, nearly_up(6)[0], (0, 1), 0.25),
        "equidistant": co.integrate(ring, nearly_up(6)[0], (0, 1), 0.05, t_eval=np.linspace(0, 1, 9) ** 2),
        "has 5 sites, and its states 18": co.integrate(
            co.LiePoissonSystem(ring.algebra, ring.hamiltonian, layout={"lattice": "chain", "shape": 5}),
            nearly_up(6)[0], (0, 1), 0.05,
        ),
    }  # fmt: skip
    for words, run_of in wrong.items():
        with pytest.raises(ValueError, match=words):
            co.spectra.structure_factor(run_of)
    with pytest.raises(ValueError, match="window is 'hannn'; give a name of scipy"):
        co.spectra.structure_factor(sol, window="hannn")
    with pytest.raises(TypeError):
        co.spectra.structure_factor(sol.x)
    two = co.batch([ring, co.systems.spin_lattice("chain", 6)])
    with pytest.raises(ValueError, match="different lattices"):
        co.spectra.structure_factor(co.integrate(two, nearly_up(6), (0, 1), 0.05))


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
    assert corner_name([2 / 3, 1 / 3]) == "(2/3, 1/3)" and repr(S).startswith("<structure factor of 7 wave vectors")


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
