"""Exponentials exp(D_v) x on coadjoint orbits, by dense matrices."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

MAX_TERMS = 60  # of a power series, whose arguments are scaled to norm one: 1/60! is below 2^-270
NEGLIGIBLE = 2.0**-60  # of the result: bound of a term that no longer changes it
MAX_SUBSTEPS = 4096  # of an exponential, as in the kernels
MAX_MIDPOINTS = 192  # iterations of the midpoint rule; convergent ones take some ten
SERIES_TOLERANCE = 2.0**-40  # of |x|: below it a correction that stagnates is round-off


class Bracket(NamedTuple):
    """Padded columns of structure constants, by output, for products sign J(x) v."""

    j: Integers
    k: Integers
    c: Floats

    def product(self, x: Floats, v: Floats) -> Floats:
        """Return sign J(x) v, antisymmetric as a matrix that acts on v."""
        return np.asarray((self.c * x[self.k] * v[self.j]).sum(axis=0))

    def generator(self, v: Floats) -> Floats:
        """Return the entries of D_v, D_v x = sign J(x) v, padded."""
        return self.c * v[self.j]

    def exponential(self, v: Floats, x: Floats) -> Floats:
        """Return exp(D_v) x by its series in substeps."""
        D = self.generator(v)
        norm = float(np.abs(D).sum(axis=0).max(initial=0.0))
        substeps = max(1, math.ceil(norm))
        for _ in range(substeps):
            terms, bound = [x], 1.0
            for k in range(1, MAX_TERMS):
                terms.append((D * terms[-1][self.k]).sum(axis=0) / (k * substeps))
                bound *= norm / (k * substeps)
                if bound <= NEGLIGIBLE:
                    break
            x = x + np.array(terms)[1:].sum(axis=0)
        return x


def exponential(system: Any, v: NDArray[Any], x: NDArray[Any]) -> NDArray[Any]:
    """Return exp(D_v) x, D_v x = sign J(x) v, by its power series in substeps."""
    D, substeps = _generator(system, v)
    for _ in range(substeps):
        term, total, negligible = x, np.zeros_like(x), NEGLIGIBLE * np.abs(x).max(initial=0.0)
        for k in range(1, MAX_TERMS):
            term = D @ term / (k * substeps)
            total = total + term
            if not np.abs(term).max(initial=0.0) > negligible:
                break
        x = x + total
    return np.asarray(x)


class FoundMidpoint(NamedTuple):
    """The midpoint of a flow and the direction of its exponential, or None with the last correction."""

    middle: NDArray[Any]
    direction: NDArray[Any] | None
    residual: float


def midpoint(system: Any, direction: Callable[..., Any], x: NDArray[Any]) -> FoundMidpoint:
    """Solve y = exp(D_v / 2) x with v = direction(y), by iteration."""
    middle, last_change = x, np.inf
    for _ in range(MAX_MIDPOINTS):
        before, v = middle, direction(middle)
        middle = exponential(system, 0.5 * v, x)
        change = float(np.sum(np.abs(middle - before)))
        if is_settled(change, last_change, x):
            return FoundMidpoint(before, v, change)
        last_change = change
    return FoundMidpoint(middle, None, last_change)


def is_settled(change: float, last_change: float, x: NDArray[Any]) -> bool:
    """Test whether an iteration ends: its changes are those of rounding, and no longer halve."""
    return change == 0.0 or (change >= 0.5 * last_change and change <= SERIES_TOLERANCE * float(np.sum(np.abs(x))))


def exponential_with_tangent(
    system: Any, v: NDArray[Any], x: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return exp(D_v) x and its derivatives (n, n) by x and by v, of the same series."""
    D, substeps = _generator(system, v)
    # Columns: the state, its derivatives by x, and those by v, for which D_w x = sign J(x) w is a source.
    n, J = len(x), system.algebra.structure_matrix
    columns = np.concatenate([x[:, None], np.eye(n), np.zeros((n, n))], axis=1)
    for _ in range(substeps):
        term, total, negligible = columns, np.zeros_like(columns), NEGLIGIBLE * np.abs(columns).max()
        for k in range(1, MAX_TERMS):
            image = D @ term
            image[:, n + 1 :] += system.sign * np.asarray(J(term[:, 0]), dtype=np.float64)
            term = image / (k * substeps)
            total += term
            if not np.abs(term).max() > negligible:
                break
        columns = columns + total
    return columns[:, 0], columns[:, 1 : n + 1], columns[:, n + 1 :]


def _generator(system: Any, v: NDArray[Any]) -> tuple[NDArray[np.float64], int]:
    """Return the matrix of D_v, and the number of substeps of its exponential, each of norm at most one."""
    D = system.sign * np.asarray(system.algebra.coadjoint(v), dtype=np.float64)
    norm = np.max(np.sum(np.abs(D), axis=1), initial=0.0)
    if not norm <= MAX_SUBSTEPS:
        raise OverflowError(f"the exponential of a matrix of norm {norm:.3g} needs more than {MAX_SUBSTEPS} substeps")
    return D, max(1, int(np.ceil(norm)))


@lru_cache(maxsize=16)
def bracket_of(algebra: Any, sign: int) -> Bracket:
    """Return the bracket of an algebra, which is cached."""
    i, j, k, c = algebra.triples
    c = sign * np.asarray(c, dtype=np.float64)
    rows, columns, values = np.append(i, j), (np.append(j, i), np.append(k, k)), np.append(c, -c)
    order = np.argsort(rows, kind="stable")
    starts = np.searchsorted(rows[order], np.arange(algebra.dim + 1))
    place = np.arange(len(rows)) - starts[rows[order]]
    found: list[Any] = []
    for column in (*columns, values):
        padded = np.zeros((int(np.max(np.diff(starts), initial=1)), algebra.dim), dtype=column.dtype)
        padded[place, rows[order]] = column[order]
        found.append(padded)
    return Bracket(*found)


def metric_root(metric: Any, what: str) -> NDArray[np.float64]:
    """Return L with L L^T = P: square roots of a number or diagonal, or a Cholesky factor, summed in a fixed order."""
    P = np.array(metric, dtype=np.float64)
    size = np.max(np.abs(P))
    if P.ndim < 2:
        if np.any(P < 0.0):
            raise ValueError(f"{what} has the negative entry {P.min():g}; damping needs a positive semidefinite one")
        return np.sqrt(P)
    if not np.array_equal(P, P.T):
        raise ValueError(f"{what} is not symmetric; damping needs a symmetric positive semidefinite one")
    n = len(P)
    L, remainder, tolerance = np.zeros((n, n)), P.copy(), 64 * n * UNIT_ROUNDOFF * size
    for k in range(n):
        if remainder[k, k] > tolerance:
            L[k:, k] = remainder[k:, k] / np.sqrt(remainder[k, k])
            remainder[k:, k:] -= np.multiply.outer(L[k:, k], L[k:, k])
        elif remainder[k, k] < -tolerance or np.max(np.abs(remainder[k:, k])) > np.sqrt(tolerance * size):
            raise ValueError(f"{what} is not positive semidefinite; damping would feed energy in")
    return L
