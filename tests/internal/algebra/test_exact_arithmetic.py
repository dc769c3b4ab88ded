"""Elimination, ranks modulo primes, fractions for floats, kernels, and checks that are cut into runs."""

from contextlib import nullcontext
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact import elimination
from coadjoint.algebra.exact.free_algebra import (
    expand_bracket,
    exponential,
    lie_coordinates,
    logarithm,
    lyndon_words,
    product,
    standard_factorization,
)
from coadjoint.algebra.invariants import casimir_equations as kernels
from drawn_matrices import constants_of
from refusals import refused

pytestmark = pytest.mark.thinned(1)


def test_elimination_agrees_with_itself():
    rng = np.random.default_rng(0)
    prime = elimination.random_prime(rng)
    for size in (2, 5, 9, 12):
        matrix = rng.integers(0, prime, (size, size)).astype(object)
        matrix[:, size // 2 :] = 0
        matrix = np.triu(matrix, 1)
        first, second = np.nonzero(matrix)
        rows = [{b: int(v) for b, v in enumerate(row) if v} for row in (matrix - matrix.T) % prime]
        entries = [int(v) for v in matrix[first, second]]
        assert (
            elimination.skew_rank(first, second, entries, size, prime) == elimination.sparse_rank(rows, prime) <= size
        )


@pytest.mark.parametrize("name", ["so(5)", "e(3)", "heisenberg(3)", "sl(3)"])
def test_ranks_do_not_depend_on_the_size_from_which_blocks_are_sparse(monkeypatch, name):
    g = co.algebras.get(name)
    dense = elimination.generic_rank(g.triples, g.dim)
    monkeypatch.setattr(elimination, "MAX_DENSE_ROWS", 0)
    assert (
        elimination.generic_rank(g.triples, g.dim)
        == dense
        == np.linalg.matrix_rank(g.structure_matrix(np.random.default_rng(0).standard_normal(g.dim)))
    )


def test_primes_are_primes_of_62_bits():
    rng = np.random.default_rng(1)
    drawn = [elimination.random_prime(rng) for _ in range(20)]
    assert len(set(drawn)) == 20
    assert all(2**61 < p < 2**62 and all(pow(a, p - 1, p) == 1 for a in (2, 3, 5, 7, 11)) for p in drawn)


def test_simple_fractions():
    """Denominators up to 10^6, and at most 2^45 for numerator and denominator together."""
    for value, meant in (
        (0.1, Fraction(1, 10)),
        (-2 / 7, Fraction(-2, 7)),
        (1e300, int(1e300)),
        (999_983 / 999_979, Fraction(999_983, 999_979)),
        (1 / 10**6, Fraction(1, 10**6)),
        ((2.0**28 + 1) / 2.0**16, Fraction(2**28 + 1, 2**16)),
    ):
        assert elimination.as_fraction(value) == meant
    for value in (np.sqrt(2.0), np.pi * 1e5, 2.0**-30, 1 / (10**6 + 1), (2.0**30 + 1) / 2.0**16):
        assert elimination.as_fraction(value) is None


def test_fractions_must_fulfil_the_jacobi_identity():
    i, j, k, c = co.algebras.so(4).triples
    assert elimination.rational_constants(Triples(i, j, k, c / 3), 6) is not None
    wrong = c.copy()
    wrong[0] = np.nextafter(1.0, 2.0) * c[0]
    assert elimination.rational_constants(Triples(i, j, k, wrong), 6) is None
    whole = np.array([int(v) * 10**9 for v in c], dtype=object)
    assert elimination.jacobi_exact(Triples(i, j, k, c), whole, 6)
    whole[0] += 1
    assert not elimination.jacobi_exact(Triples(i, j, k, c), whole, 6)


def test_a_rank_needs_a_gap():
    """Singular values are zero up to round-off, and not clear up to 2^10 of it."""
    assert elimination.rank_from_gap(np.array([1.0, 1e-3, 1e-17]), 1e-15, "A") == 2
    assert elimination.rank_from_gap(np.zeros(3), 1e-15, "A") == 0
    for ratio, rank in ((0.5, 1), (2.0, None), (2.0**9, None), (2.0**11, 2)):
        values = np.array([1.0, ratio * 1e-15])
        with nullcontext() if rank else refused(ValueError, "rank of A", "singular value"):
            assert elimination.rank_from_gap(values, 1e-15, "A") == rank


def test_large_blocks_of_equations_are_refused():
    i, j, k, c = co.algebras.so(3).triples
    for values, solve in ((c, kernels.numerical_kernel), (c.astype(int).astype(object), kernels.exact_kernel)):
        given = kernels.equations(Triples(i, j, k, c), values, kernels.monomials(3, 4), 3)
        assert len(solve(given, 6)) == 1  # x1^4 ... x3^4: six even monomials
        with refused(ValueError, "6 coefficients", "5"):
            solve(given, 5)


@pytest.mark.parametrize(("size", "clear"), [(2.0**-21, False), (2.0**-19, True)])
def test_a_leading_coefficient_is_clear_above_its_threshold(size, clear):
    vector = np.array([[size, np.sqrt(1.0 - size**2)]])
    with nullcontext() if clear else refused(ValueError, "leading"):
        assert kernels._row_echelon_form(vector, 1e-14)[0] == [0]


@pytest.mark.parametrize("chunk", [1, 7, 100])
@pytest.mark.parametrize("name", ["so(5)", "e(3)"])
def test_checks_do_not_depend_on_the_runs_they_are_cut_into(monkeypatch, name, chunk):
    """A wrong constant, or entry of a representation, is found wherever it is."""
    monkeypatch.setattr("coadjoint.algebra.exact.sparse_sums.CHUNK", chunk)
    g = co.algebras.get(name)
    c, rho = constants_of(g), g.representation
    assert co.LieAlgebra(c, representation=rho) == g
    rows = [(i, j, k, c[i, j, k]) for i, j, k in np.argwhere(c) if i < j]
    for at in range(0, len(rows) if name == "so(5)" else 0, 7):
        wrong = [(*row[:3], 2.0) if k == at else row for k, row in enumerate(rows)]
        with refused(ValueError, "Jacobi"):
            co.LieAlgebra(wrong, dim=g.dim)
    for flat in range(0, rho.size, 11):
        wrong = rho.copy()
        wrong.flat[flat] += 1e-3 * (1 + abs(wrong.flat[flat]))
        commutators = np.einsum("iab,jbc->ijac", wrong, wrong)
        defect = commutators - commutators.transpose(1, 0, 2, 3) - np.einsum("ijk,kab->ijab", c, wrong)
        if np.abs(defect).max() > 1e-6:
            with refused(ValueError, "representation"):
                co.LieAlgebra(c, representation=wrong)


# The free associative algebra, and Lie elements in brackets of Lyndon words


def letter(name, highest):
    return [{}, {(name,): Fraction(1)}, *({} for _ in range(highest - 1))]


def test_the_formula_of_baker_campbell_and_hausdorff():
    found = logarithm(product(exponential(letter("a", 4)), exponential(letter("b", 4))))
    coordinates = {}
    for weight in range(1, 5):
        own, rest = lie_coordinates(found[weight], lyndon_words({"a": 1, "b": 1}, weight))
        assert not any(rest.values())
        coordinates |= {"".join(word): value for word, value in own.items() if value}
    # a + b + [a,b]/2 + [a,[a,b]]/12 + [[a,b],b]/12 + [a,[[a,b],b]]/24
    twelfth = Fraction(1, 12)
    assert coordinates == {"a": 1, "b": 1, "ab": Fraction(1, 2), "aab": twelfth, "abb": twelfth, "aabb": twelfth / 2}


def test_as_many_lyndon_words_as_the_free_lie_algebra_has_dimensions():
    for weight, count in enumerate((1, 1, 2, 3, 6, 9, 18, 30, 56), 1):
        words = lyndon_words({k: k for k in range(1, weight + 1)}, weight)
        assert len(words) == count and all(one < other for one, other in pairwise(words))
        for word in words:
            expanded = expand_bracket(word)
            assert expanded[word] == 1 and min(expanded) == word
            if len(word) > 1:
                left, right = standard_factorization(word)
                assert left + right == word and left < right


def test_logarithm_and_exponential_undo_each_other():
    random = np.random.default_rng(5)
    series = [{}, {}, {}, {}, {}]
    for weight in range(1, 5):
        for word in ("a" * weight, "b" * weight, "ab" * (weight // 2)):
            if len(word) == weight:
                series[weight][tuple(word)] = Fraction(int(random.integers(-9, 10)), 7)
    for own, found in zip(series, logarithm(exponential(series)), strict=True):
        assert {w: v for w, v in found.items() if v} == {w: v for w, v in own.items() if v}
    _, rest = lie_coordinates({("a", "b"): 1, ("b", "a"): 1}, [("a", "b")])
    assert any(rest.values())  # what is no Lie element leaves a rest
