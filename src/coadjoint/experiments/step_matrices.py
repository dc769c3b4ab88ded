"""A Gauss or modified Gauss step as a matrix: x_new = B(x) x, with J frozen at the stages (equations (6) to (11))."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coadjoint.methods.gauss_coefficients import gauss_legendre
from coadjoint.systems.lie_poisson import LiePoissonSystem

Floats = npt.NDArray[np.float64]


def stage_iterates(system: LiePoissonSystem, stages: int, h: float, x: Floats, count: int) -> list[Floats]:
    """Return the function iterates X^0 = x, ..., X^count of equation (6).

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    stages : int
        Number s of Gauss stages.
    h : float
        Step.
    x : ndarray, shape (n,)
        State before the step.
    count : int
        Number of iterations.

    Returns
    -------
    list of ndarray, shape (s, n)
    """
    _, weights, mu = gauss_legendre(stages)
    iterates = [np.tile(x, (stages, 1))]
    for _ in range(count):
        slopes = np.array([system.vector_field(X) for X in iterates[-1]])
        iterates.append(x + h * (mu * weights) @ slopes)
    return iterates


def step_matrix(system: LiePoissonSystem, frozen: Floats, h: float, freeze: str) -> Floats:
    """Return B of the Gauss step for x' = W_j x, W_j frozen at given stages (equations (7), (8)).

    Parameters
    ----------
    system : LiePoissonSystem
        With a quadratic Hamiltonian x.Mx/2.
    frozen : ndarray, shape (s, n)
        Stages X_j at which the equation is frozen.
    h : float
        Step.
    freeze : {"structure", "gradient"}
        W_j = sign J(X_j) M, or sign D_u with u = M X_j.

    Returns
    -------
    ndarray, shape (n, n)
        M-orthogonal for ``"structure"``; orthogonal for ``"gradient"`` on so(3).

    Examples
    --------
    >>> from coadjoint.systems import paper_rigid_body
    >>> body, X = paper_rigid_body(), np.array([[1.0, 2.0, 0.5]])
    >>> B = step_matrix(body, X, 0.1, "gradient")
    >>> bool(np.allclose(B @ B.T, np.eye(3), atol=1e-15))
    True
    """
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
