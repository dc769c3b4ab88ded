"""Vectorized evaluation of many products of powers at a point, in any number type."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import exact_numbers

Coefficient = int | float | Fraction

MAX_NUMBERS = 2**18
"""Number of products evaluated at once for many points; more do not fit the cache."""


def differentiated(
    terms: Iterable[tuple[int, Coefficient, dict[int, int]]], dim: int
) -> list[tuple[int, Coefficient, dict[int, int]]]:
    """Differentiate products by each of their coordinates; place p maps to p * dim + i.

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
    """Sums of terms (place, coefficient, {coordinate: exponent}), each added to one of `places` entries of the result.

    Examples
    --------
    >>> ProductSum([(0, 2, {1: 2}), (1, 3, {})], 2)(np.array([0.0, 5.0]))
    array([50.,  3.])
    """

    def __init__(self, terms: Iterable[tuple[int, Coefficient, dict[int, int]]], places: int) -> None:
        rows = sorted(terms, key=lambda term: not term[2])  # constants last, since they have no product
        self._places = places
        self._to = np.array([place for place, _, _ in rows], dtype=np.int64)
        try:
            self._exact = exact_numbers(value for _, value, _ in rows)
            self._coefficients = np.array([float(value) for _, value, _ in rows])
        except OverflowError:
            raise ValueError(
                "a coefficient of a polynomial, or of its derivatives, leaves the range of float64"
            ) from None
        sizes = [len(factors) for _, _, factors in rows if factors]
        self._starts = (
            np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64) if sizes else np.zeros(0, dtype=np.int64)
        )
        self._index = np.array([i for _, _, factors in rows for i in factors], dtype=np.int64)
        self._power = np.array([e for _, _, factors in rows for e in factors.values()], dtype=np.int64)

    def __call__(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the sums at the point x, in its number type."""
        result = np.zeros(self._places, dtype=x.dtype)
        terms = (self._exact if x.dtype == object else self._coefficients.astype(x.dtype)).copy()
        if self._starts.size:
            power = self._power.astype(object) if x.dtype == object else self._power
            terms[: self._starts.size] *= np.multiply.reduceat(x[self._index] ** power, self._starts)
        np.add.at(result, self._to, terms)
        return result

    def along(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the sums at points (..., n), shape (..., places), in their number type.

        Powers and shared products are computed once: much faster than point by point, and equal up to rounding.
        """
        points = x.reshape(-1, x.shape[-1])
        result = np.zeros((len(points), self._places), dtype=x.dtype)
        if len(self._to):
            together = max(1, MAX_NUMBERS // (len(self._to) + self._distinct_products.distinct_factors))
            for first in range(0, len(points), together):
                some = slice(first, first + together)
                result[some, self._distinct_products.places] = self._at(np.ascontiguousarray(points[some].T)).T
        return result.reshape(*x.shape[:-1], self._places)

    def _at(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the nonconstant sums at points (n, k), shape (places with terms, k)."""
        shared, exact = self._distinct_products, x.dtype == object
        powers = [x]
        while len(powers) < int(self._power.max(initial=1)):
            powers.append(powers[-1] * x)
        table = np.stack(powers)
        products = np.ones((shared.distinct_factors, x.shape[1]), dtype=x.dtype)
        for which, index, power in shared.factors:
            products[which] = products[which] * table[power - 1, index]
        coefficients = (self._exact if exact else self._coefficients.astype(x.dtype))[shared.order]
        return np.add.reduceat(products[shared.product] * coefficients[:, None], shared.starts, axis=0)

    @cached_property
    def _distinct_products(self) -> _DistinctProducts:
        of_rows: list[tuple[tuple[int, int], ...]] = [()] * len(self._to)
        ends = np.append(self._starts, len(self._index))
        for row, (first, last) in enumerate(pairwise(ends.tolist())):
            of_rows[row] = tuple(
                sorted(zip(self._index[first:last].tolist(), self._power[first:last].tolist(), strict=True))
            )
        place = {factors: k for k, factors in enumerate(dict.fromkeys(of_rows))}
        steps: list[list[tuple[int, int, int]]] = [[] for _ in range(max(map(len, place), default=0))]
        for factors, k in place.items():
            for step, (i, e) in zip(steps, factors, strict=False):
                step.append((k, i, e))
        order = np.argsort(self._to, kind="stable")
        places, starts = np.unique(self._to[order], return_index=True)
        product = np.array([place[factors] for factors in of_rows], dtype=np.int64)[order]
        columns = [tuple(np.array(step, dtype=np.int64).T) for step in steps]
        return _DistinctProducts(len(place), columns, order, product, places, starts)


class _DistinctProducts(NamedTuple):
    """The distinct products of all sums, and the terms in order of place."""

    distinct_factors: int
    factors: list[tuple[NDArray[np.int64], ...]]  # of the first factor of each product, then of the second, and so on
    order: NDArray[np.int64]
    product: NDArray[np.int64]
    places: NDArray[np.int64]
    starts: NDArray[np.int64]
