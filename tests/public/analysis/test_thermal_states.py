"""States and runs at a temperature: exact energies of spins, chains and rings, series of lattices, densities."""

import numpy as np
import pytest
from scipy import special, stats

import coadjoint as co
from rounding import UNIT_ROUNDOFF

METHODS = {
    "heat bath": {},
    "Metropolis": {"method": "Metropolis"},
    "over-relaxation": {"over_relaxation": 2},
}


def langevin(k):
    return 1.0 / np.tanh(k) - 1.0 / k


def check(states, expected, per=1.0, transient=50):
    """Compare energies (times, members) with the exact one, and return the error; the members are independent."""
    means = states.energy[transient:].mean(axis=0) / per
    error = means.std(ddof=1) / np.sqrt(len(means))
    assert abs(means.mean() - expected) < 4.5 * error, (means.mean(), error, expected)
    return error


@pytest.mark.parametrize("how", METHODS)
@pytest.mark.thinned(3)
def test_open_chain_has_the_energy_of_langevin(how):
    """Fisher (1964): -J L(J/kT) for each bond, ferromagnetic or not."""
    for J, kT in ((1.0, 0.3), (-0.7, 1.4)):
        chain = co.systems.spin_lattice("chain", 12, exchange=J)
        states = co.thermal_states(chain, kT, 200, sweeps=300, seed=3, **METHODS[how])
        assert check(states, -J * langevin(J / kT), per=11) < 3e-3


@pytest.mark.thinned(1)
@pytest.mark.parametrize("how", METHODS)
def test_two_spins_with_every_coupling(how):
    """By quadrature over the first spin; that of the second, in its local field, is elementary."""
    tensor, D = np.array([[1.0, 0.2, 0.0], [-0.1, 0.7, 0.3], [0.0, 0.1, 1.4]]), np.array([0.3, -0.5, 0.8])
    fields, kT = np.array([[0.4, 0.1, -0.2], [-0.3, 0.2, 0.5]]), 0.6
    on_site = np.zeros((2, 3, 3))
    on_site[0] = [[0.5, 0.2, 0.0], [0.2, -0.3, 0.1], [0.0, 0.1, 0.4]]
    pair = co.systems.spin_lattice(exchange=0.9, tensor=tensor, dm=D, field=fields, on_site=on_site)
    height, weight = np.polynomial.legendre.leggauss(60)
    turn = 2.0 * np.pi * np.arange(60) / 60
    radius = np.sqrt(1.0 - height**2)[:, None]
    S = np.stack(np.broadcast_arrays(radius * np.cos(turn), radius * np.sin(turn), height[:, None]), axis=-1)
    local = np.linalg.norm(0.9 * S @ tensor - np.cross(D, S) + fields[1], axis=-1)
    own = S @ fields[0] + np.einsum("...a,ab,...b->...", S, on_site[0], S)

    def log_z(beta):
        return np.log(np.sum(weight[:, None] * np.exp(beta * own) * np.sinh(beta * local) / (beta * local)))

    expected = -(log_z(1.0 / kT + 1e-5) - log_z(1.0 / kT - 1e-5)) / 2e-5
    states = co.thermal_states(pair, kT, 500, sweeps=100, seed=2, **METHODS[how])
    assert check(states, expected, transient=30) < 0.01
    assert states.acceptance.max() <= 1.0
    assert np.allclose(states.energy[-1], pair.energy(states.x), rtol=0, atol=1e-13)


@pytest.mark.parametrize("how", METHODS)
@pytest.mark.parametrize("K", [-2.0, 1.5])
def test_one_spin_of_any_length_with_anisotropy_in_a_field(K, how):
    length, B, kT = 1.6, 0.7, 0.8
    spin = co.systems.spin_lattice([], 1, field=(0.0, 0.0, B), on_site=(0.0, 0.0, K))
    z, weight = np.polynomial.legendre.leggauss(80)
    boltzmann = weight * np.exp((B * length * z + K * (length * z) ** 2) / kT)
    states = co.thermal_states(spin, kT, 4000, sweeps=40, seed=9, x0=(0.0, 0.0, -length), **METHODS[how])
    for power in (1, 2):
        values = (states.x[:, 2] / length) ** power
        expected = np.sum(boltzmann * z**power) / np.sum(boltzmann)
        assert abs(values.mean() - expected) < 4.5 * values.std() / np.sqrt(len(values))


