"""Small motions about magnetic orders by wave vector, against closed forms of linear spin wave theory and runs."""

import numpy as np
import pytest
from scipy.constants import physical_constants

import coadjoint as co
from refusals import refused

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
    model, bond = chain(8)
    model = model.exchange(bond, -1.0).dzyaloshinskii_moriya(bond, (0, 0, 0.3)).field((0, 0, 1.0))
    x = np.random.default_rng(1).standard_normal((24,)) * 1e-3 + tiled(model)
    x = (x.reshape(-1, 3) / np.linalg.norm(x.reshape(-1, 3), axis=1, keepdims=True)).ravel()
    sol = co.integrate(model, x, (0, 40), 0.04, co.Splitting(order=4), save_every=5)
    S = co.spectra.structure_factor(sol, [(-1 / 2, 0, 0), (1 / 2, 0, 0)])
    modes = co.spectra.linear_modes(model, tiled(model), [(-1 / 2, 0, 0), (1 / 2, 0, 0)], points=8)
    assert np.allclose(modes.q, S.q)
    positive = S.omega > 0
    found = S.omega[positive][S.components[0][:, positive].argmax(axis=1)]
    assert np.all(np.abs(found - modes.frequencies[:, 0]) < 0.6 * (S.omega[1] - S.omega[0]))
    assert np.ptp(found - found[::-1]) > 1.0


@pytest.mark.parametrize("scale", [1.0, 1e-7, 1e30])
def test_a_square_antiferromagnet(scale):
    """E = 4 S J sqrt((1 + k)^2 - g^2), of intensity S (1 + k - g) / (2 sqrt((1 + k)^2 - g^2)) in each component."""
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
    assert np.all(modes.frequencies[modes.corners[:2]] == 0.0) and np.allclose(
        modes.frequencies[modes.corners[2]], 12**0.5
    )
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


def triangular(size=(3, 3, 1), **options):
    crystal = co.spins.crystal(lattice=(1, 1, 4, 90, 90, 120), sites={"Co": (0, 0, 0)})
    return co.systems.spins(crystal, size, **options), crystal.bonds(1)["1"]


def test_a_triangular_antiferromagnet_turns_by_120_degrees():
    """E = 3 J S sqrt((1 - g)(1 + 2 g)) at q and q +- K, of three sublattices that repeat obliquely."""
    model, bond = triangular((6, 3, 1), spin=0.5)
    model = model.exchange(bond, 1.4)
    angle = 2 * np.pi / 3 * (model.cells @ [1, 1, 0])
    state = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1).ravel()
    modes = co.spectra.linear_modes(model, state, [(0.05, 0, 0), (0.4, 0.23, 0), (0.1, 0.7, 0)], points=30)
    assert modes.spins_in_cell == 3 and modes.stable
    found = []
    for shift in (0, 1 / 3, -1 / 3):
        h, k = (modes.q[:, :2] + shift).T
        g = (COS(h) + COS(k) + COS(h + k)) / 3
        found.append(3 * 1.4 * 0.5 * np.sqrt(np.maximum(0, (1 - g) * (1 + 2 * g))))
    close(modes, found, rtol=1e-6)


def disordered(units="natural"):
    """Two spins of other lengths, anisotropic exchange, a layer with open edges, vacancies, and a field."""
    crystal = co.spins.crystal(
        lattice=(3, 4, 5, 80, 95, 105), sites={"Fe": (0.1, 0.2, 0.3), "Ni": (0.45, 0.7, 0.85)}, space_group="P 1"
    )
    model = co.systems.spins(crystal, (3, 3, 2), spin={"Fe": 2, "Ni": 0.5}, periodic=(True, True, False), units=units)
    bonds = crystal.bonds(5)
    model = model.exchange(bonds["1"], np.array([[-0.3, 0.1, 0], [-0.05, -0.4, 0.02], [0, 0, -0.2]]))
    model = model.exchange(bonds["3"], -0.2).single_ion("Fe", np.diag([0.02, 0, -0.1]))
    return model.field((0.1, 0, 1.5)).vacancies(0.2, seed=2).substitute("Fe", 0.3, seed=1, spin=1.5)


def whole_spectrum(model, state):
    """Return the frequencies of all wave vectors of the cells of a model, sorted."""
    corners = np.array(list(np.ndindex(model.size))) / model.size
    modes = co.spectra.linear_modes(model, state, corners, points=1)
    assert np.array_equal(modes.q, corners)
    return np.sort(modes.frequencies.ravel())


