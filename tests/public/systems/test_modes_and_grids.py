"""Modes and grids of sphere and torus: sums of harmonics and waves, there and back, and what is no field."""

import numpy as np
import pytest
import scipy.special
from fluids_by_modes import generators

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

N = 9
SPHERE, TORUS = co.systems.sphere_euler(N=N), co.systems.torus_euler(N=N)
GRIDS = ("clenshaw-curtis", "fejer", "gauss-legendre")


def harmonic(l, m, latitude, longitude):
    """Return Y_lm with the phase of Condon and Shortley, m >= 0."""
    factor = np.sqrt((2 * l + 1) / (4 * np.pi) * scipy.special.gamma(l - m + 1) / scipy.special.gamma(l + m + 1))
    return factor * scipy.special.lpmv(m, l, np.sin(latitude)) * np.exp(1j * m * longitude)


def summed(modes, latitude, longitude):
    found = np.zeros(np.broadcast_shapes(latitude.shape, longitude.shape))
    for (l, m), c in modes.items():
        if m >= 0:
            found += (c * harmonic(l, m, latitude, longitude)).real * (2 if m else 1)
    return found


def summed_waves(modes, x, y):
    return sum((w * np.exp(1j * (n1 * x - n2 * y))).real for (n1, n2), w in modes.items())


ROUNDED = 8 * N**2 * UNIT_ROUNDOFF


@pytest.mark.parametrize("points", GRIDS)
@pytest.mark.parametrize("shape", [None, (12, 7), (3, 1), (40, 61)])
def test_values_are_sums_of_harmonics(points, shape):
    W = SPHERE.random(3, degrees=(1, N - 1))
    latitude, longitude = SPHERE.grid(shape, points)
    wanted = summed(SPHERE.modes(W), latitude[:, None], longitude[None, :])
    found = SPHERE.to_grid(W, shape, points)
    assert found.shape == (len(latitude), len(longitude)) == (shape or (N + 1, 2 * N))
    # some N^2 products, with the functions of SciPy good to some N round-offs
    assert np.abs(found - wanted).max() < 8 * N**2 * UNIT_ROUNDOFF * np.abs(wanted).max() + 1e-13
    assert np.all(np.diff(latitude) < 0) and longitude[0] == 0.0


STEP = 1e-5  # of central differences in radians: errors of N^3 STEP^2/6, and of rounding over STEP


@pytest.mark.parametrize("points", GRIDS)
def test_velocities_are_derivatives_of_the_stream_function(points):
    """u = -d psi/d latitude, v = d psi/d longitude/cos(latitude), of members, by differences of sums of harmonics."""
    members = np.stack([SPHERE.random(seed, degrees=(1, N - 1)) for seed in (3, 4)])
    latitude, longitude = SPHERE.grid((7, 12), points)
    north, east = latitude[:, None], longitude[None, :]
    u, v = SPHERE.velocity(members, (7, 12), points)
    assert u.shape == v.shape == (2, 7, 12)
    for k, W in enumerate(members):
        psi = {(l, m): -c / (l * (l + 1)) for (l, m), c in SPHERE.modes(W).items()}
        southward = summed(psi, north - STEP, east) - summed(psi, north + STEP, east)
        eastward = summed(psi, north, east + STEP) - summed(psi, north, east - STEP)
        inner = np.cos(latitude) > 1e-6  # at the poles the direction is that of the meridian
        for found, wanted in ((u, southward), (v, eastward / np.cos(north))):
            assert np.abs((found[k] - wanted / (2 * STEP))[inner]).max() < 1e-8 * np.abs(u).max()
    flow = TORUS.random(5)
    x, y = TORUS.grid((10, 14))
    psi = {(a, b): -w / (a * a + b * b) for (a, b), w in TORUS.modes(flow).items()}
    along = [summed_waves(psi, x[:, None] + s, y[None, :]) for s in (-STEP, STEP)]
    across = [summed_waves(psi, x[:, None], y[None, :] + s) for s in (-STEP, STEP)]
    u, v = TORUS.velocity(flow, (10, 14))
    assert np.abs(u - (across[0] - across[1]) / (2 * STEP)).max() < 1e-8 * np.abs(u).max()
    assert np.abs(v - (along[1] - along[0]) / (2 * STEP)).max() < 1e-8 * np.abs(v).max()


