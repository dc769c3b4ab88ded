"""Monomials: validation, and vectorized evaluation of sums of products of powers in any number type."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from functools import cached_property
from itertools import combinations_with_replacement, pairwise
from numbers import Rational
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import exact_number, exact_numbers, is_finite
from coadjoint.short_repr import short
from coadjoint.validation import is_integer, is_real, read_integer

Coefficient = int | float | Fraction
Exponents = tuple[int, ...]

MAX_NUMBERS = 2**18
"""Number of products evaluated at once for many points; more do not fit the cache."""


def read_exponents(argument: Any) -> Exponents:
    """Validate exponents and return them as Python integers."""
    if not isinstance(argument, tuple | list):
        raise TypeError(f"exponents must be a tuple of whole numbers, one for each coordinate, not {short(argument)}")
    if set(map(type, argument)) <= {int} and min(argument, default=0) >= 0:  # fast path for many coordinates
        return tuple(argument)
    for exponent in argument:
        if not is_integer(exponent):
            raise TypeError(f"exponents {short(argument)} must be whole numbers; {short(exponent)} is not")
        if exponent < 0:
            raise ValueError(f"exponents {short(argument)} must not be negative")
    return tuple(map(int, argument))


def exponents_of(factors: Iterable[int], dim: int) -> Exponents:
    """Return the exponents of a product of coordinates, given by their indices."""
    exponents = [0] * dim
    for i in factors:
        exponents[i] += 1
    return tuple(exponents)


def exponents_of_degree(dim: int, degree: int) -> Iterator[Exponents]:
    """Yield the exponents of all products of `degree` coordinates."""
    return (exponents_of(factors, dim) for factors in combinations_with_replacement(range(dim), degree))


def factors_of(exponents: Exponents) -> list[int]:
    """Return the coordinates in a monomial with multiplicity; fast for low degrees and many coordinates."""
    factors: list[int] = []
    for degree in range(1, max(exponents) + 1):
        coordinate = -1
        for _ in range(exponents.count(degree)):
            coordinate = exponents.index(degree, coordinate + 1)
            factors += [coordinate] * degree
    return sorted(factors)


def read_coefficient(value: Any, what: str) -> Coefficient:
    """Validate a coefficient and return it as int, float or Fraction."""
    if not (is_real(value) and isinstance(value, Rational | float | np.floating)):
        raise TypeError(f"{what} must be an int, float or Fraction, not {short(value)}")
    number: Coefficient = exact_number(value) if isinstance(value, Rational) else float(value)
    if not is_finite(number):
        raise ValueError(f"{what} is {short(value)}; it must be finite and within float64")
    return number


def read_monomials(monomials: Any, dim: Any) -> tuple[dict[Exponents, Coefficient], int]:
    """Validate the monomials of a polynomial, and its dimension; without one, it is the number of exponents."""
    if not isinstance(monomials, Mapping):
        raise TypeError(
            "monomials must be a mapping {exponents: coefficient}, or a text such as '0.5*x1^2 - x2*x3', not "
            f"{type(monomials).__name__}"
        )
    if dim is not None:
        dim = read_integer(dim, "dim of a Polynomial")
    if not monomials and dim is None:
        raise ValueError("dim must be given for a Polynomial without monomials")
    collected: dict[Exponents, Coefficient] = {}
    for key, value in monomials.items():
        exponents = read_exponents(key)
        if dim is None:
            dim = len(exponents)
        if len(exponents) != dim:
            raise ValueError(
                f"exponents {short(key)} have length {len(exponents)}; this Polynomial has dimension {short(dim)}"
            )
        collected[exponents] = read_coefficient(value, f"the coefficient of {short(key)}")
    if dim is None or dim < 1:
        raise ValueError("a Polynomial needs at least one coordinate; its exponents are empty")
    return collected, int(dim)


def differentiated(
    terms: Iterable[tuple[int, Coefficient, dict[int, int]]], dim: int
) -> list[tuple[int, Coefficient, dict[int, int]]]:
    """Differentiate products by each of their coordinates; target t maps to t * dim + i.

    Examples
    --------
    >>> differentiated([(0, 5, {0: 3, 1: 1})], 2)
    [(0, 15, {0: 2, 1: 1}), (1, 5, {0: 3})]
    """
    result: list[tuple[int, Coefficient, dict[int, int]]] = []
    for target, value, factors in terms:
        for i, e in factors.items():
            left = {j: f - (j == i) for j, f in factors.items() if j != i or f > 1}
            result.append((target * dim + i, e * value, left))
    return result


class ProductSum:
    """Sums of terms (target, coefficient, {coordinate: exponent}), added to entry `target` of a result of `size`."""

    def __init__(self, terms: Iterable[tuple[int, Coefficient, dict[int, int]]], size: int) -> None:
        rows = sorted(terms, key=lambda term: not term[2])  # constants last, since they have no product
        self._size = size
        self._targets = np.array([target for target, _, _ in rows], dtype=np.int64)
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
        result = np.zeros(self._size, dtype=x.dtype)
        terms = (self._exact if x.dtype == object else self._coefficients.astype(x.dtype)).copy()
        if self._starts.size:
            power = self._power.astype(object) if x.dtype == object else self._power
            terms[: self._starts.size] *= np.multiply.reduceat(x[self._index] ** power, self._starts)
        np.add.at(result, self._targets, terms)
        return result

    def along(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the sums at points (..., n), shape (..., size), in their number type.

        Powers and shared products are computed once: much faster than point by point, and equal up to rounding.
        """
        points = x.reshape(-1, x.shape[-1])
        result = np.zeros((len(points), self._size), dtype=x.dtype)
        if len(self._targets):
            _, targets, _ = self._by_target
            count, _, _ = self._distinct_products
            chunk = max(1, MAX_NUMBERS // (len(self._targets) + count))
            for first in range(0, len(points), chunk):
                rows = slice(first, first + chunk)
                result[rows, targets] = self._nonconstant_sums(np.ascontiguousarray(points[rows].T)).T
        return result.reshape(*x.shape[:-1], self._size)

    def _nonconstant_sums(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the sums that have terms at points (n, k), shape (targets with terms, k)."""
        (order, _, starts), (count, factors, product) = self._by_target, self._distinct_products
        powers = [x]
        while len(powers) < int(self._power.max(initial=1)):
            powers.append(powers[-1] * x)
        table = np.stack(powers)
        products = np.ones((count, x.shape[1]), dtype=x.dtype)
        for row, index, power in factors:
            products[row] = products[row] * table[power - 1, index]
        coefficients = self._exact if x.dtype == object else self._coefficients.astype(x.dtype)
        return np.add.reduceat(products[product[order]] * coefficients[order][:, None], starts, axis=0)

    @cached_property
    def _by_target(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """The terms in order of target, the targets, and the first term of each."""
        order = np.argsort(self._targets, kind="stable")
        return order, *np.unique(self._targets[order], return_index=True)

    @cached_property
    def _distinct_products(self) -> tuple[int, list[tuple[NDArray[np.int64], ...]], NDArray[np.int64]]:
        """The number of distinct products, their first, second and further factors, and the product of each term."""
        of_rows: list[tuple[tuple[int, int], ...]] = [()] * len(self._targets)
        ends = np.append(self._starts, len(self._index))
        for row, (first, last) in enumerate(pairwise(ends.tolist())):
            of_rows[row] = tuple(
                sorted(zip(self._index[first:last].tolist(), self._power[first:last].tolist(), strict=True))
            )
        product_index = {factors: k for k, factors in enumerate(dict.fromkeys(of_rows))}
        steps: list[list[tuple[int, int, int]]] = [[] for _ in range(max(map(len, product_index), default=0))]
        for factors, k in product_index.items():
            for step, (i, e) in zip(steps, factors, strict=False):
                step.append((k, i, e))
        columns = [tuple(np.array(step, dtype=np.int64).T) for step in steps]
        return len(product_index), columns, np.array([product_index[factors] for factors in of_rows], dtype=np.int64)
