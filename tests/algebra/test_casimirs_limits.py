"""Casimirs in floats, of direct sums, in canonical form, and what is refused."""

import math
import pickle
import subprocess
import sys

import numpy as np
import pytest
from casimir_comparison import independent_count

from coadjoint.algebra import catalogue
from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact import numerical_kernel, rational_kernel
from coadjoint.algebra.invariants.casimir_equations import equations, monomials
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial

UNIT_ROUNDOFF = 2.0**-53


def copies(g, count):
    shift = np.repeat(g.dim * np.arange(count), g.triples.c.size)
    i, j, k = (np.tile(column, count) + shift for column in g.triples[:3])
    return LieAlgebra(Triples(i, j, k, np.tile(g.triples.c, count)), dim=g.dim * count)


def rotated(g, q):
    c = np.zeros((g.dim,) * 3)
    i, j, k, value = g.triples
    c[i, j, k], c[j, i, k] = value, -value
    return LieAlgebra(np.einsum("ai,bj,ijk,ck->abc", q, q, c, q))


def orthogonal(n, seed):
    return np.linalg.qr(np.random.default_rng(seed).standard_normal((n, n)))[0]


def test_simple_casimirs_look_as_a_human_writes_them():
    assert repr(catalogue.so(3).casimirs()) == "{'C2': x1^2 + x2^2 + x3^2}"
    assert repr(catalogue.sl(2).casimirs()) == "{'C2': x1*x3 + x2^2}"
    assert repr(catalogue.e(3).casimirs()) == "{'C2_1': x1*x4 + x2*x5 + x3*x6, 'C2_2': x4^2 + x5^2 + x6^2}"
    oscillator = LieAlgebra([(1, 2, 0, 1.0), (1, 3, 2, -1.0), (2, 3, 1, 1.0)], dim=4)
    assert repr(oscillator.casimirs()) == "{'C1': x1, 'C2': 2*x1*x4 + x2^2 + x3^2}"


def test_same_answer_every_time_and_whatever_the_scale():
    g = catalogue.so(5)
    first = g.casimirs()
    i, j, k, c = g.triples
    assert repr(first) == repr(g.casimirs()) == repr(LieAlgebra(Triples(i, j, k, c / 3), dim=10).casimirs())
    code = "import coadjoint.algebra.catalogue as c; print(c.so(5).casimirs())"
    again = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert again.stdout.strip() == repr(first)


def test_copies_are_solved_one_by_one():
    found = copies(catalogue.so(3), 200).casimirs()
    assert list(found)[:2] == ["C2_1", "C2_2"]
    expected = {
        tuple(frozenset(enumerate(e)) & {(q, 2) for q in range(600)} for e in c.monomials) for c in found.values()
    }
    assert expected == {tuple(frozenset({(3 * at + q, 2)}) for q in range(3)) for at in range(200)}


def test_mixed_sums_keep_their_coordinates():
    """so(3) on the coordinates 0, 2, 4, an abelian one at 1, and A2,1 at 3, 5, which has none."""
    g = LieAlgebra([(0, 2, 4, 1.0), (2, 4, 0, 1.0), (4, 0, 2, 1.0), (3, 5, 5, 1.0)], dim=6)
    assert repr(g.casimirs()) == "{'C1': x2, 'C2': x1^2 + x3^2 + x5^2}"


def test_abelian_algebras_have_their_coordinates():
    assert repr(LieAlgebra([], dim=2).casimirs()) == "{'C1_1': x1, 'C1_2': x2}"


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_rotated_basis_in_floats(seed):
    g, q = catalogue.so(4), orthogonal(6, seed)
    other = rotated(g, q)
    assert other.generic_rank() == 4
    found = other.casimirs(4 if seed == 0 else 2)  # of degree 4 there are products only
    assert list(found) == ["C2_1", "C2_2"]
    assert all(type(value) is float for c in found.values() for value in c.monomials.values())
    # both lie in the span of |x|^2 and the rotated Pfaffian
    pfaffian = q @ g.casimirs_known["Pfaffian"].hessian(np.zeros(6)) @ q.T
    known = np.stack([np.eye(6).ravel(), pfaffian.ravel()], axis=1)
    for casimir in found.values():
        hessian = casimir.hessian(np.zeros(6)).ravel()
        rest = hessian - known @ np.linalg.lstsq(known, hessian, rcond=None)[0]
        assert np.abs(rest).max() < 2**12 * UNIT_ROUNDOFF * np.abs(hessian).max()  # error / pivot, pivots above 2^-5


def test_rotated_so5_has_its_square():
    found = rotated(catalogue.so(5), orthogonal(10, 3)).casimirs(2)
    assert list(found) == ["C2"]
    assert found["C2"] == Polynomial({tuple(2 * (j == i) for j in range(10)): 1.0 for i in range(10)})


@pytest.mark.parametrize("name", ["so(3)", "e(2)", "sl(2)", "so(4)", "e(3)", "heisenberg(1)"])
def test_constants_that_are_rounding_alone_have_no_effect(name):
    """In a rotated basis, constants that are zero become some u beside the others of their bracket."""
    g = catalogue.get(name)
    for seed in range(4):
        q = orthogonal(g.dim, seed)
        found = rotated(g, q).casimirs(2)
        assert independent_count(list(found.values())) == len(found) == g.dim - g.generic_rank()
        x = np.random.default_rng(seed).standard_normal(g.dim)
        for casimir in found.values():
            moved = q.T @ casimir.gradient(q @ x)
            # error / pivot: about u / 2^-6, for some ten products
            assert np.abs(g.structure_matrix(x) @ moved).max() <= 2**12 * UNIT_ROUNDOFF * np.abs(moved).max() * 10


