"""Spin models on crystals: their energies and motions by hand, units, vacancies, dipoles, and what is refused."""

import importlib.util
import itertools
import pickle
import tracemalloc

import numpy as np
import pytest
from scipy.constants import physical_constants
from scipy.integrate import solve_ivp

import coadjoint as co
from refusals import refused

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec(name) is None, reason=f"{name} is not installed")
    for name in ("gemmi", "spglib")
]

HBAR = physical_constants["reduced Planck constant in eV s"][0] * 1e15  # meV ps
MU_B = physical_constants["Bohr magneton in eV/T"][0] * 1e3  # meV/T
K_B = physical_constants["Boltzmann constant in eV/K"][0] * 1e3  # meV/K
CUBE = co.spins.crystal(lattice=(3, 3, 3, 90, 90, 90), sites={"Fe": (0, 0, 0)}, space_group="P m -3 m")
POLAR = co.spins.crystal(  # two kinds of sites, Dzyaloshinskii-Moriya vectors and general anisotropies
    lattice=(4, 5, 6, 90, 90, 90), sites={"Fe": (0.1, 0.2, 0), "Ni": (0.4, 0.8, 0.1)}, space_group="P 1 2 1"
)
WIDER = co.spins.crystal(lattice=(4, 4, 4, 90, 90, 90), sites={"Fe": (0, 0, 0)}, space_group="P m -3 m")
MOVED = co.spins.crystal(  # sites of the same labels as of the polar one
    lattice=(4, 5, 6, 90, 90, 90), sites={"Fe": (0.1, 0.2, 0), "Ni": (0.4, 0.7, 0.1)}, space_group="P 1 2 1"
)

TWO_KINDS = co.spins.crystal(
    lattice=(4, 5, 6, 80, 90, 90), sites={"Fe1": (0, 0, 0), "Fe2": (0.5, 0, 0), "Ni1": (0, 0.5, 0.2)}, space_group="P 1"
)


