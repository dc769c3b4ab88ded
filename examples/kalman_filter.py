"""A Kalman filter on the coadjoint orbit of a heavy top, and a test of its consistency (docs/derivatives.md)."""

import numpy as np
from scipy.linalg import expm

import coadjoint as co

top, rng = co.systems.heavy_top(), np.random.default_rng(5)
step = co.stepper(top, co.Splitting(order=2), 0.1)
tensor = np.array([top.algebra.structure_matrix(e) for e in np.eye(6)])  # J(x) = sum of x_k tensor[k]
H, noise = np.eye(6)[3:], 0.05  # the vertical is measured


def action(xi):
    """Return exp(D_xi), which moves states on their orbits."""
    return expm(np.einsum("kij,j->ik", tensor, xi))


def update(x, P, z):
    """Return state and covariance after a measurement; the correction is a motion on the orbit."""
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise**2 * np.eye(3))
    xi = np.linalg.lstsq(np.tensordot(x, tensor, 1), K @ (z - H @ x), rcond=1e-10)[0]
    E = action(xi)
    return E @ x, E @ (P - K @ H @ P) @ E.T


start, spread, squares, errors = np.array([0.3, 0.2, 1.0, 0.6, 0.0, 0.8]), 0.1, [], []
for _ in range(20):
    x, truth = start, action(spread * rng.standard_normal(6)) @ start
    P = spread**2 * np.tensordot(x, tensor, 1) @ np.tensordot(x, tensor, 1).T
    for _ in range(60):
        F = step.tangent(x)
        x, P, truth = step(x), F @ P @ F.T, step(truth)
        x, P = update(x, P, truth[3:] + noise * rng.standard_normal(3))
    squares.append((truth - x) @ np.linalg.pinv(P, rcond=1e-6, hermitian=True) @ (truth - x))
    errors.append(np.linalg.norm((truth - x)[3:]))
# The squared error in units of the covariance has the mean 4, the dimension of the orbit.
assert abs(np.mean(squares) - 4) < 4 * np.sqrt(2 * 4 / 20) and np.mean(errors) < noise / 2
assert all(abs(C(x) - C(start)) < 1e-13 for C in top.casimirs.values())
print(f"mean error of the vertical {np.mean(errors):.3f}, of a measurement {noise}")
