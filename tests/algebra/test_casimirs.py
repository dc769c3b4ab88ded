"""Casimirs found by machine against the known ones: they generate the same polynomials, in every degree."""

import pytest
from casimir_comparison import (
    assert_annihilated,
    assert_same_span,
    generated,
    independent_count,
    rank,
)
from trace_casimirs import classical, symplectic

from coadjoint.algebra import catalogue
from coadjoint.algebra.polynomials.polynomial import Polynomial


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


def test_more_generators_than_independent_ones():
    found = catalogue.get("A5,2").casimirs()
    assert list(found) == ["C1", "C2", "C3", "C4"] and independent_count(list(found.values())) == 3


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", ["so(4)", "so(6)", "e(3)", "e(4)", "sl(2)", "su(4)", "heisenberg(2)", "gl(3)"])
def test_polynomial_casimirs_of_the_catalogue_are_recovered(name):
    g = catalogue.get(name)
    known = [c for c in g.casimirs_known.values() if isinstance(c, Polynomial)]
    found = list(g.casimirs().values())
    for casimir in known:
        space = generated(found, casimir.degree)
        assert rank(space) == rank([*space, casimir])
    assert independent_count(known) == len(known) <= independent_count(found)
