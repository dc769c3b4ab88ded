"""Sizes of invariants before cancellation, the scale of their round-off."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian

Floats = NDArray[np.float64]


def size_of(invariant: Any, x: Floats) -> float:
    """Return |gradient| |x| plus the sum of the absolute terms; rounding of x and of the terms changes u times that."""
    value = invariant(x) if callable(invariant) else invariant.value(x)
    terms = max(abs(float(value)), _absolute(invariant, x))
    return terms + float(np.linalg.norm(_gradient(invariant, x)) * np.linalg.norm(x))


def _gradient(invariant: Any, x: Floats) -> Floats:
    if getattr(invariant, "gradient", None) is not None:
        return np.asarray(invariant.gradient(x), dtype=np.float64)
    small = 2.0**-17 * (float(np.max(np.abs(x))) or 1.0)
    moved = [(invariant(x + small * unit) - invariant(x - small * unit)) / (2 * small) for unit in np.eye(len(x))]
    return np.array(moved, dtype=np.float64)


def _absolute(invariant: Any, x: Floats) -> float:
    """Return the sum of the absolute values of the terms; 0 for functions."""
    if isinstance(invariant, Polynomial):
        invariant = as_hamiltonian(invariant, len(x))
    if not hasattr(invariant, "terms"):
        return 0.0
    return float(sum(term.given_to(_Absolute(np.abs(x))) or 0.0 for term in invariant.terms()))


class _Absolute:
    """Visitor of the terms of a Hamiltonian that returns the sum of their absolute values."""

    def __init__(self, size: Floats) -> None:
        self.size = size

    def quadratic(self, term: Any) -> float:
        x = self.size
        couplings = float(np.sum(x[term.rows] * np.abs(term.values) * x[term.indices])) / 2
        return abs(term.constant) + float(np.abs(term.linear) @ x) + couplings

    def polynomial(self, term: Any) -> float:
        return sum(
            abs(float(c)) * float(np.prod(self.size ** np.array(e))) for e, c in term.polynomial.monomials.items()
        )

    def function(self, term: Any) -> float:
        return 0.0
