"""Casimirs found by machine: as many as linear algebra modulo a prime counts, in any basis, exact or in floats."""

import math
import pickle
import subprocess
import sys
import warnings
from fractions import Fraction

import numpy as np
import pytest
from casimir_comparison import (
    assert_annihilated,
    casimir_count,
    generated,
    independent_count,
    rank,
)
from classification import rows
from lie_algebras import fractions, in_basis, known_casimirs, orthogonal, whole_change
from scipy.integrate import solve_ivp

import coadjoint as co
from long import long_beyond, long_where
from refusals import refused
from rounding import UNIT_ROUNDOFF

pytestmark = pytest.mark.thinned(2)

SMALL = {" ".join([name, *(f"{k}={v}" for k, v in given.items())]): (name, given) for name, given in rows()}


def found_up_to(g, degree):
    """All Casimirs found, with the warning where one is missing."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", co.LongWait)  # of a busy machine
        found = g.casimirs(degree)
    assert found.corank == g.dim - g.generic_rank() == len(found.independent) + found.missing
    assert [found.sentence in str(one.message) for one in told] == [True] * bool(found.missing)
    return found


def assert_all_found(g, degree):
    """What is found is annihilated, generates as many polynomials as there are, and none of it is superfluous."""
    found = [casimir for casimir in found_up_to(g, degree).values() if isinstance(casimir, co.Polynomial)]
    for casimir in found:
        assert_annihilated(g, casimir)
        assert all(type(value) is int for value in casimir.monomials.values())
    for d in range(1, degree + 1):
        assert rank(generated(found, d)) == casimir_count(g, d), f"degree {d}"
        lower = generated([p for p in found if p.degree < d], d)
        assert rank(generated(found, d)) == rank(lower) + sum(p.degree == d for p in found)
    return found


@pytest.mark.thinned(4)
@pytest.mark.parametrize("label", SMALL)
def test_all_casimirs_of_small_algebras_are_found(label):
    name, given = SMALL[label]
    g = co.algebras.get(name, **given)
    found = assert_all_found(g, 4)
    known = [c for c in known_casimirs(g).values() if isinstance(c, co.Polynomial)]
    for casimir in known:
        assert rank([*generated(found, casimir.degree), casimir]) == rank(generated(found, casimir.degree))


@pytest.mark.parametrize(
    ("name", "degree"),
    [("so(3)", 4), ("so(4)", 4), ("so(5)", 4), ("e(3)", 4), ("e(4)", 3), ("sl(3)", 3), ("su(3)", 3), ("sp(4)", 2),
     ("heisenberg(2)", 4), ("gl(3)", 3), ("so(3,1)", 4)],
)  # fmt: skip
def test_all_casimirs_of_classical_algebras_are_found(name, degree):
    found = assert_all_found(co.algebras.get(name), degree)
    known = [c for c in known_casimirs(co.algebras.get(name)).values() if c.degree <= degree]
    assert independent_count(known) == len(known) <= independent_count(found)


@pytest.mark.parametrize(
    ("name", "degrees"),
    long_where(
        [("su(4)", [2, 3, 4])], [("so(5)", [2, 4]), ("so(6)", [2, 3, 4]), ("sl(4)", [2, 3, 4]), ("su(4)", [2, 3, 4])]
    ),
)
def test_degrees_of_simple_algebras(name, degrees):
    """The exponents of the Weyl group, plus one; independent and annihilated."""
    g = co.algebras.get(name)
    found = g.casimirs()
    assert list(found) == [f"C{degree}" for degree in degrees]
    assert len(found) == g.dim - g.generic_rank() == independent_count(list(found.values()))
    for casimir in found.values():
        assert_annihilated(g, casimir)
    if name == "so(6)":  # the Pfaffian: the perfect matchings of six points
        assert len(found["C3"].monomials) == 15 and set(found["C3"].monomials.values()) == {1, -1}


def test_more_generators_than_independent_ones():
    found = co.algebras.get("A5,2").casimirs()
    assert list(found) == ["C1", "C2", "C3", "C4"] and independent_count(list(found.values())) == 3
    assert found.independent == ("C1", "C2", "C3") and found.corank == 3 and not found.missing


CHANGED = {
    "3 so(3)": lambda: co.algebras.copies(co.algebras.so(3), 3),
    "so(4)": lambda: co.algebras.so(4),
    "e(3)": lambda: co.algebras.e(3),
    "sl(3)": lambda: co.algebras.sl(3),
    "sp(4)": lambda: co.algebras.sp(4),
}


@pytest.mark.parametrize("seed", long_beyond(1, [0, 1]))
@pytest.mark.parametrize("name", CHANGED)
def test_in_whole_bases(name, seed):
    """As many as in the other basis, of the same degrees; what is known of the algebra is carried over, exactly."""
    g, degree = CHANGED[name](), 2 if name == "sp(4)" else 3
    other = co.algebras.change_of_basis(g, whole_change(g.dim, seed))
    assert list(found_up_to(other, degree)) == list(found_up_to(g, degree))
    found = assert_all_found(other, degree)
    for casimir in known_casimirs(other).values():
        assert rank([*generated(found, casimir.degree), casimir]) == rank(generated(found, casimir.degree))


def test_simple_casimirs_are_in_canonical_form():
    assert repr(co.algebras.so(3).casimirs()) == "{'C2': x1^2 + x2^2 + x3^2}"
    assert repr(co.algebras.sl(2).casimirs()) == "{'C2': x1*x3 + x2^2}"
    assert repr(co.algebras.e(3).casimirs()) == "{'C2_1': x1*x4 + x2*x5 + x3*x6, 'C2_2': x4^2 + x5^2 + x6^2}"
    oscillator = co.LieAlgebra([(1, 2, 0, 1.0), (1, 3, 2, -1.0), (2, 3, 1, 1.0)], dim=4)
    assert repr(oscillator.casimirs()) == "{'C1': x1, 'C2': 2*x1*x4 + x2^2 + x3^2}"
    assert repr(co.LieAlgebra([], dim=2).casimirs()) == "{'C1_1': x1, 'C1_2': x2}"


def test_the_same_answer_every_time_and_whatever_the_scale():
    g = co.algebras.so(5)
    first = repr(g.casimirs())
    scaled = co.algebras.change_of_basis(g, np.diag([Fraction(1, 3)] * 10))
    code = "import coadjoint as co; print(co.algebras.so(5).casimirs())"
    again = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert again.stdout.strip() == first == repr(g.casimirs()) == repr(scaled.casimirs())


def test_summands_are_solved_one_by_one():
    found = co.algebras.copies(co.algebras.so(3), 200).casimirs()
    assert list(found)[:2] == ["C2_1", "C2_2"] and len(found) == 200
    squares = {frozenset(e.index(2) for e in c.monomials if set(e) == {0, 2} and sum(e) == 2) for c in found.values()}
    assert squares == {frozenset(range(3 * at, 3 * at + 3)) for at in range(200)}
    # so(3) on the coordinates 0, 2, 4, an abelian one at 1, and A2,1 at 3, 5, which has none.
    g = co.LieAlgebra([(0, 2, 4, 1.0), (2, 4, 0, 1.0), (4, 0, 2, 1.0), (3, 5, 5, 1.0)], dim=6)
    assert repr(g.casimirs()) == "{'C1': x2, 'C2': x1^2 + x3^2 + x5^2}"


@pytest.mark.parametrize("name", ["so(3)", "e(2)", "sl(2)", "so(4)", "e(3)", "heisenberg(1)"])
def test_rotated_bases_in_floats(name):
    """Constants that are zero become some u beside the others of their bracket, and have no effect."""
    g = co.algebras.get(name)
    for seed in range(3):
        q = orthogonal(g.dim, seed)
        other = in_basis(g, q)
        assert other.generic_rank() == g.generic_rank()
        found = other.casimirs(2)
        assert independent_count(list(found.values())) == len(found) == g.dim - g.generic_rank()
        assert all(type(value) is float for c in found.values() for value in c.monomials.values())
        x = np.random.default_rng(seed).standard_normal(g.dim)
        for casimir in found.values():
            moved = q.T @ casimir.gradient(q @ x)
            # error / pivot: about u / 2^-6, for some ten products
            assert np.abs(g.structure_matrix(x) @ moved).max() <= 2**12 * UNIT_ROUNDOFF * np.abs(moved).max() * 10


def test_a_rotated_square_stays_a_square():
    found = found_up_to(in_basis(co.algebras.so(5), orthogonal(10, 3)), 2)
    assert found == {"C2": co.Polynomial({tuple(2 * (j == i) for j in range(10)): 1.0 for i in range(10)})}


def weights(*values):
    """The algebra of one element that acts on others by weights."""
    return co.LieAlgebra([(len(values), k, k, w) for k, w in enumerate(values) if w], dim=len(values) + 1)


def assert_invariant(g, casimir, tolerance=0):
    """J(x) grad C(x) = 0 at random points, in fractions if nothing is rounded; floats and the kernel's value agree."""
    for seed in range(3):
        x = fractions(np.random.default_rng(seed), g.dim)
        x[x == 0] = Fraction(1, 8)
        slope = casimir.formula.gradient(x) if isinstance(casimir, co.Invariant) else casimir.gradient(x)
        i, j, k, c = g.triples
        meant = [Fraction(v) if tolerance else Fraction(v).limit_denominator(10**6) for v in c.tolist()]
        J = np.full((g.dim, g.dim), Fraction(0))
        for row, column, factor, value in zip(i, j, k, meant, strict=True):
            J[row, column] += value * x[factor]
            J[column, row] -= value * x[factor]
        assert np.all(np.abs(J @ slope) <= tolerance * np.abs(J) @ np.abs(slope))
        y, e = x.astype(float), 1e-6 * np.eye(g.dim)
        wanted = np.asarray(casimir.gradient(y), dtype=float)
        np.testing.assert_allclose(slope.astype(float), wanted, rtol=1e-12, atol=1e-12 * np.abs(wanted).max())
        found = [(casimir(y + h) - casimir(y - h)) / 2e-6 for h in e]
        np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-5 * np.abs(wanted).max())


