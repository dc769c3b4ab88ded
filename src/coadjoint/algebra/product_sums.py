"""Fast evaluation of many products of powers at a point, in any kind of number."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact import exact_numbers

Coefficient = int | float | Fraction

MOST_NUMBERS = 2**20
"""Factors that are held at once where there are many points: more do not fit a cache."""


def differentiated(
    terms: Iterable[tuple[int, Coefficient, dict[int, int]]], dim: int
) -> list[tuple[int, Coefficient, dict[int, int]]]:
    """Differentiate products by each of their coordinates; place p goes to place p * dim + i.

    Examples
    --------
    >>> differentiated([(0, 5, {0: 3, 1: 1})], 2)
    [(0, 15, {0: 2, 1: 1}), (1, 5, {0: 3})]
    """
    result: list[tuple[int, Coefficient, dict[int, int]]] = []
    for place, value, factors in terms:
        for i, e in factors.items():
            left = {j: f - (j == i) for j, f in factors.items() if j != i or f > 1}
            result.append((place * dim + i, e * value, left))
    return result


class ProductSum:
    """Sums of coefficient * product of powers, each added to one place of the result; arrays, so that it is fast.

    Parameters
    ----------
    terms : iterable of (place, coefficient, {coordinate: exponent})
    places : int
        Length of the result.

    Examples
    --------
    >>> ProductSum([(0, 2, {1: 2}), (1, 3, {})], 2)(np.array([0.0, 5.0]))
    array([50.,  3.])
    """

    def __init__(self, terms: Iterable[tuple[int, Coefficient, dict[int, int]]], places: int) -> None:
        rows = sorted(terms, key=lambda term: not term[2])  # constants last: they have no product
        self._places = places
        self._to = np.array([place for place, _, _ in rows], dtype=np.int64)
        self._exact = exact_numbers(value for _, value, _ in rows)
        self._coefficients = np.array([float(value) for _, value, _ in rows])
        sizes = [len(factors) for _, _, factors in rows if factors]
        self._starts = (
            np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64) if sizes else np.zeros(0, dtype=np.int64)
        )
        self._index = np.array([i for _, _, factors in rows for i in factors], dtype=np.int64)
        self._power = np.array([e for _, _, factors in rows for e in factors.values()], dtype=np.int64)

    def __call__(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the sums at the point x, in its kind of number."""
        result = np.zeros(self._places, dtype=x.dtype)
        terms = (self._exact if x.dtype == object else self._coefficients.astype(x.dtype)).copy()
        if self._starts.size:
            power = self._power.astype(object) if x.dtype == object else self._power
            terms[: self._starts.size] *= np.multiply.reduceat(x[self._index] ** power, self._starts)
        np.add.at(result, self._to, terms)
        return result

    def along(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the sums at many points (..., n), shape (..., places), in their kind of number.

        Powers are made once for all terms, so that it is much faster than point after point; the same up to rounding.
        """
        points = x.reshape(-1, x.shape[-1])
        result = np.zeros((len(points), self._places), dtype=x.dtype)
        together = max(1, MOST_NUMBERS // max(1, self._index.size + len(self._to)))
        for first in range(0, len(points), together):
            some = slice(first, first + together)
            self._add(points[some].T, result[some].T)
        return result.reshape(*x.shape[:-1], self._places)

    def _add(self, x: NDArray[Any], result: NDArray[Any]) -> None:
        """Add the sums at points (n, k) to a result (places, k)."""
        count = x.shape[1]
        exact = x.dtype == object
        coefficients = self._exact if exact else self._coefficients.astype(x.dtype)
        terms = np.repeat(coefficients[:, None], count, axis=1)
        if self._starts.size:
            powers = [x]
            while len(powers) < int(self._power.max()):
                powers.append(powers[-1] * x)
            factors = np.empty((len(self._index), count), dtype=x.dtype)
            for e, power in enumerate(powers, 1):
                own = self._power == e
                factors[own] = power[self._index[own]]
            terms[: self._starts.size] = terms[: self._starts.size] * np.multiply.reduceat(factors, self._starts)
        for place in range(self._places):
            own = np.flatnonzero(self._to == place)
            if len(own):
                result[place] += np.add.reduce(terms[own], axis=0)