def test_dense_frequencies_of_models_without_symmetry():
    model = disordered()
    found = co.equilibrium(model, tiled(model))
    modes = co.spectra.linear_modes(model, found.x, [(0, 0, 0), (0.3, 0.1, 0.7)], points=3)
    assert modes.spins_in_cell == len(model.sites)
    # The only translation is none: q = 0 has all motions, and waves of layers do not depend on q across them.
    np.testing.assert_allclose(modes.frequencies[0], found.frequencies, rtol=1e-9)
    across = co.spectra.linear_modes(model, found.x, [(0.3, 0.1, 0), (0.3, 0.1, 0.5)], points=2)
    np.testing.assert_allclose(across.frequencies, across.frequencies[[0, 0, 0]], rtol=1e-9)


def test_ions_of_other_moments_and_fields_of_sites_make_the_cell_larger():
    model, bond = chain(6, spin=1.0)
    model = model.exchange(bond, -1.0)
    assert co.spectra.linear_modes(model, tiled(model), [(0, 0, 0)]).spins_in_cell == 1
    ions = model.substitute("Cu", 1 / 6, seed=1, spin=1.0, g=3.0)  # with the same motion, and another moment
    modes = co.spectra.linear_modes(ions, tiled(ions), [(0, 0, 0)], neutrons=co.spectra.Neutrons())
    assert modes.spins_in_cell == 6 and np.allclose(modes.frequencies, np.sort(2 - 2 * COS(np.arange(6) / 6)))
    # The zone centre has the mean moment in the uniform mode, and the difference in all.
    assert np.isclose(modes.intensity[:, 1:].sum(), 2 / 3 * ((5 * 4 + 9) / 6 - (13 / 6) ** 2))
    fields = np.where(np.arange(6) % 2, 0.3, 0.5)[:, None] * UP
    assert co.spectra.linear_modes(model.field(fields), tiled(model), [(0, 0, 0)]).spins_in_cell == 2


def canted(dipolar=False):
    crystal = co.spins.crystal(
        lattice=(3, 4, 5, 85, 100, 93), sites={"Mn": [(0, 0, 0), (0.4, 0.45, 0.5)]}, space_group="P 1"
    )
    model = co.systems.spins(crystal, (4, 3, 3), spin=2.5, moments={"Mn": 4.0}, units="meV")
    bonds = [bond for bond in crystal.bonds(4.6) if bond.first != bond.second]
    model = (
        model.exchange(bonds[0], 0.3)
        .exchange(bonds[1], 0.25)
        .exchange(bonds[2], [[0.2, 0, 0.01], [0, 0.2, 0.03], [-0.01, -0.03, 0.2]])
    )
    model = model.single_ion(0, np.diag([0, 0, -0.04])).single_ion(1, np.diag([0.01, 0, -0.03])).field((3.0, 1.0, 2.0))
    return model.dipolar() if dipolar else model


@pytest.mark.parametrize("dipolar", [False, True])
def test_modes_of_all_wave_vectors_are_the_small_motions_of_the_lattice(dipolar):
    """A canted antiferromagnet of two moments, with dipoles in Ewald's sum: against the dense eigenvalues."""
    model = canted(dipolar)
    start = np.where(model.sites == 0, 1.0, -1.0)[:, None] * np.array([0.1, 0.0, 1.0])
    found = co.equilibrium(model, (start / np.linalg.norm(start, axis=1, keepdims=True)).ravel())
    frequencies = whole_spectrum(model, found.x)
    repeats = len(frequencies) // len(found.frequencies)
    np.testing.assert_allclose(frequencies, np.repeat(found.frequencies, repeats), rtol=1e-7)
    assert co.spectra.linear_modes(model, found.x, [(0, 0, 0)]).spins_in_cell < len(model.sites)


def test_intensities_are_those_of_cold_runs():
    """The equal-time S of classical modes is the sum of kT / (hbar omega) times their intensities, at q and at -q."""
    model, bond = chain(8, spin=1.5)
    model = model.exchange(bond, 1.0).single_ion("Cu", np.diag([0, 0, -0.2])).dzyaloshinskii_moriya(bond, (0, 0, 0.15))
    state, kT, members = alternating(model), 0.004, 60
    states = co.thermal_states(model, temperature=kT, members=members, sweeps=300, seed=5, x0=state)
    sol = co.integrate(model, states.x, (0, 40), 0.05, co.Splitting(order=4), save_every=10)
    S = co.spectra.structure_factor(sol, [(-1, 0, 0), (1, 0, 0)])
    modes = co.spectra.linear_modes(model, state, [(-1, 0, 0), (1, 0, 0)], points=16)
    assert np.allclose(modes.q, S.q)
    each = kT * modes.components / modes.frequencies
    expected = (each + each[:, ::-1]).sum(axis=2)[:2]
    found = S.components[:2].sum(axis=2) * (S.omega[1] - S.omega[0])
    assert np.all(np.abs(found / expected - 1) < 5 / np.sqrt(2 * members))
    # The lines of the run are at the frequencies of the modes.
    positive = S.omega > 0
    peaks = S.omega[positive][S.components[0][:, positive].argmax(axis=1)]
    width = S.omega[1] - S.omega[0]
    assert np.all(np.min(np.abs(peaks[:, None] - modes.frequencies), axis=1) < 1.5 * width)


