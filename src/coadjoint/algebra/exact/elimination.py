"""Exact elimination: spans over the rational numbers, and the rank of J(x) at a generic x."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact.numbers import as_fraction, exact_numbers, fraction, read_exact
from coadjoint.algebra.exact.sparse_sums import (
    DEFECT_FACTOR,
    Floats,
    Integers,
    connected,
    groups,
    parts_and_rows,
    positions,
)
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.validation import read_list, reject_lossy_conversion

MAX_DENSE_ROWS = 4000  # rows of a block that is eliminated as a dense matrix: at most 128 MB, a few seconds
MIN_RANK_GAP = 2.0**10  # the smallest nonzero singular value must exceed round-off by this factor

Number = int | Fraction
Vector = dict[int, Number]


def read_vector(argument: Any, dim: int, what: str) -> Vector:
    """Return the nonzero components of a vector as exact rational numbers; floats are converted exactly."""
    reject_lossy_conversion(argument, what)
    values = read_list(argument, what, "it must be a sequence of numbers")
    if len(values) != dim:
        raise ValueError(f"{what} must have {dim} components, not {len(values)}")
    vector: Vector = {}
    for i, value in enumerate(values):
        number = read_exact(value, f"component {i} of {what}")
        if number:
            vector[i] = number
    return vector


def add_multiple(left: Vector, factor: Number, right: Mapping[int, Number]) -> None:
    """Add factor * right to left in place, dropping entries that cancel."""
    for i, value in right.items():
        total = left.get(i, 0) + factor * value
        if total:
            left[i] = total
        else:
            left.pop(i, None)


class Span:
    """The span of independent sparse vectors {index: number}; a dependent vector raises ValueError."""

    def __init__(self, vectors: Iterable[Mapping[int, Number]] = ()) -> None:
        self._rows: dict[int, tuple[Vector, Vector]] = {}  # pivot -> row with 1 there, and its combination
        for number, vector in enumerate(vectors):
            if not self.add(vector):
                raise ValueError(f"vector {number} is a combination of the vectors before it")

    def add(self, vector: Mapping[int, Number]) -> bool:
        """Add a vector unless it is in the span; return whether it was added."""
        rest, used = self._reduced(vector)
        if not rest:
            return False
        pivot = min(rest)
        scale = Fraction(1) / rest[pivot]
        combination: Vector = {len(self._rows): scale}
        add_multiple(combination, -scale, used)
        row: Vector = {i: value * scale for i, value in rest.items()}
        for earlier_row, coordinates in self._rows.values():
            factor = earlier_row.get(pivot, 0)
            if factor:
                add_multiple(earlier_row, -factor, row)
                add_multiple(coordinates, -factor, combination)
        self._rows[pivot] = row, combination
        return True

    def _reduced(self, vector: Mapping[int, Number]) -> tuple[Vector, Vector]:
        """Return the remainder of a vector modulo the span, and the combination that was subtracted."""
        rest, used = dict(vector), dict[int, Number]()
        for pivot in [i for i in vector if i in self._rows]:  # rows have zeros at the other pivots
            row, combination = self._rows[pivot]
            factor = rest[pivot]
            add_multiple(rest, -factor, row)
            add_multiple(used, factor, combination)
        return rest, used

    def combination(self, vector: Mapping[int, Number]) -> Vector | None:
        """Return the coefficients of a vector in the given ones, by their number; None if it is outside the span."""
        rest, used = self._reduced(vector)
        return None if rest else {i: fraction(used[i]) for i in sorted(used)}

    def remainder(self, vector: Mapping[int, Number]) -> Vector:
        """Return the representative of a vector modulo the span that is zero at the pivots."""
        return self._reduced(vector)[0]

    @property
    def pivots(self) -> frozenset[int]:
        """Pivot indices, one per vector."""
        return frozenset(self._rows)


def clear_denominators(values: list[Fraction]) -> NDArray[Any]:
    """Multiply fractions by their common denominator; return integers in the same ratios."""
    common = math.lcm(*(value.denominator for value in values))
    return exact_numbers(value.numerator * (common // value.denominator) for value in values)


def coprime_integers(values: Iterable[Any]) -> list[Any]:
    """Return coprime integers in the ratios of some numbers, the first of them positive."""
    integers = clear_denominators([Fraction(value) for value in values]).tolist()
    common = math.gcd(*integers) * (1 if integers[0] > 0 else -1)
    return [value // common for value in integers]


def jacobi_exact(triples: Triples, integers: NDArray[Any], dim: int) -> bool:
    """Return whether integer constants fulfil the Jacobi identity exactly."""
    # Two random evaluations of a trilinear form that is not zero both vanish with probability < 2^-120 (Schwartz,
    # Zippel).
    i, j, k, c = triples
    if integers.size == 0:
        return True
    largest = max(map(abs, integers.tolist()))
    # 64 u times the sum of at most 3 n products is below 1 (u = 2^-53)
    if 3 * dim * largest**2 < 2**47 and all(a == b for a, b in zip(integers.tolist(), c.tolist(), strict=True)):
        return True

    def bracket(u: NDArray[Any], v: NDArray[Any]) -> NDArray[Any]:
        result = np.zeros(dim, dtype=object)
        np.add.at(result, k, integers * (u[i] * v[j] - u[j] * v[i]))
        return result

    rng = np.random.default_rng(0)
    for _ in range(2):
        u, v, w = rng.integers(0, 2**62, size=(3, dim)).astype(object)
        if np.any(bracket(bracket(u, v), w) + bracket(bracket(v, w), u) + bracket(bracket(w, u), v) != 0):
            return False
    return True


def rational_constants(
    triples: Triples, dim: int, exact: Callable[[float], Fraction | None] = as_fraction
) -> NDArray[Any] | None:
    """Return integers in the ratios of the constants as fractions; None if one is none, or Jacobi's identity fails."""
    # A common factor changes neither Casimirs nor ranks.
    distinct, inverse = np.unique(triples.c, return_inverse=True)
    fractions = [exact(value) for value in distinct.tolist()]
    known = [value for value in fractions if value is not None]
    if len(known) < len(fractions):
        return None
    integers = clear_denominators(known)[inverse]
    return integers if jacobi_exact(triples, integers, dim) else None


