"""Casimirs found by machine against the known ones: they generate the same polynomials, in every degree."""

from fractions import Fraction

import numpy as np
import pytest
from casimir_comparison import (
    assert_annihilated,
    assert_same_span,
    generated,
    independent_count,
    rank,
    rational_change,
    substituted,
)
from flint import fmpq, fmpq_mat
from trace_casimirs import classical, symplectic

from coadjoint.algebra import catalogue
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from long import long_where


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", ["so(3)", "so(5)", "sl(3)", "sl(4)", "su(3)", "su(4)"])
def test_classical_algebras_have_the_traces(name):
    g, known = classical(name) if name != "so(3)" else (catalogue.so(3), [catalogue.so(3).casimirs_known["|x|^2"]])
    found = g.casimirs()
    assert_same_span(found.values(), known)
    assert len(found) == g.dim - g.generic_rank() == independent_count(list(found.values()))
    for casimir in found.values():
        assert_annihilated(g, casimir)


def test_symplectic_algebra():
    g, known = symplectic()
    found = g.casimirs()
    assert list(found) == ["C2", "C4"]
    assert_same_span(found.values(), known)
    assert g.dim - g.generic_rank() == 2


def test_orthogonal_algebra_in_six_dimensions_has_the_cubic_pfaffian():
    found = catalogue.so(6).casimirs()
    assert list(found) == ["C2", "C3", "C4"]
    assert len(found["C3"].monomials) == 15  # the perfect matchings of six points
    assert set(found["C3"].monomials.values()) == {1, -1}
    for casimir in found.values():
        assert_annihilated(catalogue.so(6), casimir)


def poly(dim, text):
    """'x2^2 - 2 x1 x3' written as [(1, '22'), (-2, '13')]."""
    return Polynomial({tuple(term.count(str(i + 1)) for i in range(dim)): value for value, term in text})


# Patera, Sharp, Winternitz, Zassenhaus, J. Math. Phys. 17 (1976) 986: brackets 'ijk' -> c_ij^k with indices from 1, and
# every polynomial Casimir up to degree 4 that is no polynomial in the others. A5,2 has the seminvariants of the binary
# cubic, the last one its discriminant, with the relation C3^2 = C2^3 + C1^2 C4: four for three independent ones.
CONE = [(1, "22"), (-2, "13")]
LOW = {
    "A2,1": ({"122": 1}, []),
    "A3,1": ({"231": 1}, [[(1, "1")]]),
    "A3,2": ({"131": 1, "231": 1, "232": 1}, []),
    "A3,3": ({"131": 1, "232": 1}, []),
    "A3,4": ({"131": 1, "232": -1}, [[(1, "12")]]),
    "A3,5 a=1/3": ({"131": 1, "232": 1 / 3}, []),
    "A3,5 a=-1/3": ({"131": 1, "232": -1 / 3}, [[(1, "1222")]]),
    "A3,6": ({"132": -1, "231": 1}, [[(1, "11"), (1, "22")]]),
    "A3,7 a=2": ({"131": 2, "132": -1, "231": 1, "232": 2}, []),
    "A3,8": ({"121": 1, "132": -2, "233": 1}, [[(1, "22"), (1, "13")]]),
    "A3,9": ({"123": 1, "132": -1, "231": 1}, [[(1, "11"), (1, "22"), (1, "33")]]),
    "A4,1": ({"241": 1, "342": 1}, [[(1, "1")], CONE]),
    "A4,3": ({"141": 1, "342": 1}, [[(1, "2")]]),
    "A4,5": ({"141": 1, "242": 1 / 2, "343": -1 / 3}, [[(1, "1333")]]),
    "A4,7": ({"231": 1, "141": 2, "242": 1, "342": 1, "343": 1}, []),
    "A4,8": ({"231": 1, "242": 1, "343": -1}, [[(1, "1")], [(1, "23"), (-1, "14")]]),
    "A4,10": ({"231": 1, "243": -1, "342": 1}, [[(1, "1")], [(1, "22"), (1, "33"), (2, "14")]]),
    "A4,12": ({"131": 1, "232": 1, "142": -1, "241": 1}, []),
    "A5,1": ({"351": 1, "452": 1}, [[(1, "1")], [(1, "2")], [(1, "23"), (-1, "14")]]),
    "A5,2": (
        {"251": 1, "352": 1, "453": 1},
        [
            [(1, "1")],
            CONE,
            [(1, "222"), (3, "114"), (-3, "123")],
            [(9, "1144"), (-18, "1234"), (8, "1333"), (6, "2224"), (-3, "2233")],
        ],
    ),
    "A5,3": ({"342": 1, "351": 1, "453": 1}, [[(1, "1")], [(1, "2")], [(1, "33"), (2, "25"), (-2, "14")]]),
    "A5,4": ({"241": 1, "351": 1}, [[(1, "1")]]),
    "A5,5": ({"341": 1, "251": 1, "352": 1}, [[(1, "1")]]),
    "A5,6": ({"341": 1, "251": 1, "352": 1, "453": 1}, [[(1, "1")]]),
    "A5,8": ({"251": 1, "353": 1, "454": 1 / 2}, [[(1, "1")]]),
    "A5,10": ({"251": 1, "352": 1, "454": 1}, [[(1, "1")], CONE]),
    "A5,14": ({"251": 1, "353": 1 / 3, "354": -1, "453": 1, "454": 1 / 3}, [[(1, "1")]]),
    "A5,22": ({"231": 1, "253": 1, "454": 1}, [[(1, "1")]]),
    "A5,29": ({"231": 1, "151": 1, "252": 1, "354": 1}, [[(1, "4")]]),
    "A5,38": ({"141": 1, "252": 1, "453": 1}, [[(1, "3")]]),
    "A5,39": ({"141": 1, "242": 1, "152": -1, "251": 1, "453": 1}, [[(1, "3")]]),
    "A5,40": (
        {"121": 2, "132": -1, "233": 2, "145": 1, "244": 1, "255": -1, "354": 1},
        [[(-1, "144"), (1, "245"), (1, "355")]],
    ),
}


