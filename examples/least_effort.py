"""Turn a satellite by 90 degrees with the least effort of its reaction wheels, by exact Newton steps."""

import numpy as np

import coadjoint as co

I, h, steps = np.array([1.0, 2.0, 3.0]), 0.1, 50
satellite = co.systems.rigid_body(inertia=I)
ready = co.prepare(satellite, co.Splitting(order=2), h, attitude=True, inputs=True)
x0, u, du = np.array([0.0, 0.5, 0.0]), np.zeros((steps, 3)), np.eye(3 * steps).reshape(steps, 3, -1)
for angle in [np.pi / 4] + 9 * [np.pi / 2]:
    x, A, k = x0, np.eye(3), x0
    dx, dA, dk = np.zeros((3, 3 * steps)), np.zeros((3, 3, 3 * steps)), np.zeros((3, 3 * steps))
    for n in range(steps):
        linear, by_u = -(k + h / 2 * u[n]) / I, -(dk + h / 2 * du[n]) / I[:, None]
        directions = {"x0": dx, "attitude0": dA, "inputs": {"linear": by_u}}
        sol, tangents = ready.jvp(x, (0, h), directions, attitude=A, linear=linear)
        x, A, k = sol.x[-1], sol.attitude[-1], k + h * u[n]
        dx, dA, dk = tangents.x[-1], tangents.attitude[-1], dk + h * du[n]
    c, s = np.cos(angle), np.sin(angle)
    turns = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ satellite.representation
    missed = np.r_[np.tensordot(turns, A), x - k]
    J = np.r_[np.tensordot(turns, dA), dx - dk]
    u = np.linalg.lstsq(J, J @ u.ravel() - missed)[0].reshape(steps, 3)
assert np.abs(missed).max() < 1e-8
print(round(float(h * (u**2).sum()), 6))  # the effort: 1.984321