def generic_rank(triples: Triples, dim: int) -> int:
    """Return the rank of J(x) at a generic x: the implementation of `LieAlgebra.generic_rank`."""
    # Rounded constants treated as exact violate the Jacobi identity and give too large a rank.
    integers = rational_constants(triples, dim)
    if integers is None:
        integers = rational_constants(triples, dim, Fraction)
    if integers is None:
        return numerical_structure_rank(triples, dim)
    return structure_rank(triples.i, triples.j, triples.k, integers, dim)


def random_prime(rng: np.random.Generator) -> int:
    """Return a prime between 2^61 and 2^62."""
    from flint import fmpz

    candidate = int(rng.integers(2**60, 2**61)) * 2 + 1
    while not fmpz(candidate).is_prime():
        candidate = int(rng.integers(2**60, 2**61)) * 2 + 1
    return candidate


def residues(integers: NDArray[Any], prime: int) -> NDArray[Any]:
    """Return whole numbers modulo a prime, as an object array."""
    return np.asarray(integers, dtype=object) % prime


def sparse_rank(rows: list[dict[int, int]], prime: int) -> int:
    """Return the rank modulo a prime of a sparse matrix with rows {column: residue}, which are consumed."""
    pivots: dict[int, dict[int, int]] = {}
    for original in rows:
        row = {column: value for column, value in original.items() if value % prime}
        while row:
            lead = min(row)
            pivot = pivots.get(lead)
            if pivot is None:
                scale = pow(row[lead], -1, prime)
                pivots[lead] = {column: value * scale % prime for column, value in row.items()}
                break
            factor = row[lead]
            for column, value in pivot.items():
                entry = (row.get(column, 0) - factor * value) % prime
                if entry:
                    row[column] = entry
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
    i: Integers, j: Integers, k: Integers, integers: NDArray[Any], dim: int, points: int = 2, seed: int = 0
) -> int:
    """Return the largest rank of J(x) at seeded random points, each modulo its own random prime; never too large."""
    # One point fails with probability <= n/2^61 (Schwartz and Zippel), one prime with b/61 of > 2^55 primes for minors
    # with coefficients < 2^b; two points fail together with probability < 2^-60 for n, b < 2^30.
    rng = np.random.default_rng(seed)
    order, starts = groups(i, j)
    label = connected(dim, i, j)
    position, pairs = positions(label), order[starts]
    blocks = [(part, block) for part, block in parts_and_rows(label, i[pairs]) if part.size > 1]
    highest = sum(part.size - part.size % 2 for part, _ in blocks)
    best = 0
    for _ in range(points):
        prime = random_prime(rng)
        x = rng.integers(0, prime, size=dim).astype(object)
        products = residues(integers, prime)[order] * x[k[order]]
        entries = np.add.reduceat(products, starts) % prime if order.size else products
        rank = 0
        for part, block in blocks:
            first, second = position[i[pairs[block]]], position[j[pairs[block]]]
            rank += skew_rank(first, second, entries[block].tolist(), part.size, prime)
        best = max(best, rank)
        if best == highest:
            break
    return best


def rank_from_gap(singular: Floats, roundoff: float, what: str) -> int:
    """Return the number of singular values (descending) above `roundoff`, or raise ValueError without a clear gap."""
    rank = int(np.count_nonzero(singular > roundoff))
    if rank and singular[rank - 1] < MIN_RANK_GAP * roundoff:
        raise ValueError(
            f"the rank of {what} is not clear: its singular value {singular[rank - 1]:.3g} is neither round-off "
            f"(below {roundoff:.3g}) nor above {MIN_RANK_GAP * roundoff:.3g}; give constants that are rational or "
            "more exact"
        )
    return rank


def numerical_structure_rank(triples: Triples, dim: int) -> int:
    """Return the rank of J(x) at generic x by singular values, for constants known to 64 u times those of a block."""
    i, j, k, c = triples
    rng = np.random.default_rng(0)
    points = rng.standard_normal((2, dim))
    label = connected(dim, i, j)
    position = positions(label)
    total = 0
    for part, rows in parts_and_rows(label, i):
        if part.size == 1:
            continue
        ranks = []
        for x in points:
            matrix = np.zeros((part.size, part.size))
            np.add.at(matrix, (position[i[rows]], position[j[rows]]), c[rows] * x[k[rows]])
            matrix -= matrix.T.copy()
            # Frobenius norm for an error of 64 u max |c| in every constant
            size = float(np.abs(c[rows]).max()) * math.sqrt(2.0) * float(np.linalg.norm(x[k[rows]]))
            roundoff = DEFECT_FACTOR * UNIT_ROUNDOFF * size
            ranks.append(rank_from_gap(np.linalg.svd(matrix, compute_uv=False).astype(np.float64), roundoff, "J(x)"))
        total += max(ranks)
    return total
