"""Matrix harmonics: what they are, and the way between W and coefficients, to round-off."""

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.matrices import spherical_modes
from coadjoint.systems.matrices.spherical_modes import generators, harmonics_of_matrix, matrix_of_harmonics, scale
from coadjoint.systems.matrices.streams import DiagonalSolve
from long import long_beyond

SIZES = long_beyond(5, [2, 3, 4, 7, 32, 65, 130])


def rounded(N):
    """Sums of N products with eigenvectors that miss orthogonality by some N round-offs."""
    return 32 * N * UNIT_ROUNDOFF


def harmonic(N, l, m):
    """Return T_lm as a matrix, m of any sign."""
    c = np.zeros((N, N), dtype=complex)
    c[l, abs(m)] = 1.0
    W = matrix_of_harmonics(c) / (1j * scale(N))
    T = np.triu(W, 1) if m else W
    return T if m >= 0 else (-1) ** m * T.T


def random_coefficients(N, seed, lead=()):
    rng = np.random.default_rng(seed)
    c = np.tril(rng.standard_normal((*lead, N, N)) + 1j * rng.standard_normal((*lead, N, N)))
    c[..., 0, 0] = 0.0
    c[..., 0] = c[..., 0].real
    return c


@pytest.mark.parametrize("N", SIZES)
def test_there_and_back(N):
    c = random_coefficients(N, N)
    W = matrix_of_harmonics(c)
    np.testing.assert_array_equal(W, -W.conj().T)
    assert abs(np.trace(W)) < rounded(N) * np.abs(W).max()
    assert np.abs(harmonics_of_matrix(W) - c).max() < rounded(N) * np.abs(c).max()
    # the integral of the square of the field
    square = np.sum(np.abs(c[:, 0]) ** 2) + 2 * np.sum(np.abs(c[:, 1:]) ** 2)
    assert np.linalg.norm(W) ** 2 / scale(N) ** 2 == pytest.approx(square, rel=rounded(N))


def test_each_degree_is_an_eigenspace_of_the_laplacian():
    """Not of the equation that makes the harmonics: of the double commutators."""
    N = 9
    S = generators(N)
    for l in range(1, N):
        for m in range(-l, l + 1):
            T = harmonic(N, l, m)
            found = -sum(s @ (s @ T - T @ s) - (s @ T - T @ s) @ s for s in S)
            assert np.abs(found - l * (l + 1) * T).max() < rounded(N) * N**2
            assert np.abs(S[2] @ T - T @ S[2] + 1j * m * T).max() < rounded(N) * N
            assert np.linalg.norm(T) == pytest.approx(1.0, rel=rounded(N))


def test_signs_are_those_of_condon_and_shortley():
    """Raising: L_+ Y_lm = sqrt((l - m)(l + m + 1)) Y_l(m+1), and z Y_lm has Y_(l+1)m with a positive factor."""
    N = 8
    S = generators(N)
    raising, z = 1j * (S[0] + 1j * S[1]), 1j * S[2]
    north = harmonic(N, 1, 0)[0, 0].real
    assert north > 0
    for l in range(1, N):
        for m in range(-l, l):
            T = harmonic(N, l, m)
            up = raising @ T - T @ raising
            assert np.abs(up - np.sqrt((l - m) * (l + m + 1)) * harmonic(N, l, m + 1)).max() < rounded(N) * N**2
        for m in range(-l, l + 1):
            if l + 1 < N:
                T = harmonic(N, l, m)
                assert np.vdot(harmonic(N, l + 1, m), z @ T + T @ z).real > 0.1


def test_coordinates_are_the_generators():
    s, S = co.systems.sphere_euler(N=6), generators(6)
    a = np.sqrt(2 * np.pi / 3)
    for modes, generator in (({(1, 1): -a}, S[0]), ({(1, 1): 1j * a}, S[1]), ({(1, 0): np.sqrt(2) * a}, S[2])):
        assert np.abs(s.from_modes(modes) + generator).max() < rounded(6)


@pytest.mark.parametrize("N", [2, 5, 8])
def test_several_matrices_at_once(N):
    c = random_coefficients(N, 1, (2, 3))
    W = matrix_of_harmonics(c)
    assert W.shape == (2, 3, N, N)
    np.testing.assert_allclose(W[1, 2], matrix_of_harmonics(c[1, 2]), rtol=0, atol=rounded(N) * scale(N))
    np.testing.assert_allclose(harmonics_of_matrix(W)[1, 0], c[1, 0], rtol=0, atol=4 * rounded(N))


def test_the_stream_divides_by_the_eigenvalues():
    s = co.systems.sphere_euler(N=12)
    W = s.random(4, degrees=(1, 11))
    c, psi = s.mode_array(W), s.mode_array(s.stream(W))
    wanted = -c / np.maximum(s.eigenvalues, 1)
    assert isinstance(s.stream, DiagonalSolve) and np.abs(psi - wanted).max() < rounded(12)


