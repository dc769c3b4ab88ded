"""Algebras of functions on phase space: Heisenberg algebras, and moments of even degree."""

from __future__ import annotations

from itertools import permutations
from math import comb

import numpy as np

from coadjoint.algebra.constants import Triples, check_algebra_memory
from coadjoint.algebra.families.matrix_bases import MAX_REPRESENTATION_NUMBERS, matrices, sparse_matrices
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.monomials import exponents_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.caching import shared
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.validation import read_integer

MAX_DETERMINANT_DEGREE = 10  # a catalecticant of 6 x 6, 720 products
MAX_MOMENT_DEGREE = 100


@suggest_keywords
@shared
def heisenberg(n: int = 1) -> LieAlgebra:
    """Return the Heisenberg algebra: [q_i, p_i] = z, in the order q1 ... qn, p1 ... pn, z.

    With the central coordinate z fixed to 1 it carries canonical variables.

    Parameters
    ----------
    n : int, optional
        Number of pairs, from 1; the dimension is 2 n + 1.

    Returns
    -------
    LieAlgebra
        With the representation by (n + 2) x (n + 2) upper triangular matrices (up to 128 MB of them) and the
        Casimir ``"z"``.

    Raises
    ------
    ValueError
        n is not an integer from 1 up.

    Examples
    --------
    >>> heisenberg().basis
    ('q1', 'p1', 'z')
    """
    n = read_integer(n, "n of heisenberg(n)")
    check_algebra_memory(f"heisenberg({short(n)})", 2 * n + 1, n)
    basis = (*(f"q{i}" for i in range(1, n + 1)), *(f"p{i}" for i in range(1, n + 1)), "z")
    rho = None
    if (2 * n + 1) * (n + 2) ** 2 <= MAX_REPRESENTATION_NUMBERS:
        upper = [(i, 0, i + 1, 1.0) for i in range(n)] + [(n + i, i + 1, n + 1, 1.0) for i in range(n)]
        rho = matrices(sparse_matrices([*upper, (2 * n, 0, n + 1, 1.0)]), 2 * n + 1, n + 2)
    q = np.arange(n, dtype=np.int64)
    # All double brackets vanish, so the Jacobi identity holds.
    constants = Triples(q, q + n, np.full(n, 2 * n, dtype=np.int64), np.ones(n))
    z = {"z": Polynomial.variable(2 * n, 2 * n + 1)}
    return LieAlgebra._from_valid(constants, 2 * n + 1, basis, f"heisenberg({n})", rho, z)


def moments(degree: int = 4) -> LieAlgebra:
    """Return the algebra of the moments ``x_ij`` of ``q^i p^j`` of degrees i + j = 2, 4, ... up to `degree`."""
    # [x_ij, x_kl] = (i l - j k) x_(i+k-1)(j+l-1), zero above the degree: products of higher degrees are an ideal.
    # Degree 2 is sp(2, R). The highest moments commute with all but those of degree 2, which transform them as the
    # coefficients of a binary form: its invariants are Casimirs. Holm, Lysenko, Scovel, J. Math. Phys. 31, 1610 (1990).
    degree = read_integer(degree, "degree", 2, MAX_MOMENT_DEGREE)
    if degree % 2:
        raise ValueError(f"degree is {degree}; it must be even")
    powers = powers_of(degree)
    n = len(powers)
    index_of = {pair: number for number, pair in enumerate(powers)}
    entries = []
    for a, (i, j) in enumerate(powers):
        for b, (k, m) in enumerate(powers[a + 1 :], a + 1):
            target = index_of.get((i + k - 1, j + m - 1))
            if target is not None and i * m != j * k:
                entries.append((a, b, target, float(i * m - j * k)))
    first, second, image, c = (np.array(column) for column in zip(*entries, strict=True))
    constants = Triples(first, second, image, c)
    # x20, x11 and x02 act on the (q, p) plane by traceless matrices.
    plane = [(0, 0, 1, -2.0), (1, 0, 0, -1.0), (1, 1, 1, 1.0), (2, 1, 0, 2.0)]
    rho = matrices(sparse_matrices(plane), 3, 2) if degree == 2 else None
    names = tuple(f"x{i}{j}" if max(i, j) < 10 else f"x{i},{j}" for i, j in powers)
    # The bracket is that of polynomials in q and p, so the Jacobi identity holds.
    return LieAlgebra._from_valid(constants, n, names, f"moments({degree})", rho, _casimirs(degree, n))


def powers_of(degree: int) -> list[tuple[int, int]]:
    """Return the powers (i, j) of q and p of all moments, in order."""
    return [(d - j, j) for d in range(2, degree + 1, 2) for j in range(d + 1)]


def _casimirs(degree: int, n: int) -> dict[str, Polynomial]:
    top = [Polynomial.variable(n - degree - 1 + j, n) for j in range(degree + 1)]
    half = degree // 2
    middle = (-1) ** half * comb(degree, half) // 2  # of the middle square; all other products occur twice
    square = sum(
        ((-1) ** j * comb(degree, j) * (top[j] * top[degree - j]) for j in range(half)), middle * top[half] * top[half]
    )
    if degree == 2:
        return {"emittance^2": square}
    casimirs = {f"(form, form)_{degree}": square}
    if degree <= MAX_DETERMINANT_DEGREE:
        casimirs["catalecticant"] = _determinant([[top[a + b] for b in range(half + 1)] for a in range(half + 1)], n)
    return casimirs


def _determinant(rows: list[list[Polynomial]], n: int) -> Polynomial:
    total: dict[tuple[int, ...], int] = {}
    for order in permutations(range(len(rows))):
        exponents = exponents_of((n - 2 * len(rows) + 1 + a + b for a, b in enumerate(order)), n)
        turned = sum(order[a] > order[b] for b in range(len(order)) for a in range(b))
        total[exponents] = total.get(exponents, 0) + (-1) ** turned
    return Polynomial(total, dim=n)
