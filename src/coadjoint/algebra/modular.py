"""Exact ranks: elimination modulo a 61-bit prime, in whole numbers."""

from __future__ import annotations

import math

import numpy as np

from coadjoint.algebra.joins import Floats, Integers

PRIME = 2**61 - 1


def residue(value: float) -> int:
    """Return a finite float modulo 2^61 - 1: its exact value is a whole number times a power of two.

    Modulo this prime 2^61 = 1, so a power of two is inverted by its exponent.

    Examples
    --------
    >>> residue(0.5) * 2 % PRIME, residue(-1.0) == PRIME - 1
    (1, True)
    """
    mantissa, exponent = math.frexp(value)
    return int(math.ldexp(mantissa, 53)) * pow(2, (exponent - 53) % 61, PRIME) % PRIME


def sparse_rank(rows: list[dict[int, int]]) -> int:
    """Return the rank modulo 2^61 - 1 of a sparse matrix given by rows {column: residue}; the rows are used up.

    Elimination row by row: a row is reduced by the pivots found so far and, if anything is left, becomes one.
    Matrices of block form stay in blocks.

    Examples
    --------
    >>> sparse_rank([{0: 1, 2: 2}, {0: 2, 2: 4}, {1: 1}])
    2
    """
    pivots: dict[int, dict[int, int]] = {}
    for given in rows:
        row = {column: value for column, value in given.items() if value % PRIME}
        while row:
            lead = min(row)
            pivot = pivots.get(lead)
            if pivot is None:
                scale = pow(row[lead], -1, PRIME)
                pivots[lead] = {column: value * scale % PRIME for column, value in row.items()}
                break
            factor = row[lead]
            for column, value in pivot.items():
                left = (row.get(column, 0) - factor * value) % PRIME
                if left:
                    row[column] = left
                else:
                    row.pop(column, None)
    return len(pivots)


def structure_rank(i: Integers, j: Integers, k: Integers, c: Floats, dim: int, points: int, seed: int) -> int:
    """Return the largest rank of J(x), J_ij = sum_k c_ij^k x_k, at random points modulo 2^61 - 1.

    Parameters
    ----------
    i, j, k, c : (m,) arrays
        Constants with i < j.
    dim : int
    points : int
        Number of random points.
    seed : int

    Returns
    -------
    int

    Examples
    --------
    >>> structure_rank(*np.array([[0, 0, 1], [1, 2, 2], [2, 1, 0]]), np.array([1.0, -1.0, 1.0]), 3, 2, 0)
    2
    """
    rng = np.random.default_rng(seed)
    constants = list(zip(i.tolist(), j.tolist(), k.tolist(), map(residue, c.tolist()), strict=True))
    best = 0
    for _ in range(points):
        x = rng.integers(0, PRIME, size=dim).tolist()
        rows: list[dict[int, int]] = [{} for _ in range(dim)]
        for a, b, m, value in constants:
            entry = value * x[m]
            rows[a][b] = (rows[a].get(b, 0) + entry) % PRIME
            rows[b][a] = (rows[b].get(a, 0) - entry) % PRIME
        best = max(best, sparse_rank(sorted(rows, key=len)))
        if best >= dim - dim % 2:
            break
    return best
