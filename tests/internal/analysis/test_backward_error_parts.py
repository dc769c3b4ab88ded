"""Parts of backward error analysis: sample points, names of symbols, Hamiltonians of fields, what correctors leave."""

from itertools import permutations

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.invariants.sampled_checks import sample_points
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.analysis.backward_error.modified_hamiltonian import names_of
from coadjoint.analysis.backward_error.step_series import bracket_change, hamiltonian_of, skew_factor
from coadjoint.analysis.energy_error import short_motion
from refusals import refused

pytestmark = pytest.mark.thinned(1)


def whole(name, sign=1):
    """A system with a full M of eighths."""
    algebra, rng = co.algebras.get(name), np.random.default_rng(3)
    B = rng.integers(-2, 3, (algebra.dim, algebra.dim)) / 8
    return co.LiePoissonSystem(algebra, co.Quadratic(np.diag(1 + np.arange(algebra.dim) / 4) + B + B.T), sign=sign)


@pytest.mark.parametrize("which", [0, 1])
def test_fields_at_points_are_looked_at_in_more_than_one(which):
    """The step has an error of first order everywhere but where x1 is that of a sample point."""
    system = whole("so(3)", -1)
    calm = float(sample_points(3)[which][0])

    def step(x, h):
        middle = x + h / 2 * system.vector_field(x)
        return x + h * system.vector_field(middle) + h * h * (x[0] - calm) * x

    found = co.modified_field(system, step, 3, way="numerical")
    assert not found.exact and found.first_error == 1 and found.keeps("energy") == 1
    assert found.keeps(next(iter(system.casimirs))) == 1
    with refused(ValueError, "does not keep the energy", "at h^1"):
        found.skew_matrix([1.0, 2.0, 3.0], 0.1)
    one, three = np.array([calm, 0.5, -0.25]), np.array([[calm, 0.5, -0.25], [0.3, 0.2, 0.1], [1.0, -1.0, 0.5]])
    exact = co.modified_field(system, step, 3)
    assert exact.exact
    for k in range(3):
        expected = np.array([[F(x) for F in exact.terms[k]] for x in three])
        np.testing.assert_allclose(found.terms[k](three), expected, atol=1e-13)
        np.testing.assert_allclose(found.terms[k](one), expected[0], atol=1e-13)
    for h in (0.25, -0.25):
        np.testing.assert_allclose(found(three, h), exact(three, h), atol=1e-13)
        np.testing.assert_allclose(found(one, h), exact(one, h), atol=1e-13)


def test_names_of_coefficients():
    unit = np.eye(11, dtype=int)
    keys = [unit[0], 2 * unit[10], unit[0] + unit[10], unit[1] + 2 * unit[9], 4 * unit[2]]
    H = co.Polynomial({tuple(map(int, key)): 1.0 for key in keys} | {(0,) * 11: 3.0})
    expected = dict(
        zip((tuple(map(int, key)) for key in keys), ["b1", "m11", "m1_11", "c2_10_10", "c3_3_3_3"], strict=True)
    )
    assert names_of(H) == expected
    small = co.Polynomial({(1, 0, 2): 1.0, (0, 2, 0): 1.0, (1, 1, 0): 1.0, (0, 0, 1): 1.0, (0, 0, 0): 2.0})
    assert names_of(small) == {(1, 0, 2): "c133", (0, 2, 0): "m2", (1, 1, 0): "m12", (0, 0, 1): "b3"}


@pytest.mark.parametrize("sign", [1, -1])
def test_what_a_corrector_leaves_is_measured_along_all_motions(sign):
    """Changes of H_p + sign {G, H} against those of H_p, each motion about its own mean; one is much faster."""
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.3], linear=[0.1, 0.0, 0.2]), sign=sign)
    starts = np.array([[1.0, 0.2, 0.5], [0.1, -0.3, 0.2], [2.0, 4.0, -3.0]])
    term = co.modified_hamiltonian(system, co.Splitting(), 2).error_term.term
    better = co.make_corrector(system, co.Splitting(), starts)
    degree = term.degree - 1
    count = max(4 * sum((d + 1) * (d + 2) // 2 for d in range(1, degree + 1)) // 3, 64)
    before, after = [], []
    for x in starts:
        points = short_motion(system, x, count)[0]
        flow = [system.structure_matrix(y) @ system.hamiltonian.gradient(y) for y in points]
        rest = term(points) + sign * np.sum(better.generator.gradient(points) * flow, axis=1)
        before.append(term(points) - term(points).mean())
        after.append(rest - rest.mean())
    assert better.remaining == pytest.approx(np.max(np.abs(after)) / np.max(np.abs(before)), rel=1e-6)


def heisenberg():
    ring = ExactPolynomials(co.algebras.get("A3,1"))
    x1, x2, x3 = ring.coordinates
    J = [[ring.bracket(a, b) for b in ring.coordinates] for a in ring.coordinates]
    return ring, J, (x1, x2, x3)


def test_a_hamiltonian_of_several_degrees_is_found():
    ring, J, (x1, x2, x3) = heisenberg()
    H = x2**3 + x2 * x3 + x3 + x1 * x2
    found = hamiltonian_of(ring, J, ring.field(H))
    assert ring.field(found) == ring.field(H)
    with refused(ValueError, "have the degrees"):
        hamiltonian_of(ring, [[0 * x1, x1, x2 * x2], [-x1, 0 * x1, x1], [-x2 * x2, -x1, 0 * x1]], ring.field(H))


def test_skew_factors_are_refused_where_there_are_none():
    ring = ExactPolynomials(co.algebras.so(3))
    x1, x2, x3 = ring.coordinates
    energy = (x1**2 + x2**2) / 2
    with refused(ValueError, "does not vanish where grad H does"):
        skew_factor(ring, energy, [0 * x1, 0 * x1, 1 + 0 * x1])
    with refused(ValueError, "does not keep the energy"):
        skew_factor(ring, energy, [x1, x2, 0 * x1])
    with refused(ValueError, "not quadratic"):
        skew_factor(ring, x1**3, [0 * x1, x1, 0 * x1])
    K = skew_factor(ring, energy, [x2 * x3, -x1 * x3, x1 * x2])
    slope = ring.gradient(energy)
    assert [sum((a * b for a, b in zip(row, slope, strict=True)), ring.zero) for row in K] == [
        x2 * x3,
        -x1 * x3,
        x1 * x2,
    ]


@pytest.mark.parametrize("rates", [*permutations((1, 1, 0)), *permutations((1, 2, 8))])
def test_the_change_of_the_bracket_is_the_largest_of_all_entries(rates):
    """A field (a x1, b x2, c x3) changes the entry x3 of the bracket of so(3) by (c - a - b) x3, and so on."""
    ring = ExactPolynomials(co.algebras.so(3))
    J = [[ring.bracket(a, b) for b in ring.coordinates] for a in ring.coordinates]
    field = [rate * x for rate, x in zip(rates, ring.coordinates, strict=True)]
    total = sum(rates)
    assert bracket_change(ring, J, field) == max(abs(2 * rate - total) for rate in rates)


def test_what_is_too_large_is_refused_before_it_is_made(monkeypatch):
    system = whole("so(4)")
    monkeypatch.setattr("coadjoint.program.logarithms.MAX_PRODUCTS", 10**5)
    assert co.modified_hamiltonian(system, co.Splitting(parts="coordinates"), 4).terms[2].monomials
    with refused(ValueError, "products of monomials or more,", "at most 1e+05"):
        co.modified_hamiltonian(system, co.Splitting(parts="coordinates"), 8)
