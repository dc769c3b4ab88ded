"""Spins on lattices: paths of wave vectors, and random numbers of sites."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis import structure_factor, thermal_states
from coadjoint.analysis.wave_vectors import commensurate_waves, lattice_by_name
from coadjoint.systems.forces.base import random_words
from coadjoint.systems.lattices import geometry


def test_paths_take_every_wave_vector_on_their_lines():
    q, distance, corners = commensurate_waves(
        lattice_by_name("square", (12, 6)), [(0, 0), (0.5, 0), (0.5, 0.5), (0, 0)]
    )[:3]
    assert (q * (12, 6)).round(12).tolist()[:8] == [[k, 0] for k in range(7)] + [[6, 1]]
    assert corners.tolist() == [0, 6, 9, 12] and np.allclose(np.diff(distance)[:6], np.pi / 6)
    assert len(commensurate_waves(lattice_by_name("chain", 9), None)[0]) == 10 and commensurate_waves(
        lattice_by_name("ring", 6), [0.5]
    )[0].tolist() == [[0.5]]
    assert commensurate_waves(lattice_by_name("triangular", (6, 6)), None)[0].shape == (7, 2)
    K = (2 / 3, 1 / 3) @ geometry.reciprocal_edges("triangular")
    assert np.allclose(np.linalg.norm(K), 4 * np.pi / 3)
    for shape, path, words in (
        ((5, 5), None, r"the usual path has the corner \(0.5, 0.0\), which does not fit square, 5 x 5 cells"),
        ((4, 4), [(0, 0), (0.3, 0)], "path has the corner"),
        ((4, 4), [0.0, 0.5], r"path has shape \(2,\); give corners \(corners, 2\)"),
        ((4, 4), np.zeros((0, 2)), "path has shape"),
    ):
        with pytest.raises(ValueError, match=words):
            commensurate_waves(lattice_by_name("square", shape), path)


@pytest.mark.parametrize(("lattice", "edge"), [("triangular", 1.0), ("honeycomb", np.sqrt(3.0)), ("kagome", 2.0)])
def test_distances_along_a_path_are_those_in_space(lattice, edge):
    """Gamma, M, K, Gamma: the reciprocal edges are oblique, and sqrt(3) times as long as the sides of the zone."""
    (_, distance, corners), reciprocal = (
        commensurate_waves(lattice_by_name(lattice, (6, 6)), None)[:3],
        4.0 * np.pi / np.sqrt(3.0) / edge,
    )
    lengths = reciprocal * np.array([1.0 / 2.0, 1.0 / np.sqrt(12.0), 1.0 / np.sqrt(3.0)])
    assert np.allclose(np.diff(distance[corners]), lengths, rtol=1e-14)


def test_random_numbers_belong_to_sites():
    """No two spins, sweeps or members share one, and none is that of the noise of a force."""
    draws = [thermal_states.uniform_words(4, (sweep, part), 3, slice(0, 5)) for sweep in (0, 1, 2) for part in (0, 1)]
    assert len(np.unique(draws)) == 6 * 4 * 3 * 5
    assert np.array_equal(thermal_states.uniform_words(4, (1, 0), 3, slice(2, 4)), draws[2][:, :, 2:4])
    noise = (random_words(4, 0, 0.0, 0, 60) >> np.uint64(11)).astype(float) * 2.0**-53
    assert not np.any(np.isclose(np.ravel(draws)[:, None], noise, rtol=0, atol=1e-15))


@pytest.mark.parametrize("where", [[(0, 0, 0), (1, 0, 1)], co.spectra.Powder([0.0, 1.5, 3.0])])
def test_spectra_are_computed_in_parts_of_wave_vectors_and_times(monkeypatch, where):
    crystal = co.spins.crystal(lattice=(1, 1.2, 1.5, 90, 90, 90), sites={"Fe": (0, 0, 0)})
    model = co.systems.spins(crystal, (3, 3, 3)).exchange(crystal.bonds(1)["1"], 0.3)
    x = np.random.default_rng(1).standard_normal((2, 27, 3))
    x /= np.linalg.norm(x, axis=2, keepdims=True)
    sol = co.integrate(model, x.reshape(2, -1), (0, 1), 0.05)
    neutrons = co.spectra.Neutrons(domains="symmetry")
    whole = co.spectra.structure_factor(sol, where, None, neutrons)
    monkeypatch.setattr(structure_factor, "NUMBERS_AT_ONCE", 110)
    parts = co.spectra.structure_factor(sol, where, None, neutrons)
    for name in ("intensity", "error", "components", "static"):
        np.testing.assert_allclose(getattr(parts, name), getattr(whole, name), rtol=1e-11, atol=1e-14)
