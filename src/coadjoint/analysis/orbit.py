"""Coadjoint orbits near a state: motion along the orbit, its tangent space, and the second variation of the energy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact.components import summands
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.evaluation import scatter

Floats = NDArray[np.float64]

RANK_TOLERANCE = 1e-10  # singular values of J(x) below this, relative to the largest, are zero
MAX_DEGREE = 40  # of the series of an exponential, whose substeps have norms of at most one
NEGLIGIBLE = 2.0**-60  # of the state: the series of an exponential ends there, below round-off


class Orbit:
    """Motion along the coadjoint orbits of a system, by its sparse structure constants."""

    def __init__(self, system: Any) -> None:
        i, j, k, c = system.algebra.triples
        self.dim, self.sign = system.dim, float(system.sign)
        self._rows, self._factors, self._states = np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([k, k])
        self._constants = self.sign * np.concatenate([c, -c]).astype(np.float64)

    def product(self, x: Floats, v: Floats) -> Floats:
        """Return D_v x = sign J(x) v."""
        return np.asarray(scatter(self._rows, self._constants * x[self._states] * v[self._factors], self.dim))

    def absolute_product(self, x: Floats, v: Floats) -> Floats:
        """Return the sums of the absolute terms of `product`, the scale of its round-off."""
        terms = np.abs(self._constants * x[self._states] * v[self._factors])
        return np.asarray(scatter(self._rows, terms, self.dim))

    def norm(self, v: Floats) -> float:
        """Return the largest row sum of the absolute entries of D_v."""
        return float(np.max(scatter(self._rows, np.abs(self._constants * v[self._factors]), self.dim), initial=0.0))

    def moved(self, x: Floats, v: Floats) -> Floats:
        """Return exp(D_v) x, on the orbit of x."""
        substeps = max(1, int(np.ceil(self.norm(v))))
        for _ in range(substeps):
            term, change = x, np.zeros_like(x)
            for degree in range(1, MAX_DEGREE):
                term = self.product(term, v) / (degree * substeps)
                change = change + term
                if np.max(np.abs(term), initial=0.0) <= NEGLIGIBLE * np.max(np.abs(x), initial=0.0):
                    break
            x = x + change
        return x


class ScaledSystem:
    """A system in coordinates y = x / units, with what the study of orbits needs."""

    def __init__(self, system: Any, units: Floats) -> None:
        i, j, k, c = system.algebra.triples
        constants = Triples(i, j, k, c * (units[k] / units[i] / units[j]))
        self.algebra = LieAlgebra._from_valid(
            constants, system.dim, system.algebra.basis, system.algebra.name, None, {}
        )
        self.name, self.dim, self.sign, self.units, self._system = system.name, system.dim, system.sign, units, system
        self.hamiltonian = ScaledFunction(system.hamiltonian, units)
        integrals = {name: one for name, one in system.integrals.items() if hasattr(one, "hessian")}
        self.integrals = {name: ScaledFunction(one, units) for name, one in integrals.items()}

    def energy(self, y: Floats) -> Any:
        return self._system.energy(self.units * y)

    def vector_field(self, y: Floats) -> Floats:
        return np.asarray(self._system.vector_field(self.units * y) / self.units)

    def jacobian(self, y: Floats) -> Floats:
        return np.asarray(self._system.jacobian(self.units * y) / self.units[:, None] * self.units)

    def structure_matrix(self, y: Floats) -> Floats:
        return np.asarray(self._system.structure_matrix(self.units * y) / self.units[:, None] / self.units)


class ScaledFunction:
    """Derivatives of a Hamiltonian, at a time, or of an integral in coordinates y = x / units."""

    def __init__(self, function: Any, units: Floats) -> None:
        self._function, self._units = function, units

    def gradient(self, y: Floats, *time: float) -> Floats:
        return np.asarray(self._units * self._function.gradient(self._units * y, *time))

    def hessian(self, y: Floats, *time: float) -> Floats:
        curvature = np.asarray(self._function.hessian(self._units * y, *time))
        return np.asarray(self._units[:, None] * curvature * self._units)


def units_of(system: Any, x: Floats) -> Floats:
    """Return powers of two as units of the coordinates: sizes of their groups in x if these differ much, else one."""
    groups = CoordinateGroups(system)
    return groups.units(groups.norms(x))


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


def tangents_of(system: Any, x: Floats) -> TangentSpace:
    """Return the tangent space of the orbit of x, from singular value decompositions of J(x) on direct summands."""
    P = system.sign * np.asarray(system.structure_matrix(x), dtype=np.float64)
    found = [(rows, *np.linalg.svd(P[np.ix_(rows, rows)])[:2]) for rows, _ in summands(system.algebra.triples, len(P))]
    smallest = RANK_TOLERANCE * max(sizes[0] for _, _, sizes in found)
    kept = [(rows, left[:, sizes > smallest]) for rows, left, sizes in found]
    basis, blocks, first = np.zeros((len(P), sum(left.shape[1] for _, left in kept))), [], 0
    for rows, left in kept:
        columns = slice(first, first := first + left.shape[1])
        basis[rows, columns] = left
        blocks.append((rows, columns))
    return TangentSpace(P, basis, blocks)


def second_variation(system: Any, x: Floats, function: Any, tangents: TangentSpace, *time: float) -> Floats:
    """Return the second derivatives of F(exp(D_v) x) by v, at v = 0, in the basis of the tangent space."""
    P, U, blocks = tangents
    u = np.asarray(function.gradient(x, *time), dtype=np.float64)
    hessian = np.asarray(function.hessian(x, *time), dtype=np.float64)
    D = system.sign * np.asarray(system.algebra.coadjoint(u), dtype=np.float64)
    PU = np.zeros_like(U)
    for rows, columns in blocks:
        PU[rows, columns] = P[np.ix_(rows, rows)] @ U[rows, columns]
    Q = tangents.restricted(hessian, PU)
    for rows, columns in blocks:
        Q[columns, columns] -= U[rows, columns].T @ D[np.ix_(rows, rows)] @ PU[rows, columns]
    return np.asarray(0.5 * (Q + Q.T))