@pytest.mark.thinned(3)
@pytest.mark.parametrize("label", SMALL)
def test_small_algebras_have_as_many_independent_casimirs_as_their_corank(label):
    """Quotients, logarithms and angles besides polynomials; with those of the catalogue they have the same rank."""
    name, given = SMALL[label]
    g = co.algebras.get(name, **given)
    found = found_up_to(g, 4)
    assert not found.missing
    for casimir in found.values():
        assert_invariant(g, casimir)
    x = np.random.default_rng(1).uniform(0.5, 2.0, g.dim)
    slopes = [np.asarray(found[key].gradient(x), dtype=float) for key in found.independent]
    both = [*slopes, *(np.asarray(c.gradient(x), dtype=float) for c in known_casimirs(g).values())]
    for rows_of in (slopes, both):
        rows_of = [row / np.linalg.norm(row) for row in rows_of]
        assert not rows_of or np.linalg.matrix_rank(rows_of, tol=1e-8) == found.corank


def test_irrational_parameters():
    a = math.sqrt(2.0)
    assert repr(weights(a, 1.0).casimirs(6)) == "{'I': log|x2| - 0.7071067811865475 log|x1|}"
    assert repr(weights(a, -a, 1.0).casimirs()) == "{'C2': x1*x2, 'I': log|x2| + 1.4142135623730951 log|x3|}"
    assert not co.algebras.A3_7(math.e).casimirs().missing
    four = weights(1.0, 2.0, a, 3.0)
    found = four.casimirs()
    assert found.corank == 3 and found.independent == ("I1", "I2", "I3") and not found.missing
    for casimir in found.values():
        assert_invariant(four, casimir, 4 * UNIT_ROUNDOFF)
    again = pickle.loads(pickle.dumps(found))
    assert repr(again) == repr(found) and again.independent == found.independent


