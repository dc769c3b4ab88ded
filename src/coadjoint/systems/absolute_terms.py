"""Sizes of invariants: sums of the absolute values of their terms."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian

Floats = NDArray[np.float64]


def sum_of_absolute_terms(invariant: Any, x: Floats) -> Floats:
    """Return the sums of the absolute values of the terms of an invariant at states (..., *shape); 0 for functions.

    Examples
    --------
    >>> sum_of_absolute_terms(Polynomial("x1*x2 - 3*x3^2", 3), np.array([[1.0, -2.0, 1.0]])).tolist()
    [5.0]
    """
    if hasattr(invariant, "sum_of_absolute_terms"):
        return np.asarray(invariant.sum_of_absolute_terms(x))
    if isinstance(invariant, Polynomial):
        invariant = as_hamiltonian(invariant, x.shape[-1])
    terms = invariant.terms() if hasattr(invariant, "terms") else ()
    if not terms:
        return np.zeros(())
    total = np.zeros(x.shape[:-1])
    for term in terms:
        total += term.describe_to(_AbsoluteSum(np.abs(x)))
    return total


class _AbsoluteSum:
    """Visitor of the terms of a Hamiltonian that returns the sums of their absolute values."""

    def __init__(self, size: Floats) -> None:
        self.size = size

    def quadratic(self, term: Any) -> Floats:
        x = self.size
        # Contiguous rows are summed in the same order for one state and for many.
        products = np.ascontiguousarray(x[..., term.rows] * np.abs(term.values) * x[..., term.indices])
        linear = np.ascontiguousarray(np.abs(term.linear) * x)
        return np.asarray(abs(term.constant) + np.sum(linear, axis=-1) + np.sum(products, axis=-1) / 2)

    def polynomial(self, term: Any) -> Floats:
        total = np.zeros(self.size.shape[:-1])
        for exponents, coefficient in term.polynomial.monomials.items():
            total += abs(float(coefficient)) * np.prod(self.size ** np.array(exponents), axis=-1)
        return total

    def function(self, term: Any) -> Floats:
        return np.zeros(self.size.shape[:-1])
