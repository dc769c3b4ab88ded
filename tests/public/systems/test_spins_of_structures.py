"""Known results of spins on lattices, by models on structure files: statistics, spin waves, spin flop, helices."""

import importlib.util

import numpy as np
import pytest
from scipy.constants import physical_constants
from scipy.integrate import solve_ivp
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
    for name, label, neighbours, distance in (("RbMnF3", "Mn", 6, 4.24), ("CsNiF3", "Ni", 2, 5.242 / 2)):
        whole = co.spins.crystal(co.spins.structure(name))
        nearest = next(iter(whole.subcrystal(label).bonds(4.5)))
        assert nearest.coordination == neighbours and abs(nearest.distance - distance) < 1e-12
        assert len(whole.labels) * 2 == (10 if name == "RbMnF3" else 20)  # ABF3, two formula units in the chains
    with refused(ValueError, "MnF2", "FeI2", "RbMnF3", "CsNiF3"):
        co.spins.structure("NaCl")


def iron_iodide(size, mode="dipole"):
    """FeI2 with the anisotropic exchange and the easy axis of X. Bai et al., Nature Physics 17, 467 (2021)."""
    iron = co.spins.crystal(co.spins.structure("FeI2")).subcrystal("Fe")
    bonds, axis = iron.bonds(9.8), np.diag([0, 0, -2.165]) if mode == "dipole" else np.diag([-2.165, 0, -2.165])
    model = co.systems.spins(iron, size, spin=1, units="meV", mode=mode).single_ion("Fe", axis)
    model = model.exchange(bonds["1"], [[-0.397, 0, 0], [0, -0.075, -0.261], [0, -0.261, -0.236]])
    for name, across, along in (("3", 0.026, 0.113), ("5", 0.166, 0.211)):
        model = model.exchange(bonds[name], np.diag([across, across, along]))
    return model.exchange(bonds["4"], np.diag([0.013, 0.013, 0.051])) if size[2] > 1 else model


@pytest.mark.parametrize(("order", "steps"), [(2, (50, 100)), (4, (20, 40)), (6, (20, 40))])
def test_anisotropic_exchange_of_a_lattice_has_nine_exact_flows(order, steps):
    """All pairs of axes of neighbours need nine parts on a lattice whose sites have three or four colours."""
    model = iron_iodide((5, 8, 1))
    described = str(co.Splitting(order).describe(model)).splitlines()[0]
    assert described.endswith("in 9 parts")
    errors = errors_of_splitting(model, order, steps)
    assert errors[0] < 2e-3 and abs(np.log2(errors[0] / errors[1]) - order) < 0.1


def errors_of_splitting(model, order, steps):
    x0 = np.random.default_rng(3).standard_normal((model.dim // 3, 3))
    x0 = (x0 / np.linalg.norm(x0, axis=1, keepdims=True)).ravel()
    exact = solve_ivp(lambda t, x: model.vector_field(x), (0, 1), x0, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    return [np.abs(co.integrate(model, x0, (0, 1), 1 / n, co.Splitting(order)).x[-1] - exact).max() for n in steps]


@pytest.mark.parametrize(
    ("lattice", "shape", "tensor", "parts"),
    [
        ("triangular", (5, 8), "full", 9),
        ("cubic", (3, 3, 3), "full", 9),
        ("ring", 25, "in the plane", 5),  # z z, and four pairs of x and y
        ("complete", 20, "full", 27),  # of the 20 * 19 / 2 pairs of spins, by digits of their 20 colours to the base 4
    ],
)
def test_general_exchange_of_a_lattice_has_few_parts(lattice, shape, tensor, parts):
    T = np.random.default_rng(5).uniform(0.5, 1.0, (3, 3))
    if tensor == "in the plane":
        T[:2, 2] = T[2, :2] = 0.0
    scale = 2.0 / shape if lattice == "complete" else 1.0
    model = co.systems.spin_lattice(lattice, shape, periodic=lattice != "complete", tensor=T, exchange=scale)
    described = str(co.Splitting().describe(model)).splitlines()[0]
    assert int(described.split()[-2]) <= parts
    errors = errors_of_splitting(model, 2, (40, 80))
    assert errors[0] < 0.05 and abs(np.log2(errors[0] / errors[1]) - 2) < 0.1


def test_parts_know_the_ideals_of_coordinates_in_any_order():
    """Eight spins of a ring whose coordinates are in a drawn order: each part has one coordinate of a spin at most."""
    place, T = np.random.default_rng(2).permutation(24).reshape(8, 3), np.random.default_rng(5).uniform(0.5, 1, (3, 3))
    brackets, M = [np.roll(spin, -k) for spin in place for k in range(3)], np.zeros((24, 24))
    algebra = co.LieAlgebra([(min(i, j), max(i, j), k, np.sign(j - i)) for i, j, k in brackets], dim=24)
    for spin, other in zip(place, np.roll(place, 1, axis=0), strict=True):
        M[np.ix_(spin, other)], M[np.ix_(other, spin)] = T, T.T
    errors = errors_of_splitting(co.LiePoissonSystem(algebra, co.Quadratic(M)), 2, (40, 80))
    assert errors[0] < 0.005 and abs(np.log2(errors[0] / errors[1]) - 2) < 0.1


@pytest.mark.parametrize("mode", ["dipole", "SU(N)"])
def test_large_models_of_many_bonds_have_the_parts_of_small_ones(mode):
    """2400 bonds between 160 spins."""
    described = str(co.Splitting().describe(iron_iodide((5, 8, 4), mode)))
    assert described.splitlines()[0].endswith("in 9 parts")


def test_parts_of_general_exchange_in_batches_derivatives_and_backward():
    """The same bits beside others, derivatives by all matrices against differences, and steps that are undone."""
    T, D = np.random.default_rng(5).uniform(0.5, 1.0, (3, 3)), np.random.default_rng(6).standard_normal((3, 3))
    x = np.random.default_rng(3).standard_normal((40, 3))
    x, method = (x / np.linalg.norm(x, axis=1, keepdims=True)).ravel(), co.Splitting(order=4)

    def model(s):
        return co.systems.spin_lattice("triangular", (5, 8), periodic=True, tensor=T + s * D)

    def end(s):
        return co.integrate(model(s), x, (1, 1.5), 0.01, method).x[-1]

    alone = end(0.1)
    assert np.array_equal(co.integrate(co.batch([model(0), model(0.1)]), x, (1, 1.5), 0.01, method).x[-1, 1], alone)
    assert np.array_equal(co.integrate(model(0.1), np.tile(x, (4, 1)), (1, 1.5), 0.01, method).x[-1, 3], alone)
    assert np.abs(co.integrate(model(0.1), alone, (1.5, 1), 0.01, method).x[-1] - x).max() < 1e-13
    ready = co.prepare(model(0.1), method, step=0.01)
    tangent = ready.jvp(x, (1, 1.5), {"tensor": D})[1].x[-1]
    np.testing.assert_allclose(tangent, (end(0.1 + 1e-5) - end(0.1 - 1e-5)) / 2e-5, atol=1e-6)
    v = np.random.default_rng(1).standard_normal(120)
    sol, pullback = ready.vjp(x, (1, 1.5))
    gradient = pullback(x=np.concatenate([np.zeros((len(sol.x) - 1, 120)), v[None]]))["tensor"]
    np.testing.assert_allclose(np.sum(gradient * D), v @ tangent, rtol=1e-10)
