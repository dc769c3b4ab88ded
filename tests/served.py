"""A system and a state that a scheme can integrate: a rigid body if possible, otherwise a small matrix fluid."""

import numpy as np

import coadjoint as co

BODY = co.systems.rigid_body((1.0, 2.0, 2.5))
X = (0.3, -0.2, 0.5)
FLUID = co.systems.torus_euler(N=5)


def serves(method, system):
    """Return whether a scheme accepts a system."""
    try:
        method.properties(system)
    except ValueError:
        return False
    return True


def served(method):
    """Return a system and a state."""
    return (BODY, X) if serves(method, BODY) else (FLUID, state_of(FLUID))


def state_of(system, seed=1):
    """Return a state of a system of matrices: seeded, of size one."""
    rng, shape = np.random.default_rng(seed), system.shape
    return system.algebra.projected(rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / shape[-1]
