"""The closed form of the free rigid body: against 25 digits, in every degenerate case, and with permuted axes."""

import itertools
import json
from pathlib import Path

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from coadjoint import systems
from coadjoint.systems.bodies.rigid_body import so3_body
from coadjoint.systems.closed_forms.elliptic_integrals import across_integral, amplitude
from coadjoint.systems.closed_forms.free_rigid_body import free_rigid_body

pytestmark = pytest.mark.thinned(3)

U = 2.0**-53
CASES = json.loads((Path(__file__).parent / "rigid_body_reference.json").read_text())["cases"]


def floats(numbers):
    return np.array(numbers, dtype=object).astype(np.float64)


def integrated(m, x0, t):
    """x and A by DOP853 at its tightest tolerance."""

    def field(_, y):
        x, A = y[:3], y[3:].reshape(3, 3)
        w = m * x
        hat = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.r_[np.cross(x, w), (A @ hat).ravel()]

    start = np.r_[x0, np.eye(3).ravel()]
    run = solve_ivp(field, (0.0, t), start, method="DOP853", rtol=1e-13, atol=1e-15)
    return run.y[:3, -1], run.y[3:, -1].reshape(3, 3)


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case['name']} t={case['t']}")
def test_against_25_digits(case):
    m, x0, t = floats(case["m"]), floats(case["x0"]), float(case["t"])
    x, A = free_rigid_body(m, x0, np.array([t]))
    # Rounded data and |lam t| radians: u times the phase, with what the separatrix multiplies it by (|x|^2/gap < 2^8).
    phase = np.linalg.norm(x0) * np.abs(m).max() * abs(t)
    tolerance = 2.0**7 * U * (1 + phase) * np.linalg.norm(x0)
    assert np.abs(x[0] - floats(case["x"])).max() <= tolerance
    if abs(t) <= 100:
        assert np.abs(x[0] - floats(case["x"])).max() <= 1e-12
    if "A" in case:
        assert np.abs(A[0] - floats(case["A"])).max() <= tolerance
        if abs(t) <= 100:
            assert np.abs(A[0] - floats(case["A"])).max() <= 1e-12


DEGENERATE = {
    "two equal, c largest": ((0.5, 0.5, 0.8), (0.3, -0.4, 1.2)),
    "two equal, c smallest": ((0.7, 0.7, 0.2), (0.3, -0.4, -1.2)),
    "two equal, no component on the axis": ((0.5, 0.5, 0.8), (0.3, -0.4, 0.0)),
    "two equal, on the axis": ((0.5, 0.5, 0.8), (0.0, 0.0, -1.2)),
    "three equal": ((0.6, 0.6, 0.6), (0.3, -0.4, 1.2)),
    "at rest": ((1.0, 0.5, 0.25), (0.0, 0.0, 0.0)),
    "permanent, first": ((1.0, 0.5, 0.25), (2.0, 0.0, 0.0)),
    "permanent, middle": ((1.0, 0.5, 0.25), (0.0, -2.0, 0.0)),
    "permanent, last": ((1.0, 0.5, 0.25), (0.0, 0.0, 2.0)),
    "near permanent, first": ((1.0, 0.5, 0.25), (2.0, 1e-9, -1e-10)),
    "near permanent, last": ((1.0, 0.5, 0.25), (0.0, 1e-12, 2.0)),
    # (m1 - m2) x1^2 = (m2 - m3) x3^2 in binary numbers: exactly on the separatrix
    "separatrix ++": ((1.25, 1.0, 0.0), (2.0, 0.75, 1.0)),
    "separatrix -+": ((1.25, 1.0, 0.0), (-2.0, 0.75, 1.0)),
    "separatrix +-": ((1.25, 1.0, 0.0), (2.0, -0.75, -1.0)),
    "separatrix --": ((1.25, 1.0, 0.0), (-2.0, 0.75, -1.0)),
    "near separatrix, inside": ((1.25, 1.0, 0.0), (2.0, 0.75, 1.0 + 2.0**-20)),
    "near separatrix, outside": ((1.25, 1.0, 0.0), (-2.0, 0.75, 1.0 - 2.0**-20)),
    "start in a coordinate plane": ((1.0, 0.5, 0.25), (1.0, 0.0, 1.5)),
    "start in another plane": ((1.0, 0.5, 0.25), (1.5, 1.0, 0.0)),
    "almost two equal": ((0.5, 0.5 + 2.0**-50, 0.8), (0.3, -0.4, 1.2)),
    "paper": ((1.0, 0.5, 1.0 / 3.0), (1.0, 10.0, 1.0)),
    "a negative mass": ((1.0, -0.5, 0.25), (1.0, 0.5, -1.0)),
}


