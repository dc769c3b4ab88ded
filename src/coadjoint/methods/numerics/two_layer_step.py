"""Steps of isospectral Gauss methods on two layers in NumPy, with dual numbers as block matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.methods.numerics.isospectral_stages import DIVERGED
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem

Matrix = NDArray[Any]

MOST_ITERATIONS = 192
ROUND_OFF_TOLERANCE = 64 * UNIT_ROUNDOFF


def as_blocks(X: Matrix) -> Matrix:
    """Return A + eps B, given as (2, N, N), as the matrix ``[[A, B], [0, A]]``: products are those of dual numbers.

    Examples
    --------
    >>> as_blocks(np.array([[[1.0]], [[2.0]]]))
    array([[1., 2.],
           [0., 1.]])
    """
    return np.block([[X[0], X[1]], [np.zeros_like(X[0]), X[0]]])


def of_blocks(A: Matrix) -> Matrix:
    """Return the two layers: the inverse of `as_blocks`."""
    N = len(A) // 2
    return np.stack([A[:N, :N], A[:N, N:]])


def two_layer_increment(
    system: TwoLayerSystem, X: Matrix, t: Any, h: Any, a: NDArray[np.float64], b: NDArray[np.float64]
) -> Matrix:
    """Return the change (2, N, N) of a state in a step; raise IntegrationError if the stages do not converge."""
    W, identity = as_blocks(X), np.eye(2 * len(X[0]))

    def stream(M: Matrix) -> Matrix:
        return as_blocks(system.stream_of(of_blocks(M)))

    Y = [stream(W) for _ in b]
    M, last, change = [W for _ in b], np.inf, np.inf
    for _ in range(MOST_ITERATIONS):
        # V and U are solved exactly for given streams, unlike in the kernels: an independent implementation.
        V, U = _solved(h * a, Y, identity, left=False), _solved(-h * a, Y, identity, left=True)
        new = [v @ W @ u for v, u in zip(V, U, strict=True)]
        change = max(float(np.abs(n - m).max()) for n, m in zip(new, M, strict=True))
        M, Y = new, [stream(m) for m in new]
        if change == 0.0 or (change <= ROUND_OFF_TOLERANCE * float(np.abs(W).max()) and not change < last):
            moved = sum(weight * (y @ m - m @ y) for weight, y, m in zip(b, Y, M, strict=True))
            return of_blocks(np.asarray(h * moved))
        if not change < DIVERGED * float(np.abs(W).max()):
            break
        last = change
    raise IntegrationError(
        f"the stages do not converge with a step of {float(h):g}; take a smaller one",
        step=1,
        time=float(t),
        residual=change,
    )


def _solved(a: NDArray[np.float64], Y: list[Matrix], identity: Matrix, left: bool) -> list[Matrix]:
    """Return the solution of V_i = 1 + sum_j a_ij Y_j V_j, or with V_j on the left of Y_j."""
    s, n = len(Y), len(identity)
    whole = np.eye(s * n, dtype=Y[0].dtype)
    for i in range(s):
        for j in range(s):
            part = Y[j].T if left else Y[j]
            whole[i * n : (i + 1) * n, j * n : (j + 1) * n] -= a[i, j] * part
    found = np.linalg.solve(whole, np.tile(identity.astype(whole.dtype), (s, 1)))
    parts = [found[i * n : (i + 1) * n] for i in range(s)]
    return [part.T for part in parts] if left else parts