@pytest.mark.parametrize("name", LOW)
def test_low_dimensional_algebras(name):
    brackets, known = LOW[name]
    dim = int(name[1])
    g = LieAlgebra([(*(int(q) - 1 for q in places), c) for places, c in brackets.items()], dim=dim)
    found = g.casimirs()
    assert_same_span(found.values(), [poly(dim, text) for text in known])
    for casimir in found.values():
        assert_annihilated(g, casimir)
        assert all(type(value) is int for value in casimir.monomials.values())
    assert independent_count(list(found.values())) <= dim - g.generic_rank()


def test_more_generators_than_independent_ones():
    brackets, known = LOW["A5,2"]
    g = LieAlgebra([(*(int(q) - 1 for q in places), c) for places, c in brackets.items()], dim=5)
    first, cone, cubic, discriminant = (poly(5, text) for text in known)
    assert cubic**2 == cone**3 + first**2 * discriminant
    assert g.dim - g.generic_rank() == 3 == independent_count(list(g.casimirs().values()))
    assert list(g.casimirs()) == ["C1", "C2", "C3", "C4"]


FIXED = [name for name in LOW if "a=" not in name and name not in ("A3,7", "A4,5", "A5,8", "A5,14")]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", [*FIXED, "so(4)", "so(6)", "e(3)", "e(4)", "sl(2)", "su(4)", "heisenberg(2)", "gl(3)"])
def test_polynomial_casimirs_of_the_catalogue_are_recovered(name):
    g = catalogue.get(name)
    known = [c for c in g.casimirs_known.values() if isinstance(c, Polynomial)]
    found = list(g.casimirs().values())
    for casimir in known:
        space = generated(found, casimir.degree)
        assert rank(space) == rank([*space, casimir])
    assert independent_count(known) == len(known) <= independent_count(found)


def changed(g, p):
    """The algebra in the basis f_a = sum_i p_ai e_i, constants as fractions and as floats; coordinates x' = p x."""
    n = g.dim
    inverse = fmpq_mat(n, n, [fmpq(v.numerator, v.denominator) for v in p.ravel()]).inv()
    q = np.array([[Fraction(int(inverse[i, j].p), int(inverse[i, j].q)) for j in range(n)] for i in range(n)])
    c = np.zeros((n, n, n), dtype=object)
    for i, j, k, value in zip(*(column.tolist() for column in g.triples), strict=True):
        c[i, j, k], c[j, i, k] = Fraction(value), -Fraction(value)
    new = np.tensordot(p, np.tensordot(p, np.tensordot(c, q, 1), (1, 1)), (1, 1))
    return LieAlgebra(new.astype(float)), q


CHANGED = {
    "so(4)": lambda: (catalogue.so(4), list(catalogue.so(4).casimirs_known.values())),
    "e(3)": lambda: (catalogue.e(3), list(catalogue.e(3).casimirs_known.values())),
    "sl(3)": lambda: classical("sl(3)"),
    "su(3)": lambda: classical("su(3)"),
    "so(5)": lambda: classical("so(5)"),
    "sp(4)": symplectic,
}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", long_where(["so(5)", "sp(4)"], CHANGED))
def test_random_rational_changes_of_basis(name):
    g, known = CHANGED[name]()
    rng = np.random.default_rng(sum(map(ord, name)))
    for _ in range(3 if g.dim == 6 else 1):
        other, q = changed(g, rational_change(g.dim, rng))
        degree = max(c.degree for c in known)
        found = other.casimirs(degree)
        assert_same_span(found.values(), [substituted(c, q) for c in known], degree)
        assert all(type(value) is int for c in found.values() for value in c.monomials.values())
        assert other.generic_rank() == g.generic_rank()
        for casimir in found.values():
            assert_annihilated(other, casimir)
