"""Coefficients of collocation methods, Gauss-Legendre and Radau IIA, with any number of stages, in any number type."""

from __future__ import annotations

import decimal
import functools
import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.numbers import Number, roundoff

DIGITS = 60  # working precision for float64 coefficients; the formulas lose far fewer than 40 digits
UNIT_SPACING = 2.0**-52  # of float64 between 1 and 2, on which mu is rounded so that mu + mu^T is exactly one
MAX_DECIMAL_STAGES = 24  # up to this number of stages, sums in decimals are faster than the import of flint


Collocation = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]
"""Nodes c_i and weights b_i, shape (s,), and mu_ij = a_ij / b_j, shape (s, s)."""


def _legendre(degree: int, z: Any) -> list[Any]:
    values = [z * 0 + 1, z]
    for k in range(1, degree):
        values.append(((2 * k + 1) * z * values[k] - k * values[k - 1]) / (k + 1))
    return values[: degree + 1]


def _root(degree: int, radau: bool, z: Any) -> Any:
    """Return the root of P_degree (or of P_degree - P_{degree-1}) near z, by Newton's method to stagnation."""
    previous = None
    while True:
        values = _legendre(degree, z)
        # (z^2 - 1) P_k' = k (z P_k - P_{k-1})
        slope = degree * (z * values[-1] - values[-2])
        value = values[-1]
        if radau:
            value = values[-1] - values[-2]
            before = values[-3] if degree > 1 else value * 0
            slope = slope - (degree - 1) * (z * values[-2] - before)
        change = value * (z * z - 1) / slope
        if change == 0 or (previous is not None and abs(change) >= previous):
            return z
        previous = abs(change)
        z = z - change


def _collocation(roots: Sequence[Any], in_integers: bool = False) -> Collocation:
    """Return the method with points of [-1, 1] for which P_0, ..., P_{s-1} are discretely orthogonal."""
    # l_j = b_j sum_k (2k+1) P_k(z_j) P_k, 1/b_j = sum_k (2k+1) P_k(z_j)^2: no linear system and no cancellation.
    s = len(roots)
    values = [_legendre(s, z) for z in roots]
    sums = _sums_in_integers(values) if in_integers else None
    nodes, weights, mu = np.empty(s, dtype=object), np.empty(s, dtype=object), np.empty((s, s), dtype=object)
    for i in range(s):
        nodes[i] = (1 + roots[i]) / 2
        weights[i] = 1 / sum((2 * k + 1) * values[i][k] ** 2 for k in range(s))
        for j in range(s):
            if sums is None:
                total = sum(values[j][k] * (values[i][k + 1] - values[i][k - 1]) for k in range(1, s))
            else:
                total = decimal.Decimal(int(sums[i, j])).scaleb(-2 * DIGITS)
            mu[i, j] = (1 + roots[i] + total) / 2
    return nodes, weights, mu