def test_irrational_parameters():
    a = math.sqrt(2.0)
    assert LieAlgebra([(0, 2, 0, 1.0), (1, 2, 1, a)], dim=3).casimirs(6) == {}
    assert LieAlgebra([(0, 2, 0, 1.0), (1, 2, 1, -a)], dim=3).casimirs(6) == {}
    three = LieAlgebra([(0, 3, 0, a), (1, 3, 1, -a), (2, 3, 2, 1.0)], dim=4)
    assert three.casimirs() == {"C2": Polynomial({(1, 1, 0, 0): 1.0})}


def test_rounded_sums_count_as_zero():
    """0.1 + 0.2 - 0.3 is not zero in floats, but in the fractions that are meant; with an irrational factor, to u."""
    for factor in (1.0, math.pi):
        weights = factor * 0.1, factor * 0.2, -(factor * 0.1 + factor * 0.2)
        weights = (0.1, 0.2, -0.3) if factor == 1.0 else weights
        g = LieAlgebra([(i, 3, i, w) for i, w in enumerate(weights)], dim=4)
        assert Polynomial({(1, 1, 1, 0): 1}) in g.casimirs(3).values()


def test_algebras_without_polynomial_casimirs():
    assert LieAlgebra([(0, 1, 1, 1.0)], dim=2).casimirs() == {}
    assert catalogue.A3_7(2.0).casimirs(8) == {}
    assert catalogue.A3_7(math.e).casimirs(4) == {}


@pytest.mark.parametrize(
    ("name", "parameters"), [("A3_7", {"a": 2}), ("A4_2", {"a": 3}), ("A5_7", {"a": 0.5, "b": 0.3, "c": 0.2})]
)
@pytest.mark.parametrize("degree", [1, 3])
def test_an_empty_result_says_what_there_is(name, parameters, degree):
    g = catalogue.get(name, **parameters)
    count, found = g.dim - g.generic_rank(), g.casimirs(degree)
    there = f"of Casimirs of any kind there {'is' if count == 1 else 'are'} {count}"
    known = ", ".join(g.casimirs_known)
    assert repr(found) == f"{{}} (no polynomial up to degree {degree}; {there}; casimirs_known has: {known})"
    alone = LieAlgebra(g.triples, dim=g.dim).casimirs(degree)
    assert repr(alone) == f"{{}} (no polynomial up to degree {degree}; {there})" and alone == found == {}
    again = pickle.loads(pickle.dumps(found))
    assert repr(again) == repr(found) and type(again) is type(found)
    none = "{} (there is no Casimir of any kind: the rank of J is the dimension)"
    assert repr(catalogue.get("A2,1").casimirs(degree)) == repr(catalogue.get("A4,7").casimirs(degree)) == none


def test_unclear_ranks_are_refused():
    """Two so(3), one 10^-13 times the other, in a rotated basis: the small one could be round-off."""
    i, j, k, c = catalogue.so(3).triples
    both = Triples(*(np.concatenate([a, a + 3]) for a in (i, j, k)), np.concatenate([c, 1e-13 * c]))
    with pytest.raises(ValueError, match=r"rank of J\(x\) is not clear: its singular value .* neither round-off"):
        rotated(LieAlgebra(both, dim=6), orthogonal(6, 0)).casimirs()


@pytest.mark.long
def test_sizes_are_refused_by_name():
    with pytest.raises(
        ValueError, match="degree 6 on dimension 21 has 230230 monomials, above the limit of 40000; low"
    ):
        catalogue.so(7).casimirs(6)
    with pytest.raises(ValueError, match="of dimension 30000 need more than 50000000 exponents"):
        copies(catalogue.so(3), 10_000).casimirs()
    dense = rotated(catalogue.so(7), orthogonal(21, 0))
    with pytest.raises(
        ValueError, match=r"degree 4 on dimension 21 with .* has equations of .* terms, above the limit"
    ):
        dense.casimirs()


def test_large_blocks_are_refused_by_name():
    i, j, k, c = catalogue.so(3).triples
    monomial = monomials(3, 4)
    for values, solve in ((c, numerical_kernel.kernel), (c.astype(int).astype(object), rational_kernel.kernel)):
        given = equations(Triples(i, j, k, c), values, monomial, 3)
        assert len(solve(given, 6)) == 1  # x1^4 ... x3^4: six even monomials
        with pytest.raises(ValueError, match="6 coefficients of a Casimir are coupled, above the limit of 5; lower"):
            solve(given, 5)


@pytest.mark.parametrize("wrong", [0, -1, 2.0, True, "4", None])
def test_wrong_degrees_are_refused(wrong):
    with pytest.raises(ValueError, match="max_degree must be a whole number from 1 up, not"):
        catalogue.so(3).casimirs(wrong)


def test_functional_independence():
    c2, c4 = catalogue.so(5).casimirs().values()
    assert independent_count([c2, c4]) == 2
    assert independent_count([c2, c2**2 - 1]) == 1
    assert independent_count([c2, c4, c2 * c4 + c2]) == 2
    assert independent_count([]) == 0
    with pytest.raises(ValueError, match="same number of coordinates, not 3 and 10"):
        independent_count([c2, Polynomial.variable(0, 3)])


def test_import_stays_light():
    code = "import sys, coadjoint.algebra.catalogue as c; c.so(4); print('flint' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "False"
