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
    sense = SIN(h)
    expected = 2 * spin * (0.7 * (1 - COS(h)) + 0.3) + 2 * mu_B * 0.4
    shift = modes.energies[:, 0] - expected
    assert np.allclose(shift, -2 * spin * 0.2 * sense, rtol=1e-10, atol=1e-12) or np.allclose(
        shift, 2 * spin * 0.2 * sense, rtol=1e-10, atol=1e-12
    )
    assert modes.spins_in_cell == 1 and modes.stable
    assert np.allclose(modes.intensity, spin) and np.allclose(modes.components[:2], spin / 2)
    assert np.all(modes.components[2] < 1e-20)
