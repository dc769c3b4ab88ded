"""Casimirs found by machine against the published invariants of all 62 algebras; in random rational bases."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from casimir_comparison import assert_annihilated, assert_same_span, rational_change, substituted
from flint import fmpq, fmpq_mat
from test_low_dimensional import CASES, label
from trace_casimirs import classical, symplectic

import coadjoint as co
from coadjoint.algebra.families.low_dimensional import formulas, read_parameters
from coadjoint.algebra.invariants.logarithmic import LOGARITHM, QUOTIENT
from coadjoint.algebra.polynomials.polynomial import Polynomial
from long import long_beyond, long_where

DEGREE = 4


def poly(dim, *terms):
    """'x1^2 - 3 x2' written as (1, '11'), (-3, '2')."""
    return Polynomial({tuple(term.count(str(i + 1)) for i in range(dim)): value for value, term in terms})


# (C3^2 - C2^3)/C1^2 is a polynomial: the discriminant of a binary cubic, dependent on the three published invariants.
DEPENDENT = {"A5_2": [poly(5, (9, "1144"), (-18, "1234"), (8, "1333"), (6, "2224"), (-3, "2233"))]}


def matrix_rank(rows):
    entries = [fmpq(Fraction(v).numerator, Fraction(v).denominator) for row in rows for v in row]
    return fmpq_mat(len(rows), len(rows[0]), entries).rank()


def products_of_powers(logarithmic):
    """Every product of powers up to DEGREE of the polynomials p under the logarithms that is an invariant itself.

    It is one where its logarithm, sum of n_p log p, is a combination of the published ones, in which everything else
    (angles, quotients) cancels. Each log p, angle and quotient is taken as one unknown.
    """
    unknowns = []
    for formula in logarithmic:
        unknowns += [u for t in formula.terms if (u := (t.kind, t.first, t.second)) not in unknowns]
    published = []
    for formula in logarithmic:
        row = [0] * len(unknowns)
        for term in formula.terms:
            row[unknowns.index((term.kind, term.first, term.second))] += term.weight
        published.append(row)
    powers = [range(DEGREE // p.degree + 1) if kind == LOGARITHM else (0,) for kind, _, p in unknowns]
    for chosen in itertools.product(*powers):
        degree = sum(n * u[2].degree for n, u in zip(chosen, unknowns, strict=True))
        if 1 <= degree <= DEGREE and matrix_rank([*published, chosen]) == matrix_rank(published):
            product = Polynomial({(0,) * unknowns[0][2].dim: 1})
            for n, u in zip(chosen, unknowns, strict=True):
                product = product * u[2] ** n
            yield product


def numerators(logarithmic, polynomials):
    """p of every published p/q whose q is a published polynomial invariant."""
    alone = [formula.terms[0] for formula in logarithmic if [term.kind for term in formula.terms] == [QUOTIENT]]
    return [term.first for term in alone if term.second in polynomials]


def published_polynomials(name, chosen):
    """All polynomial invariants that are published: as such, within a logarithm, within a quotient, dependent ones."""
    found = list(formulas(name, read_parameters(name, chosen)).values())
    polynomials = [f for f in found if isinstance(f, Polynomial)]
    others = [f for f in found if not isinstance(f, Polynomial)]
    return {
        "as such": polynomials,
        "in a logarithm": list(products_of_powers(others)) if others else [],
        "in a quotient": numerators(others, polynomials),
        "dependent": DEPENDENT.get(name, []),
    }


@pytest.mark.thinned(6)
@pytest.mark.parametrize(("name", "chosen"), CASES, ids=label)
def test_published_and_found_casimirs_generate_the_same(name, chosen):
    g = co.algebras.get(name, **chosen)
    known = [c for group in published_polynomials(name, chosen).values() for c in group]
    found = g.casimirs(DEGREE)
    assert all(c.degree <= DEGREE for c in known)
    assert_same_span(found.values(), known, DEGREE)
    for casimir in found.values():
        assert_annihilated(g, casimir)
        assert all(type(value) is int for value in casimir.monomials.values())


def test_every_way_to_publish_a_polynomial_occurs():
    occurring = {}
    for name, chosen in CASES:
        for way, group in published_polynomials(name, chosen).items():
            occurring.setdefault(way, set()).update([name] if group else [])
    assert occurring["dependent"] == {"A5_2"} and occurring["in a quotient"] == {"A5_18"}
    # Every polynomial that is given as known is compared with what is found.
    assert occurring["as such"] == {
        name
        for name, chosen in CASES
        if any(isinstance(c, Polynomial) for c in co.algebras.get(name, **chosen).casimirs_known.values())
    }
    assert len(occurring["as such"]) > 20 and len(occurring["in a logarithm"]) > 5


@pytest.mark.parametrize("s", [1, -1])
def test_two_oscillators_of_one_frequency_have_the_phase_between_them(s):
    """A5,17 with p = q = 0 and z = x1 + i x2, w = x3 + i x4: |z|^2, |w|^2 and z times the conjugate of w (or w)."""
    phase = [poly(5, (1, "13"), (s, "24")), poly(5, (1, "14"), (-s, "23"))]
    known = [poly(5, (1, "11"), (1, "22")), poly(5, (1, "33"), (1, "44")), *phase]
    assert_same_span(co.algebras.get("A5,17", p=0, q=0, s=s).casimirs().values(), known)


def with_traces(g, traces):
    return co.LieAlgebra(g.triples, dim=g.dim, casimirs={f"trace {c.degree}": c for c in traces})


# With all independent Casimirs: of the catalogue's sl(3) and sp(4) the quadratic one alone is known.
CHANGED = {
    "3 so(3)": lambda: co.algebras.copies(co.algebras.so(3), 3),
    "so(4)": lambda: co.algebras.so(4),
    "e(3)": lambda: co.algebras.e(3),
    "sl(3)": lambda: with_traces(*classical("sl(3)")),
    "sp(4)": lambda: with_traces(*symplectic()),
}


def inverse_of(T):
    n = len(T)
    inverse = fmpq_mat(n, n, [fmpq(v.numerator, v.denominator) for v in T.ravel()]).inv()
    return np.array([[Fraction(int(inverse[i, j].p), int(inverse[i, j].q)) for j in range(n)] for i in range(n)])


@pytest.mark.parametrize("seed", long_beyond(1, [0, 1]))
@pytest.mark.parametrize("name", long_where(["sp(4)"], CHANGED))
def test_in_random_rational_bases(name, seed):
    """x' = T x, so C(x) is C(T^-1 x') there; the comparison is exact."""
    g = CHANGED[name]()
    known = list(g.casimirs_known.values())
    assert len(known) == g.dim - g.generic_rank()
    T = rational_change(g.dim, np.random.default_rng([seed, g.dim]))
    other, q = co.algebras.change_of_basis(g, T), inverse_of(T)
    expected = [substituted(c, q) for c in known]
    degree = max(c.degree for c in known)
    found = other.casimirs(degree)
    assert_same_span(found.values(), expected, degree)
    for casimir in found.values():
        assert_annihilated(other, casimir)
    # What is known of the algebra is carried over, exactly.
    assert list(other.casimirs_known) == list(g.casimirs_known)
    assert list(other.casimirs_known.values()) == expected


@pytest.mark.parametrize("name", ["sl(3)", "sp(4)"])
def test_the_quadratic_one_of_the_catalogue_is_found(name):
    """In the catalogue's own basis, and in a random one; there is one of degree 2, up to a factor."""
    g = co.algebras.get(name)
    for algebra in (g, co.algebras.change_of_basis(g, rational_change(g.dim, np.random.default_rng(g.dim)))):
        assert_same_span(algebra.casimirs(2).values(), algebra.casimirs_known.values(), 2)
