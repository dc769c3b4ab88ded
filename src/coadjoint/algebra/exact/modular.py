"""Exact ranks with overwhelming probability, by elimination modulo random 62-bit primes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.components import connected, parts
from coadjoint.algebra.exact.sparse_sums import Integers, groups

MAX_DENSE_ROWS = 4000  # rows of a block that is eliminated as a dense matrix: at most 128 MB, a few seconds


def random_prime(rng: np.random.Generator) -> int:
    """Return a prime between 2^61 and 2^62."""
    from flint import fmpz

    candidate = int(rng.integers(2**60, 2**61)) * 2 + 1
    while not fmpz(candidate).is_prime():
        candidate = int(rng.integers(2**60, 2**61)) * 2 + 1
    return candidate


def residues(whole: NDArray[Any], prime: int) -> NDArray[Any]:
    """Return whole numbers modulo a prime, as an object array.

    Examples
    --------
    >>> residues(np.array([-1, 8], dtype=object), 7)
    array([6, 1], dtype=object)
    """
    return np.asarray(whole, dtype=object) % prime


def sparse_rank(rows: list[dict[int, int]], prime: int) -> int:
    """Return the rank modulo a prime of a sparse matrix with rows {column: residue}, which are consumed.

    Row-by-row elimination, for matrices too large to be dense.
    """
    pivots: dict[int, dict[int, int]] = {}
    for given in rows:
        row = {column: value for column, value in given.items() if value % prime}
        while row:
            lead = min(row)
            pivot = pivots.get(lead)
            if pivot is None:
                scale = pow(row[lead], -1, prime)
                pivots[lead] = {column: value * scale % prime for column, value in row.items()}
                break
            factor = row[lead]
            for column, value in pivot.items():
                left = (row.get(column, 0) - factor * value) % prime
                if left:
                    row[column] = left
                else:
                    row.pop(column, None)
    return len(pivots)


def skew_rank(i: Integers, j: Integers, entries: list[int], size: int, prime: int) -> int:
    """Return the rank modulo a prime of a skew matrix of `size` rows, given by its entries above the diagonal."""
    if size > MAX_DENSE_ROWS:
        rows: list[dict[int, int]] = [{} for _ in range(size)]
        for a, b, value in zip(i.tolist(), j.tolist(), entries, strict=True):
            rows[a][b], rows[b][a] = value, -value % prime
        return sparse_rank(sorted(rows, key=len), prime)
    from flint import nmod_mat

    flat = [0] * size**2
    for a, b, value in zip(i.tolist(), j.tolist(), entries, strict=True):
        flat[a * size + b], flat[b * size + a] = value, -value % prime
    return nmod_mat(size, size, flat, prime).rank()


def structure_rank(
    i: Integers, j: Integers, k: Integers, whole: NDArray[Any], dim: int, points: int = 2, seed: int = 0
) -> int:
    """Return the largest rank of J(x) at seeded random points, each modulo its own random prime; never too large.

    One point fails with probability <= n/2^61 (Schwartz and Zippel), one prime with b/61 of > 2^55 primes for minors
    with coefficients < 2^b; two points fail together with probability < 2^-60 for n, b < 2^30. `whole`: integers, i < j
    sorted.

    Examples
    --------
    >>> structure_rank(*np.array([[0, 0, 1], [1, 2, 2], [2, 1, 0]]), np.array([1, -1, 1], dtype=object), 3)
    2
    """
    rng = np.random.default_rng(seed)
    order, starts = groups(i, j)
    label = connected(dim, i, j)
    members = [part for part in parts(label) if part.size > 1]
    place = np.zeros(dim, dtype=np.int64)
    for part in members:
        place[part] = np.arange(part.size)
    pairs = order[starts]
    owner, by_block = label[i[pairs]], np.argsort(label[i[pairs]], kind="stable")
    edges = np.searchsorted(owner[by_block], [part[0] for part in members] + [dim])
    highest = sum(part.size - part.size % 2 for part in members)
    best = 0
    for _ in range(points):
        prime = random_prime(rng)
        x = rng.integers(0, prime, size=dim).astype(object)
        products = residues(whole, prime)[order] * x[k[order]]
        entries = np.add.reduceat(products, starts) % prime if order.size else products
        rank = 0
        for part, begin, end in zip(members, edges[:-1], edges[1:], strict=True):
            at = by_block[begin:end]
            first, second = place[i[pairs[at]]], place[j[pairs[at]]]
            rank += skew_rank(first, second, entries[at].tolist(), part.size, prime)
        best = max(best, rank)
        if best == highest:
            break
    return best
