"""The dipolar energy by FFT: direct sums on every lattice, known pairs, runs, states at a temperature, refusals."""

from fractions import Fraction

import numpy as np
import pytest
from bonds_and_spins import positions_of

import coadjoint as co
from refusals import refused

SHAPES = {"chain": 7, "square": (4, 5), "triangular": (3, 4), "honeycomb": (3, 2), "kagome": (2, 4), "cubic": (2, 3, 4)}


def directly(positions, spins):
    """Energy by the sum over pairs, one after the other."""
    total = 0.0
    for i in range(len(spins)):
        for j in range(i):
            r = np.zeros(3)
            r[: positions.shape[1]] = positions[i] - positions[j]
            size = np.linalg.norm(r)
            total += (spins[i] @ spins[j] - 3.0 * (spins[i] @ r) * (spins[j] @ r) / size**2) / size**3
    return total


@pytest.mark.parametrize("name", SHAPES)
def test_energy_and_gradient_are_those_of_the_sum_over_pairs(name):
    system = co.systems.spin_lattice(name, SHAPES[name], exchange=0.0, dipolar=0.7)
    x = np.random.default_rng(1).normal(size=system.dim)
    positions = positions_of(name, SHAPES[name])
    assert np.isclose(system.energy(x), 0.7 * directly(positions, x.reshape(-1, 3)), rtol=1e-13)
    # The energy is quadratic, so that a central difference is exact.
    gradient = system.hamiltonian.gradient(x)
    for i in range(0, system.dim, 5):
        e = np.eye(system.dim)[i]
        assert np.isclose(gradient[i], (system.energy(x + e) - system.energy(x - e)) / 2, rtol=0, atol=1e-12)
    assert np.allclose(system.hamiltonian.hessian(x) @ x, gradient, rtol=0, atol=1e-13)
    derivative = system.hamiltonian.gradient(x + 1e-20j * e).imag / 1e-20
    assert np.allclose(derivative, system.hamiltonian.hessian(x) @ e, rtol=0, atol=1e-14)


def test_couplings_add_up():
    options = {"exchange": 0.4, "dm": (0.1, 0.2, 0.3), "on_site": (0.1, 0.0, 0.2), "field": (0.0, 0.3, 0.1)}
    given = (options, {"exchange": 0.0, "dipolar": -0.3}, {**options, "dipolar": -0.3})
    *parts, both = (co.systems.spin_lattice("square", (3, 3), **each) for each in given)
    x = np.random.default_rng(2).normal(size=27)
    assert np.isclose(both.energy(x), sum(part.energy(x) for part in parts), rtol=1e-13)
    assert np.allclose(both.vector_field(x), sum(part.vector_field(x) for part in parts), rtol=0, atol=1e-13)
    assert not both.integrals and "dipolar" not in parts[0].parameters
    with refused(TypeError, "closed form", "spin_lattice"):
        both.exact(x, 1.0)


def test_runs_conserve_energy_and_lengths():
    """The midpoint rule conserves quadratic energies, the spherical one lengths; both have order two."""
    lattice = co.systems.spin_lattice("square", (3, 3), dipolar=0.5, field=(0.0, 0.0, 0.3))
    x0 = np.random.default_rng(3).normal(size=(2, 9, 3))
    x0 = (x0 / np.linalg.norm(x0, axis=2, keepdims=True)).reshape(2, 27)
    fine = co.integrate(lattice, x0, (0, 1), 0.05, method=co.GaussLegendre(3)).x[-1]
    for method in (co.GaussLegendre(1), co.SphericalMidpoint()):
        coarse, half = (co.integrate(lattice, x0, (0, 1), step, method=method) for step in (0.05, 0.025))
        assert 3.0 < np.abs(coarse.x[-1] - fine).max() / np.abs(half.x[-1] - fine).max() < 5.0
        assert np.allclose(np.linalg.norm(coarse.x.reshape(-1, 3), axis=1), 1.0, rtol=0, atol=1e-13)
        assert (coarse.drift()["energy"] < 1e-13) == (method == co.GaussLegendre(1))


@pytest.mark.parametrize("method", ["heat bath", "Metropolis"])
def test_two_dipoles_at_a_temperature(method):
    """By quadrature over the first; the partition function of the second in its field is elementary."""
    kT, strength = 0.7, 0.9
    height, weight = np.polynomial.legendre.leggauss(60)  # along the bond

    def log_z(beta):
        local = strength * np.sqrt(1.0 + 3.0 * height**2)
        return np.log(np.sum(weight * np.sinh(beta * local) / (beta * local)))

    expected = -(log_z(1.0 / kT + 1e-5) - log_z(1.0 / kT - 1e-5)) / 2e-5
    pair = co.systems.spin_lattice("chain", 2, exchange=0.0, dipolar=strength)
    states = co.thermal_states(pair, kT, 2000, sweeps=100, seed=3, method=method)
    means = states.energy[20:].mean(axis=0)
    assert abs(means.mean() - expected) < 4.5 * means.std() / np.sqrt(2000) < 0.05
    assert np.allclose(states.energy[-1], pair.energy(states.x), rtol=0, atol=1e-13)


def test_large_lattices_have_no_second_derivatives():
    small, large = (co.systems.spin_lattice("chain", sites, dipolar=0.2) for sites in (341, 342))
    assert small.hamiltonian.hessian(np.ones(small.dim)).shape == (1023, 1023)
    with refused(TypeError, "second derivatives"):
        large.hamiltonian.hessian(np.ones(large.dim))
    for lattice in (small, large, large.with_forces(co.forces.LinearDamping(0.1))):
        with refused(ValueError, "Splitting", "dipoles", "GaussLegendre(1)", "SphericalMidpoint"):
            co.integrate(lattice, np.ones(lattice.dim), (0, 1), 0.1, method=co.Splitting(order=4))
    pair = co.systems.spin_lattice(dipolar=1.0)
    with refused(TypeError, "FFT"):
        pair.energy([Fraction(1, 2)] * 6)