@pytest.mark.thinned(57)
@pytest.mark.parametrize("order", list(itertools.permutations(range(3))), ids=str)
@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_cases_and_permuted_axes(name, order):
    m, x0 = (np.array(values)[list(order)] for values in DEGENERATE[name])
    t = 6.0
    expected_x, expected_A = integrated(m, x0, t)
    x, A = free_rigid_body(m, x0, np.array([0.0, t]))
    size = max(1.0, np.linalg.norm(x0))
    np.testing.assert_allclose(x[0], x0, rtol=0, atol=8 * U * size)
    np.testing.assert_allclose(A[0], np.eye(3), rtol=0, atol=16 * U)
    # DOP853 itself: 1e-13 a step, some hundred steps, times the growth near the separatrix.
    np.testing.assert_allclose(x[1], expected_x, rtol=0, atol=1e-10 * size)
    np.testing.assert_allclose(A[1], expected_A, rtol=0, atol=1e-10 * size)


@pytest.mark.parametrize("name", DEGENERATE)
def test_invariants_hold_at_every_time(name):
    m, x0 = (np.array(values) for values in DEGENERATE[name])
    t = np.linspace(-300.0, 300.0, 1001)
    x, A = free_rigid_body(m, x0, t)
    length2, energy2 = x0 @ x0, m @ x0**2
    assert np.abs(np.sum(x**2, axis=1) - length2).max() <= 32 * U * length2
    assert np.abs(x**2 @ m - energy2).max() <= 32 * U * np.abs(m).max() * length2
    momentum = np.einsum("kij,kj->ki", A, x)
    assert np.abs(momentum - x0).max() <= 64 * U * np.sqrt(length2)
    assert np.abs(A @ A.transpose(0, 2, 1) - np.eye(3)).max() <= 32 * U


@pytest.mark.parametrize("name", ["paper", "near separatrix, inside", "two equal, c smallest", "separatrix -+"])
def test_the_flow_is_a_group(name):
    m, x0 = (np.array(values) for values in DEGENERATE[name])
    x, A = free_rigid_body(m, x0, np.array([2.5]))
    y, B = free_rigid_body(m, x[0], np.array([1.75]))
    z, C = free_rigid_body(m, x0, np.array([4.25]))
    # the separatrix multiplies the rounding of x by exp(lam t), lam t < 13 and lam < 3
    size = 2.0**7 * U * np.exp(min(2.5 * 1.75, 6.0)) * np.linalg.norm(x0)
    np.testing.assert_allclose(y[0], z[0], rtol=0, atol=size)
    np.testing.assert_allclose(A[0] @ B[0], C[0], rtol=0, atol=size)


@pytest.mark.parametrize("scale", [2.0**-600, 2.0**500])
def test_any_size_of_momentum(scale):
    m, x0 = np.array([1.0, 0.5, 0.25]), np.array([1.0, 2.0, 0.5])
    x, A = free_rigid_body(m, x0, np.array([3.0]))
    scaled, B = free_rigid_body(m, scale * x0, np.array([3.0 / scale]))
    np.testing.assert_array_equal(scaled, scale * x)
    np.testing.assert_array_equal(A, B)


@pytest.mark.parametrize("complement", [1.0, 0.3, 1e-4, 1e-12, 1e-24])
def test_elliptic_functions_over_many_periods(complement):
    u = np.array([-35.0, -3.0, 1e-3, 0.7, 5.0, 60.0])
    phi = amplitude(u, complement)
    with mpmath.workdps(50):
        k2 = 1 - mpmath.mpf(complement)
        for value, at in zip(phi, u, strict=True):
            sine = mpmath.ellipfun("sn", mpmath.mpf(float(at)), m=k2)
            cosine = mpmath.ellipfun("cn", mpmath.mpf(float(at)), m=k2)
            assert abs(np.sin(value) - sine) <= 8 * U * (1 + abs(at))
            assert abs(np.cos(value) - cosine) <= 8 * U * (1 + abs(at))
            angle, nu = mpmath.mpf(float(value)), mpmath.mpf(-1.5)
            exact = ((1 - nu) * mpmath.ellippi(nu, angle, k2) - mpmath.ellipf(angle, k2)) / -nu
            assert abs(across_integral(-1.5, np.array([value]), complement)[0] - exact) <= 16 * U * (1 + abs(exact))


