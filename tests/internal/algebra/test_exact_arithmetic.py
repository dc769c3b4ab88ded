"""Ranks of structure matrices, thresholds of ranks and coefficients, checks cut into runs, and free algebras."""

from contextlib import nullcontext
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.exact import elimination
from coadjoint.algebra.exact.free_algebra import (
    exponential,
    lie_coordinates,
    logarithm,
    lyndon_words,
    product,
)
from coadjoint.algebra.invariants import casimir_equations as kernels
from drawn_matrices import constants_of
from refusals import refused

pytestmark = pytest.mark.thinned(1)


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


def test_a_rank_needs_a_gap():
    """Singular values are zero up to round-off, and not clear up to 2^10 of it."""
    assert elimination.rank_from_gap(np.array([1.0, 1e-3, 1e-17]), 1e-15, "A") == 2
    assert elimination.rank_from_gap(np.zeros(3), 1e-15, "A") == 0
    for ratio, rank in ((0.5, 1), (2.0, None), (2.0**9, None), (2.0**11, 2)):
        values = np.array([1.0, ratio * 1e-15])
        with nullcontext() if rank else refused(ValueError, "rank of A", "singular value"):
            assert elimination.rank_from_gap(values, 1e-15, "A") == rank


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
