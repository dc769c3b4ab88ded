"""Stability of a satellite that faces its planet, beside the conditions of DeBra and Delp (docs/two_asteroids.md)."""

import numpy as np

import coadjoint as co


def growth(k_R, k_Y, size=0.01):
    """Return the growth of small motions about the relative equilibrium of a small body, 0 where it is stable."""
    A, B = 1.0, (1 - k_Y) / (1 - k_R)
    C, small = B + k_Y * A, size**2
    inertia = small * size**2 * np.array([A, B, C]) / C
    pair = co.systems.gravitating_bodies([[0.1] * 3, inertia], [1 - small, small])
    n = np.sqrt(1 + 1.5 * (inertia.sum() - 3 * inertia[0]) / small)
    r = np.outer([-small, 1 - small], [1, 0, 0])
    x0 = pair.state(r, np.cross([0, 0, n], r), angular_velocities=[[0, 0, n]] * 2)
    turning = co.LiePoissonSystem(pair.algebra, pair.hamiltonian - n * pair.integrals["total L3"], sign=-1)
    return co.equilibrium(turning, x0, relax="none").growth


shapes = [(0.6, 0.3), (0.3, 0.6), (0.5, -0.2), (-0.1, -0.5), (-0.05, -0.6), (-0.1, -0.9)]
stable = [growth(*shape) == 0 for shape in shapes]
assert stable == [R > Y and R * Y > 0 and 1 + 3 * R + R * Y > 4 * np.sqrt(R * Y) for R, Y in shapes]
print(dict(zip(shapes, stable, strict=True)))