def _symmetric(mu: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round mu so that mu_ij + mu_ji = 1 exactly in floats: the drift of quadratic invariants then has no bias."""
    below = np.tril(np.round(mu / UNIT_SPACING) * UNIT_SPACING, -1)
    return below + np.triu(1.0 - below.T, 1) + 0.5 * np.eye(mu.shape[0])


def _sums_in_integers(values: list[list[decimal.Decimal]]) -> Any:
    """Return the sums over k of `_collocation` a hundred times faster, in units of 10^(-2 DIGITS); |P_k| <= 1."""
    from flint import fmpz_mat

    s, unit = len(values), decimal.Decimal(10) ** DIGITS
    integers = [[int((value * unit).to_integral_value()) for value in row] for row in values]
    left = fmpz_mat([[row[k + 1] - row[k - 1] for k in range(1, s)] for row in integers])
    return left * fmpz_mat([row[1:s] for row in integers]).transpose()


@functools.lru_cache(maxsize=64)
def _in_floats(stages: int, radau: bool) -> Collocation:
    with decimal.localcontext(decimal.Context(prec=DIGITS)):
        roots = (_radau_roots if radau else _gauss_roots)(stages, decimal.Decimal)
        exact = _collocation(roots, in_integers=stages > MAX_DECIMAL_STAGES)
        nodes, weights, mu = (np.array(part, dtype=np.float64) for part in exact)
    mu = mu if radau else _symmetric(mu)
    for part in (nodes, weights, mu):
        part.flags.writeable = False
    return nodes, weights, mu


def _refuse_fractions(stages: int, number: Number) -> None:
    if stages > 1 and roundoff(number) == 0:
        raise TypeError(
            f"the nodes of {stages} stages are irrational, and exact fractions cannot represent them; take mpmath.mpf"
        )


def _gauss_roots(stages: int, number: Number) -> list[Any]:
    guesses = np.polynomial.legendre.leggauss(stages)[0].tolist()
    below = [_root(stages, False, number(z)) for z in guesses[: stages // 2]]
    middle = [number(0)] if stages % 2 else []
    return [*below, *middle, *(-z for z in reversed(below))]


def _gauss(stages: int, number: Number) -> Collocation:
    _refuse_fractions(stages, number)
    return _collocation(_gauss_roots(stages, number))


def _radau_roots(stages: int, number: Number) -> list[Any]:
    series = np.zeros(stages + 1)
    series[-2:] = -1.0, 1.0
    guesses = np.polynomial.legendre.legroots(series)
    interior = sorted(float(z.real) for z in guesses)[: stages - 1]
    return [*(_root(stages, True, number(z)) for z in interior), number(1)]


def _radau(stages: int, number: Number) -> Collocation:
    _refuse_fractions(stages, number)
    return _collocation(_radau_roots(stages, number))


def node_polynomial(stages: int) -> list[Fraction]:
    """Return the monic polynomial of degree s in c whose roots are the nodes, lowest power first.

    >>> [str(coefficient) for coefficient in node_polynomial(2)]
    ['1/6', '-1', '1']
    """
    signed = [(-1) ** (stages - k) * math.comb(stages, k) * math.comb(stages + k, k) for k in range(stages + 1)]
    return [Fraction(value, signed[-1]) for value in signed]


def gauss_legendre(stages: int, number: Number = float) -> Collocation:
    """Return the Gauss-Legendre method with s stages, of order 2 s; in float64 mu_ij + mu_ji = 1 exactly."""
    # E. Hairer, C. Lubich, G. Wanner, GNI II.1.3; E. Hairer, R. McLachlan, A. Razakarivony, BIT 48 (2008) 231.
    return _in_floats(stages, False) if number is float else _gauss(stages, number)


def radau(stages: int, number: Number = float) -> Collocation:
    """Return the Radau IIA method with s stages, of order 2 s - 1 (E. Hairer, G. Wanner, Solving ODEs II, IV.5)."""
    return _in_floats(stages, True) if number is float else _radau(stages, number)


MAX_EXTRAPOLATION_DEGREE = 9
"""Highest degree of the extrapolated Legendre polynomials: at the end of the next step they are about 6^degree."""


@functools.lru_cache(maxsize=64)
def extrapolation(stages: int, ratio: float) -> NDArray[np.float64]:
    """Return E (s, s) with x + sum_j E_ij L_j the polynomial of a Gauss step at the nodes of the next one."""
    # The integral of l_j / b_j from 1 to 1 + ratio c_i, truncated at a degree; `ratio` is next step over old step.
    with decimal.localcontext(decimal.Context(prec=DIGITS)):
        roots = _gauss_roots(stages, decimal.Decimal)
        top = min(stages, MAX_EXTRAPOLATION_DEGREE + 1)
        values = [_legendre(stages, z) for z in roots]
        result = np.zeros((stages, stages))
        for i in range(stages):
            z = 1 + decimal.Decimal(ratio) * (1 + roots[i])
            ahead = _legendre(stages, z)
            for j in range(stages):
                total = sum((values[j][k] * (ahead[k + 1] - ahead[k - 1]) for k in range(1, top)), z - 1)
                result[i, j] = float(total / 2)
    result.flags.writeable = False
    return result
