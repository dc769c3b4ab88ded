"""The closed form of the free rigid body: in 25 digits, in degenerate cases, with permuted axes, over long times."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from brackets import U
from scipy.integrate import solve_ivp

import coadjoint as co
from refusals import refused

S = co.systems
CASES = json.loads((Path(__file__).parent / "rigid_body_reference.json").read_text())["cases"]


def free(m, x0, t):
    """The motion of x' = x cross (m x) and its group element: the paper's convention runs backward."""
    return S.paper_rigid_body(m).exact(x0, -np.asarray(t, dtype=float), attitude=True)


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
    x, A = free(m, x0, np.array([t]))
    # Rounded data and |lam t| radians: u times the phase, with what the separatrix multiplies it by (|x|^2/gap < 2^8).
    phase = np.linalg.norm(x0) * np.abs(m).max() * abs(t)
    tolerance = 2.0**7 * U * (1 + phase) * np.linalg.norm(x0)
    for name, found in (("x", x[0]), ("A", A[0])):
        if name in case:
            assert np.abs(found - floats(case[name])).max() <= min(tolerance, 1e-12 if abs(t) <= 100 else np.inf)


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
    x, A = free(m, x0, np.array([0.0, t]))
    size = max(1.0, np.linalg.norm(x0))
    np.testing.assert_allclose(x[0], x0, rtol=0, atol=8 * U * size)
    np.testing.assert_allclose(A[0], np.eye(3), rtol=0, atol=16 * U)
    # DOP853 itself: 1e-13 a step, some hundred steps, times the growth near the separatrix.
    np.testing.assert_allclose(x[1], expected_x, rtol=0, atol=1e-10 * size)
    np.testing.assert_allclose(A[1], expected_A, rtol=0, atol=1e-10 * size)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", DEGENERATE)
def test_invariants_hold_at_every_time(name):
    m, x0 = (np.array(values) for values in DEGENERATE[name])
    t = np.linspace(-300.0, 300.0, 1001)
    x, A = free(m, x0, t)
    length2, energy2 = x0 @ x0, m @ x0**2
    assert np.abs(np.sum(x**2, axis=1) - length2).max() <= 32 * U * length2
    assert np.abs(x**2 @ m - energy2).max() <= 32 * U * np.abs(m).max() * length2
    momentum = np.einsum("kij,kj->ki", A, x)
    assert np.abs(momentum - x0).max() <= 64 * U * np.sqrt(length2)
    assert np.abs(A @ A.transpose(0, 2, 1) - np.eye(3)).max() <= 32 * U


@pytest.mark.parametrize("scale", [2.0**-600, 2.0**500])
def test_any_size_of_momentum(scale):
    m, x0 = np.array([1.0, 0.5, 0.25]), np.array([1.0, 2.0, 0.5])
    x, A = free(m, x0, np.array([3.0]))
    scaled, B = free(m, scale * x0, np.array([3.0 / scale]))
    np.testing.assert_array_equal(scaled, scale * x)
    np.testing.assert_array_equal(A, B)


def test_full_inertia_turns_with_its_axes():
    Q = np.linalg.qr(np.random.default_rng(7).standard_normal((3, 3)))[0]
    inertia = np.array([1.0, 2.0, 2.75])
    x0, t = np.array([1.0, -2.0, 0.5]), np.array([0.5, 20.0])
    x, A = S.rigid_body(inertia).exact(x0, t, attitude=True)
    Q = Q if np.linalg.det(Q) > 0 else -Q
    full = Q @ np.diag(inertia) @ Q.T
    y, B = S.rigid_body((full + full.T) / 2).exact(Q @ x0, t, attitude=True)
    # the rounded tensor has other moments: u times the phase of 20 * |x| radians, conditioned by I's ratio
    tolerance = 2.0**7 * U * 20.0 * np.linalg.norm(x0) * 3.5
    np.testing.assert_allclose(y, x @ Q.T, rtol=0, atol=tolerance)
    np.testing.assert_allclose(B, Q @ A @ Q.T, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(S.rigid_body(np.diag(inertia)).exact(x0, t), x)


def test_the_papers_convention_runs_backwards():
    body, paper = S.rigid_body((1.0, 2.0, 2.5)), S.paper_rigid_body((1.0, 0.5, 1 / 2.5))
    x0, t = [1.0, 10.0, 1.0], np.array([0.3, 7.0])
    for forwards, backwards in zip(paper.exact(x0, t, attitude=True), body.exact(x0, -t, attitude=True), strict=True):
        np.testing.assert_array_equal(forwards, backwards)
    # A11(10) of section 5.2, the solution in the paper's convention
    A = S.paper_rigid_body().exact(x0, 10.0, attitude=True)[1]
    assert A[0, 0] == pytest.approx(0.0720212720707, abs=1e-12)
    B = S.rigid_body((1.0, 2.0, 3.0)).exact(x0, 10.0, attitude=True)[1]
    assert B[0, 0] == pytest.approx(-0.404281810695, abs=1e-12)
    for system in (S.rigid_body((1.0, 2.0, 3.0)), S.paper_rigid_body()):
        for late in (1e200, [0.0, 1e200], [-1e200, 0.0, 1.0]):
            with refused(ValueError, "overflows", "x0", "t ="):
                system.exact((1e200, 2e200, 5e199), late)