@pytest.mark.parametrize("t", [1e200, [0.0, 1e200], [-1e200, 0.0, 1.0]])
def test_a_phase_beyond_float64_is_refused(t):
    for system in (systems.rigid_body((1.0, 2.0, 3.0)), systems.paper_rigid_body()):
        with pytest.raises(ValueError, match=r"the closed form overflows from x0 = .* to t = .*; take smaller ones"):
            system.exact((1e200, 2e200, 5e199), t)


def test_full_inertia_turns_with_its_axes():
    Q = np.linalg.qr(np.random.default_rng(7).standard_normal((3, 3)))[0]
    inertia = np.array([1.0, 2.0, 2.75])
    x0, t = np.array([1.0, -2.0, 0.5]), np.array([0.5, 20.0])
    x, A = systems.rigid_body(inertia).exact(x0, t, attitude=True)
    Q = Q if np.linalg.det(Q) > 0 else -Q
    full = Q @ np.diag(inertia) @ Q.T
    y, B = systems.rigid_body((full + full.T) / 2).exact(Q @ x0, t, attitude=True)
    # the rounded tensor has other moments: u times the phase of 20 * |x| radians, conditioned by I's ratio
    tolerance = 2.0**7 * U * 20.0 * np.linalg.norm(x0) * 3.5
    np.testing.assert_allclose(y, x @ Q.T, rtol=0, atol=tolerance)
    np.testing.assert_allclose(B, Q @ A @ Q.T, rtol=0, atol=tolerance)
    diagonal = systems.rigid_body(np.diag(inertia)).exact(x0, t)
    np.testing.assert_array_equal(diagonal, x)


def test_the_papers_convention_runs_backwards():
    body, paper = systems.rigid_body((1.0, 2.0, 2.5)), systems.paper_rigid_body((1.0, 0.5, 1 / 2.5))
    x0, t = [1.0, 10.0, 1.0], np.array([0.3, 7.0])
    for forwards, backwards in zip(paper.exact(x0, t, attitude=True), body.exact(x0, -t, attitude=True), strict=True):
        np.testing.assert_array_equal(forwards, backwards)
    # A11(10) of section 5.2, the solution in the paper's convention
    A = systems.paper_rigid_body().exact(x0, 10.0, attitude=True)[1]
    assert A[0, 0] == pytest.approx(0.0720212720707, abs=1e-12)


FOUR_POINTS = np.array([-2.0, -1.0, 1.0, 2.0])


@pytest.mark.long
@pytest.mark.parametrize("sign", [-1, 1])
def test_random_full_tensors_solve_their_own_equation(sign):
    """Both frames of eigenvectors, orders of the moments, regions of the sphere, signs, and directions of time."""
    rng = np.random.default_rng(8)
    h = 2.0**-8
    weights = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * h)
    frames, regions = set(), set()
    for _ in range(40):
        B = rng.uniform(-1.0, 1.0, (3, 3))
        M = np.diag(rng.uniform(0.5, 2.0, 3)) + 0.4 * (B + B.T)
        system = so3_body(M, sign=sign, name="body", parameters={})
        masses, axes = np.linalg.eigh(M)
        frames.add(round(float(np.linalg.det(axes))))
        x0 = rng.uniform(-1.5, 1.5, 3)
        regions.add(bool(x0 @ M @ x0 > masses[1] * (x0 @ x0)))
        middle = float(rng.choice([-3.0, 3.0]))
        first = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        x, A = system.exact(x0, middle + h * FOUR_POINTS, attitude=first)
        now, attitude = system.exact(x0, middle, attitude=first)
        # A difference of order 4: h^4 |x^(5)| / 30, each derivative at most |M| |x| < 8 times the one before.
        tolerance = h**4 * 8.0**5 * 3.0 / 30
        np.testing.assert_allclose(weights @ x, system.vector_field(now), rtol=0, atol=tolerance)
        rho = np.einsum("i,ijk->jk", system.hamiltonian.gradient(now), system.representation)
        slope = np.tensordot(weights, A, axes=1)
        np.testing.assert_allclose(slope, -sign * attitude @ rho, rtol=0, atol=tolerance)
        start = system.exact(x0, 0.0, attitude=first)
        np.testing.assert_allclose(start[0], x0, rtol=0, atol=2.0**6 * U)
        np.testing.assert_allclose(start[1], first, rtol=0, atol=2.0**6 * U)
        np.testing.assert_allclose(attitude @ now, first @ x0, rtol=0, atol=2.0**8 * U)
    assert frames == {1, -1} and regions == {True, False}
