"""Turn a satellite by 90 degrees with the least effort of its reaction wheels, by exact Newton steps.

The rotors carry the momentum x0 of the satellite at rest. Their motors exert torques u that are constant in each step,
and the effort is the integral of |u|^2. Tangents of momentum and attitude by all torques are carried from step to step;
the torques of least norm that satisfy the linear equations at the end are the next ones.
"""

import numpy as np

import coadjoint as co

I, T = np.array([1.0, 2.0, 3.0]), 5.0


def torques(x0, steps):
    """Return the torques (steps, 3) that turn the satellite about its third axis, from rest to rest in the time T."""
    h, satellite = T / steps, co.systems.rigid_body(inertia=I)
    ready = co.prepare(satellite, co.Splitting(order=2), h, attitude=True, inputs=True)
    u, du = np.zeros((steps, 3)), np.eye(3 * steps).reshape(steps, 3, -1)
    for angle in [np.pi / 4] + 9 * [np.pi / 2]:
        x, A, k = x0, np.eye(3), x0
        dx, dA, dk = np.zeros((3, 3 * steps)), np.zeros((3, 3, 3 * steps)), np.zeros((3, 3 * steps))
        for n in range(steps):  # a step takes the momentum of the rotors at its middle
            linear, by_u = -(k + h / 2 * u[n]) / I, -(dk + h / 2 * du[n]) / I[:, None]
            directions = {"x0": dx, "attitude0": dA, "inputs": {"linear": by_u}}
            sol, tangents = ready.jvp(x, (0, h), directions, attitude=A, linear=linear)
            x, A, k = sol.x[-1], sol.attitude[-1], k + h * u[n]
            dx, dA, dk = tangents.x[-1], tangents.attitude[-1], dk + h * du[n]
        c, s = np.cos(angle), np.sin(angle)
        turns = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ satellite.representation
        missed, J = np.r_[np.tensordot(turns, A), x - k], np.r_[np.tensordot(turns, dA), dx - dk]
        u = np.linalg.lstsq(J, J @ u.ravel() - missed)[0].reshape(steps, 3)
    assert np.abs(missed).max() < 1e-7
    return u


def effort(x0, steps):
    """Return the least effort of torques that are constant in steps."""
    return T / steps * (torques(x0, steps) ** 2).sum()


if __name__ == "__main__":
    print(round(float(effort(np.array([0.0, 0.5, 0.0]), 50)), 6))  # 1.984321; without the bias x0 2.132688
