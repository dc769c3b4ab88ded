"""Systems with stages of every kind: quadratic, quartic and driven Hamiltonians, and a nonlinear bracket."""

from __future__ import annotations

import math

import numpy as np

import coadjoint as co


def full(n, seed=0):
    B = np.random.default_rng(seed).uniform(-0.2, 0.2, (n, n))
    return np.diag(np.linspace(0.5, 1.5, n)) + (B + B.T)


def nonlinear_structure(x):
    a, b, c = x[1] * x[2], x[0] * x[2], x[0] * x[1] + 2.0 * x[2]
    return np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])


def driven(x, t):
    return 0.5 * x[0] * x[0] * (1.0 + math.sin(t)) + x[1] * x[2] + math.cos(2.0 * t) * x[1] * x[1]


def driven_gradient(x, t):
    return np.array([x[0] * (1.0 + math.sin(t)), x[2] + 2.0 * math.cos(2.0 * t) * x[1], x[1]])


def heavy_top():
    """A top without symmetry: not integrable."""
    H = co.Quadratic([1.0, 0.5, 0.4, 0.0, 0.0, 0.0], linear=[0.0, 0.0, 0.0, 0.75, 0.5, 1.0])
    return co.LiePoissonSystem(co.algebras.e(3), H, sign=-1), np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8])


def systems():
    so4, e3 = co.algebras.so(4), co.algebras.e(3)
    quartic = co.Polynomial(
        {(2, 0, 0, 0, 0, 0): 0.5, (0, 1, 0, 0, 1, 0): 0.25, (0, 0, 0, 1, 1, 1): 1.0, (0, 0, 4, 0, 0, 0): 0.5}
    )
    six = np.array([1.0, 0.5, -0.25, 0.75, -1.0, 0.375])
    return {
        "top": heavy_top(),
        "so(4)": (co.LiePoissonSystem(so4, co.Quadratic(full(6))), six),
        "A3,7": (co.LiePoissonSystem(co.algebras.A3_7(1.5), co.Quadratic(full(3))), np.array([0.75, 0.5, 0.625])),
        "sl(2)": (co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, 2.0, 3.0])), np.array([1.0, 0.5, -0.25])),
        "quartic": (co.LiePoissonSystem(e3, quartic, sign=-1), six),
        "driven": (
            co.LiePoissonSystem(co.algebras.sl(2), co.Hamiltonian(driven, driven_gradient)),
            np.array([1.0, 0.5, -0.25]),
        ),
        "nonlinear J": (
            co.PoissonSystem(nonlinear_structure, co.Quadratic([1.0, 0.5, 0.25]), sign=-1),
            np.array([0.75, 0.5, -0.625]),
        ),
    }


def spin_chain(spins):
    rows = [
        (3 * i + a, 3 * i + b, 3 * i + c, 1.0) for i in range(spins) for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    ]
    algebra = co.LieAlgebra(rows, dim=3 * spins)
    M = np.zeros((3 * spins, 3 * spins))
    for i in range(spins):
        j = (i + 1) % spins
        for a, coupling in enumerate((1.0, 0.5, 0.25)):
            M[3 * i + a, 3 * j + a] += coupling
            M[3 * j + a, 3 * i + a] += coupling
    S = co.Polynomial({tuple(2 * (k == i) for k in range(3 * spins)): 1 for i in range(3 * spins)})
    x0 = np.random.default_rng(5).standard_normal((spins, 3))
    x0 /= np.linalg.norm(x0, axis=1, keepdims=True)
    return co.LiePoissonSystem(algebra, co.Quadratic(M), casimirs={"S": S}), x0.ravel()
