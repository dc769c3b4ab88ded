"""Formal vector field of a step (Lemma 6.1), from the exact power series or pointwise."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import fraction
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials

Field = list[Exact]
"""The n polynomials of a vector field."""


def field_of_series(ring: ExactPolynomials, series: Sequence[Field]) -> list[Field]:
    """Return f_0, f_1, ... with exp(h (f_0 + h f_1 + ...)) = the series of a step.

    The terms are found recursively. With D the derivative along h f_0 + h^2 f_1 + ..., the flow is sum_m D^m x / m!, in
    which f_k first occurs in the coefficient of h^(k+1), with the factor one. So f_k is this coefficient of the series
    minus that of the flow of the previous terms.

    Parameters
    ----------
    ring : ExactPolynomials
        The ring of the coefficients.
    series : sequence
        The coefficients of h^0 (the coordinates), h^1, ... of the step, n polynomials each.

    Returns
    -------
    list
        n polynomials for each power of h, one power fewer than in the series.

    Notes
    -----
    S. Reich 1993, Lemma 6.1, where the indices of the fields Y are too low by one.

    Examples
    --------
    The explicit Euler method for x' = x: the logarithm of 1 + h.

    >>> ring = plain_ring(1)
    >>> x = ring.coordinates[0]
    >>> [str(f) for (f,) in field_of_series(ring, [[x], [x], [0 * x], [0 * x]])]
    ['x1', '-1/2*x1', '1/3*x1']
    """
    fields: list[Field] = []
    # powers[m - 1][q] is the coefficient of h^q in D^m x, q >= m.
    powers: list[dict[int, Field]] = [{}]
    for k in range(len(series) - 1):
        power = k + 1
        field = list(series[power])
        for m in range(2, power + 1):
            if len(powers) < m:
                powers.append({})
            total = [ring.zero] * ring.dim
            for q, inner in powers[m - 2].items():
                j = power - q - 1
                if 0 <= j < len(fields):
                    total = [a + ring.along(fields[j], F) for a, F in zip(total, inner, strict=True)]
            powers[m - 1][power] = total
            field = [a - b / math.factorial(m) for a, b in zip(field, total, strict=True)]
        fields.append(field)
        powers[0][power] = field
    return fields


def plain_ring(dim: int, symbols: Sequence[str] = ()) -> ExactPolynomials:
    """Return the ring of polynomials in n coordinates, with zero bracket."""
    from coadjoint.algebra.lie_algebra import LieAlgebra

    return ExactPolynomials(LieAlgebra([], dim=dim), symbols)


def size_of(polynomial: Exact) -> float:
    """Return the largest absolute coefficient.

    Examples
    --------
    >>> x = plain_ring(1).coordinates[0]
    >>> size_of(3 * x - x * x / 2)
    3.0
    """
    largest = max((abs(value) for value in polynomial.coeffs()), default=0)
    return float(fraction(largest)) if largest else 0.0


def field_at(step: Callable[[NDArray[Any], Any], Any], x: NDArray[Any], steps: Sequence[Any]) -> NDArray[Any]:
    """Return f_0(x), ..., f_(r-1)(x) from steps of r different lengths.

    X(h) = (1/h) sum_(m=1)^r (-1)^(m+1)/m (step - 1)^m x is f_0 + h f_1 + ... + O(h^r), where powers are those of the
    operator of composition with the step. The terms are the coefficients of the interpolation polynomial in h through
    the r values of X.

    Parameters
    ----------
    step : callable
        ``step(x, h)``.
    x : (n,) array
        The point, in numbers of sufficient precision.
    steps : sequence of r numbers
        The lengths h, distinct and non-zero.

    Returns
    -------
    (r, n) array

    Examples
    --------
    >>> from fractions import Fraction
    >>> one = np.array([Fraction(1)], dtype=object)
    >>> terms = field_at(lambda x, h: x + h * x, one, [Fraction(k, 10**6) for k in (1, -1, 2)])
    >>> [float(f[0]).__round__(5) for f in terms]
    [1.0, -0.5, 0.33333]
    """
    count = len(steps)
    values = []
    for h in steps:
        points = [x]
        for _ in range(count):
            points.append(np.asarray(step(points[-1], h)))
        total, differences = 0 * x, points
        for m in range(1, count + 1):
            differences = [b - a for a, b in pairwise(differences)]
            total = total + differences[0] * (1 if m % 2 else -1) / m
        values.append(total / h)
    # Newton's divided differences, expanded in powers of h.
    table = list(values)
    for level in range(1, count):
        for i in reversed(range(level, count)):
            table[i] = (table[i] - table[i - 1]) / (steps[i] - steps[i - level])
    terms = [table[-1]]
    for i in reversed(range(count - 1)):
        shifted = [0 * x, *terms]
        for k, term in enumerate(terms):
            shifted[k] = shifted[k] - steps[i] * term
        shifted[0] = shifted[0] + table[i]
        terms = shifted
    return np.array(terms, dtype=object)
