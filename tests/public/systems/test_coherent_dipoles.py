"""Dipoles of sites of SU(N): against Schroedinger's equation with the direct sum, exact averages, and vectors."""

import importlib.util

import numpy as np
import pytest
from scipy.constants import physical_constants
from scipy.integrate import solve_ivp

import coadjoint as co
from matrix.forces import force_on, is_noise
from refusals import refused
from same_runs import check_same

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec(name) is None, reason=f"{name} is not installed")
    for name in ("gemmi", "spglib")
]

HBAR = physical_constants["reduced Planck constant in eV s"][0] * 1e15  # meV ps
MU_B = physical_constants["Bohr magneton in eV/T"][0] * 1e3  # meV/T
MU0 = physical_constants["vacuum mag. permeability"][0] / (4 * np.pi) * physical_constants["Bohr magneton"][0] ** 2
MU0 *= 1e30 / physical_constants["electron volt"][0] * 1e3  # meV cubic angstroms
LOW = co.spins.crystal(lattice=(3, 4, 5, 80, 95, 90), sites={"A": (0.1, 0, 0), "B": (0.4, 0.5, 0.2)}, space_group="P 1")
G, J, AXIS = (2.0, -30.0), 0.05, 0.3  # the second moments are so large that dipoles are as strong as the exchange


def model(S=1, size=(2, 1, 2), mode="SU(N)", periodic=False, field=(0.3, -0.2, 0.5), J=J, name="J1", dipoles=True):
    made = co.systems.spins(
        LOW, size, spin=S, g=dict(zip("AB", G, strict=True)), units="meV", mode=mode, periodic=periodic
    )
    made = made.exchange(LOW.bonds(4)["1"], J, name=name).field(field)
    if mode == "SU(N)" and S > 0.5:
        made = made.single_ion("A", AXIS * co.spins.operators(S)[2] @ co.spins.operators(S)[2])
    return made.dipolar() if dipoles else made


def spin_matrices(S):
    """Return Sx, Sy, Sz from the text book."""
    m = S - np.arange(round(2 * S + 1))
    up = np.diag(np.sqrt(S * (S + 1) - m[1:] * (m[1:] + 1)), 1)
    return np.array([(up + up.T) / 2, (up - up.T) / 2j, np.diag(m)])


def direct_sum(system):
    """Return the tensors of all pairs (sites, sites, 3, 3), of the spins."""
    r = system.positions[:, None] - system.positions
    d = np.sqrt((r**2).sum(axis=-1)) + np.eye(len(r))
    T = (np.eye(3) - 3 * r[..., :, None] * r[..., None, :] / d[..., None, None] ** 2) / d[..., None, None] ** 3
    g = np.array(G)[system.sites]
    T *= MU0 * (g[:, None] * g)[..., None, None]
    T[np.arange(len(r)), np.arange(len(r))] = 0.0
    return T


def by_schroedinger(system, S, Z, times, field):
    """Return the amplitudes at the times: i hbar Z_i' = (A - g mu_B B . S + (sum_j (J + T_ij) <S_j>) . S) Z_i."""
    matrices, T, sites = spin_matrices(S), direct_sum(system), system.sites
    bond = LOW.bonds(4)["1"]
    for i, j in zip(*np.nonzero((sites[:, None] == bond.first) & (sites == bond.second)), strict=True):
        if np.array_equal(system.cells[j] - system.cells[i], bond.offset):
            T[i, j] += J * np.eye(3)
            T[j, i] += J * np.eye(3)
    on_site = np.zeros((len(sites), *matrices.shape[1:]), dtype=complex)
    if S > 0.5:
        on_site[sites == 0] = AXIS * matrices[2] @ matrices[2]

    def rate(t, flat):
        Z = flat.reshape(len(sites), -1)
        s = np.einsum("ia,kab,ib->ik", Z.conj(), matrices, Z).real
        B = np.einsum("ijkl,jl->ik", T, s) - MU_B * np.array(G)[sites][:, None] * field(t)
        return (-1j / HBAR * np.einsum("iab,ib->ia", on_site + np.einsum("ik,kab->iab", B, matrices), Z)).ravel()

    found = solve_ivp(rate, (times[0], times[-1]), Z.ravel(), "DOP853", times, rtol=1e-12, atol=1e-13)
    return found.y.T.reshape(len(times), *Z.shape)


