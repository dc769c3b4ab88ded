"""Small motions about magnetic orders by wave vector, against closed forms of linear spin wave theory and runs."""

import numpy as np
import pytest
from scipy.constants import physical_constants

import coadjoint as co

HBAR = physical_constants["reduced Planck constant in eV s"][0] * 1e15  # meV ps
UP = np.array([0.0, 0.0, 1.0])
COS, SIN = (lambda x: np.cos(2 * np.pi * x)), (lambda x: np.sin(2 * np.pi * x))


def chain(cells=6, a=1.0, **options):
    crystal = co.spins.crystal(lattice=(a, 2 * a, 2 * a, 90, 90, 90), sites={"Cu": (0, 0, 0)}, space_group="P 1")
    return co.systems.spins(crystal, (cells, 1, 1), **options), crystal.bonds(a)["1"]


def tiled(model, directions=UP):
    """Return the state with directions of the sites of the cell, or one for all."""
    return np.broadcast_to(directions, (len(model.sites), 3)).astype(float).ravel()


def alternating(model, step=(1, 1, 1)):
    """Return up and down along the cells, and on the sites of the cell."""
    signs = (-1.0) ** (model.cells @ np.array(step) + model.sites)
    return (signs[:, None] * UP).ravel()


def close(modes, expected, rtol=1e-11):
    expected = np.sort(np.array(expected).T.reshape(len(modes.q), -1), axis=1)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(np.sort(modes.energies, axis=1), expected, rtol=rtol, atol=rtol * scale)


@pytest.mark.parametrize("units", ["natural", "meV"])
@pytest.mark.parametrize("spin", [0.5, 1.5])
def test_a_ferromagnetic_chain(spin, units):
    """E = 2 S J (1 - cos q) + 2 S K + g mu_B B + 2 S D sin q: exchange, an easy axis, a field and D along the spins."""
    model, bond = chain(spin=spin, units=units)
    mu_B = co.systems.spins(model.crystal, (3, 1, 1), units=units).field((0, 0, 1)).energy(tiled(chain(3)[0])) / -6
    model = model.exchange(bond, -0.7).dzyaloshinskii_moriya(bond, (0, 0, 0.2))
    model = model.single_ion("Cu", np.diag([0, 0, -0.3])).field((0, 0, 0.4))
    modes = co.spectra.linear_modes(model, tiled(model), [(-1, 0, 0), (1, 0.3, 0)], points=17)
    h = modes.q[:, 0]
    close(modes, [2 * spin * (0.7 * (1 - COS(h)) + 0.3 + 0.2 * SIN(h)) + 2 * mu_B * 0.4])
    assert modes.spins_in_cell == 1 and modes.stable
    assert np.allclose(modes.intensity, spin) and np.allclose(modes.components[:2], spin / 2)
    assert np.all(modes.components[2] < 1e-20)


def test_the_sense_of_dzyaloshinskii_moriya_coupling_is_that_of_runs():
    model, bond = chain(16)
    model = model.exchange(bond, -1.0).dzyaloshinskii_moriya(bond, (0, 0, 0.3)).field((0, 0, 1.0))
    x = np.random.default_rng(1).standard_normal((48,)) * 1e-3 + tiled(model)
    x = (x.reshape(-1, 3) / np.linalg.norm(x.reshape(-1, 3), axis=1, keepdims=True)).ravel()
    sol = co.integrate(model, x, (0, 60), 0.02, method=co.SphericalMidpoint(), save_every=10)
    S = co.spectra.structure_factor(sol, [(-1 / 2, 0, 0), (1 / 2, 0, 0)])
    modes = co.spectra.linear_modes(model, tiled(model), [(-1 / 2, 0, 0), (1 / 2, 0, 0)], points=16)
    assert np.allclose(modes.q, S.q)
    positive = S.omega > 0
    found = S.omega[positive][S.components[0][:, positive].argmax(axis=1)]
    assert np.all(np.abs(found - modes.frequencies[:, 0]) < 0.6 * (S.omega[1] - S.omega[0]))
    assert np.ptp(found - found[::-1]) > 1.0


@pytest.mark.parametrize("scale", [1.0, 1e-7, 1e30])
def test_a_square_antiferromagnet(scale):
    """E = 4 S J sqrt((1 + k)^2 - g^2), and the intensity S (1 + k - g) / (2 sqrt((1 + k)^2 - g^2)) of each component."""
    crystal = co.spins.crystal(lattice=(scale, scale, 3 * scale, 90, 90, 90), sites={"Cu": (0, 0, 0)})
    J, spin, easy = 0.6 * scale, 1.5, 0.05
    model = co.systems.spins(crystal, (4, 4, 1), spin=spin).exchange(crystal.bonds(scale)["1"], J)
    model = model.single_ion("Cu", np.diag([0, 0, -2 * J * easy]))
    state = alternating(model, (1, 1, 0))
    modes = co.spectra.linear_modes(model, state, [(0, 0, 0), (1, 0.3, 0), (0.2, 0.9, 3)], points=20)
    g = (COS(modes.q[:, 0]) + COS(modes.q[:, 1])) / 2
    root = np.sqrt((1 + easy) ** 2 - g**2)
    close(modes, [4 * spin * J * root] * 2)
    assert modes.spins_in_cell == 2
    # Of the two degenerate modes only the sum is defined.
    each = modes.components.sum(axis=2)
    np.testing.assert_allclose(each[0], spin * (1 + easy - g) / (2 * root), rtol=1e-9)
    np.testing.assert_allclose(each[1], each[0], rtol=1e-9)


