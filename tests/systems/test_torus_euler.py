"""The fluid on the torus: the sine bracket of its matrices, its equation for the modes, and its motion to 40 digits."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.fluids.torus_euler import torus_euler
from coadjoint.systems.matrices.torus_modes import modes_of_matrix
from torus import first_modes, last_modes, mode, of_size, smooth


@pytest.mark.parametrize("N", [3, 5, 7, 9])
def test_commutators_are_the_sine_bracket(N):
    """[T_m, T_n] = -2 i sin(2 pi (m x n)/N) T_(m + n), and T_n* = T_-n."""
    rng = np.random.default_rng(N)
    for m, n in rng.integers(-(N // 2), N // 2 + 1, (20, 2, 2)):
        A, B = mode(N, m), mode(N, n)
        factor = -2j * np.sin(2 * np.pi * (m[0] * n[1] - m[1] * n[0]) / N)
        assert np.abs(A @ B - B @ A - factor * mode(N, m + n)).max() < 32 * N * UNIT_ROUNDOFF
        assert np.abs(np.conj(A.T) - mode(N, -m)).max() < 32 * N * UNIT_ROUNDOFF


@pytest.mark.parametrize("N", [3, 5, 9])
def test_the_equation_of_the_modes(N):
    """w_n' = sum over m of N/(2 pi) sin(2 pi (m x n)/N) w_m w_(n - m)/|m|^2, term by term."""
    system = torus_euler(N=N)
    W = smooth(system, N)
    w, squares, places = modes_of_matrix(W), of_size(N), range(N)
    slope = np.zeros((N, N), dtype=complex)
    for n1, n2, m1, m2 in np.ndindex(N, N, N, N):
        if (m1, m2) != (0, 0):
            sine = np.sin(2 * np.pi * (m1 * n2 - m2 * n1) / N)
            slope[n1, n2] += N / (2 * np.pi) * sine * w[m1, m2] * w[n1 - m1, n2 - m2] / squares[m1, m2]
    found = modes_of_matrix(system.vector_field(W))
    assert np.abs(found - slope).max() < 64 * N**2 * UNIT_ROUNDOFF * np.abs(slope).max()
    energy = sum(abs(w[i, j]) ** 2 / squares[i, j] / 2 for i in places for j in places if (i, j) != (0, 0))
    assert system.energy(W) == pytest.approx(N**3 / (4 * np.pi) ** 2 * energy, rel=1e-13)


@pytest.mark.parametrize("N", [3, 5, 7])
def test_forty_digits(N):
    """The error of six stages with a step of 1/16 is below round-off."""
    system = torus_euler(N=N)
    W0 = system.from_modes(first_modes(N))
    found = co.integrate(system, W0, (0.0, 1.0), 1 / 16, co.IsospectralGauss(6)).x[-1]
    assert np.abs(found - system.from_modes(last_modes(N))).max() < 1e-14


@pytest.mark.thinned(2)
@pytest.mark.parametrize("N", [3, 5, 9, 15, 45, 59, 77, 167])
def test_the_stream_of_the_kernels(N):
    """One step by Fourier transforms of every kind, of small primes, products, and primes by convolutions."""
    system = torus_euler(N=N)
    W = smooth(system, 1)
    method = co.IsospectralGauss(1)
    found = co.integrate(system, W, (0.0, 0.02), 0.02, method).x[-1]
    moved = np.abs(found - W).max()
    # Its rounding, and that of the products, moves with the increment.
    assert np.abs(found - method.step(system, W, 0.0, 0.02)).max() < 64 * np.sqrt(N) * UNIT_ROUNDOFF * np.abs(W).max()
    assert moved > 1e-4 * np.abs(W).max()


def test_modes_there_and_back():
    system = torus_euler(N=7)
    W = smooth(system, 2)
    assert np.abs(system.from_modes(system.modes(W)) - W).max() < 1e-14
