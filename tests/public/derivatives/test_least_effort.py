"""The turn of a satellite in docs/control.md, against Pontryagin's equations."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

import coadjoint as co

I, T = np.array([1.0, 2.0, 3.0]), 5.0
TARGET = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
ACCURACY = 1e-8


def effort(x0, steps):
    """Return the least effort of torques that are constant in steps, as on the page."""
    h, satellite = T / steps, co.systems.rigid_body(inertia=I)
    ready = co.prepare(satellite, co.Splitting(order=2), h, attitude=True, inputs=True)
    u, du = np.zeros((steps, 3)), np.eye(3 * steps).reshape(steps, 3, -1)
    for angle in [np.pi / 4] + 9 * [np.pi / 2]:
        x, A, k = x0, np.eye(3), x0
        dx, dA, dk = np.zeros((3, 3 * steps)), np.zeros((3, 3, 3 * steps)), np.zeros((3, 3 * steps))
        for n in range(steps):
            linear, by_u = -(k + h / 2 * u[n]) / I, -(dk + h / 2 * du[n]) / I[:, None]
            directions = {"x0": dx, "attitude0": dA, "inputs": {"linear": by_u}}
            sol, tangents = ready.jvp(x, (0, h), directions, attitude=A, linear=linear)
            x, A, k = sol.x[-1], sol.attitude[-1], k + h * u[n]
            dx, dA, dk = tangents.x[-1], tangents.attitude[-1], dk + h * du[n]
        turns = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix() @ satellite.representation
        missed, J = np.r_[np.tensordot(turns, A), x - k], np.r_[np.tensordot(turns, dA), dx - dk]
        u = np.linalg.lstsq(J, J @ u.ravel() - missed)[0].reshape(steps, 3)
    assert np.abs(missed).max() < 1e-7
    return h * (u**2).sum()


def pontryagin(x0):
    """Return the least effort in continuous time: quaternion, rotor momentum, and the costates of both."""

    def rates(t, y):
        q, k, mu, p = y[:4], y[4:7], y[7:10], y[10:13]
        x = np.einsum("mji,j->im", Rotation.from_quat(q.T).as_matrix(), x0)
        Omega, of_rate = (x - k) / I[:, None], mu / I[:, None]
        vector = 0.5 * (q[3] * Omega + np.cross(q[:3].T, Omega.T).T)
        of_turn = np.cross(mu.T, Omega.T).T - np.cross(of_rate.T, x.T).T
        return np.vstack([vector, -0.5 * (q[:3] * Omega).sum(axis=0), p / 2, of_turn, of_rate])

    def ends(a, b):
        missed = TARGET.T @ Rotation.from_quat(b[:4]).as_matrix()
        skew = [missed[2, 1] - missed[1, 2], missed[0, 2] - missed[2, 0], missed[1, 0] - missed[0, 1]]
        return np.r_[a[:4] - [0, 0, 0, 1], a[4:7] - x0, b[4:7] - TARGET.T @ x0, skew]

    t = np.linspace(0.0, T, 41)
    angle, rate = np.pi / 2 * (3 - 2 * t / T) * (t / T) ** 2, 3 * np.pi / T * (t / T) * (1 - t / T)
    q = np.array([0 * t, 0 * t, np.sin(angle / 2), np.cos(angle / 2)])
    k = np.einsum("mji,j->im", Rotation.from_quat(q.T).as_matrix(), x0) - np.array([0 * t, 0 * t, I[2] * rate])
    found = solve_bvp(rates, ends, t, np.vstack([q, k, np.zeros((6, len(t)))]), tol=ACCURACY, max_nodes=20000)
    assert found.status == 0
    nodes, weights = np.polynomial.legendre.leggauss(100)
    costate = found.sol(T / 2 * (1 + nodes))[10:13]
    return T / 2 * weights @ ((costate / 2) ** 2).sum(axis=0)


@pytest.mark.parametrize("x0", [(0.0, 0.5, 0.0), (0.3, 0.5, 0.2)])
def test_the_effort_converges_to_that_of_pontryagin(x0):
    """The errors of N steps are those of 1/N^2, and of 1/N^4 after extrapolation: below (3/N)^4."""
    start = np.array(x0)
    few, many, exact = effort(start, 20), effort(start, 40), pontryagin(start)
    assert 3.8 < (few - exact) / (many - exact) < 4.2
    assert abs((4 * many - few) / 3 - exact) < exact * (3 / 40) ** 4


def test_the_effort_without_bias_is_that_of_a_double_integrator():
    steps = 20
    expected = 12 * I[2] ** 2 * (np.pi / 2) ** 2 / T**3 * steps**2 / (steps**2 - 1)
    assert abs(effort(np.zeros(3), steps) - expected) < 1e-10 * expected
