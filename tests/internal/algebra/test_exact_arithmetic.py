"""The generic rank: large and many blocks, rounded constants, and the elimination behind it."""

from fractions import Fraction

import numpy as np
import pytest

from coadjoint.algebra import catalogue
from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact.ranks import random_prime, rank_from_gap, skew_rank, sparse_rank
from coadjoint.algebra.exact.rational_constants import as_fraction, jacobi_exact, rational_constants
from coadjoint.algebra.lie_algebra import LieAlgebra


def test_many_and_large_blocks():
    count = 20_000
    i, j, k, c = catalogue.so(3).triples
    shift = np.repeat(3 * np.arange(count), 3)
    many = LieAlgebra(Triples(*(np.tile(a, count) + shift for a in (i, j, k)), np.tile(c, count)), dim=3 * count)
    assert many.generic_rank() == 2 * count
    assert catalogue.so(25).generic_rank() == 300 - 12


def test_a_block_too_large_to_be_dense():
    n = 2500  # e1 acts on all others: one connected block of 5001 rows, of rank 2
    g = LieAlgebra([(0, i, i, float(i)) for i in range(1, 2 * n + 1)], dim=2 * n + 1)
    assert g.generic_rank() == 2


def test_rounded_constants_are_not_taken_for_exact():
    """In floats, thirds break the Jacobi identity, and the rank of the rounded constants is that of no Lie algebra."""
    g = catalogue.so(5)
    c = np.zeros((10, 10, 10))
    i, j, k, value = g.triples
    c[i, j, k], c[j, i, k] = value, -value
    rng = np.random.default_rng(0)
    p = np.eye(10) + np.triu(rng.integers(-1, 2, (10, 10)), 1) / 3
    q = np.linalg.inv(p)
    new = np.einsum("ai,bj,ijk,kc->abc", p, p, c, q)
    assert LieAlgebra(new).generic_rank() == 8
    rotation, _ = np.linalg.qr(rng.standard_normal((10, 10)))
    assert LieAlgebra(np.einsum("ai,bj,ijk,ck->abc", rotation, rotation, c, rotation)).generic_rank() == 8


@pytest.mark.parametrize("sizes", [(1.0, 1e-12), (1e-12, 1.0), (1e9, 1.0, 1e-9), (2.0**-300, 2.0**300)])
def test_rounded_constants_of_each_summand_have_their_own_size(sizes):
    """Summands in rotated bases, in units of very different sizes, their coordinates mixed with one another."""
    rng = np.random.default_rng(3)
    parts, begin = [], 0
    for g, size in zip((catalogue.so(4), catalogue.e(3), catalogue.so(3)), sizes, strict=False):
        i, j, k, value = g.triples
        c = np.zeros((g.dim,) * 3)
        c[i, j, k], c[j, i, k] = value, -value
        q = np.linalg.qr(rng.standard_normal((g.dim, g.dim)))[0]
        i, j, k, value = LieAlgebra(np.einsum("ai,bj,ijk,ck->abc", q, q, c, q)).triples
        parts.append((i + begin, j + begin, k + begin, size * value))
        begin += g.dim
    i, j, k, value = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = rng.permutation(begin)
    whole = LieAlgebra(Triples(order[i], order[j], order[k], value), dim=begin)
    assert rational_constants(whole.triples, begin) is None
    assert whole.generic_rank() == sum((4, 4, 2)[: len(sizes)])
    found = whole.casimirs(2)
    assert list(found) == [f"C2_{number + 1}" for number in range(sum((2, 2, 1)[: len(sizes)]))]
    x = rng.standard_normal(begin)
    J = whole.structure_matrix(x)
    for casimir in found.values():
        gradient = casimir.gradient(x)
        # The coefficients have errors of some u, divided by the smallest pivots and singular values.
        assert (np.abs(J @ gradient) <= 2.0**-35 * np.abs(J) @ np.abs(gradient)).all()


def test_elimination_agrees_with_itself():
    rng = np.random.default_rng(0)
    prime = random_prime(rng)
    for size in (2, 5, 9, 12):
        matrix = rng.integers(0, prime, (size, size)).astype(object)
        matrix[:, size // 2 :] = 0
        matrix = np.triu(matrix, 1)
        first, second = np.nonzero(matrix)
        rows = [{b: int(v) for b, v in enumerate(row) if v} for row in (matrix - matrix.T) % prime]
        entries = [int(v) for v in matrix[first, second]]
        assert skew_rank(first, second, entries, size, prime) == sparse_rank(rows, prime) <= size


def test_primes_are_primes_of_62_bits():
    rng = np.random.default_rng(1)
    drawn = [random_prime(rng) for _ in range(20)]
    assert len(set(drawn)) == 20
    assert all(2**61 < p < 2**62 and all(pow(a, p - 1, p) == 1 for a in (2, 3, 5, 7, 11)) for p in drawn)


def test_simple_fractions():
    assert [as_fraction(v) for v in (0.1, -2 / 7, 1e300, 999_983 / 999_979)] == [
        Fraction(1, 10),
        Fraction(-2, 7),
        int(1e300),
        Fraction(999_983, 999_979),
    ]
    assert as_fraction(np.sqrt(2.0)) is as_fraction(np.pi * 1e5) is as_fraction(2.0**-30) is None


def test_fractions_must_fulfil_the_jacobi_identity():
    i, j, k, c = catalogue.so(4).triples
    assert rational_constants(Triples(i, j, k, c / 3), 6) is not None
    wrong = c.copy()
    wrong[0] = np.nextafter(1.0, 2.0) * c[0]
    assert rational_constants(Triples(i, j, k, wrong), 6) is None
    whole = np.array([int(v) * 10**9 for v in c], dtype=object)
    assert jacobi_exact(Triples(i, j, k, c), whole, 6)
    whole[0] += 1
    assert not jacobi_exact(Triples(i, j, k, c), whole, 6)


def test_a_rank_needs_a_gap():
    assert rank_from_gap(np.array([1.0, 1e-3, 1e-17]), 1e-15, "A") == 2
    assert rank_from_gap(np.zeros(3), 1e-15, "A") == 0
    with pytest.raises(ValueError, match="the rank of A is not clear: its singular value 1e-13"):
        rank_from_gap(np.array([1.0, 1e-13]), 1e-15, "A")
