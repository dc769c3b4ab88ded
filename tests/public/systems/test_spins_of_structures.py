"""Known results of spins on lattices, by models on structure files: statistics, spin waves, spin flop, helices."""

import importlib.util

import numpy as np
import pytest
from scipy.constants import physical_constants
from scipy.special import spherical_in

import coadjoint as co
from refusals import refused

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec(name) is None, reason=f"{name} is not installed")
    for name in ("gemmi", "spglib")
]

HBAR = physical_constants["reduced Planck constant in eV s"][0] * 1e15  # meV ps
MU_B = physical_constants["Bohr magneton in eV/T"][0] * 1e3  # meV/T
K_B = physical_constants["Boltzmann constant in eV/K"][0] * 1e3  # meV/K
CIF = """data_{name}
_cell_length_a {a}
_cell_length_b {a}
_cell_length_c {c}
_cell_angle_alpha 90
_cell_angle_beta 90
_cell_angle_gamma {gamma}
_space_group_name_H-M_alt '{group}'
loop_
_atom_site_label
_atom_site_type_symbol
_atom_site_fract_x
_atom_site_fract_y
_atom_site_fract_z
{sites}
"""
CHAIN = {"name": "chain", "a": 9.0, "c": 3.0, "gamma": 90, "group": "P 4/m m m", "sites": "Ni Ni2+ 0 0 0"}
HONEYCOMB = {
    "name": "honeycomb",
    "a": 6.0,
    "c": 9.0,
    "gamma": 120,
    "group": "P 6/m m m",
    "sites": "Cr Cr3+ 0.3333333 0.6666667 0",
}


def crystal_of(cif, folder):
    file = folder / f"{cif['name']}.cif"
    file.write_text(CIF.format(**cif))
    return co.spins.crystal(file)


def energies(model, T, seed):
    """Return mean energies in equilibrium, and their standard error by members."""
    states = co.thermal_states(model, T, members=120, sweeps=120, seed=seed)
    means = states.energy[30:].mean(axis=0)
    return means.mean(), means.std() / np.sqrt(len(means))


def test_chains_and_rings_of_spins(tmp_path):
    """Fisher's open chain, -K L(K) for each bond, and Joyce's ring, of lengths S, in meV and kelvin."""
    chain, S, J, T = crystal_of(CHAIN, tmp_path), 1.5, -0.4, 6.0
    bond = chain.bonds(3.1)["1"]
    K = -J * S**2 / (K_B * T)
    model = co.systems.spins(chain, (1, 1, 12), spin=S, units="meV", periodic=False).exchange(bond, J)
    mean, error = energies(model, T, 1)
    assert abs(mean - 11 * J * S**2 * (1 / np.tanh(K) - 1 / K)) < 4 * error

    count, h = 5, 1e-5

    def log_partition(K):
        return np.log(sum((2 * l + 1) * spherical_in(l, K) ** count for l in range(40)))

    ring = co.systems.spins(chain, (1, 1, count), spin=S, units="meV").exchange(bond, J)
    mean, error = energies(ring, T, 2)
    exact = J * S**2 * (log_partition(K + h) - log_partition(K - h)) / (2 * h)
    assert abs(mean - exact) < 4 * error


def test_spin_waves_of_a_honeycomb_and_its_dirac_point(tmp_path):
    """A S (3 +- |f(q)|) in the field of the exchange, and the gap 2 |A| S of the easy axis; f is zero at K."""
    honeycomb, S, J, A, n = crystal_of(HONEYCOMB, tmp_path), 1.5, -2.0, -0.25, 3
    model = co.systems.spins(honeycomb, (n, n, 1), spin=S, units="meV", periodic=(True, True, False))
    model = model.exchange(honeycomb.bonds(3.5)["1"], J).single_ion("Cr", np.diag([0, 0, A]))
    found = HBAR * np.sort(co.equilibrium(model, np.tile([0.0, 0, 1], 2 * n * n)).frequencies)
    q = 2 * np.pi * np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2) / n
    f = np.abs(1 + np.exp(1j * q[:, 0]) + np.exp(1j * q[:, 1]))
    wanted = np.sort(np.concatenate([3 - f, 3 + f]) * -J * S + 2 * S * -A)
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    assert np.sum(np.abs(f) < 1e-12) == 2  # K and K', where two bands meet