@pytest.mark.parametrize("rotation", [0.0, 3.0])
def test_velocities_of_solid_rotations(rotation):
    """About any axis, relative to the frame: axis x r along east and north, also at the poles."""
    axis = np.array([0.3, -0.5, 0.7])
    s = co.systems.sphere_euler(N, rotation)
    latitude, longitude = (one.ravel() for one in np.meshgrid(*s.grid(), indexing="ij"))
    r = np.stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], -1)
    east = np.stack([-np.sin(longitude), np.cos(longitude), 0 * longitude], -1)
    motion = np.cross(axis, r)
    W = s.from_grid((2 * r @ axis).reshape(N + 1, 2 * N), absolute=False)
    for given in (W, s.relative(W)):
        u, v = s.velocity(given)
        assert np.abs(u.ravel() - (motion * east).sum(-1)).max() < ROUNDED
        assert np.abs(v.ravel() - (motion * np.cross(r, east)).sum(-1)).max() < ROUNDED


@pytest.mark.parametrize("points", GRIDS)
@pytest.mark.parametrize("shape", [(N + 1, 2 * N), (N + 2, 2 * N - 1), (31, 50)])
def test_there_and_back(points, shape):
    W = SPHERE.random(5, degrees=(1, N - 1))
    back = SPHERE.from_grid(SPHERE.to_grid(W, shape, points), points)
    assert np.abs(back - W).max() < 64 * N**2 * UNIT_ROUNDOFF * np.abs(W).max()


def test_a_grid_of_other_longitudes_and_a_mean():
    W = SPHERE.random(6)
    latitude, longitude = SPHERE.grid((12, 20))
    field = summed(SPHERE.modes(W), latitude[:, None], longitude[None, :] + 0.3)
    back = SPHERE.from_grid(field + 5.0, longitude=0.3)
    assert np.abs(back - W).max() < 1e-12 * np.abs(W).max()
    assert abs(np.trace(back)) < 1e-13 * np.abs(W).max()


def test_coarser_and_finer_grids_keep_what_they_resolve():
    W = SPHERE.random(7, degrees=(1, 4))
    assert np.abs(SPHERE.from_grid(SPHERE.to_grid(W, (7, 12))) - W).max() < 1e-12 * np.abs(W).max()
    small = co.systems.sphere_euler(N=5)
    fine = SPHERE.to_grid(SPHERE.random(8, degrees=(1, N - 1)), (20, 40))
    cut = small.modes(small.from_grid(fine))
    kept = {mode: c for mode, c in SPHERE.modes(SPHERE.from_grid(fine)).items() if mode[0] < 5}
    assert list(cut) == list(kept)
    assert max(abs(cut[mode] - kept[mode]) for mode in kept) < 1e-12
    # eight columns do not tell the phase of an order of 4
    assert np.abs(SPHERE.from_grid(SPHERE.to_grid(SPHERE.from_modes({(5, 4): 1.0}), (12, 8)))).max() < 1e-12
    degrees = {l for l, _ in SPHERE.modes(SPHERE.from_grid(SPHERE.to_grid(SPHERE.random(9), (6, 30))))}
    assert max(degrees) == 4  # of six rows