def start(model, seed=1):
    """Return random directions of the spins."""
    x = np.random.default_rng(seed).standard_normal((model.dim // 3, 3))
    return (x / np.linalg.norm(x, axis=1, keepdims=True)).ravel()


class ByHand:
    """Spins of lengths S, bond by bond and site by site, in loops over cells."""

    def __init__(self, crystal, size, periodic, S, mu):
        self.size, self.periodic, self.count = np.array(size), np.array(periodic), len(crystal.labels)
        self.S = np.array([S[label] for label in crystal.labels])
        self.mu = np.array([mu[label] for label in crystal.labels])
        self.pairs, self.on_site, self.B = [], {}, np.zeros(3)
        self.cells = list(itertools.product(*map(range, size)))

    def number(self, cell, site):
        return np.ravel_multi_index(tuple(cell), self.size) * self.count + site

    def couple(self, bond, matrices):
        for (i, j), n, J in zip(bond.sites, bond.offsets, matrices, strict=True):
            for cell in self.cells:
                other = np.where(self.periodic, (np.array(cell) + n) % self.size, np.array(cell) + n)
                if np.all((other >= 0) & (other < self.size)):
                    self.pairs.append((self.number(cell, i), self.number(other, j), self.S[i] * self.S[j] * J))

    def gradient(self, x, t=0.0):
        x, field = x.reshape(-1, 3), self.B(t) if callable(self.B) else self.B
        g = np.zeros_like(x)
        for i, j, J in self.pairs:
            g[i] += J @ x[j]
            g[j] += J.T @ x[i]
        for k in range(len(x)):
            site = k % self.count
            A = self.on_site.get(site, np.zeros((3, 3)))
            g[k] += self.S[site] ** 2 * (A + A.T) @ x[k] - self.mu[site] * field
        return g

    def rates(self, t, x, hbar=1.0):
        lengths = np.tile(self.S, len(self.cells))[:, None]
        return (np.cross(x.reshape(-1, 3), -self.gradient(x, t)) / (hbar * lengths)).ravel()


def field_in_time(t):
    return np.array([0.3 * np.cos(2 * t), 0.1, np.sin(t)])


@pytest.mark.parametrize(
    ("periodic", "units", "driven"),
    [
        (True, "natural", False),
        ((True, False, True), "meV", False),
        pytest.param(False, "natural", True, marks=pytest.mark.long),
    ],
)
def test_energies_and_motions_by_hand(periodic, units, driven):
    """Exchange, Dzyaloshinskii-Moriya, anisotropy and field of two kinds of spins, against loops and SciPy."""
    rng, size, S = np.random.default_rng(5), (3, 3, 1), {"Fe": 2.5, "Ni": 1.0}
    g = {"Fe": 2.0, "Ni": -2.3}
    flags = (periodic,) * 3 if isinstance(periodic, bool) else periodic
    hbar, mu_B = (HBAR, MU_B) if units == "meV" else (1.0, 1.0)
    hand = ByHand(POLAR, size, flags, S, {label: g[label] * S[label] * mu_B for label in S})
    model = co.systems.spins(POLAR, size, spin=S, g=g, periodic=periodic, units=units)
    bonds = [bond for bond in POLAR.bonds(5.1) if not bond.offset[2]][:4]
    for k, bond in enumerate(bonds):
        D, J = rng.normal(size=3), np.tensordot(rng.normal(size=len(bond.basis)), bond.basis, axes=1)
        model = model.exchange(bond, J)
        hand.couple(bond, bond.exchange(J))
        if k == 1:
            cross = np.array([[0, D[2], -D[1]], [-D[2], 0, D[0]], [D[1], -D[0], 0]])  # D . (S_i x S_j)
            near = sum(np.sum(M * cross) / np.sum(M * M) * M for M in bond.basis if np.all(M == -M.T))
            D = np.array([near[1, 2], near[2, 0], near[0, 1]])
            model = model.dzyaloshinskii_moriya(bond, D)
            hand.couple(bond, bond.exchange(near))
    for label in S:
        site = POLAR.site(label)
        A = np.tensordot(rng.normal(size=len(site.basis)), site.basis, axes=1)
        model = model.single_ion(label, A)
        hand.on_site |= dict(zip(site.sites.tolist(), site.single_ion(A), strict=True))
    hand.B = field_in_time if driven else np.array([0.2, -0.4, 0.7])
    model = model.field(hand.B)
    x0 = start(model)
    scale = np.abs(hand.gradient(x0)).max()
    np.testing.assert_allclose(
        model.hamiltonian.gradient(x0, 0.3).reshape(-1, 3), hand.gradient(x0, 0.3), atol=1e-14 * scale
    )
    half = [model.energy(x0 + d, 0.3) - model.energy(x0 - d, 0.3) for d in 0.5 * np.eye(len(x0))[:6]]
    np.testing.assert_allclose(half, hand.gradient(x0, 0.3).ravel()[:6], atol=1e-12 * scale)
    np.testing.assert_allclose(model.vector_field(x0, 0.3), hand.rates(0.3, x0, hbar), atol=1e-13 * scale / hbar)
    end = 0.5 * hbar
    exact = solve_ivp(lambda t, x: hand.rates(t, x, hbar), (0, end), x0, method="DOP853", rtol=1e-11, atol=1e-12).y[
        :, -1
    ]
    found = co.integrate(model, x0, (0, end), end / 50, co.GaussLegendre(3) if driven else co.Splitting(order=6)).x[-1]
    np.testing.assert_allclose(found, exact, atol=1e-7)


@pytest.mark.parametrize("each", [False, True])
def test_a_field_of_the_time_acts_on_moments_of_any_size(each):
    model = co.systems.spins(POLAR, (2, 1, 1), spin={"Fe": 2.5, "Ni": 1.0}, g={"Fe": 2.0, "Ni": -2.3}, units="meV")
    model = model.substitute("Fe", 0.5, seed=1, spin=1.0, g=1.0)
    rows = np.linspace(0.5, 2.0, len(model.sites))[:, None] if each else 1.0
    driven = model.field(lambda t: rows * np.array([0.3 * t, 0.1, np.cos(t)]))
    x, t = start(model).reshape(-1, 3), 0.7
    field = MU_B * model.moments[:, None] * rows * np.array([0.3 * t, 0.1, np.cos(t)])
    np.testing.assert_allclose(driven.energy(x.ravel(), t), -np.sum(x * field), rtol=1e-8)
    rates = np.cross(x, field) / (HBAR * model.spin[:, None])
    np.testing.assert_allclose(
        driven.vector_field(x.ravel(), t), rates.ravel(), rtol=0, atol=1e-7 * np.abs(rates).max()
    )
    assert len(set(model.moments.tolist())) == 3


LATTICES = {
    "square": ((1, 1, 9, 90, 90, 90), [(0, 0, 0)], 1.0, (4, 5, 1)),
    "triangular": ((1, 1, 9, 90, 90, 60), [(0, 0, 0)], 1.0, (4, 5, 1)),
    "cubic": ((1, 1, 1, 90, 90, 90), [(0, 0, 0)], 1.0, (3, 4, 3)),
    "kagome": ((2, 2, 9, 90, 90, 60), [(0, 0, 0), (0.5, 0, 0), (0, 0.5, 0)], 1.0, (3, 4, 1)),
}


@pytest.mark.parametrize("name", LATTICES)
@pytest.mark.parametrize("periodic", [True, False])
def test_lattices_by_name_have_the_same_bits(name, periodic):
    cell, places, length, size = LATTICES[name]
    crystal = co.spins.crystal(lattice=cell, sites={"Fe": places})
    flags = (periodic, periodic, periodic and name == "cubic")
    model = co.systems.spins(crystal, size, spin=1, g=1, periodic=flags)
    (bond,) = crystal.bonds(length)
    model = model.exchange(bond, -0.7).field((0.1, 0, 0.4))
    by_name = co.systems.spin_lattice(
        name, size if name == "cubic" else size[:2], periodic, exchange=0.7, field=(0.1, 0, 0.4)
    )
    x = start(model)
    order = np.arange(model.dim)
    np.testing.assert_array_equal(model.vector_field(x), by_name.vector_field(x[order]))
    assert model.energy(x) == by_name.energy(x) and model.integrals.keys() == by_name.integrals.keys()
    runs = [co.integrate(system, x, (0, 0.5), 0.05).x for system in (model, by_name)]
    np.testing.assert_array_equal(*runs)


def test_large_lattices_have_the_bits_of_small_rows():
    """Rows that are stored once for each shape are those of single bonds, with two kinds of spins and anisotropy."""
    rng, bonds = np.random.default_rng(3), POLAR.bonds(4.3)[:4]
    matrices = [np.tensordot(rng.normal(size=len(bond.basis)), bond.basis, axes=1) for bond in bonds]
    model = co.systems.spins(POLAR, (12, 12, 5), spin={"Fe": 2, "Ni": 1}, periodic=(True, True, False))
    for bond, J in zip(bonds, matrices, strict=True):
        model = model.exchange(bond, J)
    model = model.single_ion("Fe", np.diag([0.1, 0, -0.2])).field((0, 0, 0.3))
    hand = ByHand(POLAR, model.size, model.periodic, {"Fe": 2, "Ni": 1}, {"Fe": 4, "Ni": 2})
    for bond, J in zip(bonds, matrices, strict=True):
        hand.couple(bond, bond.exchange(J))
    site = POLAR.site("Fe")
    hand.on_site = dict(zip(site.sites.tolist(), site.single_ion(np.diag([0.1, 0, -0.2])), strict=True))
    hand.B = np.array([0, 0, 0.3])
    x = start(model)
    np.testing.assert_allclose(model.hamiltonian.gradient(x).reshape(-1, 3), hand.gradient(x), rtol=0, atol=1e-13)
    assert model.dim == 3 * 2 * len(POLAR.labels) * 360 and model.parameters is None


def test_parameters_make_the_system_again(tmp_path):
    model = co.systems.spins(POLAR, (3, 3, 1), spin={"Fe": 2, "Ni": 1}, units="meV").exchange(POLAR.bonds(4)[0], 0.4)
    model = model.single_ion("Ni", np.diag([0, -0.3, 0.1])).field((0, 0, 2.0))
    x = start(model)
    again = co.systems.get(model.name, **model.parameters)
    np.testing.assert_array_equal(again.vector_field(x), model.vector_field(x))
    hot = model.with_forces(co.forces.Gilbert(0.1, temperature=20.0, seed=1))
    whole = co.integrate(hot, x, (1, 2), 0.1)
    co.integrate(hot, x, (1, 1.5), 0.1, archive=tmp_path / "run")
    np.testing.assert_array_equal(co.resume(tmp_path / "run", 2).x[-1], whole.x[-1])
    copied = pickle.loads(pickle.dumps(hot))
    np.testing.assert_array_equal(co.integrate(copied, x, (1, 2), 0.1).x, whole.x)
    assert copied.crystal.labels == model.crystal.labels and copied.boltzmann == model.boltzmann


@pytest.mark.parametrize("scale", [1.0, 1e-7, 1e30])
def test_units(scale):
    """Fields in tesla, times in ps, temperatures in kelvin, and the natural ones of any size."""
    model = co.systems.spins(CUBE, (1, 1, 1), spin=7 / 2, g=1.9, units="meV").field((0, 0, 4.0 * scale))
    rate = 1.9 * MU_B * 4.0 / HBAR
    turned = co.integrate(model, (1.0, 0, 0), (0, 1 / scale), 0.02 / scale).x[-1]
    np.testing.assert_allclose(turned, [np.cos(rate), -np.sin(rate), 0], rtol=0, atol=1e-8)
    assert np.isclose(model.energy([0, 0, 1]), -1.9 * MU_B * 3.5 * 4 * scale, rtol=1e-8)
    natural = co.systems.spins(CUBE, (3, 3, 3), spin=2).exchange(CUBE.bonds(3)["1"], -scale).field((0, scale, 0))
    x = start(natural)
    small = co.systems.spins(CUBE, (3, 3, 3), spin=2).exchange(CUBE.bonds(3)["1"], -1.0).field((0, 1.0, 0))
    found = [co.integrate(one, x, (0, 1 / s), 0.01 / s).x[-1] for one, s in ((natural, scale), (small, 1.0))]
    np.testing.assert_allclose(*found, rtol=0, atol=1e-12)


def test_negative_g_is_the_spin_of_an_electron():
    """Its moment turns counterclockwise, as its spin, which is opposite to the field at rest."""
    B, mu = 3.0, 2.0
    electron = co.systems.spins(CUBE, (1, 1, 1), spin=1, g=-mu).field((0, 0, B))
    np.testing.assert_allclose(
        co.integrate(electron, (1.0, 0, 0), (0, 0.2), 0.01).x[-1], [np.cos(1.2), np.sin(1.2), 0], atol=1e-9
    )
    assert electron.energy([0, 0, -1]) == -mu * B and electron.moments.tolist() == [-2.0]


def test_moments_give_spins_or_g():
    by_moments = co.systems.spins(CUBE, (2, 1, 1), moments=7.63)
    assert by_moments.spin.tolist() == [3.815, 3.815] and by_moments.moments.tolist() == [7.63, 7.63]
    both = co.systems.spins(CUBE, (1, 1, 1), moments=3.0, spin=0.5, units="meV").field((0, 0, 1.0))
    assert np.isclose(both.energy([0, 0, 1]), -3 * MU_B, rtol=1e-8)
    rate = 3 * MU_B / (HBAR * 0.5)
    np.testing.assert_allclose(both.vector_field([1.0, 0, 0]), [0, -rate, 0], rtol=1e-8)


def test_temperatures_in_kelvin():
    """Thermal states and baths of the model in kelvin are those of its energies, and converted once."""
    model = co.systems.spins(CUBE, (3, 3, 1), spin=2, periodic=(True, True, False), units="meV")
    model = model.exchange(CUBE.bonds(3)["1"], -0.3).single_ion("Fe", 0.0 * np.eye(3)).field((0, 0, 1.0))
    plain = co.systems.get(model.name, **model.parameters)
    assert np.isclose(model.boltzmann, K_B, rtol=1e-8) and plain.boltzmann == 1.0
    cold = co.thermal_states(model, 8.0, members=2, sweeps=5, seed=3)
    np.testing.assert_array_equal(
        cold.x, co.thermal_states(plain, model.boltzmann * 8.0, members=2, sweeps=5, seed=3).x
    )
    for bath in (co.forces.Gilbert, co.forces.HeatBath):
        in_kelvin = model.with_forces(bath(0.2, temperature=8.0, seed=5))
        in_energies = plain.with_forces(bath(0.2, temperature=model.boltzmann * 8.0, seed=5))
        runs = [co.integrate(one, cold.x, (0, 0.4), 0.1).x for one in (in_kelvin, in_energies)]
        np.testing.assert_array_equal(*runs)
        assert model.with_forces(*in_kelvin.forces).forces == in_kelvin.forces
        warmer = in_kelvin.field((0, 0, 2.0))
        assert warmer.forces == in_kelvin.forces and warmer.energy(cold.x[0]) != model.energy(cold.x[0])
    each = model.with_forces(co.forces.Gilbert(0.2, temperature=np.linspace(1, 9, 9), seed=5))
    np.testing.assert_array_equal(each.forces[0].temperature, np.linspace(1, 9, 9))
    assert each.forces[0].boltzmann == model.boltzmann
    with refused(ValueError, "temperature", "-1"):
        co.thermal_states(model, -1.0, seed=1)


@pytest.mark.parametrize(("bath", "mode"), [("HeatBath", "vectors"), ("Gilbert", "vectors"), ("HeatBath", "SU(N)")])
def test_temperature_is_a_parameter_in_kelvin(bath, mode):
    """Derivatives by the temperature are those by the kelvin that were given, of single runs and of batches."""
    kwargs = {} if mode == "vectors" else {"mode": mode}
    plain = co.systems.spins(CUBE, (2, 1, 1), spin=1, periodic=False, units="meV", **kwargs).field((0.5, 0, 2.0))

    def forced(T):
        return plain.with_forces(getattr(co.forces, bath)(0.1, temperature=T, seed=5))

    def ready(*kelvin):
        systems = [forced(T) for T in kelvin]
        return co.prepare(co.batch(systems) if len(systems) > 1 else systems[0], co.Splitting(), step=0.05)

    x = co.thermal_states(plain, 5.0, sweeps=2, seed=1).x[0]
    name, e = f"{bath}.temperature", 1e-3
    assert ready(10.0).parameters[name] == 10.0
    assert ready(10.0, 20.0).parameters[name].tolist() == [10.0, 20.0]
    _, tangents = ready(10.0).jvp(x, (0, 0.5), {name: 1.0})
    ends = [ready(10.0 + by).run(x, (0, 0.5)).x[-1] for by in (e, -e)]
    slope = (ends[0] - ends[1]) / (2 * e)
    np.testing.assert_allclose(tangents.x[-1], slope, rtol=1e-6, atol=1e-6 * np.abs(slope).max())
    both = ready(10.0, 20.0).run([x, x], (0, 0.5)).x[-1]
    np.testing.assert_array_equal(both[0], ready(10.0).run(x, (0, 0.5)).x[-1])


def test_sublattices_of_different_moments_equilibrate():
    """Two uncoupled moments in a bath have Langevin's means of their own energies, in kelvin and tesla."""
    pair = co.spins.crystal(lattice=(3, 3, 6, 90, 90, 90), sites={"Fe": (0, 0, 0), "Gd": (0, 0, 0.5)})
    mu, T, B = {"Fe": 2.2, "Gd": 7.63}, 4.0, 3.0
    model = co.systems.spins(pair, (1, 1, 1), moments=mu, units="meV").field((0, 0, B))
    states = co.thermal_states(model, T, members=4000, sweeps=2, seed=1).x
    for k, moment in enumerate(mu.values()):
        a = moment * MU_B * B / (K_B * T)
        langevin, spread = 1 / np.tanh(a) - 1 / a, np.sqrt(1 / 3 / 4000)
        assert abs(states[:, 3 * k + 2].mean() - langevin) < 4 * spread


@pytest.mark.parametrize("dipolar", [False, True])
def test_vacancies_are_spins_of_no_length(dipolar):
    full = co.systems.spins(POLAR, (3, 2, 2), spin={"Fe": 2, "Ni": 1}, periodic=False)
    full = full.exchange(POLAR.bonds(4)[0], 0.4).single_ion("Ni", np.diag([0, -0.3, 0.1])).field((0.2, 0, 1.0))
    full = full.dipolar() if dipolar else full
    part = full.vacancies({"Ni": 0.25, "Fe": 0.5}, seed=2)
    assert part.dim == 3 * (24 * 0.75 + 24 * 0.5)
    cell = np.ravel_multi_index(part.cells.T, part.size) * len(POLAR.labels) + part.sites
    np.testing.assert_allclose(part.positions, full.positions[cell], atol=1e-14)
    x, whole = start(part), np.zeros((full.dim // 3, 3))
    whole[cell] = x.reshape(-1, 3)
    np.testing.assert_allclose(part.energy(x), full.energy(whole.ravel()), rtol=1e-12)
    gradient = full.hamiltonian.gradient(whole.ravel()).reshape(-1, 3)[cell]
    np.testing.assert_allclose(part.hamiltonian.gradient(x).reshape(-1, 3), gradient, atol=1e-13)
    np.testing.assert_array_equal(part.cells, full.vacancies({"Ni": 0.25, "Fe": 0.5}, seed=2).cells)
    assert not np.array_equal(part.cells, full.vacancies({"Ni": 0.25, "Fe": 0.5}, seed=3).cells)


@pytest.mark.parametrize("dipolar", [False, True])
def test_substituted_ions_are_spins_of_other_lengths(dipolar):
    """Energies are those of the model of equal ions, whose vectors have the ratios of the lengths and moments."""
    native = co.systems.spins(POLAR, (2, 2, 3), spin={"Fe": 2, "Ni": 1}, periodic=False)
    native = native.exchange(POLAR.bonds(4)[0], 0.4).exchange(POLAR.bonds(4)[1], -0.7)
    native = native.single_ion("Ni", np.diag([0, -0.3, 0.1])).field((0.2, 0, 1.0))
    native = native.dipolar() if dipolar else native
    alloy = native.substitute("Ni", 0.5, seed=2, spin=1.5).substitute("Fe", 0.25, seed=3, spin=0.5)
    ratio = alloy.spin / native.spin
    assert sorted(set(ratio.tolist())) == [0.25, 1.0, 1.5] and np.sum(ratio == 1.5) == 12 and np.sum(ratio == 0.25) == 6
    x = start(native)
    scaled = (x.reshape(-1, 3) * ratio[:, None]).ravel()
    np.testing.assert_allclose(alloy.energy(x), native.energy(scaled), rtol=1e-12)
    gradient = native.hamiltonian.gradient(scaled).reshape(-1, 3) * ratio[:, None]
    np.testing.assert_allclose(alloy.hamiltonian.gradient(x).reshape(-1, 3), gradient, atol=1e-13)
    np.testing.assert_allclose(
        alloy.hamiltonian.hessian(x) @ x, gradient.ravel() - alloy.hamiltonian.gradient(0 * x), atol=1e-12
    )
    part = alloy.vacancies(0.3, seed=5)  # in both orders
    again = native.vacancies(0.3, seed=5).substitute("Ni", 0.5, seed=2, spin=1.5)
    np.testing.assert_array_equal(part.cells, again.cells)
    kept = np.ravel_multi_index(part.cells.T, part.size) * len(POLAR.labels) + part.sites
    np.testing.assert_array_equal(part.spin, alloy.spin[kept])
    whole = np.zeros((native.dim // 3, 3))
    whole[kept] = start(part).reshape(-1, 3)
    np.testing.assert_allclose(part.energy(start(part)), alloy.energy(whole.ravel()), rtol=1e-12)


def test_the_g_of_substituted_ions():
    alloy = co.systems.spins(CUBE, (4, 1, 1), spin=2, units="meV").substitute("Fe", 0.5, seed=1, spin=3, g=1.5)
    alloy = alloy.field((0, 0, 2.0))
    up = np.tile([0.0, 0, 1], 4)
    assert np.isclose(alloy.energy(up), -2.0 * MU_B * (2 * 2 * 2 + 2 * 3 * 1.5), rtol=1e-8)
    rates = alloy.vector_field(np.tile([1.0, 0, 0], 4))[1::3]
    np.testing.assert_allclose(rates, np.where(alloy.spin == 3, -1.5, -2.0) * 2.0 * MU_B / HBAR, rtol=1e-8)
    assert "2 of Fe: S = 3, moment 4.5 mu_B" in str(alloy)


@pytest.mark.parametrize("g", [1.5, -0.5])
def test_dipoles_of_substituted_ions_have_their_g(g):
    pair = co.systems.spins(CUBE, (1, 1, 2), spin=2, periodic=False).dipolar()
    alloy = pair.substitute("Fe", 0.5, seed=1, spin=3, g=g)
    assert sorted(alloy.moments.tolist()) == sorted([4.0, 3 * g])
    np.testing.assert_allclose(alloy.energy([0, 0, 1] * 2), -2 * 4 * 3 * g / 27, rtol=1e-12)  # mu mu'/r^3, r = 3
    np.testing.assert_allclose(alloy.hamiltonian.hessian(np.zeros(6))[0, 3], 4 * 3 * g / 27, rtol=1e-12)


def test_elements_of_one_label_stand_for_it():
    model, A = co.systems.spins(TWO_KINDS, (3, 3, 3)), np.diag([0.1, 0.2, -0.4])
    x = start(model)
    assert TWO_KINDS.site("Ni").number == TWO_KINDS.site("Ni1").number == 2 and TWO_KINDS.site("Fe2").number == 1
    assert model.single_ion("Ni", A).energy(x) == model.single_ion("Ni1", A).energy(x) != model.energy(x)
    for name in ("Ni", "Ni1"):
        assert np.bincount(model.vacancies({name: 1 / 3}, seed=1).sites).tolist() == [27, 27, 18]
        alloy = model.substitute(name, 1 / 3, seed=1, spin=2)
        assert np.bincount(alloy.sites, alloy.spin).tolist() == [27, 27, 36]
        assert "9 of Ni1: S = 2" in str(alloy)


def test_members_and_batches():
    bond = CUBE.bonds(3)["1"]
    models = [co.systems.spins(CUBE, (3, 3, 1), periodic=(True, True, False)).exchange(bond, J) for J in (0.3, -0.8)]
    x = start(models[0])
    runs = co.integrate(co.batch(models), x, (2, 1.5), 0.05)
    for member, model in enumerate(models):
        np.testing.assert_array_equal(runs.x[:, member], co.integrate(model, x, (2, 1.5), 0.05).x)


def test_derivatives_by_exchange_constants():
    """Of a run, by the exchange of one kind of bonds: its matrices of all edges are parameters of the system."""
    S, bonds = 1.5, CUBE.bonds(4.3)

    def model(J):
        flat = co.systems.spins(CUBE, (3, 3, 1), spin=S, periodic=(True, True, False))
        return flat.exchange(bonds["1"], J).exchange(bonds["2"], 0.2).field((0, 0.3, 0.5))

    x, span, method, h = start(model(0.5)), (0, 0.5), co.Splitting(order=6), 1e-4
    direction = np.zeros((36, 3, 3))
    direction[:18] = S**2 * np.eye(3)  # bonds 1 are the first edges, two for each of nine sites
    found = co.prepare(model(0.5), method, step=0.02).jvp(x, span, {"tensor": direction})[1].x[-1]
    up, down = (co.integrate(model(0.5 + s * h), x, span, 0.02, method).x[-1] for s in (1, -1))
    np.testing.assert_allclose(found, (up - down) / (2 * h), atol=1e-6)
    assert np.abs(found).max() > 0.1


@pytest.mark.parametrize(("size", "a"), [((1, 1, 1), 3.0), ((2, 3, 5), 3.0), ((2, 1, 1), 3e-10), ((1, 2, 2), 3e30)])
def test_dipoles_in_a_periodic_cube(size, a):
    """Parallel dipoles of a cubic crystal have the field mu0 M/3: an energy of -1/6 mu0 mu^2/V each."""
    cube = co.spins.crystal(lattice=(a, a, a, 90, 90, 90), sites={"Fe": (0, 0, 0)}, space_group="P m -3 m")
    model = co.systems.spins(cube, size, spin=2, g=1.5).dipolar()
    x = np.tile([0.36, 0.48, 0.8], model.dim // 3)
    each = model.energy(x) / (model.dim / 3) / (4 * np.pi * 3.0**2 / a**3)  # mu0 = 4 pi, moments 3
    assert abs(each + 1 / 6) < 1e-13


def test_dipoles_do_not_depend_on_the_supercell():
    """Cells of a crystal, and the same atoms as one cell, with moments of two kinds."""
    lattice = np.array([[3.0, 0, 0], [0.4, 4.0, 0], [-0.3, 0.5, 5.0]])
    places = {"Fe": np.array([0, 0, 0]), "Ni": np.array([0.3, 0.45, 0.6])}
    small = co.spins.crystal(lattice=lattice, sites=places, space_group="P 1")
    size, shifts = (2, 1, 3), list(itertools.product(range(2), range(1), range(3)))
    large = co.spins.crystal(
        lattice=lattice * np.array(size)[:, None],
        sites={label: [(place + shift) / size for shift in shifts] for label, place in places.items()},
        space_group="P 1",
    )
    mu = {"Fe": 1.0, "Ni": 2.5}
    one, other = (co.systems.spins(c, n, moments=mu).dipolar() for c, n in ((small, size), (large, (1, 1, 1))))
    x = start(one)
    order = np.array([[2 * k, 2 * k + 1] for k in range(6)]).T.ravel()  # of spins of the large cell in the small ones
    y = x.reshape(-1, 3)[order].ravel()
    np.testing.assert_allclose(one.energy(x), other.energy(y), rtol=1e-13)
    gradient = one.hamiltonian.gradient(x)
    np.testing.assert_allclose(gradient.reshape(-1, 3)[order].ravel(), other.hamiltonian.gradient(y), atol=1e-13)
    np.testing.assert_allclose(one.hamiltonian.hessian(x) @ x, gradient, atol=1e-13)


def test_periodic_dipoles_are_the_sum_over_images():
    """Of cells without a moment, whose sum over growing spheres converges, here to 1e-5 of single terms."""
    lattice = np.array([[3.0, 0, 0], [0, 3.5, 0], [0.5, 0, 4.0]])
    crystal = co.spins.crystal(lattice=lattice, sites={"Fe": [(0, 0, 0), (0.4, 0.5, 0.55)]}, space_group="P 1")
    model = co.systems.spins(crystal, (1, 1, 1), g=1).dipolar()
    images = np.array(list(itertools.product(range(-14, 15), repeat=3))) @ lattice
    images = images[np.linalg.norm(images, axis=1) < 40]
    for up in ((0.6, 0, 0.8), (0, 1, 0), (0, 0.6, -0.8)):
        x, total = np.array([up, np.negative(up)]), 0.0
        for i, j in itertools.product(range(2), repeat=2):
            r = images + (crystal.positions[i] - crystal.positions[j]) @ lattice
            d = np.linalg.norm(r, axis=1)
            r, d = r[d > 0], d[d > 0]
            total += 0.5 * np.sum(x[i] @ x[j] / d**3 - 3 * (r @ x[i]) * (r @ x[j]) / d**5)
        assert abs(model.energy(x.ravel()) - total) < 1e-5


def test_open_dipoles_in_their_units():
    """Two moments at a distance in angstroms, in meV; along the bond they attract, across it they repel."""
    pair = co.systems.spins(CUBE, (1, 1, 2), moments=2.5, periodic=False, units="meV").dipolar()
    mu0, joule = physical_constants["vacuum mag. permeability"][0], physical_constants["electron volt"][0]
    strength = mu0 / (4 * np.pi) * (2.5 * physical_constants["Bohr magneton"][0]) ** 2 / 27e-30 / joule * 1e3
    np.testing.assert_allclose(pair.energy([0, 0, 1] * 2), -2 * strength, rtol=1e-8)
    np.testing.assert_allclose(pair.energy([1, 0, 0] * 2), strength, rtol=1e-8)
    states = co.thermal_states(pair, 0.5, sweeps=2, seed=1).x[0]
    assert co.integrate(pair, states, (0, 1), 0.02, co.GaussLegendre(1)).drift()["energy"] < 1e-13


def test_sites_of_equal_energy():
    """Single-ion matrices are kept by the symmetry of the crystal, in space: as the energies of turned sites."""
    site = POLAR.site("Fe")
    A = np.tensordot(np.random.default_rng(2).normal(size=len(site.basis)), site.basis, axes=1)
    matrices, L = site.single_ion(A), POLAR.lattice.T
    assert len(site.sites) == 2 and len(site.basis) == 6
    for W, w in zip(POLAR.rotations, POLAR.translations, strict=True):
        R = L @ W @ np.linalg.inv(L)
        for place, number in enumerate(site.sites.tolist()):
            gap = POLAR.positions - (W @ POLAR.positions[number] + w)
            (image,) = np.flatnonzero(np.abs(gap - np.round(gap)).max(axis=1) < 1e-9)
            np.testing.assert_allclose(
                matrices[site.sites.tolist().index(image)], R @ matrices[place] @ R.T, atol=1e-13
            )


@pytest.mark.parametrize(
    ("words", "call"),
    [
        (("another crystal",), lambda m: m.exchange(POLAR.bonds(4)[0], 1.0)),
        (("another crystal",), lambda m: m.exchange(WIDER.bonds(4)[0], 1.0)),
        (
            ("another crystal",),
            lambda m: co.systems.spins(POLAR, (3, 3, 3)).exchange(
                next(bond for bond in MOVED.bonds(5) if len(set(bond.kinds)) == 2), 1.0
            ),
        ),
        (("bonds(",), lambda m: m.exchange("1", 1.0)),
        (("exchange", "bond 1", "sum"), lambda m: m.exchange(CUBE.bonds(3)[0], 1.0).exchange(CUBE.bonds(3)[0], 1.0)),
        (("not allowed", "A"), lambda m: m.exchange(CUBE.bonds(3)[0], np.diag([1.0, 2.0, 3.0]))),
        (("not allowed",), lambda m: m.dzyaloshinskii_moriya(CUBE.bonds(3)[0], (0, 0, 1.0))),
        (("(3,)",), lambda m: m.dzyaloshinskii_moriya(CUBE.bonds(3)[0], 1.0)),
        (("not allowed", "A  0  0".split()[0]), lambda m: m.single_ion("Fe", np.diag([0, 0, -1.0]))),
        (("Fe", "Co"), lambda m: m.single_ion("Co", np.eye(3))),
        (("sum",), lambda m: m.single_ion("Fe", np.eye(3)).single_ion(0, np.eye(3))),
        (("(64, 3)",), lambda m: m.field((1.0, 2.0))),
        (("once",), lambda m: m.dipolar().dipolar()),
        (("fraction", "1.0"), lambda m: m.vacancies(1.0, seed=1)),
        (("one call",), lambda m: m.vacancies(0.1, seed=1).vacancies(0.1, seed=2)),
        (("Ni",), lambda m: m.vacancies({"Ni": 0.1}, seed=1)),
        (("Ni",), lambda m: m.substitute("Ni", 0.1, seed=1, spin=1)),
        (("label", "Fe1, Fe2"), lambda m: co.systems.spins(TWO_KINDS, (4, 4, 4)).vacancies({"Fe": 0.1}, seed=1)),
        (("label", "Fe1, Fe2"), lambda m: co.systems.spins(TWO_KINDS, (4, 4, 4)).substitute("Fe", 0, seed=1, spin=1)),
        (("site", "Fe1, Fe2"), lambda m: TWO_KINDS.site("Fe")),
        (("Ni1", "element"), lambda m: co.systems.spins(TWO_KINDS, (2, 1, 1)).vacancies({"Ni": 0, "Ni1": 0}, seed=1)),
        (("spin",), lambda m: m.substitute("Fe", 0.1, seed=1, spin=0.0)),
        (("g is 0",), lambda m: m.substitute("Fe", 0.1, seed=1, spin=1, g=0)),
        (("large", "units"), lambda m: m.field((0, 0, 1e150))),
        (
            ("twice", "2 x 4 x 4", "3 cells", "along a"),
            lambda m: co.systems.spins(CUBE, (2, 4, 4)).exchange(CUBE.bonds(3)[0], 1.0),
        ),
        (("itself", "1 x 4 x 4"), lambda m: co.systems.spins(CUBE, (1, 4, 4)).exchange(CUBE.bonds(3)[0], 1.0)),
        (("size", "3 whole"), lambda m: co.systems.spins(CUBE, (4, 4))),
        (("crystal",), lambda m: co.systems.spins("FeI2.cif", (4, 4, 4))),
        (("units", "meV"), lambda m: co.systems.spins(CUBE, (4, 4, 4), units="eV")),
        (("two of them",), lambda m: co.systems.spins(CUBE, (4, 4, 4), spin=1, g=2, moments=3)),
        (("positive",), lambda m: co.systems.spins(CUBE, (4, 4, 4), spin=-1.0)),
        (("zero",), lambda m: co.systems.spins(CUBE, (4, 4, 4), g=0.0)),
        (("Ni", "label"), lambda m: co.systems.spins(POLAR, (4, 4, 4), spin={"Fe": 1.0})),
        (
            ("periodic", "two axes"),
            lambda m: co.systems.spins(CUBE, (4, 4, 4), periodic=(True, False, False)).dipolar(),
        ),
    ],
)
def test_what_is_refused(words, call):
    model = co.systems.spins(CUBE, (4, 4, 4))
    with refused((ValueError, TypeError), *words):
        call(model)


def test_different_bonds_that_meet_in_a_small_lattice():
    bonds = CUBE.bonds(6)
    model = co.systems.spins(CUBE, (3, 3, 3)).exchange(bonds["1"], 1.0)
    with refused(ValueError, "twice", "3 x 3 x 3"):
        model.exchange(bonds["4"], 1.0)
    open_ends = co.systems.spins(CUBE, (1, 1, 2), periodic=False).exchange(bonds["4"], 1.0)
    assert open_ends.energy([0, 0, 1] * 2) == 0.0  # the bond is longer than the lattice
    assert "antiferromagnetic" in str(model) and "ferromagnetic" in str(model.field((0, 0, 1)))


def test_memory_of_bonds_of_two_lengths():
    """While seven bonds of each site are made, a site costs at most half a kilobyte; what remains is less than 0.2."""
    sites = {"Fe": (0, 0, 0), "Co": (0.5, 0.5, 0.5)}
    crystal = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites=sites, space_group="P m -3 m")
    near, *far = crystal.bonds(max_distance=1.0)
    model = co.systems.spins(crystal, (36, 36, 36)).exchange(near, 1.0).exchange(far[0], 0.5)
    count = model.dim // 3
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    finished = model.exchange(far[1], 0.5)
    now, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (peak - before) / count < 500 and (now - before) / count < 200
    up = np.tile([0.0, 0.0, 1.0], count)
    assert abs(finished.energy(up) / count - (4 * 1.0 + 3 * 0.5)) < 1e-12


def test_baths_in_kelvin_are_described_again(tmp_path):
    """A bath in kelvin, made from its parameters or read from an archive, runs with the same bits."""
    model = co.systems.spins(CUBE, (2, 1, 1), spin=1, periodic=False, units="meV").field((0, 0, 2.0))
    plain, x = co.systems.get(model.name, **model.parameters), np.tile([0.0, 0.6, 0.8], 2)
    for bath in (co.forces.HeatBath, co.forces.Gilbert):
        one = model.with_forces(bath(0.1, temperature=10.0, seed=5))
        again = co.forces.get(bath.__name__, **one.forces[0].parameters())
        runs = [co.integrate(s, x, (0, 0.5), 0.1).x for s in (one, plain.with_forces(again))]
        np.testing.assert_array_equal(*runs)
        co.integrate(one, x, (0, 0.5), 0.1, archive=tmp_path / bath.__name__)
        stored = co.open_archive(tmp_path / bath.__name__).system
        assert stored.forces == one.forces
        np.testing.assert_array_equal(co.integrate(stored, x, (0, 0.5), 0.1).x, runs[0])


def test_missing_parameters_of_batches_say_why():
    """A batch names the member whose noise vanishes, or whose value has no derivative."""
    model, Gilbert = co.systems.spin_lattice("ring", 4, field=(0, 0.1, 0.4)), co.forces.Gilbert
    with refused(ValueError, "member 1", "Gilbert", "no noise", "temperature is 0"):
        co.batch([model.with_forces(Gilbert(0.1, temperature=T, seed=1)) for T in (0.1, 0.0)])
    x = np.tile([0.0, 0.6, 0.8], 4)
    for alpha, told in ((0.0, "limit"), ([0.1] * 4, "shape")):
        batch = co.batch([model.with_forces(Gilbert(a)) for a in (0.1, alpha)])
        ready = co.prepare(batch, co.Splitting(), step=0.05)
        with refused(ValueError, "Gilbert.alpha of member 1", told):
            ready.jvp([x, x], (0, 1), {"Gilbert.alpha": [1.0, 1.0]})
