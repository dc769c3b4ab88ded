"""Models of SU(N): against Schroedinger's equation, exact thermal averages, generalized spin waves, and dipoles."""

import importlib.util
import itertools

import numpy as np
import pytest
from scipy.constants import physical_constants
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import coadjoint as co
from refusals import refused

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec(name) is None, reason=f"{name} is not installed")
    for name in ("gemmi", "spglib")
]

HBAR = physical_constants["reduced Planck constant in eV s"][0] * 1e15  # meV ps
MU_B = physical_constants["Bohr magneton in eV/T"][0] * 1e3  # meV/T
K_B = physical_constants["Boltzmann constant in eV/K"][0] * 1e3  # meV/K
ION = co.spins.crystal(lattice=(1, 1, 2, 90, 90, 90), sites={"Fe": (0, 0, 0)})
CUBE = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
CHAIN = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Ni": (0, 0, 0)}, space_group="P 1")
LOW = co.spins.crystal(lattice=(3, 4, 5, 80, 95, 90), sites={"A": (0.1, 0, 0), "B": (0.4, 0.5, 0.2)}, space_group="P 1")
UP = np.array([0.0, 0.0, 1.0])


def spin_matrices(S):
    """Return Sx, Sy, Sz from the text book."""
    m = S - np.arange(round(2 * S + 1))
    up = np.diag(np.sqrt(S * (S + 1) - m[1:] * (m[1:] + 1)), 1)
    return np.array([(up + up.T) / 2, (up - up.T) / 2j, np.diag(m)])


def hermitian(rng, n):
    A = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
    return A + A.conj().T