@pytest.mark.long
def test_cubic_lattice_has_the_published_cumulant_at_its_critical_point():
    """C. Holm, W. Janke, Phys. Rev. B 48, 936 (1993): J/kT = 0.6930(1), 1 - <m^4> / (3 <m^2>^2) = 0.6217(8)."""
    cubic = co.systems.spin_lattice("cubic", (6, 6, 6), periodic=True)
    states = co.thermal_states(cubic, 1.0 / 0.693, 2000, sweeps=100, seed=1, over_relaxation=2)
    square = np.sum(states.x.reshape(2000, -1, 3).mean(axis=1) ** 2, axis=1)
    blocks = square.reshape(20, 100)
    cumulants = 1.0 - np.mean(blocks**2, axis=1) / (3.0 * np.mean(blocks, axis=1) ** 2)
    error = cumulants.std(ddof=1) / np.sqrt(20)
    assert abs(1.0 - np.mean(square**2) / (3.0 * np.mean(square) ** 2) - 0.6217) < 4.0 * error < 0.01


def test_recorded_energies_are_those_of_the_system_with_its_constants():
    pair = co.systems.spin_lattice(field=(0.1, 0.2, 0.3), on_site=(0.0, 0.4, 0.5))
    parts = [pair.hamiltonian, co.Quadratic(np.zeros(6), constant=1.5), co.Quadratic(np.zeros(6), constant=-0.25)]
    raised = co.LiePoissonSystem(pair.algebra, sum(parts[1:], start=parts[0]), sign=pair.sign)
    states = co.thermal_states(raised, 0.5, 3, seed=1, sweeps=4)
    assert np.allclose(states.energy[-1], [raised.energy(x) for x in states.x], rtol=1e-13)
    assert np.allclose(states.energy, co.thermal_states(pair, 0.5, 3, seed=1, sweeps=4).energy + 1.25, rtol=1e-13)


@pytest.mark.parametrize("how", METHODS)
def test_lengths_of_spins_are_constant(how):
    lengths = np.array([0.0, 1e-3, 0.4, 1.0, 2.0, 30.0])
    x0 = np.concatenate([length * np.array([0.36, 0.48, 0.8]) for length in lengths])
    chain = co.systems.spin_lattice("chain", 6, on_site=(0.0, 0.0, 0.1))
    states = co.thermal_states(chain, 0.7, sweeps=1000, seed=1, x0=x0, **METHODS[how])
    found = np.linalg.norm(states.x.reshape(6, 3), axis=1)
    assert np.allclose(found, lengths, rtol=4e-16, atol=0) and not np.allclose(states.x[0], x0)


def test_every_sweep_of_over_relaxation_is_a_half_turn():
    """Of spins without couplings, about the field: two of them are none, and three of them one."""
    free = co.systems.spin_lattice("chain", 5, exchange=0.0, field=(0.3, -0.2, 0.5))
    found = [co.thermal_states(free, 0.7, 3, sweeps=4, seed=2, over_relaxation=k).x for k in range(4)]
    along = np.reshape([0.3, -0.2, 0.5], (1, 3)) / np.linalg.norm([0.3, -0.2, 0.5])
    drawn = found[0].reshape(-1, 3)
    turned = 2.0 * (drawn @ along.T) * along - drawn
    for k, spins in enumerate(found):
        np.testing.assert_allclose(spins.reshape(-1, 3), turned if k % 2 else drawn, rtol=0, atol=1e-14)


def test_a_member_has_the_same_bits_alone_and_continues_from_its_own_state():
    lattice = co.systems.spin_lattice("triangular", (3, 4), dm=(0, 0, 0.3), on_site=(0, 0, 0.5), field=(0.1, 0, 0))
    kT = np.linspace(0.3, 2.0, 7)
    options = {"sweeps": 6, "seed": 8, "over_relaxation": 1}
    for method in ("heat bath", "Metropolis"):
        states = co.thermal_states(lattice, kT, method=method, **options)
        alone = co.thermal_states(lattice, kT[0], method=method, **options)
        assert states.x.shape == (7, 36) and states.temperature.tolist() == kT.tolist()
        assert np.array_equal(states.x[:1], alone.x) and np.array_equal(states.energy[:, :1], alone.energy)
        other = co.thermal_states(lattice, kT, method=method, **{**options, "seed": 9})
        assert np.all(np.any(other.x != states.x, axis=1)) and len(np.unique(states.x[:, 0])) == 7
        later = co.thermal_states(lattice, kT, method=method, x0=states.x, **options)
        assert np.allclose(later.energy[0], states.energy[-1], rtol=1e-12, atol=1e-12)


