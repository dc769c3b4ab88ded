"""Gauss and modified Gauss steps as matrices: x_new = B(x) x, with J frozen at the stages (equations (6) to (11))."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coadjoint.methods.numerics.gauss_coefficients import gauss_legendre
from coadjoint.systems.lie_poisson import LiePoissonSystem

Floats = npt.NDArray[np.float64]


def stage_iterates(system: LiePoissonSystem, stages: int, h: float, x: Floats, count: int) -> list[Floats]:
    """Return the function iterates X^0 = x, ..., X^count of equation (6), each (s, n), for s Gauss stages."""
    _, weights, mu = gauss_legendre(stages)
    iterates = [np.tile(x, (stages, 1))]
    for _ in range(count):
        slopes = np.array([system.vector_field(X) for X in iterates[-1]])
        iterates.append(x + h * (mu * weights) @ slopes)
    return iterates


def step_matrix(system: LiePoissonSystem, frozen: Floats, h: float, freeze: str) -> Floats:
    """Return B of the Gauss step for x' = W_j x, W_j frozen at given stages (s, n) (equations (7), (8)); H = x.Mx/2."""
    # `freeze`: "structure", W_j = sign J(X_j) M, gives M-orthogonal B; "gradient", W_j = sign D_u with u = M X_j,
    # orthogonal B on so(3).
    stages, n = frozen.shape
    _, weights, mu = gauss_legendre(stages)
    M = system.hamiltonian.hessian(frozen[0])
    if freeze == "structure":
        W = np.array([system.sign * system.structure_matrix(X) @ M for X in frozen])
    else:
        W = np.array([system.sign * system.algebra.coadjoint(M @ X) for X in frozen])
    coupled = np.einsum("ij,jab->iajb", h * mu * weights, W).reshape(stages * n, stages * n)
    right = np.tile(np.eye(n), (stages, 1))
    points = np.linalg.solve(np.eye(stages * n) - coupled, right).reshape(stages, n, n)
    return np.asarray(np.eye(n) + h * np.einsum("j,jab,jbc->ac", weights, W, points))