def test_goldstone_modes_are_zero_and_diverge_where_the_order_scatters():
    crystal = co.spins.crystal(lattice=(1, 1, 3, 90, 90, 90), sites={"Cu": (0, 0, 0)})
    model = co.systems.spins(crystal, (4, 4, 1)).exchange(crystal.bonds(1)["1"], 1.0)
    corners = [(0, 0, 0), (1 / 2, 1 / 2, 0), (1 / 4, 1 / 2, 0)]
    modes = co.spectra.linear_modes(model, alternating(model, (1, 1, 0)), corners, points=6)
    first, second, third = (modes.intensity[corner] for corner in modes.corners)
    assert np.all(modes.frequencies[modes.corners[:2]] == 0.0) and np.allclose(modes.frequencies[modes.corners[2]], 12**0.5)
    assert np.all(first == 0.0) and np.all(np.isinf(second)) and np.isclose(third.sum(), 3**0.5)
    spectrum = modes.spectrum(np.linspace(0, 5, 501), 0.2)
    assert np.isfinite(spectrum.intensity).all()


def kagome(size=(3, 3, 1), **options):
    sites = {"Cu": [(0, 0, 0), (1 / 2, 0, 0), (0, 1 / 2, 0)]}
    crystal = co.spins.crystal(lattice=(2, 2, 5, 90, 90, 120), sites=sites)
    model = co.systems.spins(crystal, size, **options)
    return model, crystal.bonds(1)["1"]


def test_a_kagome_ferromagnet_has_a_flat_band():
    """E = S J (6, 3 +- sqrt(1 + 8 cos cos cos)) of bonds half the edges; Harris, Kallin, Berlinsky 1992."""
    model, bond = kagome(spin=2.5)
    model = model.exchange(bond, -0.8)
    modes = co.spectra.linear_modes(model, tiled(model), [(0, 0, 0), (1 / 2, 0, 0), (1 / 3, 1 / 3, 0), (0.3, 1.1, 0)])
    h, k, _ = modes.q.T
    root = np.sqrt(np.maximum(0, 1 + 8 * np.cos(np.pi * h) * np.cos(np.pi * k) * np.cos(np.pi * (h + k))))
    close(modes, 2.5 * 0.8 * np.array([np.full_like(h, 6.0), 3 + root, 3 - root]), rtol=1e-7)
    assert np.allclose(modes.intensity.sum(axis=1), 2.5)


def test_a_kagome_antiferromagnet_has_a_zero_mode_everywhere():
    """The coplanar state of the magnetic cell: 0, and twice J S sqrt(2 [sin^2 + sin^2 + sin^2]) (Harris et al.)."""
    model, bond = kagome()
    model = model.exchange(bond, 1.0)
    angle = 2 * np.pi * np.array([0, 1, 2]) / 3
    state = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)[model.sites].ravel()
    modes = co.spectra.linear_modes(model, state, [(0.1, 0, 0), (1 / 2, 0, 0), (0.4, 0.3, 0)], points=20)
    h, k, _ = modes.q.T
    wave = np.sqrt(2 * (np.sin(np.pi * h) ** 2 + np.sin(np.pi * k) ** 2 + np.sin(np.pi * (h + k)) ** 2))
    close(modes, [0 * h, wave, wave], rtol=1e-6)
    assert modes.spins_in_cell == 3 and np.all(modes.frequencies[:, 0] == 0.0)


def test_a_honeycomb_ferromagnet_has_a_dirac_point():
    """E = S J (3 +- |sum of exp(i q . d)|), which meet at K."""
    crystal = co.spins.crystal(lattice=(1, 1, 4, 90, 90, 120), sites={"Cr": [(1 / 3, 2 / 3, 0), (2 / 3, 1 / 3, 0)]})
    model = co.systems.spins(crystal, (3, 3, 1), spin=1.5).exchange(crystal.bonds(0.6)["1"], -1.0)
    modes = co.spectra.linear_modes(model, tiled(model), [(0, 0, 0), (1 / 3, 1 / 3, 0), (0.2, 0.7, 0)], points=30)
    h, k, _ = modes.q.T
    size = np.abs(1 + np.exp(2j * np.pi * h) + np.exp(-2j * np.pi * k))
    close(modes, [1.5 * (3 - size), 1.5 * (3 + size)], rtol=1e-9)
    assert np.ptp(modes.frequencies[modes.corners[1]]) < 1e-9
