"""Derivatives of attitudes: by the group elements of loops, unit ones at the start of shifted runs; and of one step."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.program.shifts.shift import quadratic_entries
from coadjoint.runs.loops.loops import loops_of_system
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.systems.parameter_differences import DISTANCE, NODES, WEIGHTS

Floats = NDArray[np.float64]

# Largest matrix whose exponential is differentiated in all directions at once, by blocks of twice the size.
LARGEST_BLOCK = 16


class AttitudeDerivatives:
    """The attitude A = A0 exp(t X) G of the element G of a loop, with X linear in the initial momentum."""

    # X = -sign sum c rho(grad C(x0)) over the Casimirs subtracted from the energy; without any A = G, started at A0.

    def __init__(self, system: Any, shift: Sequence[tuple[Any, float]], representation: Any) -> None:
        self.factors = np.array([factor for _, factor in shift])
        rho = -np.swapaxes(_dual_coadjoint(system), 1, 2) if isinstance(representation, str) else representation
        # X = sum over Casimirs c and coordinates j of factors[c] x0[j] of_casimir[c, j].
        self.of_casimir = np.zeros((len(shift), system.dim, *rho.shape[1:]))
        for number, (casimir, _) in enumerate(shift):
            entries = quadratic_entries(casimir)
            assert entries is not None
            for i, j, value in zip(*entries, strict=True):
                self.of_casimir[number, j] -= system.sign * value * rho[i]

    def with_factors(self, factors: Floats) -> AttitudeDerivatives:
        """Return the derivatives for other factors of the same Casimirs."""
        other = copy.copy(self)
        other.factors = factors
        return other

    @property
    def shifted(self) -> bool:
        """Whether a Casimir was subtracted."""
        return len(self.factors) > 0

    def _generator(self, x0: Floats) -> Floats:
        return np.asarray(np.einsum("c,j,cjab->ab", self.factors, x0, self.of_casimir))

    def element(self, x0: Floats, A0: Floats, t: float, G: Floats) -> Floats:
        """Return the attitude (d, d) of a shifted run at a time since the start."""
        from scipy.linalg import expm

        return np.asarray(A0 @ expm(t * self._generator(x0)) @ G)

    def tangents(
        self, x0: Floats, A0: Floats, times: Floats, G: Floats, dx0: Floats, dA0: Floats, factors: Floats, dG: Floats
    ) -> Floats:
        """Return the tangents (points, k, d, d) of the attitudes of one member along k directions."""
        if not self.shifted:
            return dG
        X = self._generator(x0)
        dX = np.einsum("c,kj,cjab->kab", self.factors, dx0, self.of_casimir)
        dX += np.einsum("kc,j,cjab->kab", factors, x0, self.of_casimir)
        # The derivative of the exponential is linear: many directions are combined from those of a basis.
        basis, weights = dX, np.eye(len(dX))
        if len(dX) > len(x0) + len(self.factors):
            of_x0 = np.einsum("c,cjab->jab", self.factors, self.of_casimir)
            of_factors = np.einsum("j,cjab->cab", x0, self.of_casimir)
            basis, weights = np.concatenate([of_x0, of_factors]), np.concatenate([dx0, factors], axis=1)
        out = np.empty_like(dG)
        for point, t in enumerate(times.tolist()):
            E, of_basis = _exponentials(t * X, t * basis)
            dE = np.tensordot(weights, of_basis, axes=1)
            out[point] = dA0 @ (E @ G[point]) + A0 @ (dE @ G[point] + E @ dG[point])
        return out

    def cotangents(
        self, x0: Floats, A0: Floats, times: Floats, G: Floats, of_attitudes: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the cotangents of x0, A0, the factors, and the elements of the loop, for those of the attitudes."""
        from scipy.linalg import expm, expm_frechet

        d = A0.shape[0]
        of_x0, of_A0, of_factors = np.zeros(len(x0)), np.zeros((d, d)), np.zeros(len(self.factors))
        if not self.shifted:
            return of_x0, of_A0, of_factors, of_attitudes
        X, of_G = self._generator(x0), np.empty_like(of_attitudes)
        for point, t in enumerate(times.tolist()):
            E, of_A = expm(t * X), of_attitudes[point]
            of_G[point] = (A0 @ E).T @ of_A
            of_A0 += of_A @ (E @ G[point]).T
            if t and of_A.any():
                of_E = A0.T @ of_A @ G[point].T
                of_X = t * expm_frechet(t * X.T, of_E, compute_expm=False)
                by_pair = np.einsum("ab,cjab->cj", of_X, self.of_casimir)
                of_x0 += self.factors @ by_pair
                of_factors += by_pair @ x0
        return of_x0, of_A0, of_factors, of_G


