"""Quadratic and linear polynomials in many coordinates, and polynomials under linear substitutions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import quotient
from coadjoint.algebra.polynomials.monomials import Coefficient, exponents_of
from coadjoint.algebra.polynomials.polynomial import Polynomial

MAX_STORED_EXPONENTS = 2**22  # exponents in all the known Casimirs of an algebra: 32 MB; so(60) has 1770^2


def casimirs_fit(monomials: int, dim: int) -> bool:
    """Return whether polynomials with this many monomials in `dim` coordinates are small enough to be stored."""
    return monomials * dim <= MAX_STORED_EXPONENTS


def quadratic(entries: Iterable[tuple[int, int, Coefficient]], dim: int) -> Polynomial:
    """Return the sum of c x_i x_j over the entries (i, j, c)."""
    total: dict[tuple[int, ...], Coefficient] = {}
    for i, j, value in entries:
        exponents = exponents_of((i, j), dim)
        total[exponents] = total.get(exponents, 0) + value
    return Polynomial._from_valid(total, dim)


def linear(entries: Mapping[int, Coefficient], dim: int) -> Polynomial:
    """Return the sum of c_i x_i."""
    return Polynomial._from_valid({exponents_of((i,), dim): value for i, value in entries.items()}, dim)


def of_entries(
    rows: NDArray[Any], columns: NDArray[Any], entries: NDArray[Any], coefficients: NDArray[Any], constant: Coefficient
) -> Polynomial:
    """Return ``x . M x / 2 + coefficients . x + constant`` for entries of both triangles of M; exact if they are."""
    n = len(coefficients)
    monomials: dict[tuple[int, ...], Any] = {(0,) * n: constant}
    for i, c in enumerate(coefficients.tolist()):
        monomials[exponents_of((i,), n)] = c
    for i, j, c in zip(rows.tolist(), columns.tolist(), entries.tolist(), strict=True):
        if i <= j:
            monomials[exponents_of((i, j), n)] = c if i < j else quotient(c, 2)
    return Polynomial(monomials, dim=n)


def substituted(p: Polynomial, rows: Sequence[Mapping[int, Coefficient]], dim: int) -> Polynomial:
    """Substitute x_i = sum_j rows[i][j] y_j (sparse rows) in a polynomial of x; the result has `dim` coordinates."""
    forms: dict[int, Polynomial] = {}
    total = Polynomial({}, dim=dim)
    for exponents, value in p.monomials.items():
        product = Polynomial({(0,) * dim: value})
        for i, power in enumerate(exponents):
            if power:
                if i not in forms:
                    forms[i] = linear(rows[i], dim)
                product = product * forms[i] ** power
        total = total + product
    return total


def embedded(p: Polynomial, begin: int, dim: int) -> Polynomial:
    """Rewrite a polynomial in more coordinates, its own starting at index `begin`."""
    before, after = (0,) * begin, (0,) * (dim - begin - p.dim)
    return Polynomial._from_valid({before + exponents + after: value for exponents, value in p.monomials.items()}, dim)
