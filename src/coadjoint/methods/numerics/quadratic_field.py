"""Quadratic fields, and the steps of Kahan's method from many states at once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.system_checks import System


def derivative(system: System, x: NDArray[Any], t: Any) -> NDArray[Any]:
    """Return f'(x) of a quadratic field; if J is a function, by differences, which are then exact."""
    if system.algebra is not None:
        return np.asarray(system.jacobian(x, t))
    size = max(abs(x)) or 1
    offsets = size * np.eye(len(x), dtype=np.int64)
    pairs = [system.vector_field(x + offset, t) - system.vector_field(x - offset, t) for offset in offsets]
    return np.stack(pairs, axis=1) / (2 * size)


class QuadraticField(NamedTuple):
    """A quadratic field f(x) = f(0) + (f'(0) + f'(x)) x / 2 with f'(x) = f'(0) + f'' x, for steps from many states."""

    constant: NDArray[np.float64]
    linear: NDArray[np.float64]
    quadratic: NDArray[np.float64]

    @classmethod
    def of(cls, system: System) -> QuadraticField:
        """Return the field of a system for which `Kahan` is defined."""
        linear, *others = (derivative(system, x, 0.0) for x in np.eye(system.dim + 1, system.dim, -1))
        return cls(np.asarray(system.vector_field(np.zeros(system.dim))), linear, np.array(others) - linear)

    def derivative(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return f'(x), (k, n, n), at states (k, n)."""
        return self.linear + np.tensordot(x, self.quadratic, 1)

    def step(self, x: NDArray[np.float64], h: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return Kahan's steps from states (k, n), and whether a pole is between the steps by 0 and by h.

        There det(1 - s/2 f'(x)) changes its sign, and the solution of the linear system goes through infinity.
        """
        slope, n = self.derivative(x), x.shape[1]
        matrix, after = np.eye(n) - h / 2 * slope, np.full_like(x, np.nan)
        field = self.constant + np.einsum("kij,kj->ki", self.linear + slope, x) / 2
        finite = np.isfinite(matrix).all(axis=(1, 2))
        sign = np.ones(len(x))
        sign[finite] = np.linalg.slogdet(matrix[finite])[0]
        regular = finite & (sign != 0.0)
        after[regular] = x[regular] + np.linalg.solve(matrix[regular], h * field[regular][..., None])[..., 0]
        return after, sign <= 0.0