class Schroedinger:
    """Product states: i hbar Z_i' = (A_i + <P_ij>_j) Z_i, with pair operators of all bonds."""

    def __init__(self, model, S, g, hbar, mu_B):
        self.S, self.N, self.hbar, self.moment = spin_matrices(S), round(2 * S + 1), hbar, g * mu_B
        self.model, self.count = model, len(model.sites)
        self.on_site = np.zeros((self.count, self.N, self.N), dtype=complex)
        self.pairs, self.B = [], lambda t: np.zeros(3)

    def couple(self, bond, operator):
        cells, sites, size = self.model.cells, self.model.sites, np.array(self.model.size)
        for a in range(self.count):
            if sites[a] != bond.first:
                continue
            other = cells[a] + bond.offset
            other = np.where(self.model.periodic, other % size, other)
            b = np.flatnonzero(np.all(cells == other, axis=1) & (sites == bond.second))
            self.pairs += [(a, int(k), operator.reshape([self.N] * 4)) for k in b]

    def matrices(self, t, Z):
        h = self.on_site - self.moment * np.einsum("k,kab->ab", self.B(t), self.S)
        for i, j, P in self.pairs:
            h[i] += np.einsum("b,abcd,d->ac", Z[j].conj(), P, Z[j])
            h[j] += np.einsum("a,abcd,c->bd", Z[i].conj(), P, Z[i])
        return h

    def energy(self, t, Z):
        single = self.on_site - self.moment * np.einsum("k,kab->ab", self.B(t), self.S)
        total = np.einsum("ia,iab,ib", Z.conj(), single, Z).real
        return total + sum(
            np.einsum("a,b,abcd,c,d", Z[i].conj(), Z[j].conj(), P, Z[i], Z[j]).real for i, j, P in self.pairs
        )

    def run(self, Z, span):
        def field(t, y):
            Z = y.reshape(self.count, self.N)
            return (-1j / self.hbar * np.einsum("iab,ib->ia", self.matrices(t, Z), Z)).ravel()

        end = solve_ivp(field, span, Z.ravel().astype(complex), method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        return end.reshape(self.count, self.N)


def amplitudes(count, N, seed=1):
    rng = np.random.default_rng(seed)
    Z = rng.standard_normal((count, N)) + 1j * rng.standard_normal((count, N))
    return Z / np.linalg.norm(Z, axis=1, keepdims=True)


def full_model(S, units):
    """Return a model with every term on two sublattices, and the equation by hand."""
    rng = np.random.default_rng(5)
    model = co.systems.spins(LOW, (2, 2, 1), spin=S, g=-1.7, periodic=(False, True, False), units=units, mode="SU(N)")
    hbar, mu_B = (HBAR, MU_B) if units == "meV" else (1.0, 1.0)
    N, (first, second, third) = round(2 * S + 1), LOW.bonds(3.1)[:3]
    reference = Schroedinger(model, S, -1.7, hbar, mu_B)
    J, D, K = rng.standard_normal((3, 3)), np.array([0.3, -0.5, 0.2]), 0.21
    A, P = 0.4 * hermitian(rng, N), 0.1 * hermitian(rng, N * N)
    kron = np.array([[np.kron(a, b) for b in reference.S] for a in reference.S])
    reference.couple(first, np.einsum("ab,abij->ij", J, kron) + P)
    cross = [D[0] * (kron[1, 2] - kron[2, 1]), D[1] * (kron[2, 0] - kron[0, 2]), D[2] * (kron[0, 1] - kron[1, 0])]
    scalar = kron[0, 0] + kron[1, 1] + kron[2, 2]
    reference.couple(second, sum(cross) + K * scalar @ scalar)
    reference.couple(third, -0.3 * scalar)
    reference.on_site[model.sites == 1] = A
    model = model.exchange(first, J).pair_coupling(first, P).dzyaloshinskii_moriya(second, D).biquadratic(second, K)
    model = model.exchange(third, -0.3).single_ion("B", A, time_reversal=False)
    return model, reference


@pytest.mark.parametrize(("S", "units"), [(1, "natural"), (1.5, "meV")])
def test_motion_is_that_of_schroedinger(S, units):
    model, reference = full_model(S, units)
    strength = 1.0 / reference.moment
    reference.B = lambda t: strength * np.array([0.3, -0.2, 0.5])
    model = model.field(reference.B(0.0))
    Z = amplitudes(8, reference.N)
    x0 = model.from_amplitudes(np.exp(2j) * Z)
    assert np.isclose(model.energy(x0), reference.energy(0.0, Z), rtol=1e-13, atol=1e-13)
    span = (1.0, 1.0 + 0.4 * reference.hbar)
    expected = model.from_amplitudes(reference.run(Z, span))
    for order, cells in ((2, 80), (4, 40), (6, 20)):
        errors = []
        for refined in (1, 2):
            step = (span[1] - span[0]) / (cells * refined)
            sol = co.integrate(model, x0, span, step, co.Splitting(order=order))
            errors.append(np.abs(sol.x[-1] - expected).max())
            assert max(value for name, value in sol.drift().items() if name != "energy") < 1e-13
        # Beyond round-off and the tolerance of the reference, errors fall by 2^order.
        assert errors[0] < 2e-3
        assert errors[1] < 1e-11 or errors[0] / errors[1] > 0.8 * 2**order
    back = co.integrate(model, sol.x[-1], span[::-1], step, co.Splitting(order=6))
    assert np.allclose(back.x[-1], x0, atol=1e-12, rtol=0)
    implicit = co.integrate(model, x0, span, (span[1] - span[0]) / 20, co.GaussLegendre(3))
    assert np.allclose(implicit.x[-1], expected, atol=1e-7, rtol=0)
    assert implicit.drift()["energy"] < 1e-14 * 50


def test_fields_of_time():
    model = co.systems.spins(CHAIN, (2, 1, 1), spin=1, g=2, periodic=False, mode="SU(N)").exchange(
        CHAIN.bonds(1)["1"], 0.7
    )
    reference = Schroedinger(model, 1, 2, 1.0, 1.0)
    reference.couple(CHAIN.bonds(1)["1"], 0.7 * sum(np.kron(s, s) for s in spin_matrices(1)))
    reference.B = lambda t: np.array([0.3 * t, 0.1, 0.2])
    driven = model.field(lambda t: (0.3 * t, 0.1, 0.2))
    Z = amplitudes(2, 3)
    sol = co.integrate(driven, driven.from_amplitudes(Z), (1, 2), 0.02, co.Splitting(order=4))
    assert np.allclose(sol.x[-1], driven.from_amplitudes(reference.run(Z, (1, 2))), atol=1e-8, rtol=0)


@pytest.mark.parametrize("units", ["natural", "meV"])
def test_spins_of_one_half_are_dipoles(units):
    bond = LOW.bonds(3.1)[0]
    J = np.random.default_rng(2).standard_normal((3, 3))
    shape = {"spin": 0.5, "g": -2, "units": units}
    classical = co.systems.spins(LOW, (3, 2, 1), **shape).exchange(bond, J).field((0.1, 0.2, 0.5))
    quantum = co.systems.spins(LOW, (3, 2, 1), mode="SU(N)", **shape).exchange(bond, J).field((0.1, 0.2, 0.5))
    n = np.random.default_rng(3).standard_normal((12, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    x0 = quantum.coherent(3.0 * n)
    assert np.allclose(x0, 0.5 * n.ravel(), atol=1e-15)
    assert np.isclose(quantum.energy(x0), classical.energy(n.ravel()), rtol=1e-13)
    runs = [
        co.integrate(one, x, (0, 2), 0.05, co.Splitting(order=4)) for one, x in ((classical, n.ravel()), (quantum, x0))
    ]
    assert np.allclose(runs[0].x, 2.0 * runs[1].x, atol=1e-13, rtol=0)
    assert np.allclose(runs[0].energy, runs[1].energy, rtol=0, atol=1e-12)
    S = [co.spectra.structure_factor(run, [(0, 0, 0), (1 / 3, 0, 0)]) for run in runs]
    assert np.allclose(S[0].intensity, S[1].intensity, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("S", [0.5, 1, 1.5, 2, 3.5])
def test_states_and_expectations(S):
    spin = spin_matrices(S)
    assert np.allclose(co.spins.operators(S), spin, atol=1e-15)
    model = co.systems.spins(CHAIN, (3, 1, 1), spin=S, mode="SU(N)")
    N = model.levels
    A, Z = hermitian(np.random.default_rng(1), N), amplitudes(3, N)
    x = model.from_amplitudes(5.0 * Z)
    assert x.shape == (3 * (N * N - 1),) == (model.dim,)
    assert np.allclose(model.expectation(x, A), np.einsum("ia,ab,ib->i", Z.conj(), A, Z).real, atol=1e-12)
    assert np.allclose(model.dipoles(x), np.einsum("ia,kab,ib->ik", Z.conj(), spin, Z).real, atol=1e-12)
    n = np.array([[1.0, -2.0, 0.5], [0.0, 0.0, -3.0], [0.2, 0.1, 0.0]])
    unit = n / np.linalg.norm(n, axis=1, keepdims=True)
    coherent = model.coherent(n)
    assert np.allclose(model.dipoles(coherent), S * unit, atol=1e-12)
    along = np.einsum("k,kab->ab", unit[0], spin)
    assert np.isclose(model.expectation(coherent, along @ along)[0], S**2, rtol=1e-12)
    # Random states are uniform: the mean of <A>^2 is (tr A^2 + (tr A)^2)/(N (N + 1)).
    many = model.expectation(model.random(3, 4000), spin[2]) ** 2
    assert abs(many.mean() - np.sum(spin[2] ** 2).real / (N * (N + 1))) < 4 * many.std() / np.sqrt(many.size)
    assert np.isclose(np.sum(x[: N * N - 1] ** 2), 2 * S**2 * (S + 1) / 3, rtol=1e-12)


def amplitudes_of(model, x):
    """Return amplitudes of a state, from expectations of E_ab + E_ba and i (E_ab - E_ba)."""
    rho = np.zeros((len(model.sites), model.levels, model.levels), dtype=complex)
    for a, b in itertools.product(range(model.levels), repeat=2):
        E = np.zeros((model.levels, model.levels))
        E[a, b] = 1.0
        rho[:, a, b] = 0.5 * (model.expectation(x, E + E.T) + 1j * model.expectation(x, 1j * (E - E.T)))
    return np.linalg.eigh(rho)[1][:, :, -1]


def random_means(energy, N, count, kT, seed=7, samples=200_000):
    """Return the thermal mean of an energy of pure states by weights of uniform ones, and its standard error."""
    Z = amplitudes(samples * count, N, seed).reshape(samples, count, N)
    E = energy(Z)
    w = np.exp(-(E - E.min()) / kT)
    mean = (w * E).sum() / w.sum()
    return mean, np.sqrt((w**2 * (E - mean) ** 2).sum()) / w.sum()


EXACT = [(1, 0.125, 0.2473082), (1, 0.5, 0.5443212), (2, 0.125, 0.4340860), (2, 0.5, 0.6009702)]


def anisotropic(S, D=1.0, size=(2, 2, 2), units="natural"):
    Sz = co.spins.operators(S)[2]
    A = Sz @ Sz if S == 1 else Sz @ Sz - np.linalg.matrix_power(Sz, 4) / 5
    return co.systems.spins(ION, size, spin=S, units=units, mode="SU(N)").single_ion("Fe", D * A)


@pytest.mark.parametrize(("S", "kT", "mean"), EXACT)
def test_thermal_states_of_anisotropic_ions(S, kT, mean):
    D, model = 0.7, anisotropic(S, 0.7, units="meV")
    members = 1000 if S == 1 else 250
    states = co.thermal_states(model, D * kT / K_B, members, seed=2, sweeps=35, over_relaxation=S - 1)
    energy = states.energy[5:].mean(axis=0) / (8 * D)
    error = energy.std() / np.sqrt(len(energy))
    assert abs(energy.mean() - mean) < 4 * error < 0.01 * mean * 4
    assert abs(energy.mean() - mean) < 0.003 * mean
    assert np.all(states.acceptance == 1.0) and states.sites == 8


def stevens_by_hand(S):
    """Return operators of C. Rudowicz, C. Y. Chung, J. Phys.: Condens. Matter 16, 5825 (2004)."""
    Sx, Sy, Sz = co.spins.operators(S)
    X, one, power = S * (S + 1), np.eye(len(Sz)), np.linalg.matrix_power
    up, down = Sx + 1j * Sy, Sx - 1j * Sy
    found = {
        "B20": 3 * Sz @ Sz - X * one,
        "B21": (Sz @ Sx + Sx @ Sz) / 2,
        "B2-1": (Sz @ Sy + Sy @ Sz) / 2,
        "B22": (power(up, 2) + power(down, 2)) / 2,
        "B2-2": (power(up, 2) - power(down, 2)) / 2j,
    }
    if S >= 2:
        cubic, odd = power(up, 3) + power(down, 3), power(up, 3) - power(down, 3)
        found["B40"] = 35 * power(Sz, 4) - (30 * X - 25) * Sz @ Sz + (3 * X**2 - 6 * X) * one
        found |= {"B43": (Sz @ cubic + cubic @ Sz) / 4, "B4-3": (Sz @ odd + odd @ Sz) / 4j}
        found |= {"B44": (power(up, 4) + power(down, 4)) / 2, "B4-4": (power(up, 4) - power(down, 4)) / 2j}
    if S >= 3:
        found["B60"] = 231 * power(Sz, 6) - (315 * X - 735) * power(Sz, 4)
        found["B60"] += (105 * X**2 - 525 * X + 294) * Sz @ Sz + (40 * X**2 - 5 * X**3 - 60 * X) * one
        found["B66"] = (power(up, 6) + power(down, 6)) / 2
    return found


@pytest.mark.parametrize("S", [1, 1.5, 2, 3, 4.5])
def test_stevens_operators_are_those_of_the_literature(S):
    empty = co.systems.spins(CHAIN, (1, 1, 1), spin=S, periodic=False, mode="SU(N)")
    x, site = empty.random(3, members=4), empty.crystal.labels[0]
    for name, A in stevens_by_hand(S).items():
        one = empty.single_ion(site, {name: 0.3})
        expected = 0.3 * empty.expectation(x, A)[:, 0]
        np.testing.assert_allclose([one.energy(state) for state in x], expected, atol=1e-13 * np.abs(A).max())
        other = empty.single_ion(site, 0.3 * A)
        assert f"O{name[1:]}" in str(other) and f"{name} = 0.3" in str(one)
    if S < 3:
        with refused(ValueError, "vanish"):
            empty.single_ion(site, {"B66": 1.0})


@pytest.mark.long
@pytest.mark.parametrize(("S", "kT", "mean"), EXACT)
def test_baths_of_anisotropic_ions_to_a_third_of_a_percent(S, kT, mean):
    # States of N levels relax N (N^2 - 1) / 6 times as fast as energies over hbar: 4 and 20.
    energy, error = energy_in_bath(S, kT, members=4000 if S == 1 else 1000, step=0.05 if S == 1 else 0.025)
    assert abs(energy - mean) < 4 * error and abs(energy - mean) < 0.003 * mean


def energy_in_bath(S, kT, members, step, end=20.0):
    model = anisotropic(S, size=(1, 1, 1))
    bath = co.forces.HeatBath(1.0, temperature=kT, seed=4)
    sol = co.integrate(model.with_forces(bath), model.random(1, members), (0, end), step, save_every=round(0.1 / step))
    energy = sol.energy[60:].mean(axis=0)
    assert np.abs(np.sum(sol.x**2, axis=-1) - 2 * S**2 * (S + 1) / 3).max() < 1e-12
    return energy.mean(), energy.std() / np.sqrt(members)


def test_baths_of_anisotropic_ions():
    energy, error = energy_in_bath(1, 0.5, members=400, step=0.1)
    assert abs(energy - EXACT[1][2]) < 4 * error < 0.03


def test_thermal_states_of_coupled_sites():
    model = co.systems.spins(CHAIN, (2, 1, 1), spin=1, periodic=False, mode="SU(N)")
    bond, A = CHAIN.bonds(1)["1"], hermitian(np.random.default_rng(4), 3)
    P = 0.4 * hermitian(np.random.default_rng(3), 9)
    model = model.pair_coupling(bond, P).single_ion("Ni", 0.3 * A, time_reversal=False)
    P4 = P.reshape(3, 3, 3, 3)

    def energy(Z):
        first, second = Z[:, 0], Z[:, 1]
        rho = [np.einsum("na,nb->nab", one.conj(), one) for one in (first, second)]
        pair = np.einsum("nac,abcd,nbd->n", rho[0], P4, rho[1], optimize=True).real
        return pair + 0.3 * sum(np.einsum("nab,ab->n", one, A).real for one in rho)

    mean, error = random_means(energy, 3, 2, 1.0)
    states = co.thermal_states(model, 1.0, members=400, sweeps=50, seed=1)
    found = states.energy[10:].mean(axis=0)
    assert abs(found.mean() - mean) < 4 * np.hypot(error, found.std() / 20) < 0.1
    again = co.thermal_states(model, 1.0, members=3, sweeps=50, seed=1)
    assert np.allclose(again.x, states.x[:3], atol=1e-10)
    assert np.allclose([model.energy(x) for x in states.x[:3]], states.energy[-1, :3], atol=1e-12)


@pytest.mark.parametrize("extra", [0, 1])
def test_states_without_energy_stay_uniform(extra):
    """Means of the uniform distribution: none of traceless operators, and tr(A B) / (N (N + 1)) of <A><B>."""
    model = co.systems.spins(CHAIN, (1, 1, 1), spin=1, periodic=False, mode="SU(N)").field((0, 0, 1e-9))
    count = 20_000
    x = co.thermal_states(model, 1.0, members=count, sweeps=2, seed=6, over_relaxation=extra).x
    for values, mean in ((x.T, 0.0), ((x[:, :, None] * x[:, None]).reshape(count, -1).T, np.eye(8).ravel() / 6)):
        assert np.all(abs(values.mean(axis=1) - mean) < 5 * values.std(axis=1) / np.sqrt(count))


def spin_waves(reference, Z):
    """Return the frequencies of generalized spin waves: Bogoliubov modes of the amplitudes across a product state."""
    count, N = Z.shape
    U = np.array([np.linalg.svd(one.conj()[None])[2].conj().T for one in Z])  # first column along the state
    U[:, :, 0] = Z
    h = np.einsum("iba,ibc,icd->iad", U.conj(), reference.matrices(0.0, Z), U)
    assert np.abs(h[:, 1:, 0]).max() < 1e-9  # stationary
    d = N - 1
    normal, anomalous = np.zeros((2, count * d, count * d), dtype=complex)
    for i in range(count):
        normal[i * d : (i + 1) * d, i * d : (i + 1) * d] = h[i, 1:, 1:] - h[i, 0, 0] * np.eye(d)
    for i, j, P in reference.pairs:
        Q = np.einsum("aA,bB,abcd,cC,dD->ABCD", U[i].conj(), U[j].conj(), P, U[i], U[j])
        one, two = slice(i * d, (i + 1) * d), slice(j * d, (j + 1) * d)
        normal[one, two] += Q[1:, 0, 0, 1:]
        normal[two, one] += Q[0, 1:, 1:, 0]
        anomalous[one, two] += Q[1:, 1:, 0, 0]
        anomalous[two, one] += Q[1:, 1:, 0, 0].T
    modes = np.block([[normal, anomalous], [-anomalous.conj(), -normal.conj()]])
    return np.sort(np.abs(np.linalg.eigvals(modes).real))[::2]


def test_frequencies_of_a_quantum_paramagnet():
    """S = 1 with D > 0 and exchange: sqrt(D^2 + 2 D J z gamma_q), twice."""
    D, J, L = 2.0, 0.3, 4
    model = co.systems.spins(CHAIN, (L, 1, 1), spin=1, mode="SU(N)").exchange(CHAIN.bonds(1)["1"], J)
    Sz = co.spins.operators(1)[2]
    model = model.single_ion("Ni", D * Sz @ Sz)
    found = co.equilibrium(model, model.from_amplitudes([[0, 1, 0]] * L))
    waves = np.sqrt(D**2 + 2 * D * J * 2 * np.cos(2 * np.pi * np.arange(L) / L))
    assert found.stability == "stable" and abs(found.energy) < 1e-14
    assert np.allclose(found.frequencies, np.sort(np.repeat(waves, 2)), atol=1e-9)


def test_frequencies_are_those_of_generalized_spin_waves():
    """An easy-axis antiferromagnet with biquadratic coupling in a field: branches of dipoles and of quadrupoles."""
    D, J, K, B, L = -0.8, 1.0, 0.15, 0.3, 4
    bond = CHAIN.bonds(1)["1"]
    Sx, Sy, Sz = co.spins.operators(1)
    A = D * Sz @ Sz + 0.1 * (Sx @ Sx - Sy @ Sy)
    model = co.systems.spins(CHAIN, (L, 1, 1), spin=1, g=2, mode="SU(N)").exchange(bond, J).biquadratic(bond, K)
    model = model.single_ion("Ni", A).field((0, 0, B))
    up_and_down = np.where(np.arange(L) % 2, -1, 1)[:, None] * UP
    found = co.equilibrium(model, model.coherent(up_and_down + [0.2, 0, 0]))
    Z = amplitudes_of(model, found.x)
    assert np.allclose(model.from_amplitudes(Z), found.x, atol=1e-8)
    reference = Schroedinger(model, 1, 2, 1.0, 1.0)
    scalar = sum(np.kron(s, s) for s in spin_matrices(1))
    reference.couple(bond, J * scalar + K * scalar @ scalar)
    reference.on_site[:] = A
    reference.B = lambda t: np.array([0, 0, B])
    assert np.allclose(found.frequencies, spin_waves(reference, Z), atol=1e-6)
    assert len(found.frequencies) == 2 * L


def test_symmetry_turns_operators():
    """Quadrupolar couplings of a cube have its symmetry, whatever the state."""
    Q = np.array([[1.0, 0, 0], [0, -0.5, 0], [0, 0, -0.5]])
    spin = spin_matrices(1.5)
    axial = sum(Q[a, b] * spin[a] @ spin[b] for a in range(3) for b in range(3))
    bond = CUBE.bonds(1)["1"]
    model = co.systems.spins(CUBE, (2, 2, 2), spin=1.5, periodic=False, mode="SU(N)").pair_coupling(
        bond, np.kron(axial, axial)
    )
    cubic = sum(np.linalg.matrix_power(one, 4) for one in spin_matrices(2))
    ions = co.systems.spins(CUBE, (1, 1, 1), spin=2, mode="SU(N)").single_ion("Fe", cubic)
    Z = amplitudes(8, 4)
    cells = 2 * model.cells - 1
    assert model.energy(model.from_amplitudes(Z)) != 0.0
    for turn in Rotation.create_group("O"):
        R, vector = turn.as_matrix().round(), turn.as_rotvec()
        moved = cells @ R.T
        order = [int(np.flatnonzero(np.all(cells == one, axis=1))[0]) for one in moved.round()]
        turned = np.empty_like(Z)
        turned[order] = Z @ expm(-1j * np.einsum("k,kab->ab", vector, spin)).T
        assert np.isclose(
            model.energy(model.from_amplitudes(turned)), model.energy(model.from_amplitudes(Z)), atol=1e-12
        )
        state = amplitudes(1, 5, 2)
        image = state @ expm(-1j * np.einsum("k,kab->ab", vector, spin_matrices(2))).T
        assert np.isclose(
            ions.energy(ions.from_amplitudes(image)), ions.energy(ions.from_amplitudes(state)), atol=1e-12
        )
    forbidden = spin_matrices(1.5)[0] @ spin_matrices(1.5)[0]
    with refused(ValueError, "not allowed by symmetry"):
        co.systems.spins(CUBE, (1, 1, 1), spin=1.5, mode="SU(N)").single_ion("Fe", forbidden)
    with refused(ValueError, "not allowed by symmetry"):
        model.biquadratic(CUBE.bonds(1)["1"], 0.1).pair_coupling(CUBE.bonds(1.5)["2"], np.kron(axial, np.eye(4)))


def test_exchange_is_the_same_as_operators_of_pairs(tmp_path):
    """Of bonds that rotations by 90 degrees take to others, and from files of directions."""
    turning = co.spins.crystal(lattice=(4, 4, 5, 90, 90, 90), sites={"Fe": (0.1, 0.2, 0)}, space_group="P 4")
    bond, S = turning.bonds(2)[0], spin_matrices(1)
    J = np.random.default_rng(1).standard_normal((3, 3))
    empty = co.systems.spins(turning, (2, 2, 1), spin=1, mode="SU(N)")
    x = empty.random(1)
    operator = sum(J[a, b] * np.kron(S[a], S[b]) for a in range(3) for b in range(3))
    pairs = empty.pair_coupling(bond, operator)
    assert np.isclose(empty.exchange(bond, J).energy(x), pairs.energy(x), rtol=1e-12)
    # Inversion at the middle of a bond exchanges its ends.
    inverted = co.spins.crystal(lattice=(1, 2, 2, 80, 85, 95), sites={"Ni": (0, 0, 0)}, space_group="P -1")
    with refused(ValueError, "not allowed by symmetry"):
        co.systems.spins(inverted, (3, 1, 1), spin=1, mode="SU(N)").pair_coupling(
            inverted.bonds(1)["1"], np.kron(S[0], S[1]) - np.kron(S[1], S[0])
        )

    rows = ["# cell", "1 2 2", "# vectors", "1 0 0", "0 1 0", "0 0 1", "# Atoms", "1 1", "0 0 0 0 0", "# Interactions"]
    forward, backward = (" ".join(map(repr, matrix.ravel().tolist())) for matrix in (1e-22 * J, 1e-22 * J.T))
    rows += ["2 tensorial", f"0 0 0 1 0 0 {forward}", f"1 0 0 -1 0 0 {backward}"]
    path = tmp_path / "chain.ucf"
    path.write_text("\n".join(rows) + "\n")
    table = co.spins.read_exchange(path, CHAIN)
    n = np.random.default_rng(2).standard_normal((4, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    vectors = co.systems.spins(CHAIN, (4, 1, 1), spin=3 / 2, units="meV").exchange(table)
    states = co.systems.spins(CHAIN, (4, 1, 1), spin=3 / 2, units="meV", mode="SU(N)").exchange(table)
    assert np.isclose(states.energy(states.coherent(n)), vectors.energy(n.ravel()), rtol=1e-12)


def test_structure_factor_of_dipoles():
    D, J, L = 2.0, 0.3, 8
    model = co.systems.spins(CHAIN, (L, 1, 1), spin=1, mode="SU(N)").exchange(CHAIN.bonds(1)["1"], J)
    Sz = co.spins.operators(1)[2]
    model = model.single_ion("Ni", D * Sz @ Sz)
    states = co.thermal_states(model, temperature=0.005, members=3, sweeps=30, seed=1)
    sol = co.integrate(model, states.x, (0, 100), 0.1, save_every=5)
    S = co.spectra.structure_factor(sol, [(0, 0, 0), (1 / 2, 0, 0)])
    peaks = abs(S.omega[S.components[:2].sum(axis=0).argmax(axis=1)])
    waves = np.sqrt(D**2 + 4 * D * J * np.cos(2 * np.pi * S.q[:, 0]))
    assert np.all(abs(peaks - waves) < 2 * np.pi / 100)
    assert np.allclose(
        S.static[0],
        np.mean(np.sum(model.dipoles(sol.x).sum(axis=2) ** 2, axis=-1) * np.hanning(201)[:, None] ** 2)
        / np.mean(np.hanning(201) ** 2)
        / L,
        rtol=0.02,
    )


def bound_chain(D=-4.0, J=-0.5, K=0.2, L=8):
    """Return an easy-axis ferromagnet whose excitation from m = 1 to m = -1 has a dispersion, by the biquadratic K."""
    bond, Sz = CHAIN.bonds(1)["1"], co.spins.operators(1)[2]
    model = co.systems.spins(CHAIN, (L, 1, 1), spin=1, mode="SU(N)").exchange(bond, J).biquadratic(bond, K)
    return model.single_ion("Ni", D * Sz @ Sz)


def test_quadrupoles_show_the_bound_states_of_two_magnons():
    """By Holstein and Primakoff for three levels: E1 = -D - 2 J (1 - cos q), E2 = -4 J + 2 K (1 + cos q)."""
    model, Z = bound_chain(), 0.02 * amplitudes(16, 3).reshape(2, 8, 3)
    Z[..., 0] = 1.0
    sol = co.integrate(model, model.from_amplitudes(Z), (0, 100), 0.1, save_every=5)
    Sx, Sy, _ = spin_matrices(1)
    S = co.spectra.structure_factor(sol, [(0, 0, 0), (1 / 2, 0, 0)], operators=[Sx, Sx @ Sy + Sy @ Sx])
    found = abs(S.omega[S.components.argmax(axis=2)])
    c = np.cos(2 * np.pi * S.q[:, 0])
    magnons, bound = 4.0 + (1 - c), 2.0 + 0.4 * (1 + c)
    assert np.all(abs(found - [magnons, bound]) < 2 * np.pi / 100)
    modes = co.spectra.linear_modes(model, model.coherent(UP), S.q, points=1).frequencies
    np.testing.assert_allclose(modes, np.transpose([bound, magnons]), rtol=1e-7)
    # The dipoles alone have no such line.
    dipoles = co.spectra.structure_factor(sol, S.q[[0, -1]])
    near = abs(abs(S.omega) - bound[:, None]) < 0.3
    power = [(one * near).sum(axis=1) / one.sum(axis=1) for one in (S.components[1], dipoles.components[0])]
    assert power[0].min() > 0.95 and power[1].max() < 0.01


@pytest.mark.parametrize("factor", [1e-7, 1.0, 1e30])
@pytest.mark.parametrize("span", [(0, 4), (3, -1)])
def test_spectra_of_operators_by_hand(span, factor):
    """Members with other vacancies, sites at their positions, constants of operators, times that descend, any units."""
    rng, Z = np.random.default_rng(3), amplitudes(18, 4).reshape(2, 9, 4)
    (first, second), models = LOW.bonds(3.1)[:2], []
    for seed in (1, 2):
        made = co.systems.spins(LOW, (3, 2, 1), spin=1.5, periodic=(True, True, False), mode="SU(N)")
        models.append(made.exchange(first, 0.3 * factor).biquadratic(second, 0.1 * factor).vacancies(0.25, seed=seed))
    x0 = np.stack([model.from_amplitudes(one) for model, one in zip(models, Z, strict=True)])
    steps = [time / factor for time in (*span, 0.1)]
    forces = [co.forces.DoubleBracketDamping(0.01)] if factor == 1.0 else []
    system = co.batch([model.with_forces(*forces) if forces else model for model in models])
    sol = co.integrate(system, x0, tuple(steps[:2]), steps[2], co.Splitting(order=2), save_every=2)
    chosen = np.array([factor * hermitian(rng, 4), np.diag([1.0, 0, 0, 0])])
    S = co.spectra.structure_factor(sol, [(0, 0, 0), (1, 1 / 2, 2)], None, operators=chosen)
    q, spectra = 2 * np.pi * np.linalg.solve(LOW.lattice, S.q.T), []  # a . q = 2 pi h
    for member, model in enumerate(models):
        values = np.array([model.expectation(sol.x[:, member], A) for A in chosen])
        by_amplitudes = np.einsum("im,amn,in->ai", Z[member].conj(), chosen, Z[member]).real
        np.testing.assert_allclose(values[:, 0], by_amplitudes, atol=1e-12 * abs(by_amplitudes).max())
        sums = np.einsum("ati,ik->akt", values, np.exp(-1j * model.positions @ q))
        count, step = len(sol.t), abs(sol.t[1] - sol.t[0])
        waves = np.exp(1j * np.outer(sol.t, S.omega))
        scale = 1 / (len(model.sites) * count)
        spectra.append(
            (np.abs(sums @ waves) ** 2 * scale * step / (2 * np.pi), np.sum(np.abs(sums) ** 2, (0, 2)) * scale)
        )
    expected, static = (np.mean(part, axis=0) for part in zip(*spectra, strict=True))
    for found, wanted in zip(S.components, expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-11 * wanted.max())
    np.testing.assert_allclose(S.static, static, rtol=1e-12)
    np.testing.assert_allclose(S.intensity.sum(axis=1) * (S.omega[1] - S.omega[0]), static, rtol=1e-12)
    np.testing.assert_allclose(S.components.sum(axis=0), S.intensity, rtol=1e-14)
    assert S.broadened(0.3 * factor).components.shape == S.components.shape == (2, len(S.q), len(sol.t))
    plain = co.spectra.structure_factor(sol, S.q[[0, -1]])
    same = co.spectra.structure_factor(sol, S.q[[0, -1]], operators=co.spins.operators(1.5))
    np.testing.assert_allclose(same.components, plain.components, rtol=1e-12, atol=1e-14 * plain.components.max())


@pytest.mark.parametrize(
    ("operators", "options", "words"),
    [
        ([], {}, "operators is empty"),
        (np.eye(3), {}, "operators[0] has shape (3,)"),
        ([np.eye(3), np.eye(2)], {}, "operators[1] has shape (2, 2)"),
        ([np.triu(np.ones((3, 3)))], {}, "operators[0] is not Hermitian"),
        ([np.eye(3)], {"neutrons": co.spectra.Neutrons()}, "give one of them"),
    ],
)
def test_refused_operators_of_spectra(operators, options, words):
    model = bound_chain(L=3)
    sol = co.integrate(model, model.coherent(UP), (0, 1), 0.1)
    with refused(ValueError, words):
        co.spectra.structure_factor(sol, [(0, 0, 0)], operators=operators, **options)


def test_dipoles_have_no_operators():
    model = co.systems.spins(CHAIN, (2, 1, 1), spin=1)
    ring = co.systems.spin_lattice("ring", 4)
    for system in (model, ring):
        sol = co.integrate(system, np.tile(UP, system.dim // 3), (0, 1), 0.1)
        with refused(ValueError, "no states of N levels"):
            co.spectra.structure_factor(sol, [(0,) * (3 if system is model else 1)], operators=[np.eye(2)])


def test_meetings(tmp_path):
    """Members, batches, archives that resume, derivatives, other units, vacancies, conserved spins."""
    bond = CHAIN.bonds(1)["1"]
    Sz = co.spins.operators(1)[2]
    made = [
        co.systems.spins(CHAIN, (4, 1, 1), spin=1, mode="SU(N)").exchange(bond, J).single_ion("Ni", 0.4 * Sz @ Sz)
        for J in (0.5, 0.9)
    ]
    model = made[0]
    x = model.random(1, 2)
    batch = co.integrate(co.batch(made), x, (0, 1), 0.1, co.Splitting(order=4))
    for member, one in enumerate(made):
        alone = co.integrate(one, x[member], (0, 1), 0.1, co.Splitting(order=4))
        assert np.array_equal(alone.x, batch.x[:, member])
    assert list(model.integrals) == ["total S3"] and list(model.casimirs) == [f"|x|^2 [{k}]" for k in (1, 2, 3, 4)]
    long = co.integrate(model, x[0], (0, 40), 0.1, co.GaussLegendre(2), observe=model.integrals)
    assert np.ptp(long.observed["total S3"]) < 1e-13 and long.drift()["energy"] < 1e-13
    isotropic = co.systems.spins(CHAIN, (4, 1, 1), spin=1, mode="SU(N)").biquadratic(bond, 0.3)
    assert list(isotropic.integrals) == ["total S1", "total S2", "total S3"]

    bath = model.with_forces(co.forces.HeatBath(0.3, temperature=0.4, seed=2))
    assert isinstance(bath, type(model)) and bath.levels == 3
    whole = co.integrate(bath, x[0], (0, 2), 0.1)
    co.integrate(bath, x[0], (0, 1), 0.1, archive=tmp_path / "run")
    assert np.array_equal(co.resume(tmp_path / "run", 2.0).x, whole.x)
    assert co.load(tmp_path / "run", system=bath).system is bath
    damped = co.integrate(model.with_forces(co.forces.DoubleBracketDamping(0.5)), x[0], (0, 5), 0.1)
    assert np.all(np.diff(damped.energy) < 0)

    prepared = co.prepare(model, co.Splitting(order=2), step=0.1)
    v = np.random.default_rng(2).standard_normal(model.dim)
    _, tangents = prepared.jvp(x[0], (0, 1), {"x0": v})
    ends = [prepared.run(x[0] + s * 1e-6 * v, (0, 1)).x[-1] for s in (1, -1)]
    assert np.allclose(tangents.x[-1], (ends[0] - ends[1]) / 2e-6, atol=1e-7)

    for factor in (1e-7, 1e30):
        scaled = co.systems.spins(CHAIN, (4, 1, 1), spin=1, mode="SU(N)").exchange(bond, 0.5 * factor)
        scaled = scaled.single_ion("Ni", 0.4 * factor * Sz @ Sz)
        sol = co.integrate(scaled, x[0], (0, 1 / factor), 0.1 / factor, co.Splitting(order=4))
        assert np.allclose(sol.x[-1], co.integrate(model, x[0], (0, 1), 0.1, co.Splitting(order=4)).x[-1], atol=1e-13)
        states = co.thermal_states(scaled, 0.3 * factor, members=2, sweeps=5, seed=1)
        assert np.allclose(states.x, co.thermal_states(model, 0.3, members=2, sweeps=5, seed=1).x, atol=1e-9)

    fewer = model.vacancies(0.25, seed=1)
    assert fewer.dim == 24 and len(fewer.dipoles(fewer.random(1))) == 3
    ends = co.integrate(fewer, fewer.coherent(UP), (0, 1), 0.1).x[-1]
    assert np.allclose(ends, fewer.coherent(UP), atol=1e-13)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda m: m.substitute("Ni", 0.5, 1, spin=2.0), "substitute is not available"),
        (lambda m: m.single_ion("Ni", np.diag([0.0, 0.0, -0.1])), "time reversal"),
        (lambda m: m.single_ion("Ni", np.triu(np.ones((3, 3)))), "not Hermitian"),
        (lambda m: m.single_ion("Ni", np.eye(2)), "shape (2, 2)"),
        (lambda m: m.single_ion("Ni", np.diag([np.nan, 0, 0])), "not finite"),
        (lambda m: m.single_ion("Ni", np.diag([1e101, 0, 1e101])), "larger units"),
        (lambda m: m.single_ion("Ni", np.diag([1, 0, 1])).single_ion("Ni", np.diag([1, 0, 1])), "give the sum"),
        (lambda m: m.biquadratic(CUBE.bonds(1)["1"], 0.1), "another crystal"),
        (lambda m: m.biquadratic(CHAIN.bonds(1)["1"], 0.1).biquadratic(CHAIN.bonds(1)["1"], 0.1), "give the sum"),
        (lambda m: m.pair_coupling(CHAIN.bonds(1)["1"], np.eye(3)), "(9, 9)"),
        (lambda m: m.coherent((0, 0, 0)), "length zero"),
        (lambda m: m.coherent(np.ones((2, 3))), "shape (2, 3)"),
        (lambda m: m.from_amplitudes(np.zeros((3, 3))), "without amplitude"),
        (lambda m: m.from_amplitudes(np.ones((3, 2))), "shape (3, 2)"),
        (lambda m: m.expectation(np.ones(7), np.eye(3)), "shape (7,)"),
        (lambda m: co.thermal_states(m, 1.0, seed=1, sweeps=1, method="Metropolis"), "heat bath"),
        (lambda m: co.thermal_states(m, 1.0, seed=1, sweeps=1, x0=np.zeros(m.dim)), "pure state"),
        (lambda m: co.integrate(m, m.random(1), (0, 1), 0.1, co.SphericalMidpoint()), "copies of so(3)"),
    ],
)
def test_what_is_refused(call, words):
    model = co.systems.spins(CHAIN, (3, 1, 1), spin=1, mode="SU(N)")
    with refused(ValueError, words):
        call(model)


def test_equilibria_need_sites_that_move():
    model = co.systems.spins(CHAIN, (3, 1, 1), spin=1, mode="SU(N)").exchange(CHAIN.bonds(1)["1"], 1.0)
    x0 = model.coherent(UP)
    x0[:8] = 0.0
    with refused(ValueError, "singular"):
        co.equilibrium(model, x0)


@pytest.mark.parametrize("spin", [0.7, 0, 8, {"A": 1, "B": 2}])
def test_refused_levels(spin):
    with refused(ValueError, "spin"):
        co.systems.spins(LOW, (1, 1, 1), spin=spin, mode="SU(N)")
    if not isinstance(spin, dict):
        with refused(ValueError, "multiples of 1/2"):
            co.spins.operators(spin)


def test_refused_mode():
    with refused(ValueError, "mode"):
        co.systems.spins(LOW, (1, 1, 1), mode="SU(3)")