def amplitudes(system, seed=1):
    Z = np.random.default_rng(seed).standard_normal((2, len(system.sites), system.levels))
    Z = Z[0] + 1j * Z[1]
    return Z / np.sqrt((abs(Z) ** 2).sum(axis=-1, keepdims=True))


@pytest.mark.parametrize("S", [0.5, 1, 2])
@pytest.mark.parametrize("span", [(0.0, 2.0), (3.0, 1.0)])
@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize("vacancies", [False, True])
def test_against_schroedinger(S, span, driven, vacancies):
    """Sites of two moments, forward and backward, in constant and driven fields; schemes of their orders."""
    field = (lambda t: np.array([0.3, -0.2, 0.5]) * (1 + np.sin(3 * t))) if driven else (0.3, -0.2, 0.5)
    system = model(S, (3, 1, 2) if vacancies else (2, 1, 2), field=field)
    if vacancies:
        system = system.vacancies(0.3, seed=3)
    Z, times = amplitudes(system), np.linspace(*span, 5)
    exact = by_schroedinger(system, S, Z, times, field if driven else lambda t: np.array(field))
    x = system.from_amplitudes(Z)
    wanted = system.from_amplitudes(exact)
    T, s = direct_sum(system), system.dipoles(x)
    energy = 0.5 * np.einsum("ik,ijkl,jl->", s, T, s)
    without = model(S, system.size, field=field, dipoles=False)
    without = without.vacancies(0.3, seed=3) if vacancies else without
    assert abs(system.energy(x, span[0]) - without.energy(x, span[0]) - energy) < 1e-12 * np.abs(T).max() * len(s) ** 2
    assert np.abs(wanted[-1] - x).max() > 0.3
    for method, error in ((co.GaussLegendre(4), 1e-9), (co.CommutatorFree(4), 1e-3)):
        run = co.integrate(system, x, span, 0.01, method, save_every=50)
        np.testing.assert_allclose(run.x, wanted, rtol=0, atol=error)


def test_states_stay_pure():
    """By exponentials, to round-off; by Gauss methods with the energy to round-off, and purity to their order."""
    system = model(1)
    x = system.from_amplitudes(amplitudes(system))

    def impurity(run):
        """Return |rho^2 - rho| at the end, of rho by its coefficients in an orthogonal basis."""
        basis = np.array([system.expectation(one, np.eye(3)) for one in run.x[-1:]])
        assert np.abs(basis - 1).max() < 1e-13
        rows = run.x[-1].reshape(len(system.sites), 8)
        units = [np.zeros((3, 3), dtype=complex) for _ in range(9)]
        found = np.zeros((len(rows), 3, 3), dtype=complex)
        for k, (a, b) in enumerate(np.ndindex(3, 3)):
            units[k][a, b] += 1.0
            real = system.expectation(run.x[-1], (units[k] + units[k].T) / 2)
            imaginary = system.expectation(run.x[-1], (units[k] - units[k].T) / 2j)
            found[:, b, a] = real + 1j * imaginary
        return np.abs(found @ found - found).max()

    free = co.integrate(system, x, (0, 4), 0.05, co.CommutatorFree(4))
    gauss = [co.integrate(system, x, (0, 4), h, co.GaussLegendre(2)) for h in (0.05, 0.025)]
    assert impurity(free) < 1e-13 and all(run.drift()["energy"] < 1e-13 for run in gauss)
    assert 8 < impurity(gauss[0]) / impurity(gauss[1]) < 32