def starts(members, spins, seed):
    S = np.random.default_rng(seed).standard_normal((members, spins, 3))
    return (S / np.linalg.norm(S, axis=-1, keepdims=True)).reshape(members, 3 * spins)


def test_members_that_are_not_swept_together_have_their_own_starts_and_temperatures():
    """Those beyond 2^15 spins are swept later: the last ones stay near the state of lowest energy, others do not."""
    pair, members = co.systems.spin_lattice(exchange=1.0), 2**14 + 5
    x0, kT = starts(members, 2, 1), np.ones(members)
    x0[-4:], kT[-4:] = np.tile([0.6, 0.0, 0.8], 2), 1e-6
    states = co.thermal_states(pair, kT, x0=x0, sweeps=2, seed=3)
    np.testing.assert_allclose(states.energy[0], pair.energy(x0), rtol=0, atol=16 * UNIT_ROUNDOFF)
    np.testing.assert_allclose(states.energy[-1], pair.energy(states.x), rtol=0, atol=16 * UNIT_ROUNDOFF)
    assert np.all(np.abs(states.energy[:, -4:] + 1.0) < 1e-4) and np.std(states.energy[-1, :-4]) > 0.1
    assert len(np.unique(states.x[:, 0])) == members
    alone = co.thermal_states(pair, kT[:2], x0=x0[:2], sweeps=2, seed=3)
    assert np.array_equal(states.x[:2], alone.x)


def test_spin_in_a_field_has_boltzmann_density():
    """cos(theta) has the density exp(b cos(theta)), b = B/kT, for both signs of the bracket."""
    B, T, members = 1.5, 0.75, 300
    for sign, seed in ((1, 5), (-1, 6)):
        spin = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(0, 0, 1): -B}), sign=sign)
        bath = co.forces.HeatBath(0.5, temperature=T, seed=seed)
        sol = co.integrate(
            spin.with_forces(bath), starts(members, 1, seed), (0, 12), 2**-3, co.Splitting(), save_every=96, watch=False
        )
        found, b = sol.x[-1, :, 2], B / T
        exact = stats.kstest(found, lambda c, b=b: (np.exp(b * c) - np.exp(-b)) / (np.exp(b) - np.exp(-b)))
        assert exact.pvalue > 1e-3
        wrong = [
            stats.kstest(found, lambda c, b=w: np.expm1(b * (c + 1)) / np.expm1(2 * b)).pvalue for w in (b / 2, 2 * b)
        ]
        assert max(wrong) < 1e-6, "half or twice the noise must be detected"
        assert np.max(np.abs(np.sum(sol.x[-1] ** 2, axis=1) - 1.0)) < 8 * 192 * UNIT_ROUNDOFF
        assert abs(np.mean(np.exp(1j * np.arctan2(sol.x[-1, :, 1], sol.x[-1, :, 0])))) < 4 / np.sqrt(members)


def ring_energy(K, spins):
    """- d ln Z/dK of the classical Heisenberg ring, for each bond: Z = sum_l (2 l + 1) i_l(K)^N."""
    l, e = np.arange(40), 1e-5

    def log_partition(k):
        return np.log(np.sum((2 * l + 1) * special.spherical_in(l, k) ** spins))

    return -(log_partition(K + e) - log_partition(K - e)) / (2 * e) / spins


def test_energy_and_specific_heat_of_a_spin_ring():
    """Against transfer functions, within the sampling error."""
    spins, T, members = 6, 0.5, 48
    ring = co.systems.spin_lattice("ring", spins).with_forces(co.forces.HeatBath(0.5, temperature=T, seed=2))
    sol = co.integrate(ring, starts(members, spins, 1), (0, 40), 2**-4, co.Splitting(), save_every=16, watch=False)
    energies = sol.energy[16:] / spins  # from t = 16 on
    each = energies.mean(axis=0)  # members are independent
    exact, error = ring_energy(1.0 / T, spins), each.std(ddof=1) / np.sqrt(members)
    assert error < 0.01
    assert abs(each.mean() - exact) < 3 * error + (2**-4) ** 2
    # The variance of the energy is N T^2 times the specific heat, - K^2 du/dK.
    K, e = 1.0 / T, 1e-3
    heat = -(K**2) * (ring_energy(K + e, spins) - ring_energy(K - e, spins)) / (2 * e)
    squares = (energies - exact) ** 2 * spins / T**2
    spread = squares.mean(axis=0).std(ddof=1) / np.sqrt(members)
    assert abs(squares.mean() - heat) < 4 * spread
    assert max(drift for name, drift in sol.balance().items() if name != "energy") < 8 * 640 * UNIT_ROUNDOFF