def test_manganese_fluoride_from_its_structure_file():
    """hbar omega = S sqrt((8 J + 2 D)^2 - (8 J cos(pi h) cos(pi k) cos(pi l))^2) -+ g mu_B B."""
    mn = co.spins.crystal(co.spins.structure("MnF2")).subcrystal("Mn")
    J, D, B, g = 0.304, 0.019, 3.0, 2.0
    model = co.systems.spins(mn, (3, 3, 3), spin=5 / 2, units="meV").exchange(mn.bonds(4)["2"], J)
    model = model.single_ion("Mn", np.diag([0, 0, -D])).field((0, 0, B))
    state = (np.where(model.sites == 0, 1.0, -1.0)[:, None] * UP).ravel()
    modes = co.spectra.linear_modes(model, state, [(1, 0, 0), (1.5, 0.2, 0.3), (0, 0, 0.7)])
    product = np.cos(np.pi * modes.q).prod(axis=1)
    wave = 2.5 * np.sqrt((8 * J + 2 * D) ** 2 - (8 * J * product) ** 2)
    shift = g * physical_constants["Bohr magneton in eV/T"][0] * 1e3 * B
    close(modes, [wave - shift, wave + shift], rtol=1e-9)


def test_unstable_orders_are_named():
    model, bond = chain(6)
    model = model.exchange(bond, 1.0).single_ion("Cu", np.diag([0, 0, 0.5]))
    modes = co.spectra.linear_modes(model, alternating(model), [(0, 0, 0), (1, 0, 0)], points=40)
    k, g = -0.5, COS(modes.q[:, 0])
    square = 4 * (1 + k) ** 2 - 4 * g**2
    np.testing.assert_allclose(modes.growth[:, 0], np.sqrt(np.maximum(0, -square)), rtol=1e-8, atol=1e-7)
    np.testing.assert_allclose(modes.frequencies[:, 0], np.sqrt(np.maximum(0, square)), rtol=1e-8, atol=1e-7)
    assert not modes.stable and "unstable, growth 1.732 at q = [0.0, 0.0, 0.0]" in repr(modes)
    assert np.all(np.isnan(modes.intensity) == (modes.growth > 0))
    # A maximum of the energy: the same motions, whose quanta lower the energy.
    top = co.spectra.linear_modes(model, tiled(model), [(0, 0, 0), (1, 0, 0)], points=7)
    assert top.stable and np.all(top.frequencies <= 0) and np.allclose(top.intensity, 1.0)
    close(top, [-2 * (1 - COS(top.q[:, 0])) - 1.0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_stable_saddles_have_quanta_of_both_signs(sign):
    """Spins along and against a field, with a weak coupling: one mode raises the energy, the other lowers it."""
    crystal = co.spins.crystal(
        lattice=(1, 2, 2, 90, 90, 90), sites={"A": (0, 0, 0), "B": (0.5, 0, 0)}, space_group="P 1"
    )
    J, along, b = 0.1, 0.3, 2.0
    model = co.systems.spins(crystal, (3, 1, 1), g=b).exchange(crystal.bonds(0.6)["1a"], np.diag([J, J, along]))
    state = (np.where(model.sites == 0, 1.0, -1.0)[:, None] * UP).ravel()
    modes = co.spectra.linear_modes(model.field((0, 0, sign)), state, [(0, 0, 0), (1, 0.3, 0)], points=9)
    root = np.sqrt(along**2 - J**2) + 0 * modes.q[:, 0]
    assert modes.stable
    close(modes, [root - b, root + b], rtol=1e-9)
    expected = (along - J * np.cos(np.pi * modes.q[:, 0])) / (2 * root)
    np.testing.assert_allclose(modes.components[:2].sum(axis=2), [expected] * 2, rtol=1e-9)


LINE = co.spins.crystal(lattice=(1, 3, 3, 90, 90, 90), sites={"Cu": (0, 0, 0)}, space_group="P m m m")


@pytest.mark.parametrize("whole_turns", [0, 1])
def test_helix_of_any_period_by_twisted_boundaries(whole_turns):
    """omega = S sqrt((J(q) - J(Q)) ((J(q + Q) + J(q - Q)) / 2 - J(Q))) in frames that turn, seen at q and q -+ Q."""
    J1, J2, S = -1.0, 0.4, 1.5
    Q = np.arccos(-J1 / (4 * J2))
    first, second = LINE.bonds(2)
    twist = (5 * Q - 2 * np.pi * whole_turns, 0, 0)
    chain = co.systems.spins(LINE, (5, 1, 1), periodic=(True, False, False), spin=S, twist=twist)
    chain = chain.exchange(first, J1).exchange(second, J2)
    turn = Q * np.arange(5)
    helix = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1).ravel()
    modes = co.spectra.linear_modes(chain, helix, [(0, 0, 0), (1, 0, 0)], points=20)

    def J(q):
        return 2 * J1 * np.cos(q) + 2 * J2 * np.cos(2 * q)

    def omega(q):
        return S * np.sqrt(np.maximum(0, (J(q) - J(Q)) * (0.5 * (J(q + Q) + J(q - Q)) - J(Q))))

    k = 2 * np.pi * modes.q[:, :1]
    expected = np.sort(np.concatenate([omega(k), omega(k - Q), omega(k + Q)], axis=1), axis=1)
    np.testing.assert_allclose(modes.frequencies, expected, atol=1e-12)
    assert modes.stable and modes.spins_in_cell == 1
    assert modes.plot().axes[0].get_ylabel()


def cone(cells, **twisted):
    """Return a model of two sites in a cell, with a cone about an axis in general position."""
    crystal = co.spins.crystal(
        lattice=(2, 3, 3.5, 90, 80, 90), sites={"Cu": (0, 0.1, 0), "Ni": (0.4, 0, 0.2)}, space_group="P 1"
    )
    axis = np.array([0.0, 0.6, 0.8])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    model = co.systems.spins(
        crystal, (cells, 1, 1), spin=[1.0, 1.5], periodic=(True, False, False), axis=axis, **twisted
    )
    for bond in crystal.bonds(4.01):
        if bond.offset == (0, 0, 0):
            model = model.exchange(bond, -0.3)
        elif bond.first == bond.second and bond.offset[1:] == (0, 0):
            J = np.eye(3) + 0.1 * cross if abs(bond.offset[0]) == 1 else -0.25 / np.cos(0.8 * np.pi) * np.eye(3)
            model = model.exchange(bond, J)
    for site in (0, 1):
        model = model.single_ion(site, 0.3 * np.outer(axis, axis))
    return model.field(0.4 * axis), axis


@pytest.mark.parametrize("neutrons", [None, co.spectra.Neutrons(temperature=3.0), co.spectra.Neutrons()])
def test_twisted_cones_have_the_spectra_of_whole_periods(neutrons):
    """Two turns in five cells, and a twist of six."""
    whole, axis = cone(5)
    turn = 0.8 * np.pi * (whole.cells[:, :1] + 0.4 * whole.sites[:, None])
    start = np.cos(turn) * [1, 0, 0] + np.sin(turn) * np.cross(axis, (1, 0, 0)) + 0.1 * axis
    x = co.equilibrium(whole, (start / np.linalg.norm(start, axis=1, keepdims=True)).ravel()).x
    twisted, _ = cone(6, twist=(6 * 0.8 * np.pi, 0, 0))
    path, energies = [(0.1, 0, 0), (1.3, 0.7, 0.2)], np.linspace(-0.5, 12, 200)
    found, expected = (
        co.spectra.linear_modes(one, state, path, points=12, neutrons=neutrons)
        for one, state in ((twisted, np.concatenate([x, x[:6]])), (whole, x))
    )
    assert found.spins_in_cell == 2 and expected.spins_in_cell == 10
    S, T = (modes.spectrum(energies, 0.3) for modes in (found, expected))
    for one, other in ((S.intensity, T.intensity), (S.components, T.components)):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6 * other.max())


def test_half_turns_of_twisted_boundaries_are_refused():
    chain = co.systems.spins(LINE, (4, 1, 1), periodic=(True, False, False), twist=(np.pi, 0, 0))
    with refused(ValueError, "half turns"):
        co.spectra.linear_modes(chain.exchange(LINE.bonds(1)["1"], -1.0), [0, 0, 1] * 4, [(0, 0, 0), (1, 0, 0)])
    turned = co.systems.spins(LINE, (4, 1, 1), periodic=(True, False, False), twist=(2 * np.pi, 0, 0))
    modes = co.spectra.linear_modes(
        turned.exchange(LINE.bonds(1)["1"], -1.0), [0, 0, 1] * 4, [(0, 0, 0), (1, 0, 0)], points=4
    )
    np.testing.assert_allclose(modes.frequencies[:, 0], [0, 2, 4, 2, 0], atol=1e-12)
