"""Fluids of matrices on sphere and torus: random states, and the generators of rotations."""

import numpy as np

import coadjoint as co

FINE = co.IsospectralGauss(6)
"""Of order twelve: a steady state moves by rounding alone."""


def random_matrix(system, seed=4):
    """Return a random state of a system of matrices, of numbers of size one."""
    drawn = np.random.default_rng(seed).standard_normal((2, *system.shape))
    return system.algebra.projected(drawn[0] + 1j * drawn[1])


def generators(N):
    """Return the three generators of rotations, by the field whose modes are those of minus the coordinates."""
    sphere, a = co.systems.sphere_euler(N=N), np.sqrt(2 * np.pi / 3)
    modes = ({(1, 1): a}, {(1, 1): -1j * a}, {(1, 0): -np.sqrt(2) * a})
    return [sphere.from_modes(each) for each in modes]


def last(system, x, t, step, method=FINE):
    """Return the end of a run."""
    return co.integrate(system, x, (0, t), step, method, save_every=10**6).x[-1]
