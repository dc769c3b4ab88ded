"""Formal vector field of a step (Lemma 6.1), from the exact power series or pointwise."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import fraction
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials

Field = list[Exact]
"""The n polynomials of a vector field."""


def field_of_series(ring: ExactPolynomials, series: Sequence[Field]) -> list[Field]:
    """Return f_0, f_1, ... with exp(h (f_0 + h f_1 + ...)) = the series of a step, as polynomials of h^0, h^1, ..."""
    # S. Reich 1993, Lemma 6.1, where the indices of the fields Y are too low by one. With D the derivative along
    # h f_0 + h^2 f_1 + ..., the flow is sum_m D^m x / m!, in which f_k first occurs in the coefficient of h^(k+1).
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
    return ExactPolynomials(LieAlgebra([], dim=dim), symbols)


def size_of(polynomial: Exact) -> float:
    """Return the largest absolute coefficient."""
    largest = max((abs(value) for value in polynomial.coeffs()), default=0)
    return float(fraction(largest)) if largest else 0.0


def field_at(step: Callable[[NDArray[Any], Any], Any], x: NDArray[Any], steps: Sequence[Any]) -> NDArray[Any]:
    """Return f_0(x), ..., f_(r-1)(x), (r, n), from steps ``step(x, h)`` of r different lengths, in the numbers of x."""
    # X(h) = (1/h) sum_(m=1)^r (-1)^(m+1)/m (step - 1)^m x is f_0 + h f_1 + ... + O(h^r). The terms are the coefficients
    # of the interpolation polynomial in h through the r values of X.
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
