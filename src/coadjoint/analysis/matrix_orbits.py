"""Unitary orbits of skew-Hermitian matrices, W -> U W U*, in the form in which equilibria are found on orbits."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Matrix = NDArray[np.complex128]

DEGENERATE = 1e-10  # differences of eigenvalues below this, relative to the largest, are zero
LINEAR = 1e-10  # deviation from its gradient, relative to its terms, of an integral that counts as linear


class OffDiagonal(NamedTuple):
    """The tangent space of an orbit: orthonormal matrices (r, N, N) of the algebra, and as columns (n, r)."""

    matrices: Matrix
    basis: Floats


class MatrixOrbits:
    """The orbits of a system of matrices in y, their numbers / units: motion along them, derivatives of the energy."""

    # Units of states and of the energy are powers of two, so that scaling does not round, and thresholds are relative.

    def __init__(self, system: Any, start: Floats) -> None:
        self.system, self.dim, self.units, self._energy_unit = system, system.dim, 1.0, 1.0
        self.units = _power_of_two(float(np.max(np.abs(start), initial=0.0)))
        self._energy_unit = _power_of_two(self.field_scale(start / self.units))

    def _stream(self, y: Floats) -> Matrix:
        """Return the derivative of the energy, as an element of the algebra."""
        factor = self.units * self.system.energy_factor / self._energy_unit
        return np.asarray(factor * self.system.stream_of(self.units * self._matrix(y)))

    def _matrix(self, y: Floats) -> Matrix:
        return np.asarray(self.system.from_vector(y))

    def _numbers(self, W: Matrix) -> Floats:
        return np.asarray(self.system.to_vector(W), dtype=np.float64)

    def product(self, y: Floats, v: Floats) -> Floats:
        """Return [v, y]."""
        return self._numbers(self.system.bracket(self._matrix(v), self._matrix(y)))

    def norm(self, v: Floats) -> float:
        """Return a bound of the norm of [v, .]."""
        return float(2.0 * np.max(np.sum(np.abs(self._matrix(v)), axis=-1), initial=0.0))

    def moved(self, y: Floats, v: Floats) -> Floats:
        """Return y conjugated by exp(v)."""
        angles, V = np.linalg.eigh(-1j * self._matrix(v))
        U = (V * np.exp(1j * angles)) @ V.conj().T
        W = U @ self._matrix(y) @ U.conj().T
        return self._numbers(0.5 * (W - W.conj().T))

    def energy(self, y: Floats) -> float:
        return float(self.system.energy(self.units * self._matrix(y))) / self._energy_unit

    def gradient(self, y: Floats) -> Floats:
        return self._numbers(self._stream(y))

    def sizes(self, y: Floats) -> tuple[float, float]:
        """Return the sizes of the state and of J(y): on a compact orbit neither changes much."""
        size = float(np.max(np.abs(y)))
        return size, size

    def field_scale(self, y: Floats) -> float:
        """Return the size of the terms of [P, W], which cancel at an equilibrium."""
        P = np.abs(self.system.slope_of(self.units * self._matrix(y)))
        if self.system.linear is not None:
            P = P + np.abs(self.system.linear)
        factor = abs(self.units * self.system.energy_factor / self._energy_unit)
        return float(np.max(np.abs(y), initial=0.0)) * self.norm(self._numbers(factor * P))

    def tangents(self, y: Floats) -> OffDiagonal:
        """Return the tangent space: off-diagonal matrices in an eigenbasis of W, between different eigenvalues."""
        N = self.system.algebra.N
        w, V = np.linalg.eigh(-1j * self._matrix(y))
        i, j = np.triu_indices(N, 1)
        apart = np.abs(w[i] - w[j]) > DEGENERATE * np.max(np.abs(w), initial=0.0)
        i, j = i[apart], j[apart]
        upper = np.einsum("ka,la->akl", V[:, i], V[:, j].conj())
        lower = np.conj(np.swapaxes(upper, -1, -2))
        matrices = np.concatenate([upper - lower, 1j * (upper + lower)]) * np.sqrt(0.5)
        return OffDiagonal(matrices, np.ascontiguousarray(self._numbers(matrices).T))

    def second_variation(self, y: Floats, tangents: OffDiagonal, function: Floats | None = None) -> Floats:
        """Return the second derivatives of H, or of a linear function by its gradient, along the orbit, by v at 0."""
        B, system = tangents.matrices, self.system
        C = self._numbers(system.bracket(B, self._matrix(y)))
        G = self._stream(y) if function is None else self._matrix(function)
        Q = -self._numbers(system.bracket(B, G)) @ C.T
        if function is None:
            factor = self.units**2 * system.energy_factor / self._energy_unit
            Q = Q + factor * self._numbers(system.slope_of(self._matrix(C))) @ C.T
        return np.asarray(0.5 * (Q + Q.T))

    def small_motions(self, y: Floats, tangents: OffDiagonal) -> Floats:
        """Return the linearized motion on the orbit, in the basis of the tangent space."""
        B, system, W = tangents.matrices, self.system, self.units * self._matrix(y)
        changes = system.bracket(system.slope_of(B), W) + system.bracket(system.stream_of(W), B)
        return np.asarray(tangents.basis.T @ self._numbers(changes).T)

    def integrals(self, y: Floats) -> list[tuple[Floats, Floats]]:
        """Return the gradients of combinations of the system's linear integrals, nearest to critical at y last."""
        # Such as the angular momentum about the axis of a zonal flow. A gradient is also its function.
        W, found = self._matrix(y), []
        for integral in self.system.integrals.values():
            u = np.asarray(integral(self.system.algebra.projected(self._matrix(np.eye(self.dim)))), dtype=np.float64)
            if abs(float(integral(W)) - u @ y) <= LINEAR * (np.abs(u) @ np.abs(y)):
                found.append(u)
        if not found:
            return []
        fields = np.stack([self.product(y, u) for u in found])
        combinations = np.linalg.svd(fields, full_matrices=False)[0]
        return [(u, u) for u in combinations.T @ np.stack(found)]


def _power_of_two(size: float) -> float:
    """Return a power of two near a size, 1 for zero."""
    return float(2.0 ** np.floor(np.log2(size))) if size > 0.0 else 1.0