class ElementDifferences:
    """The element g of a step, A -> A g, and its derivative by the state before, by differences of order 8."""

    def __init__(self, method: Method, h: float, representation: Representation) -> None:
        self._method, self._h, self._representation = method, h, representation
        self._steps: dict[int, tuple[Any, PartialSteps]] = {}

    def at(self, system: Any, x: Floats, t: float, h: float) -> Floats:
        """Return the elements (m, d, d) of a step of a system from states (m, n)."""
        if id(system) not in self._steps:
            loops = loops_of_system(system, self._method, self._h, self._representation)
            if any(loops.corrections):
                raise TypeError(f"attitudes by {self._method} have no derivatives; take Splitting or GaussLegendre")
            # The system is stored with its loops: its number is not used for another one.
            self._steps[id(system)] = system, PartialSteps(system, self._method, loops)
        d = system.dim if isinstance(self._representation, str) else self._representation.shape[1]  # type: ignore[union-attr]
        count, units = len(x), np.tile(np.eye(d).ravel(), (len(x), 1))
        owners = np.zeros(count, dtype=np.int64)
        _, groups = self._steps[id(system)][1].take(
            np.ascontiguousarray(x), units, np.full(count, t), np.full(count, h), owners
        )
        return np.swapaxes(groups.reshape(count, d, d), 1, 2)

    def with_derivative(self, system: Any, x: Floats, t: float, h: float) -> tuple[Floats, Floats]:
        """Return the element (d, d) of a step, and its derivative (n, d, d) by the state."""
        distance = DISTANCE * (float(np.max(np.abs(x))) or 1.0)
        moves = distance * np.concatenate([NODES, -NODES])[:, None, None] * np.eye(len(x))
        rows = np.concatenate([x[None], (x + moves).reshape(-1, len(x))])
        elements = self.at(system, rows, t, h)
        moved = elements[1:].reshape(len(moves), len(x), *elements.shape[1:])
        weights = np.concatenate([WEIGHTS, -WEIGHTS]) / distance
        return elements[0], np.tensordot(weights, moved, axes=1)


def _exponentials(X: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Return the exponential of X and its derivatives along directions (k, d, d)."""
    from scipy.linalg import expm, expm_frechet

    count, d = len(directions), len(X)
    if d > LARGEST_BLOCK:
        nonzero = directions.any(axis=(1, 2))
        derivatives = np.zeros((count, d, d))
        for k in np.flatnonzero(nonzero):
            derivatives[k] = expm_frechet(X, directions[k], compute_expm=False)
        return expm(X), derivatives
    blocks = np.zeros((count, 2 * d, 2 * d))
    blocks[:, :d, :d] = blocks[:, d:, d:] = X
    blocks[:, :d, d:] = directions
    return expm(X), expm(blocks)[:, :d, d:]


def _dual_coadjoint(system: Any) -> Floats:
    """Return -D_i^T, with J(x) e_i = D_i x."""
    units = np.eye(system.dim)
    J = np.array([system.algebra.structure_matrix(unit) for unit in units])
    return np.asarray(-np.transpose(J, (2, 0, 1)))
