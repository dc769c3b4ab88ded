"""Heat baths sample the Boltzmann distribution, for one spin and for a ring of spins."""

import numpy as np
from scipy import special, stats

import coadjoint as co
from rounding import UNIT_ROUNDOFF


def starts(members, spins, seed):
    S = np.random.default_rng(seed).standard_normal((members, spins, 3))
    return (S / np.linalg.norm(S, axis=-1, keepdims=True)).reshape(members, 3 * spins)


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
    M = np.zeros((3 * spins, 3 * spins))
    for a in range(spins):
        b = (a + 1) % spins
        for c in range(3):
            M[3 * a + c, 3 * b + c] = M[3 * b + c, 3 * a + c] = -1.0
    algebra = co.algebras.copies(co.algebras.so(3), spins)
    ring = co.LiePoissonSystem(algebra, co.Quadratic(M)).with_forces(co.forces.HeatBath(0.5, temperature=T, seed=2))
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
