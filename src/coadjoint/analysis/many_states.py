"""Vectors of polynomials at many states at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomial import Polynomial

AT_ONCE = 2**22  # products that are in memory at once


class ManyStates:
    """Polynomials at states (k, n), from one table of their monomials.

    Parameters
    ----------
    polynomials : sequence of Polynomial
        In the same coordinates.

    Examples
    --------
    >>> ManyStates([Polynomial({(2, 1): 3}), Polynomial({(0, 0): 1})])(np.array([[1.0, 2.0], [2.0, 0.5]]))
    array([[6., 1.],
           [6., 1.]])
    """

    def __init__(self, polynomials: Sequence[Polynomial]) -> None:
        dim = polynomials[0].dim
        monomials = sorted({e for polynomial in polynomials for e in polynomial.monomials})
        place = {e: k for k, e in enumerate(monomials)}
        self._exponents = np.array(monomials, dtype=np.int64).reshape(len(monomials), dim)
        self._coefficients = np.zeros((len(monomials), len(polynomials)))
        for column, polynomial in enumerate(polynomials):
            for e, value in polynomial.monomials.items():
                self._coefficients[place[e], column] = value

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values, shape (k, polynomials)."""
        count, highest = len(self._exponents), int(self._exponents.max(initial=0))
        at_once = max(1, AT_ONCE // max(1, count))
        result = np.empty((len(x), self._coefficients.shape[1]))
        for first in range(0, len(x), at_once):
            states = x[first : first + at_once]
            powers = [np.ones_like(states)]
            for _ in range(highest):
                powers.append(powers[-1] * states)
            table = np.stack(powers)
            products = np.ones((len(states), count))
            for i in range(states.shape[1]):
                products *= table[self._exponents[:, i], :, i].T
            result[first : first + at_once] = products @ self._coefficients
        return result
