"""Test systems beyond so(3).

Unimodular and non-unimodular algebras, diagonal and full M, permuted axes, a dense change of basis, both signs; each
with a state from which the motion is nonlinear and of size one.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

import coadjoint as co


class Case(NamedTuple):
    """A system, a state, and the time over which orders are measured."""

    system: co.LiePoissonSystem | co.PoissonSystem
    x0: np.ndarray
    time: float = 1.0


def full_matrix(seed: int, n: int) -> np.ndarray:
    """Return a symmetric positive definite matrix with condition number of a few."""
    B = np.random.default_rng(seed).uniform(-0.5, 0.5, (n, n))
    M = np.diag(np.linspace(0.6, 1.6, n)) + 0.25 * (B + B.T)
    assert np.linalg.eigvalsh(M)[0] > 0.05
    return np.round(M, 3)


def rotation_unlike_jacobi(x):
    """Return a skew matrix that violates the Jacobi identity: w = (x2, x3 + x1^2, x1) is not orthogonal to its curl."""
    return np.array([[0.0, x[0], -x[2] - x[0] * x[0]], [-x[0], 0.0, x[1]], [x[2] + x[0] * x[0], -x[1], 0.0]])


def rotation_unlike_jacobi_derivative(x):
    d = np.zeros((3, 3, 3))
    d[0, 1, 0], d[1, 0, 0] = 1.0, -1.0
    d[0, 2, 2], d[2, 0, 2] = -1.0, 1.0
    d[0, 2, 0], d[2, 0, 0] = -2.0 * x[0], 2.0 * x[0]
    d[1, 2, 1], d[2, 1, 1] = 1.0, -1.0
    return d


def _driven(y, t):
    return 0.5 * y * y + math.sin(3.0 * t) * y


def _driven_slope(y, t):
    return y + math.sin(3.0 * t)


def _driven_curvature(y, t):
    return 1.0 + 0.0 * y * t


@cache
def cases() -> dict[str, Case]:
    """Return the systems with a Lie algebra, by name."""
    so3, so4, e3, sl2 = co.algebras.so(3), co.algebras.so(4), co.algebras.e(3), co.algebras.sl(2)
    turned = co.algebras.change_of_basis(so3, np.eye(3)[[2, 0, 1]])
    permuted = co.algebras.change_of_basis(e3, np.eye(6)[[4, 1, 3, 0, 5, 2]])
    T = np.eye(6)
    T[[0, 1, 2, 3, 4], [1, 2, 3, 4, 5]] = [1, -1, 1, 1, -1]
    T[5] += T[0]
    so4_basis = co.algebras.change_of_basis(so4, T)
    top = np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8])
    six = np.array([1.0, 0.5, -0.4, 0.7, -1.0, 0.3])
    system = co.LiePoissonSystem
    return {
        "so(3), diagonal": Case(co.systems.paper_rigid_body(), np.array([1.0, 2.0, 0.5]), 2.0),
        "so(3), full, axes turned": Case(
            system(turned, co.Quadratic(full_matrix(1, 3)), sign=-1), np.array([1.0, -1.5, 1.2]), 2.0
        ),
        "A3,7, diagonal": Case(co.systems.paper_a37(2.0, (1.0, 1.5, 0.3)), np.array([0.7, 0.5, 0.6]), 1.0),
        "A3,7, full": Case(
            system(co.algebras.A3_7(1.5), co.Quadratic(full_matrix(2, 3)), sign=-1), np.array([0.7, -0.4, 0.5]), 0.8
        ),
        "sl(2), diagonal": Case(system(sl2, co.Quadratic([1.0, 2.0, 3.0])), np.array([1.0, 0.5, -0.25]), 1.0),
        "so(4), diagonal": Case(system(so4, co.Quadratic([2.0, 0.4, 0.7, 0.3, 0.5, 1.0]), sign=-1), six, 1.0),
        "so(4), full, another basis": Case(system(so4_basis, co.Quadratic(0.4 * full_matrix(4, 6))), six, 0.5),
        "e(3), heavy top": Case(
            system(e3, co.Quadratic([1.0, 0.5, 0.4, 0.0, 0.0, 0.0], linear=[0, 0, 0, 0.75, 0.5, 1.0]), sign=-1),
            top,
            3.0,
        ),
        "e(3), full, axes permuted": Case(system(permuted, co.Quadratic(full_matrix(5, 6))), six, 1.0),
        "sl(2), driven": Case(
            system(sl2, co.Separable({i: (_driven, _driven_slope, _driven_curvature) for i in range(3)}), sign=-1),
            np.array([0.8, 0.5, 0.6]),
        ),
    }


@cache
def without_jacobi() -> Case:
    """Return x' = J(x) M x with a skew J that is no Poisson bracket."""
    return Case(
        co.PoissonSystem(
            rotation_unlike_jacobi,
            co.Quadratic(full_matrix(6, 3)),
            derivative=rotation_unlike_jacobi_derivative,
            name="skew without Jacobi",
            jacobi=False,
        ),
        np.array([0.5, 0.7, -0.4]),
    )


@cache
def matrices() -> dict[str, Case]:
    """Return systems of matrices, with states as vectors."""
    g, rng = co.MatrixAlgebra, np.random.default_rng(7)

    def case(system: co.MatrixSystem, time: float = 1.0, size: float = 1.0) -> Case:
        W = system.algebra.projected(rng.normal(size=system.shape) + 1j * rng.normal(size=system.shape))
        return Case(system.in_numbers, system.to_vector(size * W / np.abs(W).max()), time)

    masses = np.linspace(1.0, 2.0, 5)
    return {
        "so(5), body": case(co.MatrixSystem(g("so", 5), co.systems.Weights(3.0 / np.add.outer(masses, masses)))),
        "sphere": case(co.systems.sphere_euler(N=3), size=3.0),
        "torus": case(co.systems.torus_euler(N=3), 2.0),
        "gl(3), transposed": case(co.MatrixSystem(g("gl", 3), np.transpose, np.diag([0.3, 0.1, -0.2]), energy_sign=-1)),
        "magnetic sphere": case(co.systems.reduced_mhd(N=3), 2.0),
    }


def all_cases() -> dict[str, Case]:
    return {**cases(), "skew J, no Jacobi identity": without_jacobi(), **matrices()}
