"""Manakov's integrals on so(n), the coefficients of ``tr (X + mu a)^m``, and quadratic trace forms."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.exact.numbers import fraction, rational
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.quadratic import Quadratic

MAX_SO_DIMENSION = 6
"""Largest n with integrals of degree 4 and higher; their number of terms grows at least like n^4."""
MAX_TRACE_POWER = 10
"""Largest power of a in a quadratic integral; higher ones would overflow float64 in large dimensions."""


@lru_cache(maxsize=8)
def rotations(n: int) -> LieAlgebra:
    """Return so(n), cached: one object for all bodies."""
    return catalogue.so(n)


def planes(n: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return i and j of each coordinate of so(n), the entry (i, j) of the matrix X."""
    if n == 3:
        return np.array([2, 0, 1]), np.array([1, 2, 0])
    first, second = np.triu_indices(n, 1)
    return first.astype(np.int64), second.astype(np.int64)


def trace_form(a: npt.NDArray[Any], k: int) -> npt.NDArray[Any]:
    """Return the matrix of the form ``-sum over p + q = k of tr(X a^p X a^q) / 2`` in the n (n - 1)/2 coordinates x."""
    # For k = 1 and the second moments of mass it maps Omega to the momentum.
    i, j = planes(len(a))
    powers = [np.eye(len(a), dtype=int).astype(a.dtype)]
    for _ in range(k):
        powers.append(np.array([[(row * column).sum() for column in a.T] for row in powers[-1]], dtype=a.dtype))
    total = np.zeros((i.size, i.size), dtype=a.dtype)
    for P, Q in zip(powers, reversed(powers), strict=True):
        # tr(E_ij P E_kl Q) with E_ij = e_i e_j^T - e_j e_i^T, rows (i, j), columns (k, l).
        total += P[np.ix_(j, j)] * Q[np.ix_(i, i)] - P[np.ix_(j, i)] * Q[np.ix_(i, j)]
        total += P[np.ix_(i, i)] * Q[np.ix_(j, j)] - P[np.ix_(i, j)] * Q[np.ix_(j, i)]
    return total / 2


def inverse_of_form(form: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Return the inverse of a matrix of exact numbers, rounded once."""
    from flint import fmpq_mat

    n = len(form)
    inverse = fmpq_mat(n, n, [rational(entry) for entry in form.ravel().tolist()]).inv()
    try:
        return np.array([float(fraction(entry)) for entry in inverse.entries()]).reshape(n, n)
    except OverflowError:
        raise ValueError("inertia has an inverse that overflows; take larger units") from None


def manakov_integrals(a: npt.NDArray[Any]) -> dict[str, Quadratic | Polynomial]:
    """Return the nontrivial integrals by name, for a diagonal (n,) or a symmetric matrix a."""
    # At most ten quadratic ones for every n; those of higher degree for n up to 6.
    try:
        return _quadratic_integrals(a) | (_higher_integrals(a) if 5 <= len(a) <= MAX_SO_DIMENSION else {})
    except OverflowError:  # fractions beyond the range of floats
        raise ValueError("a power of the entries overflows in an integral; take other units") from None


def _quadratic_integrals(a: npt.NDArray[Any]) -> dict[str, Quadratic | Polynomial]:
    """Return the integrals of degree 2."""
    n = len(a)
    integrals: dict[str, Quadratic | Polynomial] = {}
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(1, min(n - 2, MAX_TRACE_POWER) + 1):
            form = 2 * (_complete_homogeneous_sums(a, k) if a.ndim == 1 else trace_form(a, k)).astype(np.float64)
            if not np.isfinite(form).all():
                raise ValueError(f"the power {k} of the entries overflows in an integral; take other units")
            integrals[_integral_name(2, k)] = Quadratic(form)
    return integrals


def _complete_homogeneous_sums(a: npt.NDArray[Any], k: int) -> npt.NDArray[Any]:
    """Return ``sum over p + q = k of a_i^p a_j^q`` for each plane."""
    i, j = planes(len(a))
    return sum((a[i] ** p * a[j] ** (k - p) for p in range(k + 1)), np.zeros(i.size))


def _integral_name(degree: int, power: int) -> str:
    return f"X^{degree} a" if power == 1 else f"X^{degree} a^{power}"


def _higher_integrals(a: npt.NDArray[Any]) -> dict[str, Polynomial]:
    """Return the integrals of degree 4 and higher, from the powers of X + mu a as a matrix of polynomials."""
    n = len(a)
    a_matrix = np.diag(a) if a.ndim == 1 else a
    ring = ExactPolynomials(rotations(n), ("mu",))
    matrix = [[rational(entry) * ring.symbol_elements["mu"] for entry in row] for row in a_matrix.tolist()]
    for x, i, j in zip(ring.coordinates, *(side.tolist() for side in planes(n)), strict=True):
        matrix[i][j] += x
        matrix[j][i] -= x
    columns = list(zip(*matrix, strict=True))

    def dot(row: Sequence[Exact], column: Sequence[Exact]) -> Exact:
        return sum((p * q for p, q in zip(row, column, strict=True)), ring.zero)

    power, integrals = matrix, {}
    for m in range(2, n + 1):
        if m >= 5:
            trace = sum(map(dot, power, columns), ring.zero).to_dict()
            for j in range(2, (m + 1) // 2):
                monomials: dict[tuple[int, ...], Any] = {
                    tuple(map(int, e[:-1])): float(fraction((-1) ** j * value / m))
                    for e, value in trace.items()
                    if e[-1] == m - 2 * j
                }
                integrals[_integral_name(2 * j, m - 2 * j)] = Polynomial(monomials, dim=ring.dim)
        power = [[dot(row, column) for column in columns] for row in power]
    return integrals


def halves_of_so4(sign: float) -> list[list[float]]:
    """Return the linear forms, (3, 6), of ``(x23, -x13, x12) + sign (x14, x24, x34)``, of constant length in so(4)."""
    # The coordinates are x12, x13, x14, x23, x24, x34; sign is 1.0 or -1.0.
    forms = [[0.0] * 6 for _ in range(3)]
    for row, (first, factor, second) in enumerate(((3, 1.0, 2), (1, -1.0, 4), (0, 1.0, 5))):
        forms[row][first], forms[row][second] = factor, sign
    return forms
