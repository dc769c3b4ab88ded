"""Commutator-free methods on matrices: order, spectrum, exponentials, and what is not kept."""

import numpy as np
import pytest
from scipy.linalg import expm
from torus_flows import first_modes, last_modes

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF


def body(N):
    """A body of N dimensions with random moments, on so(N)."""
    a = np.random.default_rng(N).uniform(1.0, 2.0, N)
    return co.MatrixSystem(co.MatrixAlgebra("so", N), co.systems.Weights(1 / np.add.outer(a, a)), name="body")


SYSTEMS = {
    "torus": co.systems.torus_euler(N=5),
    "sphere": co.systems.sphere_euler(N=6),
    "body": body(5),
    "two layers": co.TwoLayerSystem(
        co.MatrixAlgebra("u", 4),
        co.systems.Weights(1 / (1 + np.add.outer(np.arange(4.0), np.arange(4.0)))),
        co.systems.Weights(np.add.outer(np.arange(4.0), np.arange(4.0)) / 4),
    ),
    "u": co.MatrixSystem(
        co.MatrixAlgebra("u", 4), co.systems.Weights(np.add.outer(np.arange(4.0), np.arange(4.0))), name="u"
    ),
}


def state(system, seed, size=1.0):
    rng = np.random.default_rng(seed)
    W = rng.standard_normal(system.shape) + 1j * system.complex * rng.standard_normal(system.shape)
    W = system.algebra.projected(W if system.complex else W.real)
    return size * W / np.linalg.norm(W.reshape(-1, system.algebra.N), 2)


def last(system, W, time, steps, method):
    return co.integrate(system, W, (0.0, time), abs(time) / steps, method, save_every=steps, watch=False).x[-1]


@pytest.mark.thinned(6)
@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("name", SYSTEMS)
def test_order_and_spectrum(name, order):
    """Slopes, forward and backward, against six stages; the spectrum moves by rounding alone."""
    system = SYSTEMS[name]
    W, method = state(system, 1), co.CommutatorFree(order)
    for time in (2.0, -2.0):
        exact = last(system, W, time, 64, co.IsospectralGauss(6))
        assert np.linalg.norm(exact - W) > 0.05
        found = [last(system, W, time, steps, method) for steps in (32, 64)]
        errors = [np.linalg.norm(x - exact) for x in found]
        assert abs(np.log2(errors[0] / errors[1]) - order) < 0.3
        assert np.abs(system.spectrum(found[1]) - system.spectrum(W)).max() < 64 * UNIT_ROUNDOFF


@pytest.mark.thinned(4)
@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_kernels_do_the_plain_reading(name, order):
    system, method = SYSTEMS[name], co.CommutatorFree(order)
    # in the second place the exponentials take several substeps
    for size in (1.0, 6.0):
        W = state(system, 2, size)
        plain = method.step(system, W, 0.0, 0.7)
        assert np.abs(last(system, W, 0.7, 1, method) - plain).max() < 256 * UNIT_ROUNDOFF * size * size
        flat = method.step(system, system.to_vector(W), 0.0, 0.7)
        assert np.array_equal(flat, system.to_vector(plain))


def test_one_exponential_is_that_of_a_matrix():
    """The second stage of order 2 is U W U* with U = exp(h/2 P)."""
    system = SYSTEMS["sphere"]
    W, h = state(system, 3), 0.8
    U = expm(h / 2 * system.stream(W))
    middle = U @ W @ np.conj(U.T)
    U = expm(h * system.stream(middle))
    found = last(system, W, h, 1, co.CommutatorFree(2))
    assert np.abs(found - U @ W @ np.conj(U.T)).max() < 64 * UNIT_ROUNDOFF


def test_the_energy_drifts_and_the_spectrum_does_not():
    """Over 2000 steps; the energy of a scheme that is a Poisson map comes back."""
    system = SYSTEMS["torus"]
    W = state(system, 6, 2.0)
    sol = co.integrate(system, W, (0.0, 1000.0), 0.5, co.CommutatorFree(2), save_every=100)
    assert np.abs(system.spectrum(sol.x) - system.spectrum(W)).max() < 1e-14
    assert np.array_equal(sol.x[-1], -np.conj(sol.x[-1].T))
    energy = system.energy(sol.x)
    other = co.integrate(system, W, (0.0, 1000.0), 0.5, co.LineSplitting(2), save_every=100)
    assert np.abs(energy - energy[0]).max() > 3 * np.abs(system.energy(other.x) - energy[0]).max()


def test_a_step_beyond_its_series_fails_by_name():
    system = SYSTEMS["sphere"]
    with refused(co.IntegrationError, "too large for its series"):
        co.integrate(system, state(system, 7, 1e6), (0.0, 1.0), 1.0, co.CommutatorFree())


def test_properties():
    for system in SYSTEMS.values():
        said = co.CommutatorFree().properties(system)
        assert not said.poisson and said.casimirs == "all" and said.attitude == "none"
    with refused(ValueError, "attitude"):
        co.integrate(SYSTEMS["body"], np.zeros((5, 5)), (0, 1), 0.1, co.CommutatorFree(), attitude=np.eye(5))


def test_forty_digits():
    """Seven by seven modes of a fluid on the torus at t = 1: the slope, and the value that it leads to."""
    system = co.systems.torus_euler(N=7)
    start, exact = system.from_modes(first_modes(7)), system.from_modes(last_modes(7))
    errors = [np.abs(last(system, start, 1.0, n, co.CommutatorFree(4)) - exact).max() for n in (16, 32, 512)]
    assert abs(np.log2(errors[0] / errors[1]) - 4) < 0.3 and errors[2] < 1e-12


@pytest.mark.parametrize("h", [1.0, -3.0])
def test_a_step_in_python_is_that_of_exact_exponentials_for_streams_of_any_shape(h):
    """The norm of a commutator is that of both sides, however much the sums of rows and columns differ."""
    for P in (np.diag([0.9, 0.0, -0.9, 0.4]), np.ones((4, 1)) * [1.2, 0.0, 0.0, -0.3], 2.0 * np.eye(4, k=2)):
        system = co.MatrixSystem(co.MatrixAlgebra("gl", 4), co.systems.Weights(np.zeros((4, 4))), P)
        W = np.random.default_rng(3).uniform(-1.0, 1.0, (4, 4))
        U, V = expm(h * P), expm(-h * P)
        exact, scale = U @ W @ V, np.abs(U) @ np.abs(W) @ np.abs(V)
        for order in (2, 3, 4):
            found = co.CommutatorFree(order).step(system, W, 0.0, h)
            # Substeps of norm one, each a series with sums of at most exp(1): some roundings of each.
            assert np.abs(found - exact).max() < 256 * UNIT_ROUNDOFF * scale.max()
