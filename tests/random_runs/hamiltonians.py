"""Random Hamiltonians of every kind."""

from __future__ import annotations

import math

import numpy as np

import coadjoint as co
from matrix.functions import well, well_curvature, well_slope


def driven(y, t):
    return 0.5 * y * y + math.sin(3.0 * t) * y


def driven_slope(y, t):
    return y + math.sin(3.0 * t)


def driven_curvature(y, t):
    return 1.0 + 0.0 * y * t


def growth(y):
    return math.exp(y)


def bent(x):
    return 0.5 * (x[0] ** 2 + 2 * x[1] ** 2 + 3 * x[2] ** 2) + 0.1 * x[0] * x[1] ** 2


def bent_gradient(x):
    return np.array([x[0] + 0.1 * x[1] ** 2, 2 * x[1] + 0.2 * x[0] * x[1], 3 * x[2]])


def bent_hessian(x):
    return np.array([[1.0, 0.2 * x[1], 0.0], [0.2 * x[1], 2.0 + 0.2 * x[0], 0.0], [0.0, 0.0, 3.0]])


FUNCTIONS = ((well, well_slope, well_curvature), (driven, driven_slope, driven_curvature), (growth,) * 3)


def matrix(rng: np.random.Generator, n: int):
    """Return a number, diagonal or matrix for `Quadratic`, also singular, indefinite and large ones."""
    B = rng.standard_normal((n, n))
    symmetric = (B + B.T) / (2 * math.sqrt(n))
    kind = rng.integers(8)
    if kind == 0:
        return float(rng.uniform(0.1, 2.0))
    if kind == 1:
        return rng.uniform(-2.0, 2.0, n)
    if kind == 2:
        return rng.uniform(0.1, 2.0, n) * (rng.random(n) < 0.6)
    if kind == 3:
        upper = np.triu(symmetric * (rng.random((n, n)) < 0.3))
        return upper + np.triu(upper, 1).T
    if kind == 4:
        low = rng.standard_normal((n, max(1, n // 3)))
        return low @ low.T / n
    if kind == 5:
        return symmetric * 10.0 ** rng.integers(0, 4)
    return symmetric + np.eye(n)


def polynomial(rng: np.random.Generator, n: int) -> co.Polynomial:
    """Return a few monomials of degrees up to four."""
    exponents = rng.multinomial(1, np.full(n, 1.0 / n), size=(int(rng.integers(1, 8)), 4))
    exponents = (exponents * (rng.random((*exponents.shape[:2], 1)) < 0.7)).sum(axis=1)
    monomials = {tuple(map(int, row)): float(np.round(rng.standard_normal(), 3)) or 1.0 for row in exponents}
    return co.Polynomial(monomials)


def some_hamiltonian(rng: np.random.Generator, n: int):
    """Return a random Hamiltonian of n coordinates."""
    kind = rng.random()
    if kind < 0.6:
        linear = rng.standard_normal(n) if rng.random() < 0.3 else None
        constant = float(rng.standard_normal()) if rng.random() < 0.2 else 0.0
        return co.Quadratic(matrix(rng, n), linear=linear, constant=constant)
    if kind < 0.85 or n < 3:
        return polynomial(rng, n)
    if kind < 0.93:
        chosen = rng.permutation(n)[: int(rng.integers(1, min(n, 4) + 1))]
        return co.Separable({int(i): FUNCTIONS[rng.integers(len(FUNCTIONS))] for i in chosen})
    expected = co.Hamiltonian(bent, bent_gradient, bent_hessian)
    if n == 3:
        return expected
    order = [int(i) for i in rng.permutation(n)]
    single = [((i,), co.Quadratic(float(rng.uniform(0.1, 2.0)))) for i in order[3:]]
    return co.SplitHamiltonian([(tuple(order[:3]), expected), *single])