def test_spin_flop_of_manganese_fluoride():
    """Resonances gamma (B_c -+ B), B_c^2 = B_A (2 B_E + B_A), of which the lower one is zero at the spin flop."""
    mn = co.spins.crystal(co.spins.structure("MnF2")).subcrystal("Mn")
    (body,) = [bond for bond in mn.bonds(4) if bond.coordination == 8]
    S, g, J, A = 2.5, 2.0, 0.304, -0.019
    model = co.systems.spins(mn, (2, 2, 2), spin=S, g=g, units="meV").exchange(body, J)
    model = model.single_ion("Mn", np.diag([0, 0, A]))
    up = np.array([0.0, 0, 1]) * np.where(model.sites == 0, 1, -1)[:, None]
    exchange, anisotropy = 8 * J * S / (g * MU_B), -2 * A * S / (g * MU_B)
    flop = np.sqrt(anisotropy * (2 * exchange + anisotropy))
    assert 9 < flop < 10  # tesla: measured 9.3
    for B in (0.0, 4.0):
        found = co.equilibrium(model.field((0, 0, B)), up.ravel())
        assert found.stability == "stable"
        for wanted in (flop - B, flop + B):
            assert np.abs(HBAR * found.frequencies / (g * MU_B) - wanted).min() < 1e-7 * flop
    tilted = (up + [1e-3, 0, 0]).ravel() / np.sqrt(1 + 1e-6)
    below, above = (co.equilibrium(model.field((0, 0, B)), tilted).x for B in (0.97 * flop, 1.03 * flop))
    np.testing.assert_allclose(below, up.ravel(), atol=1e-6)
    np.testing.assert_allclose(above[2::3], 1.03 * flop / (2 * exchange - anisotropy), atol=1e-6)


def test_helix_of_competing_exchange(tmp_path):
    """J1 < 0 and J2 > 0 along a chain: cos q = -J1/(4 J2), and the energy of a helix of six spins a turn."""
    chain, S = crystal_of(CHAIN, tmp_path), 2.0
    bonds = chain.bonds(6.1)
    model = co.systems.spins(chain, (1, 1, 12), spin=S).exchange(bonds["1"], -1.0).exchange(bonds["2"], 0.5)
    turn = 2 * np.pi * np.arange(12) / 6 + 0.05 * np.random.default_rng(1).normal(size=12)
    start = np.stack([np.cos(turn), np.sin(turn), 0.1 * np.cos(turn)], axis=-1)
    start /= np.linalg.norm(start, axis=1, keepdims=True)
    helix = co.equilibrium(model, start.ravel())
    assert abs(helix.energy - 12 * S**2 * (-0.5 - 0.25)) < 1e-10
    assert abs(helix.energy) > abs(model.energy(np.tile([0.0, 0, 1], 12)))


@pytest.mark.parametrize("angle", [20.0, 45.0, 70.0])
def test_astroid_of_stoner_and_wohlfarth(tmp_path, angle):
    """A spin with an easy axis leaves the side against a field at B_A (cos^(2/3) + sin^(2/3))^(-3/2), within 1e-3."""
    chain, S, g, A = crystal_of(CHAIN, tmp_path), 2.0, 1.9, -0.05
    model = co.systems.spins(chain, (1, 1, 1), spin=S, g=g, units="meV").single_ion("Ni", np.diag([0, 0, A]))
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    switching = -2 * A * S / (g * MU_B) * (c ** (2 / 3) + s ** (2 / 3)) ** -1.5
    x = np.array([0.0, 0, 1])
    for part, stays in ((0.9, True), (0.999, True), (1.001, False)):
        damped = model.field(-part * switching * np.array([s, 0, c])).with_forces(co.forces.Gilbert(1.0))
        x = co.integrate(damped, x, (0, 1000), 0.05, save_every=20000).x[-1]
        assert (x[2] > 0.3) == stays


def test_files_of_the_package():
    iron = co.spins.crystal(co.spins.structure("FeI2")).subcrystal("Fe")
    assert [len(bond.basis) for bond in iron.bonds(7.9)] == [4, 2, 4, 6]
    with refused(ValueError, "MnF2", "FeI2"):
        co.spins.structure("NaCl")
