"""Fluids in motion: known solutions, references of many digits, symmetries, Poisson maps, and the limit of large N."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from fluids_by_modes import generators, last
from scipy.linalg import expm

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF
from torus import first_modes, last_modes, of_size, smooth

REFERENCE = json.loads(Path(__file__).with_name("zeitlin_reference.json").read_text())
SPHERE, TORUS = co.systems.sphere_euler(N=8), co.systems.torus_euler(N=7)
TURNING = co.systems.sphere_euler(N=8, rotation=-0.9)
FLUIDS = pytest.mark.parametrize("s", [SPHERE, TURNING, TORUS], ids=["sphere", "rotating sphere", "torus"])


def test_rossby_and_haurwitz_in_su5_to_12_digits():
    given = REFERENCE["sphere"]
    s = co.systems.sphere_euler(N=given["N"])
    W0, wanted = (np.array(given[name]) @ [1, 1j] for name in ("W0", "Wt"))
    assert np.abs(s.exact(W0, given["t"]) - wanted).max() < 1e-12
    assert np.abs(last(s, W0, given["t"], 1 / 32, co.IsospectralGauss(8)) - wanted).max() < 1e-12


@pytest.mark.parametrize("rotation", [0.0, 0.8, -2.0])
def test_the_phase_speed_of_rossby_and_haurwitz(rotation):
    """The pattern turns by zonal - 2 (zonal + rotation)/(l(l + 1)), whatever N."""
    for N in (7, 12):
        s = co.systems.sphere_euler(N=N, rotation=rotation)
        W = s.rossby_haurwitz(5, 4, zonal=1.3, wave=0.6)
        t = 0.75
        moved = (1.3 - 2 * (1.3 + rotation) / 30) * t
        wanted = s.rossby_haurwitz(5, 4, zonal=1.3, wave=0.6, longitude=moved)
        assert np.abs(s.exact(W, t) - wanted).max() < 1e-13 * N * np.abs(W).max()
        assert np.abs(last(s, W, t, 1 / 64) - wanted).max() < 1e-11 * np.abs(W).max()


@pytest.mark.parametrize("rotation", [0.0, 1.1])
def test_the_exact_motion_about_any_axis(rotation):
    s = co.systems.sphere_euler(N=9, rotation=rotation)
    modes = {(1, 0): 0.7, (1, 1): 0.4 - 0.9j, (6, 2): 1j, (6, 5): -0.5, (6, 0): 0.3}
    W = s.from_modes(modes, absolute=False)
    times = np.array([0.0, 0.5, -0.75])
    exact = s.exact(W, times)
    assert exact.shape == (3, 9, 9) and np.abs(exact[0] - W).max() < 1e-13 * np.abs(W).max()
    for t, wanted in zip(times[1:], exact[1:], strict=True):
        assert np.abs(last(s, W, t, 1 / 64) - wanted).max() < 1e-11 * np.abs(W).max()
    zonal = s.zonal_jet(perturbation=0.0)
    np.testing.assert_array_equal(s.exact(zonal, [1.0, 2.0])[1], zonal)
    with refused(ValueError, "[2, 3]", "closed form"):
        s.exact(s.random(1, degrees=(2, 3)), 1.0)
    with refused(ValueError, "x0", "(2, 9, 9)"):
        s.exact(np.stack([W, W]), 1.0)


def test_a_trace_is_not_seen_by_the_stream():
    """The middle of a step has one: the stream leaves it out, and turns with the matrix all the same."""
    A = np.random.default_rng(1).standard_normal((8, 8, 2)) @ [1, 1j]
    A = A - A.conj().T
    assert abs(np.trace(A)) > 0.1
    P = SPHERE.stream(A)
    assert np.abs(P - SPHERE.stream(SPHERE.algebra.projected(A))).max() < 1e-14
    U = expm(np.einsum("a,aij->ij", [0.3, -0.5, 0.9], np.stack(generators(8))))
    assert np.abs(SPHERE.stream(U @ A @ U.conj().T) - U @ P @ U.conj().T).max() < 1e-13


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
def test_angular_momentum():
    """Constant without rotation; with it the part along the axis, and the others turn westward."""
    W = SPHERE.random(8, degrees=(1, 7))
    L = SPHERE.angular_momentum(np.stack([W, 2 * W]))
    assert L.shape == (2, 3) and np.array_equal(L[1], 2 * L[0])
    latitude, longitude = SPHERE.grid((40, 60), "gauss-legendre")
    weights = np.polynomial.legendre.leggauss(40)[1][:, None] * 2 * np.pi / 60
    field = weights * SPHERE.to_grid(W, (40, 60), "gauss-legendre")
    east, north = np.cos(latitude)[:, None], np.sin(latitude)[:, None]
    wanted = [(east * np.cos(longitude) * field).sum(), (east * np.sin(longitude) * field).sum(), (north * field).sum()]
    np.testing.assert_allclose(L[0], wanted, rtol=0, atol=1e-13)
    for h in (0.125, 0.5):
        end = last(SPHERE, W, 4.0, h, co.IsospectralGauss())
        assert np.abs(SPHERE.angular_momentum(end) - L[0]).max() < 1e-12
        turned = TURNING.angular_momentum(last(TURNING, W, 4.0, h, co.IsospectralGauss()))
        assert abs(turned[2] - L[0, 2]) < 1e-12 and np.abs(turned - L[0]).max() > 0.1
    t, Omega = 0.5, TURNING.rotation
    moved = TURNING.angular_momentum(last(TURNING, W, t, 1 / 32))
    cos, sin = np.cos(-Omega * t), np.sin(-Omega * t)
    np.testing.assert_allclose(moved, [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]] @ L[0], rtol=0, atol=1e-11)


@pytest.mark.parametrize(("degree", "order"), [(2, 0), (3, 1), (5, 4), (6, 6), (7, 2)])
def test_the_field_of_rossby_and_haurwitz(degree, order):
    """Solid rotation, and a harmonic of the given root mean square with a maximum at the given longitude."""
    from scipy.special import gamma, lpmv

    N, zonal, wave, longitude = 9, -0.7, 1.3, 0.4
    for s in (co.systems.sphere_euler(N=N), co.systems.sphere_euler(N=N, rotation=0.6)):
        W = s.relative(s.rossby_haurwitz(degree, order, zonal=zonal, wave=wave, longitude=longitude))
        latitude, east = s.grid((12, 30))
        # Without the phase of Condon and Shortley; the mean of the square over the sphere is one.
        factor = np.sqrt((2 if order else 1) * (2 * degree + 1) * gamma(degree - order + 1) / gamma(degree + order + 1))
        shape = (-1) ** order * factor * lpmv(order, degree, np.sin(latitude))
        wanted = 2 * zonal * np.sin(latitude)[:, None] + wave * shape[:, None] * np.cos(order * (east - longitude))
        np.testing.assert_allclose(s.to_grid(W, (12, 30)), wanted, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("speed", "perturbation", "waves"), [(0.8, 0.0, 2), (2.0, 0.05, 1), (0.5, -0.1, 3)])
def test_the_field_of_two_jets(speed, perturbation, waves):
    """u = speed / cosh^2 eastward at pi / 2 and westward at 3 pi / 2; the vorticity is -du/dy, and waves on both."""
    s, width = co.systems.torus_euler(N=65), 0.5
    W = s.zonal_jet(speed, width=width, perturbation=perturbation, waves=waves)
    x, y = s.grid((16, 80))
    wanted = np.zeros((16, 80))
    for sign, middle in ((1, np.pi / 2), (-1, 3 * np.pi / 2)):
        for turn in 2 * np.pi * np.arange(-3, 4):
            away = (y - middle + turn) / width
            wanted += sign * 2 * speed / width * np.tanh(away) / np.cosh(away) ** 2
            wanted += perturbation * speed / width * np.cos(waves * x)[:, None] / np.cosh(away) ** 2
    # Waves beyond the 32nd are cut off: of the size exp(-32 pi width / 2), 1e-11, times some powers of 32.
    np.testing.assert_allclose(s.to_grid(W, (16, 80)), wanted, rtol=0, atol=1e-7)


@FLUIDS
def test_energy_is_that_of_the_relative_motion(s):
    """The integral over the surface, also of states in numbers and of several."""
    states = np.stack([s.random(10), s.random(11, degrees=(1, 3))])
    wanted = pytest.approx(s.energy_spectrum(states)[1].sum(axis=-1), rel=1e-12)
    assert s.energy(states) == wanted and s.energy(s.to_vector(states)) == wanted
    assert s.energy(states[0]) == pytest.approx(wanted.expected[0], rel=1e-12)


@pytest.mark.parametrize("N", [3, 5, 9])
def test_the_equation_of_the_modes(N):
    """w_n' = sum over m of N/(2 pi) sin(2 pi (m x n)/N) w_m w_(n - m)/|m|^2, term by term."""
    system = co.systems.torus_euler(N=N)
    W = smooth(system, N)
    w, squares, places = system.mode_array(W), of_size(N), range(N)
    slope = np.zeros((N, N), dtype=complex)
    for n1, n2, m1, m2 in np.ndindex(N, N, N, N):
        if (m1, m2) != (0, 0):
            sine = np.sin(2 * np.pi * (m1 * n2 - m2 * n1) / N)
            slope[n1, n2] += N / (2 * np.pi) * sine * w[m1, m2] * w[n1 - m1, n2 - m2] / squares[m1, m2]
    found = system.mode_array(system.vector_field(W))
    assert np.abs(found - slope).max() < 64 * N**2 * UNIT_ROUNDOFF * np.abs(slope).max()
    energy = sum(abs(w[i, j]) ** 2 / squares[i, j] / 2 for i in places for j in places if (i, j) != (0, 0))
    assert system.energy(W) == pytest.approx(4 * np.pi**2 * energy, rel=1e-13)


@pytest.mark.parametrize("N", [3, 5, 7])
def test_forty_digits(N):
    """The error of six stages with a step of 1/16 is below round-off."""
    system = co.systems.torus_euler(N=N)
    W0 = system.from_modes(first_modes(N))
    found = co.integrate(system, W0, (0.0, 1.0), 1 / 16, co.IsospectralGauss(6)).x[-1]
    assert np.abs(found - system.from_modes(last_modes(N))).max() < 1e-14


@pytest.mark.thinned(2)
@pytest.mark.parametrize("N", [3, 5, 9, 15, 45, 59, 77, 167])
def test_the_stream_of_the_kernels(N):
    """One step by Fourier transforms of every kind, of small primes, products, and primes by convolutions."""
    system = co.systems.torus_euler(N=N)
    W = smooth(system, 1)
    method = co.IsospectralGauss(1)
    found = co.integrate(system, W, (0.0, 0.02), 0.02, method).x[-1]
    moved = np.abs(found - W).max()
    # Its rounding, and that of the products, moves with the increment.
    assert np.abs(found - method.step(system, W, 0.0, 0.02)).max() < 64 * np.sqrt(N) * UNIT_ROUNDOFF * np.abs(W).max()
    assert moved > 1e-4 * np.abs(W).max()
