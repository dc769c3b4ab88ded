"""Separable Hamiltonians that are no polynomials, on algebras that are not so(3) alone."""

import mpmath as mp
import numpy as np
import pytest

import coadjoint as co

CASES = {
    "A3,7": ({"a": 1.5}, (1.0, 0.7, -0.3), (0.7, 0.5, 0.4)),
    "e(3)": ({}, (1.0, 0.5, 0.4, 0.3, 0.0, 0.2), (0.7, -0.5, 0.9, 0.6, 0.2, 0.8)),
    "so(4)": ({}, (0.8, 0.4, 0.7, 0.3, 0.5, 1.0), (0.7, 0.5, -0.4, 0.6, -0.8, 0.3)),
}


def made(name, stiffness=1.25):
    constants, masses, x0 = CASES[name]
    return co.systems.separable_cosh(name, masses, stiffness, constants), np.array(x0)


def by_hand(system, masses, kappa, x):
    """J(x) grad H, from the structure constants one by one, in the numbers that x has."""
    force = [m * mp.sinh(kappa * y) / kappa for m, y in zip(masses, x, strict=True)]
    slope = [mp.mpf(0)] * len(x)
    for i, j, k, c in zip(*(column.tolist() for column in system.algebra.triples), strict=True):
        slope[i] += c * x[k] * force[j]
        slope[j] -= c * x[k] * force[i]
    return slope


@pytest.mark.parametrize("name", CASES)
def test_energy_field_and_motion(name):
    system, x0 = made(name)
    masses = CASES[name][1]
    energy = sum(m * (np.cosh(1.25 * y) - 1) / 1.25**2 for m, y in zip(masses, x0, strict=True))
    assert system.energy(x0) == pytest.approx(energy, rel=1e-14) and system.sign == 1
    with mp.workdps(20):
        field = [float(v) for v in by_hand(system, masses, mp.mpf(1.25), [mp.mpf(v) for v in x0])]
        motion = mp.odefun(lambda t, x: by_hand(system, masses, mp.mpf(1.25), x), 0, [mp.mpf(v) for v in x0])
        wanted = np.array([float(v) for v in motion(0.5)])
    np.testing.assert_allclose(system.vector_field(x0), field, rtol=0, atol=2e-15)
    found = co.integrate(system, x0, (0.0, 0.5), 1 / 32, co.GaussLegendre(6)).x[-1]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-14)


def test_hessian_and_small_momenta():
    system, x0 = made("A3,7", stiffness=2.0)
    np.testing.assert_allclose(
        np.diag(system.hamiltonian.hessian(x0)), (1.0, 0.7, -0.3) * np.cosh(2.0 * x0), rtol=1e-15
    )
    tiny = 1e-9 * x0
    assert system.energy(tiny) == pytest.approx(np.dot((0.5, 0.35, -0.15), tiny**2), rel=1e-14)
