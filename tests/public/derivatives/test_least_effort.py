"""The turn of a satellite in docs/control.md: its least effort in closed form."""

import numpy as np
from scipy.spatial.transform import Rotation

import coadjoint as co

I, T = np.array([1.0, 2.0, 3.0]), 5.0


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


def test_the_effort_without_bias_is_that_of_a_double_integrator():
    steps = 20
    expected = 12 * I[2] ** 2 * (np.pi / 2) ** 2 / T**3 * steps**2 / (steps**2 - 1)
    assert abs(effort(np.zeros(3), steps) - expected) < 1e-10 * expected
