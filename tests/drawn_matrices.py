"""Drawn matrices shared by several tests."""

import numpy as np


def full(n, seed=0, size=0.2, ends=(0.6, 1.4)):
    """Return a symmetric matrix with a diagonal between these ends and other entries below `size`."""
    B = np.random.default_rng(seed).uniform(-0.5, 0.5, (n, n))
    return np.diag(np.linspace(*ends, n)) + size * (B + B.T)


def wide(n, seed):
    """Return a symmetric matrix with larger entries beside its diagonal."""
    return full(n, seed, 0.5, (0.5, 1.5))


def whole_matrix(n, seed):
    """Return a matrix of whole numbers and of determinant one: a change of basis that keeps constants exact."""
    draw = np.random.default_rng(seed).integers(-1, 2, (2, n, n)).astype(float)
    return (np.tril(draw[0], -1) + np.eye(n)) @ (np.triu(draw[1], 1) + np.eye(n))


def constants_of(algebra):
    """Return the structure constants as an array of shape (n, n, n)."""
    c = np.zeros((algebra.dim,) * 3)
    i, j, k, value = algebra.triples
    c[i, j, k], c[j, i, k] = value, -value
    return c