@pytest.mark.parametrize("periodic", [True, (True, True, False), False])
def test_spins_of_one_half_are_vectors(periodic):
    """S = 1/2 is the model of vectors of length 1/2, also in Ewald's sums: states, energy, equilibria."""
    coherent, vectors = (model(0.5, (3, 2, 2), mode, periodic) for mode in ("SU(N)", "dipole"))
    n = np.random.default_rng(2).standard_normal((24, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    x, method = coherent.coherent(n), co.GaussLegendre(2)
    assert abs(coherent.energy(x) - vectors.energy(n.ravel())) < 1e-12
    runs = [
        co.integrate(system, start, (1, 2), 0.02, method) for system, start in ((coherent, x), (vectors, n.ravel()))
    ]
    np.testing.assert_allclose(2 * runs[0].x, runs[1].x, rtol=0, atol=1e-11)
    with refused(ValueError, "once"):
        coherent.dipolar()
    H = coherent.hamiltonian.hessian(x)
    np.testing.assert_allclose(H / 4, vectors.hamiltonian.hessian(n.ravel()), rtol=0, atol=1e-12)


def test_two_dipoles_at_a_temperature():
    """Sites of S = 1/2 are drawn uniformly from the sphere: the mean energy is that of classical dipoles."""
    pair = co.spins.crystal(lattice=(3, 9, 9, 90, 90, 90), sites={"A": (0, 0, 0)})
    spins = co.systems.spins(pair, (2, 1, 1), spin=0.5, g=8.0, units="natural", periodic=False, mode="SU(N)").dipolar()
    strength, kT = (8.0 * 0.5) ** 2 / 27, 0.4
    height, weight = np.polynomial.legendre.leggauss(60)

    def log_z(beta):
        local = strength * np.sqrt(1.0 + 3.0 * height**2)
        return np.log(np.sum(weight * np.sinh(beta * local) / (beta * local)))

    expected = -(log_z(1.0 / kT + 1e-5) - log_z(1.0 / kT - 1e-5)) / 2e-5
    states = co.thermal_states(spins, kT, 2000, sweeps=60, seed=3)
    means = states.energy[20:].mean(axis=0)
    assert abs(means.mean() - expected) < 4.5 * means.std() / np.sqrt(2000) < 0.05
    np.testing.assert_allclose(states.energy[-1], spins.energy(states.x), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", co.forces.names())
def test_every_force_in_both_orders(name, tmp_path):
    """With each force that the model takes without dipoles: small steps by DOP853; resumed, and as a member."""
    for first in (True, False):
        forces = [force_on(name, model()), co.forces.LinearDamping(0.1)][:: 1 if first else -1]
        try:
            co.integrate(
                model(dipoles=False).with_forces(*forces), model().random(1), (0, 0.1), 0.05, co.GaussLegendre(2)
            )
        except (TypeError, ValueError):
            return
        one, other = (model(J=strength).with_forces(*forces) for strength in (0.05, 0.3))
        x, given = one.random(1), {"t_span": (1.0, 1.4), "step": 0.05, "method": co.GaussLegendre(2)}
        run = co.integrate(one, x, **given)
        members = co.integrate(co.batch([other, one]), [x, x], **given, threads=2)
        if not is_noise(name):  # whose numbers are those of the member
            assert members.x[:, 1].tobytes() == run.x.tobytes()
            exact = solve_ivp(lambda t, y, s=one: s.vector_field(y, t), (1, 1.4), x, "DOP853", rtol=1e-10, atol=1e-12)
            fine = co.integrate(one, x, **{**given, "step": 0.0125}).x[-1] - exact.y[:, -1]
            # Steps of a quarter: errors of order one fall to a fourth, those of higher order to less.
            assert np.abs(fine).max() < 0.3 * np.abs(run.x[-1] - exact.y[:, -1]).max() + 1e-9
        path = tmp_path / f"run{first}.zarr"
        co.integrate(one, x, **{**given, "t_span": (1.0, 1.2)}, archive=path)
        check_same(co.resume(path, 1.4, system=one), run)


def test_derivatives_by_constants():
    """By the exchange and the start, forward and backward, against differences of other models."""
    x, span, h, method = model().random(1), (0.3, -0.1), 1e-4, co.GaussLegendre(2)
    ready = co.prepare(model(), method, step=0.02)
    sol, pullback = ready.vjp(x, span)
    v, w = np.random.default_rng(4).standard_normal((2, len(x)))
    gradient = pullback(x=np.concatenate([np.zeros((len(sol.x) - 1, len(x))), w[None]]))
    for by, moved in (({"J1": 1.0}, (1, 0 * v)), ({"x0": v}, (0, v))):
        found = ready.jvp(x, span, by)[1].x[-1]
        up, down = (
            co.integrate(model(J=J + s * h * moved[0]), x + s * h * moved[1], span, 0.02, method).x[-1] for s in (1, -1)
        )
        np.testing.assert_allclose(found, (up - down) / (2 * h), rtol=0, atol=1e-6)
    np.testing.assert_allclose(gradient["J1"], w @ ready.jvp(x, span, {"J1": 1.0})[1].x[-1], rtol=1e-9)


@pytest.mark.parametrize(
    ("method", "mode", "schemes"),
    [
        (method, mode, schemes)
        for method in (co.Splitting(order=4), co.Taylor(8), co.IsospectralGauss(), co.Kahan())
        for mode, schemes in (("dipole", "SphericalMidpoint"), ("SU(N)", "CommutatorFree"))
    ]
    + [(co.SphericalMidpoint(), "SU(N)", "CommutatorFree")],
    ids=str,
)
def test_schemes_that_do_not_take_dipoles_name_those_that_do(method, mode, schemes):
    system = model(mode=mode)
    x = system.random(1) if mode == "SU(N)" else np.ones(system.dim)
    with refused(ValueError, "GaussLegendre", schemes) as caught:
        co.integrate(system, x, (0, 1), 0.1, method)
    assert "or Splitting" not in str(caught.value) and "take Splitting" not in str(caught.value)


@pytest.mark.parametrize("h", [0.02, -0.005])
def test_the_midpoint_of_many_sites_is_solved_to_round_off(h):
    """More than 341 sites reuse the field of the dipoles in the iteration while nothing is seen of it."""
    chain = co.spins.crystal(lattice=(3, 9, 9, 90, 90, 90), sites={"A": (0, 0, 0)})
    system = co.systems.spins(chain, (343, 1, 1), spin=1, g=20.0, units="meV", periodic=False, mode="SU(N)")
    system = system.exchange(chain.bonds(4)["1"], 0.3).dipolar()
    run = co.integrate(system, system.random(1), (1.0, 1.0 + 4 * h), abs(h), co.GaussLegendre(1))
    for before, after in zip(run.x[:-1], run.x[1:], strict=True):
        slope = system.vector_field((before + after) / 2)
        # The sum of a step, the mean of its ends, and the transforms, of some ten levels.
        assert np.abs(after - before - h * slope).max() < 16 * 2.0**-53 * (1.0 + abs(h) * np.abs(slope).max())


def test_modes_at_all_wave_vectors_are_the_small_motions_of_the_lattice():
    """With Ewald's sum, as strong as the single-ion anisotropy: the modes by q are those of the whole lattice."""
    iron = co.spins.crystal(co.spins.structure("FeI2")).subcrystal("Fe")
    system = co.systems.spins(iron, (3, 3, 2), spin=1, g=40.0, units="meV", mode="SU(N)").dipolar()
    system = system.exchange(iron.bonds(5)["1"], -0.2).single_ion("Fe", {"B20": -1.0})
    found = co.equilibrium(system, system.coherent((0.1, 0.0, 1.0)))
    corners = np.array(list(np.ndindex(system.size))) / system.size
    modes = co.spectra.linear_modes(system, found.x, corners, points=1)
    frequencies = np.sort(modes.frequencies.ravel())
    repeated = np.repeat(found.frequencies, len(frequencies) // len(found.frequencies))
    assert repeated[-1] > 5.0
    np.testing.assert_allclose(frequencies, repeated, rtol=1e-7, atol=1e-6 * frequencies[-1])
