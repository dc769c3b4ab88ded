"""Two asymmetric bodies in space, and a potential with its derivatives."""

import numpy as np
from scipy.spatial.transform import Rotation

import coadjoint as co

S = co.systems
EXACT_BODIES = "free_body"
SHAPES = ((0.2, 0.4, 0.5), ((0.4, 0.05, -0.025), (0.05, 0.6, 0.1), (-0.025, 0.1, 0.8)))
MASSES = (3.0, 1.5)
TURNED = Rotation.from_rotvec([[0.3, -0.2, 0.9], [1.1, 0.4, -0.5]])
PLACES, SPEEDS = [[-1.0, 0.5, 0.0], [3.0, 0.0, 0.5]], [[0.0, -0.25, 0.05], [0.1, 0.75, 0.0]]
SPINS = [[0.1, 0.3, 0.2], [-0.2, 0.1, 0.4]]


def splitting(order):
    return co.Splitting(order=order, parts=EXACT_BODIES)


def pair_of_bodies():
    """Return two asymmetric bodies on an eccentric orbit, and their state."""
    pair = S.gravitating_bodies(SHAPES, MASSES)
    return pair, pair.state(PLACES, SPEEDS, TURNED, SPINS)


def spring(r, A):
    ends = r[0] + A[0, :, 0] - r[1] - A[1, :, 2]
    return 0.5 * (ends * ends).sum() ** 2 + A[0, 1, 1] * r[1, 2]


def spring_slopes(r, A):
    by_r, by_A = np.zeros((2, 3)), np.zeros((2, 3, 3))
    ends = r[0] + A[0, :, 0] - r[1] - A[1, :, 2]
    pull = 2.0 * (ends * ends).sum() * ends
    by_r[0], by_r[1] = pull, -pull
    by_A[0, :, 0], by_A[1, :, 2] = pull, -pull
    by_r[1, 2] += A[0, 1, 1]
    by_A[0, 1, 1] += r[1, 2]
    return by_r, by_A
