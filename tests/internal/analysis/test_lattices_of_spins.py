"""Spins on lattices: geometry and paths of wave vectors, sublattices, random numbers, and parts of one computation."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis import structure_factor, thermal_states
from coadjoint.analysis.structure_factor import reciprocal_path
from coadjoint.analysis.thermal_states import spin_energy
from coadjoint.pictures.analysis_figures import corner_name
from coadjoint.systems.forces.base import random_words
from coadjoint.systems.lattices import geometry

WINDOWS = ["hann", "boxcar", None, "blackmanharris", ("kaiser", 6.0)]


def run(lattice, x0, span=60.0, step=0.025, every=8):
    return co.integrate(lattice, x0, (0, span), step, method=co.SphericalMidpoint(), save_every=every)


@pytest.mark.parametrize("name", geometry.CELLS)
def test_bonds_of_a_lattice_have_length_one(name):
    shape = (4,) * len(geometry.CELLS[name].edges)
    shape = shape[0] if len(shape) == 1 else shape
    _, edges = geometry.graph("chain" if name == "ring" else name, shape, False)
    positions = geometry.lattice_positions(name, shape)
    assert np.allclose(np.linalg.norm(positions[edges[:, 0]] - positions[edges[:, 1]], axis=1), 1.0, rtol=1e-14)
    coordinates = geometry.cell_coordinates(name, shape)
    assert np.allclose(coordinates @ np.array(geometry.CELLS[name].edges), positions, rtol=0, atol=1e-14)


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
    edges = np.array(geometry.CELLS[name].edges)
    q = S.q @ (2 * np.pi * np.linalg.inv(edges @ edges.T) @ edges)
    spins = sol.x.reshape(*sol.x.shape[:2], -1, 3)
    sums = np.einsum("tmia,ik->tmka", spins, np.exp(-1j * geometry.lattice_positions(name, shape) @ q.T))
    equal_time = np.sum(np.abs(sums) ** 2, axis=3) / spins.shape[2]
    from scipy.signal import get_window

    weight = get_window("boxcar" if window is None else window, len(sol.t)) ** 2
    assert np.allclose(S.static, np.average(equal_time.mean(axis=1), axis=0, weights=weight), rtol=1e-11)


def test_paths_take_every_wave_vector_on_their_lines():
    q, distance, corners = reciprocal_path("square", (12, 6), [(0, 0), (0.5, 0), (0.5, 0.5), (0, 0)])
    assert (q * (12, 6)).round(12).tolist()[:8] == [[k, 0] for k in range(7)] + [[6, 1]]
    assert corners.tolist() == [0, 6, 9, 12] and np.allclose(np.diff(distance)[:6], np.pi / 6)
    assert len(reciprocal_path("chain", 9, None)[0]) == 10 and reciprocal_path("ring", 6, [0.5])[0].tolist() == [[0.5]]
    assert reciprocal_path("triangular", (6, 6), None)[0].shape == (7, 2)
    K = (2 / 3, 1 / 3) @ geometry.reciprocal_edges("triangular")
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
    (_, distance, corners), reciprocal = reciprocal_path(lattice, (6, 6), None), 4.0 * np.pi / np.sqrt(3.0) / edge
    lengths = reciprocal * np.array([1.0 / 2.0, 1.0 / np.sqrt(12.0), 1.0 / np.sqrt(3.0)])
    assert np.allclose(np.diff(distance[corners]), lengths, rtol=1e-14)


def test_random_numbers_belong_to_sites():
    """No two spins, sweeps or members share one, and none is that of the noise of a force."""
    draws = [thermal_states.uniform_words(4, (sweep, part), 3, slice(0, 5)) for sweep in (0, 1, 2) for part in (0, 1)]
    assert len(np.unique(draws)) == 6 * 4 * 3 * 5
    assert np.array_equal(thermal_states.uniform_words(4, (1, 0), 3, slice(2, 4)), draws[2][:, :, 2:4])
    noise = (random_words(4, 0, 0.0, 0, 60) >> np.uint64(11)).astype(float) * 2.0**-53
    assert not np.any(np.isclose(np.ravel(draws)[:, None], noise, rtol=0, atol=1e-15))


@pytest.mark.parametrize("name", ["chain", "square", "triangular", "kagome", "cubic", "complete"])
def test_spins_of_a_sublattice_are_not_coupled(name):
    shape = {"chain": 5, "complete": 4, "cubic": (3, 3, 3)}.get(name, (3, 3))
    energies = spin_energy(co.systems.spin_lattice(name, shape, periodic=name not in ("complete",)), "a test")
    sets = [sublattice.sites for sublattice in energies.sublattices]
    assert np.array_equal(np.sort(np.concatenate(sets)), np.arange(energies.sites))
    assert all(energies.strengths[sites][:, sites].nnz == 0 for sites in sets)
    even = co.systems.spin_lattice("square", (4, 6), periodic=True)
    assert len(spin_energy(even, "a test").sublattices) == 2


def test_parts_of_a_computation_change_nothing(monkeypatch):
    """Spins are drawn in groups of members, and spins of a run are summed in groups of times."""
    chain, kT = co.systems.spin_lattice("chain", 4, periodic=True), np.linspace(0.3, 2.0, 5)
    states = [co.thermal_states(chain, kT, seed=2, sweeps=3, method=method) for method in ("heat bath", "Metropolis")]
    sol = run(chain, np.random.default_rng(4).normal(size=(3, 12)), span=8.0)
    S = co.spectra.structure_factor(sol)
    monkeypatch.setattr(structure_factor, "NUMBERS_AT_ONCE", 36 * 7)
    assert np.allclose(co.spectra.structure_factor(sol).intensity, S.intensity, rtol=1e-11)
    for spins in (1, 8, 2**20):
        monkeypatch.setattr(thermal_states, "SPINS_AT_ONCE", spins)
        for found, method in zip(states, ("heat bath", "Metropolis"), strict=True):
            again = co.thermal_states(chain, kT, seed=2, sweeps=3, method=method)
            for name in ("x", "energy", "acceptance"):
                assert np.array_equal(getattr(again, name), getattr(found, name))


def test_corners_have_names_of_fractions():
    assert corner_name([2 / 3, 1 / 3]) == "(2/3, 1/3)"
