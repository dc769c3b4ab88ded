"""Monte Carlo sweeps over sites of SU(N): each is drawn from the exact distribution in the field of the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.lattices.spin_operators import norms_of, tensor_operators

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

PURE = 1e-9  # largest deviation of rho^2 from rho


@dataclass(frozen=True)
class CoherentMoves:
    """Moves of pure states of N levels, whose coordinates are expectations of the basis operators."""

    levels: int

    @property
    def width(self) -> int:
        """Coordinates of a site."""
        return self.levels**2 - 1

    @property
    def words(self) -> int:
        """Random numbers of a site in a sweep: of the weights of pairs of levels, and of the phases."""
        return max(2 * self.levels, self.levels * (self.levels + 1) // 2)

    def uniform(self, u: Floats) -> Floats:
        """Return uniform pure states (sites, width, members) from `words` uniform numbers each."""
        # Weights of levels are uniform on their simplex: spacings of the exponential distribution.
        waiting = -np.log(u[: self.levels])
        phases = u[self.levels : 2 * self.levels]
        return self._coordinates(np.sqrt(waiting / waiting.sum(axis=0)) * np.exp(2j * np.pi * phases))

    def draw(self, field: Floats, x: Floats, beta: Floats, u: Floats, weights: bool) -> Floats:
        """Return new states in the field -dH/dx, (sites, width, members); without `weights` of the same energy."""
        energies, vectors = np.linalg.eigh(-self._matrices(field))
        p = (vectors.conj() * (self._densities(x) @ vectors)).sum(axis=-2).real.clip(0.0)
        p = np.moveaxis(p / p.sum(axis=-1, keepdims=True), -1, 0)
        energies = np.moveaxis(energies, -1, 0)
        pairs = [(i, j) for j in range(self.levels) for i in range(j)]
        for word, (i, j) in enumerate(pairs if weights else []):
            # The energy of a pair is linear in its upper weight: a truncated exponential distribution.
            total = p[i] + p[j]
            strength = beta * (energies[j] - energies[i]) * total
            with np.errstate(divide="ignore", invalid="ignore"):
                share = -np.log1p(u[word] * np.expm1(-strength)) / strength
            p[j] = total * np.where(strength > 0.0, share, u[word]).clip(0.0, 1.0)
            p[i] = total - p[j]
        amplitudes = np.sqrt(p) * np.exp(2j * np.pi * u[len(pairs) : len(pairs) + self.levels])
        Z = (vectors * np.moveaxis(amplitudes, 0, -1)[..., None, :]).sum(axis=-1)
        return self._coordinates(np.moveaxis(Z, -1, 0))

    def are_pure(self, x: Floats) -> bool:
        """Return whether all states (sites, width, members) are pure."""
        rho = self._densities(x)
        return bool(np.abs(rho @ rho - rho).max() <= PURE)

    def _coordinates(self, Z: Complex) -> Floats:
        """Return expectations (sites, width, members) in amplitudes (N, sites, members) of norm one."""
        rows = []
        for T in tensor_operators(self.levels)[1:]:
            i, j = np.nonzero(T)
            rows.append(sum((Z[a].conj() * T[a, b] * Z[b]).real for a, b in zip(i.tolist(), j.tolist(), strict=True)))
        return np.stack(rows, axis=1)

    def _matrices(self, coefficients: Floats) -> Complex:
        """Return the matrices (sites, members, N, N) of coefficients (sites, width, members)."""
        shape = (len(coefficients), coefficients.shape[2], self.levels, self.levels)
        found = np.zeros(shape, dtype=np.complex128)
        for a, T in enumerate(tensor_operators(self.levels)[1:]):
            for i, j in zip(*np.nonzero(T), strict=True):
                found[:, :, i, j] += coefficients[:, a] * T[i, j]
        return found

    def _densities(self, x: Floats) -> Complex:
        """Return the density matrices (sites, members, N, N) of states."""
        return np.asarray(self._matrices(x / norms_of(self.levels)[1]) + np.eye(self.levels) / self.levels)
