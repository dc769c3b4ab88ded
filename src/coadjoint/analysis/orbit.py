"""Coadjoint orbits near a state: motion along the orbit, its tangent space, and the second variation of the energy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import summands
from coadjoint.systems.evaluation import scatter

Floats = NDArray[np.float64]

RANK_TOLERANCE = 1e-10  # singular values of J(x) below this, relative to the largest, are zero
MAX_DEGREE = 40  # of the series of an exponential, whose substeps have norms of at most one
NEGLIGIBLE = 2.0**-60  # of the state: the series of an exponential ends there, below round-off


class TangentSpace(NamedTuple):
    """The tangent space of an orbit: P = sign J(x), an orthonormal basis (n, r), and its blocks on direct summands."""

    P: Floats
    basis: Floats
    blocks: list[tuple[NDArray[np.int64], slice]]

    def restricted(self, matrix: Floats, factor: Floats) -> Floats:
        """Return factor^T matrix factor, for a factor (n, r) with the blocks of the basis."""
        columns, result = np.empty_like(factor), np.empty((factor.shape[1],) * 2)
        for rows, places in self.blocks:
            columns[:, places] = matrix[:, rows] @ factor[rows, places]
        for rows, places in self.blocks:
            result[places] = factor[rows, places].T @ columns[rows]
        return result


class Orbit:
    """The coadjoint orbits of a system in coordinates y = x / units: motion along them, derivatives of functions."""

    # Units are powers of two, so that scaling does not round.

    def __init__(self, system: Any, units: Floats) -> None:
        i, j, k, c = system.algebra.triples
        self.system, self.units, self.dim, self.sign = system, units, system.dim, float(system.sign)
        self._rows, self._factors, self._states = np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([k, k])
        constants = (c * (units[k] / units[i] / units[j])).astype(np.float64)
        self._constants = self.sign * np.concatenate([constants, -constants])

    def product(self, y: Floats, v: Floats) -> Floats:
        """Return D_v y = sign J(y) v."""
        return np.asarray(scatter(self._rows, self._constants * y[self._states] * v[self._factors], self.dim))

    def absolute_product(self, y: Floats, v: Floats) -> Floats:
        terms = np.abs(self._constants * y[self._states] * v[self._factors])
        return np.asarray(scatter(self._rows, terms, self.dim))

    def norm(self, v: Floats) -> float:
        """Return the largest row sum of the absolute entries of D_v."""
        return float(np.max(scatter(self._rows, np.abs(self._constants * v[self._factors]), self.dim), initial=0.0))

    def moved(self, y: Floats, v: Floats) -> Floats:
        substeps = max(1, int(np.ceil(self.norm(v))))
        for _ in range(substeps):
            term, change = y, np.zeros_like(y)
            for degree in range(1, MAX_DEGREE):
                term = self.product(term, v) / (degree * substeps)
                change = change + term
                if np.max(np.abs(term), initial=0.0) <= NEGLIGIBLE * np.max(np.abs(y), initial=0.0):
                    break
            y = y + change
        return y

    def energy(self, y: Floats) -> float:
        return float(self.system.energy(self.units * y))

    def gradient(self, y: Floats, function: Any = None) -> Floats:
        return self.units * np.asarray(self._derivative("gradient", y, function), dtype=np.float64)

    def hessian(self, y: Floats, function: Any = None) -> Floats:
        return self.units[:, None] * np.asarray(self._derivative("hessian", y, function), np.float64) * self.units

    def _derivative(self, name: str, y: Floats, function: Any) -> Any:
        if function is None:
            return getattr(self.system.hamiltonian, name)(self.units * y, 0.0)
        return getattr(function, name)(self.units * y)

    def linearized(self, y: Floats) -> Floats:
        return self._map(self.system.jacobian(self.units * y))

    def _map(self, matrix: Any) -> Floats:
        return np.asarray(matrix, dtype=np.float64) / self.units[:, None] * self.units

    def tangents(self, y: Floats) -> TangentSpace:
        """Return the tangent space of the orbit of y, by singular value decompositions of J on direct summands."""
        J = np.asarray(self.system.structure_matrix(self.units * y), dtype=np.float64)
        P = self.sign * (J / self.units[:, None] / self.units)
        parts = summands(self.system.algebra.triples, len(P))
        found = [(rows, *np.linalg.svd(P[np.ix_(rows, rows)])[:2]) for rows, _ in parts]
        smallest = RANK_TOLERANCE * max(sizes[0] for _, _, sizes in found)
        kept = [(rows, left[:, sizes > smallest]) for rows, left, sizes in found]
        basis, blocks, first = np.zeros((len(P), sum(left.shape[1] for _, left in kept))), [], 0
        for rows, left in kept:
            columns = slice(first, first := first + left.shape[1])
            basis[rows, columns] = left
            blocks.append((rows, columns))
        return TangentSpace(P, basis, blocks)

    def second_variation(self, y: Floats, tangents: TangentSpace, function: Any = None) -> Floats:
        """Return the second derivatives of F(exp(D_v) y) by v, at v = 0, in the basis of the tangent space."""
        P, U, blocks = tangents
        coadjoint = self.system.algebra.coadjoint(self.gradient(y, function) / self.units)
        D = self.sign * self._map(coadjoint)
        PU = np.zeros_like(U)
        for rows, columns in blocks:
            PU[rows, columns] = P[np.ix_(rows, rows)] @ U[rows, columns]
        Q = tangents.restricted(self.hessian(y, function), PU)
        for rows, columns in blocks:
            Q[columns, columns] -= U[rows, columns].T @ D[np.ix_(rows, rows)] @ PU[rows, columns]
        return np.asarray(0.5 * (Q + Q.T))