@pytest.mark.parametrize("shape", [None, (12, 20), (5, 4), (1, 3), (16, 9)])
def test_values_are_sums_of_waves(shape):
    W = TORUS.random(3, degrees=(1, N // 2))
    x, y = TORUS.grid(shape)
    wanted = summed_waves(TORUS.modes(W), x[:, None], y[None, :])
    found = TORUS.to_grid(W, shape)
    assert found.shape == (len(x), len(y)) == (shape or (N, N))
    assert np.abs(found - wanted).max() < 10 * ROUNDED


@pytest.mark.parametrize("shape", [(N, N), (10, 9), (32, 15)])
def test_there_and_back_on_the_torus(shape):
    W = np.stack([TORUS.random(4), TORUS.random(5)])
    back = TORUS.from_grid(TORUS.to_grid(W, shape) + 3.0)
    assert back.shape == W.shape and np.abs(back - W).max() < ROUNDED * np.abs(W).max()
    assert np.abs(TORUS.from_modes(TORUS.mode_array(W)) - W).max() < ROUNDED * np.abs(W).max()


def test_coarse_grids_and_small_sizes_keep_what_they_resolve():
    W = TORUS.from_modes({(1, 2): 1.0, (2, -1): 1j, (3, 0): 0.5, (0, 2): 0.25})
    assert set(TORUS.modes(TORUS.from_grid(TORUS.to_grid(W, (32, 4))))) == {(2, -1), (-2, 1), (3, 0), (-3, 0)}
    small = co.systems.torus_euler(N=5)
    assert set(small.modes(small.from_grid(TORUS.to_grid(W)))) == {(1, 2), (-1, -2), (2, -1), (-2, 1), (0, 2), (0, -2)}


def rounded(N):
    """Sums of N products with eigenvectors that miss orthogonality by some N round-offs."""
    return 32 * N * UNIT_ROUNDOFF


def matrix_harmonic(s, l, m):
    """Return T_lm of norm one, up to the phase -i, from two real fields."""
    if m == 0:
        return s.from_modes({(l, 0): 1.0}) / s.scale
    real, imaginary = (s.from_modes({(l, m): c}) for c in (1.0, 1j))
    return (real - 1j * imaginary) / (2 * s.scale)


def test_harmonics_of_matrices():
    """Eigenvectors of double commutators, with the phases of Condon and Shortley, and of norm one."""
    s, S = SPHERE, generators(N)
    raising, z = 1j * (S[0] + 1j * S[1]), 1j * S[2]
    for l in range(1, N):
        for m in range(-l, l + 1):
            T = matrix_harmonic(s, l, m)
            found = -sum(a @ (a @ T - T @ a) - (a @ T - T @ a) @ a for a in S)
            assert np.abs(found - l * (l + 1) * T).max() < rounded(N) * N**2
            assert np.abs(S[2] @ T - T @ S[2] + 1j * m * T).max() < rounded(N) * N
            assert np.linalg.norm(T) == pytest.approx(1.0, rel=rounded(N))
            # L_+ Y_lm = sqrt((l - m)(l + m + 1)) Y_l(m+1), and z Y_lm has Y_(l+1)m with a positive factor.
            if m < l:
                up, factor = raising @ T - T @ raising, np.sqrt((l - m) * (l + m + 1))
                assert np.abs(up - factor * matrix_harmonic(s, l, m + 1)).max() < rounded(N) * N**2
            if l + 1 < N:
                assert np.vdot(matrix_harmonic(s, l + 1, m), z @ T + T @ z).real > 0.1
    assert matrix_harmonic(s, 1, 0)[0, 0].imag > 0  # north


@pytest.mark.parametrize("size", [2, 3, 4, 7, 32, 65, 130])
def test_there_and_back_of_coefficients(size):
    s, rng = co.systems.sphere_euler(N=size), np.random.default_rng(size)
    c = np.tril(rng.standard_normal((2, size, size)) + 1j * rng.standard_normal((2, size, size)))
    c[..., 0, 0], c[..., 0] = 0.0, c[..., 0].real
    c[..., 0, 0] = 0.0
    W = s.from_modes(c)
    np.testing.assert_array_equal(W, -np.swapaxes(W.conj(), 1, 2))
    assert abs(np.trace(W[0])) < rounded(size) * np.abs(W).max()
    assert np.abs(s.mode_array(W) - c).max() < 4 * rounded(size) * np.abs(c).max()
    np.testing.assert_allclose(W[1], s.from_modes(c[1]), rtol=0, atol=rounded(size) * s.scale)
    # the integral of the square of the field
    square = np.sum(np.abs(c[0, :, 0]) ** 2) + 2 * np.sum(np.abs(c[0, :, 1:]) ** 2)
    assert np.linalg.norm(W[0]) ** 2 / s.scale**2 == pytest.approx(square, rel=rounded(size))


def test_modes_of_a_mapping():
    s = co.systems.sphere_euler(N=5)
    given = {(2, -1): 1 + 2j, (4, 0): 3.0, (3, 3): 1j}
    found, wanted = s.modes(s.from_modes(given)), given | {(2, 1): -1 + 2j, (3, -3): 1j}
    assert list(found) == sorted(wanted)
    for mode, value in wanted.items():
        assert found[mode] == pytest.approx(value, abs=1e-14)
    assert np.abs(s.from_modes(found) - s.from_modes(given)).max() < 1e-13
    with refused(ValueError, "one matrix"):
        s.modes(np.zeros((2, 5, 5)))


def test_without_ducc0(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with refused(ImportError, "ducc0", "coadjoint[fluids]"):
        SPHERE.to_grid(SPHERE.random(1))


def test_modes_that_a_grid_does_not_resolve_are_zero():
    """Orders above (columns - 1)/2 of a sphere, and from half the number of points on a torus; lower ones are exact."""
    sphere, torus = co.systems.sphere_euler(N=8), co.systems.torus_euler(N=9)
    state = sphere.from_modes({(l, m): 1.0 + 0.5j * (m > 0) for l in range(1, 8) for m in range(min(l, 2) + 1)})
    found = sphere.modes(sphere.from_grid(sphere.to_grid(state, (9, 5))))
    assert max(m for _, m in found if abs(found[_, m]) > 1e-13) == 2
    wanted = sphere.modes(state)
    assert max(abs(found.get(mode, 0.0) - wanted[mode]) for mode in wanted) < 1e-13
    waves = {(1, 0): 0.5, (2, 1): 0.25j, (-1, 2): 1.0}
    coarse = torus.modes(torus.from_grid(torus.to_grid(torus.from_modes(waves), (5, 5))))
    assert all(abs(c - coarse[mode]) < 1e-14 for mode, c in waves.items())
    assert all(max(map(abs, mode)) <= 2 for mode, c in coarse.items() if abs(c) > 1e-13)