def test_a_turn_of_the_matrix_is_a_turn_of_the_field():
    """exp(b n . S) turns the field about n by b, as the right hand does: a blob goes where its place goes."""
    N, n, b = 24, np.array([0.6, -0.48, 0.64]), 1.1
    s, S = co.systems.sphere_euler(N=N), np.stack(generators(N))
    place = np.array([0.4, 2.0])
    x = np.array([np.cos(place[0]) * np.cos(place[1]), np.cos(place[0]) * np.sin(place[1]), np.sin(place[0])])
    x = x * np.cos(b) + np.cross(n, x) * np.sin(b) + n * (n @ x) * (1 - np.cos(b))
    U = expm(b * np.einsum("a,aij->ij", n, S))
    there = s.blobs([(np.arcsin(x[2]), np.arctan2(x[1], x[0]))], 1.0, 0.3)
    turned = U @ s.blobs([place], 1.0, 0.3) @ U.conj().T
    # the places of blobs are good to 3e-13
    assert np.abs(turned - there).max() < 1e-12 * np.abs(there).max() * N


def test_modes_of_a_mapping():
    s = co.systems.sphere_euler(N=5)
    given = {(2, -1): 1 + 2j, (4, 0): 3.0, (3, 3): 1j}
    found = s.modes(s.from_modes(given))
    wanted = given | {(2, 1): -1 + 2j, (3, -3): 1j}
    assert list(found) == sorted(wanted)
    for mode, value in wanted.items():
        assert found[mode] == pytest.approx(value, abs=1e-14)
    assert np.abs(s.from_modes(found) - s.from_modes(given)).max() < 1e-13


@pytest.mark.parametrize(
    ("modes", "kind", "said"),
    [
        ({(5, 0): 1.0}, ValueError, r"mode \(5, 0\): 1.0; give a degree l from 1 to 4"),
        ({(0, 0): 1.0}, ValueError, "a degree l from 1"),
        ({(2, 3): 1.0}, ValueError, "an order m from -l to l"),
        ({(2, 1): np.nan}, ValueError, "a finite coefficient"),
        ({(2, 0): 1j}, ValueError, "do not belong to a real vorticity"),
        ({(2, 1): 1.0, (2, -1): 1.0}, ValueError, "do not belong to a real vorticity"),
        ({2: 1.0}, TypeError, r"give \(l, m\): coefficient"),
        ({(2.5, 1): 1.0}, TypeError, r"give \(l, m\): coefficient"),
        (np.ones((4, 4)), ValueError, r"shape \(4, 4\)"),
        (np.ones((5, 5)), ValueError, "these must be zero"),
        (np.triu(np.ones((5, 5)), 1), ValueError, "these must be zero"),
        (np.outer(np.eye(5)[0], np.eye(5)[0]), ValueError, "these must be zero"),
        (1j * np.outer(np.eye(5)[3], np.eye(5)[0]), ValueError, "these must be zero"),
        (np.full((5, 5), np.inf), ValueError, "finite"),
        ("(2, 1)", TypeError, "modes is"),
        ({(2, 1): 10**400}, ValueError, "too large for float64"),
        ({(2, 1): 1.0, (2, -1): 10**400}, ValueError, "too large for float64"),
        ({(10**400, 0): 1.0}, ValueError, "give a degree l from 1 to 4"),
        ({(2, 10**5000): 1.0}, ValueError, "an order m from -l to l"),
        ([[10**400] * 5] * 5, ValueError, "too large for float64"),
    ],
)
def test_what_is_no_field_is_refused(modes, kind, said):
    with pytest.raises(kind, match=said):
        co.systems.sphere_euler(N=5).from_modes(modes)


def test_one_matrix_for_a_mapping():
    with pytest.raises(ValueError, match="one matrix"):
        co.systems.sphere_euler(N=5).modes(np.zeros((2, 5, 5)))


def test_tables_are_kept_within_bounds(monkeypatch):
    shelf = spherical_modes._HarmonicsCache()
    assert shelf.get(6, 2) is shelf.get(6, 2)
    monkeypatch.setattr(spherical_modes, "MAX_CACHE_BYTES", 0)
    other = shelf.get(6, 3)
    assert other is not shelf.get(6, 3)
    np.testing.assert_array_equal(other, shelf.get(6, 3))
    monkeypatch.setattr(spherical_modes, "MAX_CACHE_BYTES", 2**20)
    shelf.get(7, 2)
    assert shelf._N == 7 and list(shelf._entries) == [2]
    monkeypatch.setattr("coadjoint.memory.available", lambda: 1000)
    with pytest.raises(ValueError, match="the matrix harmonics of order 0 for N = 4000 needs about"):
        shelf.get(4000, 0)


def test_large_sizes_neither_overflow_nor_lose_digits():
    """From the pole to the equator the harmonics of high degrees grow by a factor beyond float64."""
    N = 1400
    V = spherical_modes.harmonics(N, 0)
    rows = [0, 1, 2, 3, 700, 701, 1398, 1399]
    products = 2 * V[rows] @ V[rows].T  # of the upper half; rows of both parities are orthogonal by their signs
    same = (np.array(rows)[:, None] - rows) % 2 == 0
    assert np.abs(np.where(same, products, 0.0) - np.eye(8)).max() < rounded(N)
    assert V[1, 0] == pytest.approx((N - 1) / 2 / (scale(N) * np.sqrt(4 * np.pi / 3)), rel=rounded(N))
    assert np.isfinite(V).all() and np.all(V[0] > 0)