@pytest.mark.parametrize("factor", [1e-7, 1.0, 1e30])
@pytest.mark.parametrize("values", [(1.0, 2.0, 0.5), (1.0, math.sqrt(2.0)), (0.3, 0.3, -0.2, 0.7, 5.0)])
def test_weights_in_units_and_in_bases(values, factor):
    """Multiples of the acting element, a basis that is mixed, a sum with so(3), and names of the basis."""
    g = weights(*(factor * w for w in values))
    others = [co.algebras.direct_sum(co.algebras.so(3), g)]
    if factor == 1.0:
        others.append(co.LieAlgebra(g.triples, dim=g.dim, basis=[*"abcdefg"[: g.dim]]))
    if values[0] == 0.3 or factor != 1.0 or len(values) == 2:
        others.append(g)
    else:
        others.append(co.algebras.change_of_basis(g, whole_change(g.dim, 0)))
    for other in others:
        found = other.casimirs()
        assert not found.missing and len(found.independent) == other.dim - other.generic_rank()
        for casimir in found.values():
            assert_invariant(other, casimir, 16 * UNIT_ROUNDOFF)
    assert "log|a|" in repr(others[1].casimirs()) or len(values) != 2 or factor != 1.0


def test_systems_record_what_is_found_and_do_not_warn():
    """Splitting conserves what is no polynomial to round-off; DOP853 gives the motion."""
    g = weights(1.0, 2.0, math.sqrt(2.0), 3.0)
    system, x0 = co.LiePoissonSystem(g, "x1^2/2 + x2*x3 + x5^2/2"), [0.5, -0.4, 0.3, 0.2, 0.1]
    assert list(system.casimirs) == ["I1", "I2", "I3"]
    sol = co.integrate(system, x0, (1, -1), 0.0025, co.Splitting(4))
    assert max(sol.drift()[name] for name in system.casimirs) < 2**10 * UNIT_ROUNDOFF
    exact = solve_ivp(lambda t, x: system.vector_field(x), (1, -1), x0, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(sol.x[-1], exact, rtol=0, atol=1e-7)  # 1.5e-6 at four times the step
    hidden = co.LieAlgebra.from_brackets(3, {(0, 2): {0: 1.0, 1: 1.0}, (1, 2): {0: 1.0}})
    assert co.LiePoissonSystem(hidden, "x1^2/2 + x3^2/2").casimirs == {}


@pytest.mark.parametrize("factor", [1.0, math.pi])
def test_rounded_sums_count_as_zero(factor):
    """0.1 + 0.2 - 0.3 is not zero in floats, but in the fractions that are meant; with an irrational factor, to u."""
    weights = factor * 0.1, factor * 0.2, -(factor * 0.1 + factor * 0.2)
    weights = (0.1, 0.2, -0.3) if factor == 1.0 else weights
    g = co.LieAlgebra([(i, 3, i, w) for i, w in enumerate(weights)], dim=4)
    assert co.Polynomial({(1, 1, 1, 0): 1}) in g.casimirs(3).values()


GOLDEN = {(0, 2): {0: 1.0, 1: 1.0}, (1, 2): {0: 1.0}}


@pytest.mark.parametrize("copies", [1, 2])
def test_a_result_that_is_not_complete_says_what_is_missing(copies):
    """The weights are roots of s^2 - s - 1: the invariant is no function of polynomials with rational coefficients."""
    g = co.algebras.copies(co.LieAlgebra.from_brackets(3, GOLDEN), copies)
    with pytest.warns(
        UserWarning, match=f"found 0 of {copies} independent .*degree 3.* give the {copies} missing"
    ) as told:
        found = g.casimirs(3)
    assert len(told) == 1 and told[0].filename == __file__
    assert found == {} and found.missing == found.corank == copies and found.sentence in repr(found)
    again = pickle.loads(pickle.dumps(found))
    assert repr(again) == repr(found) and type(again) is type(found)
    golden = (1 + math.sqrt(5)) / 2

    def given(x):
        return math.log(abs(golden * x[0] + x[1])) + golden**2 * math.log(abs(golden * x[1] - x[0]))

    system = co.LiePoissonSystem(g, "x1^2/2 + x3^2/2" if copies == 1 else co.Quadratic(1.0), casimirs={"C": given})
    assert list(system.casimirs) == ["C"]
    known = co.LieAlgebra.from_brackets(3, GOLDEN, casimirs={"C": co.Invariant(given)})
    assert "casimirs_known has: C" in found_up_to(known, 2).sentence
    with refused(ValueError, "'C'", "not a Casimir"):
        co.LieAlgebra.from_brackets(3, GOLDEN, casimirs={"C": co.Invariant(lambda x: given(x) + 1e-5 * x[0])})


def test_an_empty_result_says_why():
    none = co.algebras.get("A2,1").casimirs(3)
    assert none == co.algebras.get("A4,7").casimirs() == {} and "no Casimir of any kind" in repr(none)


def test_unclear_ranks_are_refused():
    """Two so(3), one 10^-13 times the other, in a rotated basis: the small one could be round-off."""
    size = np.diag([1.0, 1.0, 1.0, 1e-13, 1e-13, 1e-13])
    both = in_basis(co.algebras.copies(co.algebras.so(3), 2), size)
    with refused(ValueError, "rank of J(x)", "singular value"):
        in_basis(both, orthogonal(6, 0)).casimirs()


def test_a_degree_with_too_many_monomials_is_refused():
    with refused(ValueError, "degree 6", "dimension 21", "230230", "40000"):
        co.algebras.so(7).casimirs(6)
    one_block = co.LieAlgebra([(0, k, k, 1.0) for k in range(1, 16)], dim=16)
    with refused(ValueError, "degree 6", "dimension 16", "54264", "40000"):
        one_block.casimirs(6)


def test_summands_with_the_same_constants_at_other_places_have_their_own_casimirs():
    g = co.LieAlgebra.from_brackets(6, ["[e1,e2]=e3", "[e5,e6]=e4"])
    x = np.arange(1.0, 7.0)
    slopes = [C.gradient(x) for C in g.casimirs().values()]
    assert len(slopes) == 2
    for slope in slopes:
        assert not np.any(g.structure_matrix(x) @ slope)
