"""Modified fields and Hamiltonians: rates of invariants against steps, sample points, signs, directions and shapes."""

from __future__ import annotations

from fractions import Fraction
from itertools import permutations

import numpy as np
import pytest
from fields_under_test import along, whole

import coadjoint as co
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.analysis.backward_error.corrector import Corrector
from coadjoint.analysis.backward_error.polynomial_fields import bracket_change, hamiltonian_of, skew_factor
from coadjoint.analysis.backward_error.scheme_terms import names_of
from coadjoint.analysis.short_motion import short_motion
from coadjoint.systems.user_functions import sample_points

SYSTEMS = {
    "so(3) +": lambda: whole("so(3)", 1, linear=True),
    "so(3) -": lambda: whole("so(3)", -1, linear=True),
    "A3,7 -": lambda: whole("A3,7", -1),
}


RUNGE, FROZEN = co.ExplicitRungeKutta("runge2"), co.ModifiedGaussLegendre(1, freeze="gradient")


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    ("name", "scheme"),
    [("so(3) +", RUNGE), ("so(3) -", FROZEN), ("A3,7 -", RUNGE), ("A3,7 -", FROZEN)],
)
def test_rates_of_change_are_those_of_steps(name, scheme):
    """A step changes F by h^(k + 1) r_k first; the mean over h and -h leaves out the next term."""
    system = SYSTEMS[name]()
    found = co.modified_field(system, scheme, 4)
    x = np.array([0.5, -0.75, 0.625])
    own = co.Polynomial({(1, 1, 0): 1, (0, 0, 3): Fraction(-1, 2), (1, 0, 0): Fraction(1, 4)})
    for given, value in (("energy", system.energy), (own, own)):
        rates = found.rate(given)
        first = min(rates)
        assert found.keeps(given) == first and all(F.monomials for F in rates.values())
        means = []
        for h in (0.02, 0.01):
            changes = [(value(co.stepper(system, scheme, s)(x)) - value(x)) / s ** (first + 1) for s in (h, -h)]
            means.append(sum(changes) / 2)
        error = [abs(mean - rates[first](x)) for mean in means]
        # What is left is of the size h^2, above rounding of 1e-16 / h^(k + 1).
        assert error[1] < 0.3 * error[0] + 1e-9 and error[0] < 0.05 * abs(rates[first](x))
    assert first == 0
    for k, term in found.terms.items():
        assert found.rate(own).get(k, co.Polynomial({}, dim=3)) == along(term, own)


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
    with pytest.raises(ValueError, match=r"does not keep the energy .* at h\^1"):
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


@pytest.mark.thinned(2)
@pytest.mark.parametrize("way", ["exact", "numerical"])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_matrix_at_points_is_skew_and_gives_the_field(sign, way):
    """The exact flow of a quartic energy over h + h^3 - 2 h^4 keeps it: f_2 = f and f_3 = -2 f."""
    H = co.Polynomial({(0, 4, 0): 0.25, (0, 1, 0): 1.0, (0, 2, 0): 0.5, (2, 0, 0): 0.125})
    system = co.LiePoissonSystem(co.algebras.get("A3,1"), H, sign=sign)

    def step(x, h):  # x1 and x2 are constant
        return x + (h + h**3 - 2 * h**4) * system.vector_field(x)

    found = co.modified_field(system, step, 4, way=way)
    assert found.exact == (way == "exact") and found.first_error == 2 and found.keeps("energy") is None
    states = np.array([[0.5, -0.75, 1.0], [1.0, 0.25, -0.5]])
    gradients = [system.hamiltonian.gradient(x) for x in states]
    motion = np.array([system.vector_field(x) for x in states])
    J = np.array([system.structure_matrix(x) for x in states])
    for h in (0.125, -0.25, 0.0):
        K = found.skew_matrix(states, h)
        assert K.shape == (2, 3, 3) and np.array_equal(K, -np.swapaxes(K, 1, 2))
        product = sign * np.einsum("mij,mj->mi", K, gradients)
        np.testing.assert_allclose(product, (1.0 + h**2 - 2 * h**3) * motion, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(found(states, h), product, rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(found.skew_matrix(states[1], h), K[1])
        # Twice the change of the field: of it and its mirror image.
        excess = np.linalg.norm(K - J, axis=(1, 2))
        expected = abs(h**2 - 2 * h**3) * np.linalg.norm(motion, axis=1) / np.linalg.norm(gradients, axis=1)
        np.testing.assert_allclose(excess, np.sqrt(2.0) * expected, rtol=1e-9, atol=1e-14)
    level = co.LiePoissonSystem(co.algebras.get("A3,1"), co.Polynomial({(0, 4, 0): 0.25}), sign=sign)
    flat = co.modified_field(level, lambda x, h: x + h * level.vector_field(x), 2, way=way)
    with pytest.raises(ValueError, match=r"gradient of H is zero at \[1.0, 0.0, 2.0\]"):
        flat.skew_matrix([[1.0, 1.0, 1.0], [1.0, 0.0, 2.0]], 0.1)


def test_a_derivation_is_poisson_and_not_hamiltonian():
    """On the Heisenberg algebra (2 x1, x2, x3) respects the bracket, and moves the Casimir x1."""
    system = co.LiePoissonSystem(co.algebras.get("A3,1"), co.Quadratic([0.0, 1.0, 0.0]))

    def step(x, h):
        y = x + h * system.vector_field(x)  # the exact flow, since x1 and x2 are constant
        growth = 1 + h * h + h**4 / 2
        return np.array([growth * growth * y[0], growth * y[1], growth * y[2]])

    found = co.modified_field(system, step, 3)
    assert found.exact and not found.poisson_defects and found.first_error == 1
    with pytest.raises(ValueError, match=r"is not Hamiltonian: at h\^1 it moves x1, with a coefficient of 2"):
        found.hamiltonians  # noqa: B018
    uneven = co.modified_field(system, lambda x, h: step(x, h) + h * h * np.array([x[0], 0 * x[0], 0 * x[0]]), 3)
    assert uneven.poisson_defects[1] == 1.0
    with pytest.raises(ValueError, match=r"not a Poisson map .* at h\^1"):
        uneven.hamiltonians  # noqa: B018


# Modified Hamiltonians as text, as expressions, and at points


@pytest.mark.parametrize("order", [1, 2])
def test_all_forms_of_a_modified_hamiltonian_have_one_value(order):
    sympy = pytest.importorskip("sympy")
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), sign=-1)
    method = co.Splitting(order=order, parts="coordinates")
    found = co.modified_hamiltonian(system, method, 4)
    symbolic = co.modified_hamiltonian(system, method, 4, symbols=True)
    assert set(found.terms) == ({0, 1, 2, 3} if order == 1 else {0, 2})
    x, h = [0.5, -2.0, 1.5], -0.25
    expected = sum(h**k * term(x) for k, term in found.terms.items())
    assert found(x, h) == pytest.approx(expected, rel=1e-14)
    places = {sympy.Symbol(f"x{i + 1}"): v for i, v in enumerate(x)} | {sympy.Symbol("h"): h}
    assert float(found.to_sympy().subs(places)) == pytest.approx(expected, rel=1e-14)
    values = {sympy.Symbol(name): float(value) for name, value in symbolic.values.items()}
    assert float(symbolic.to_sympy().subs({**places, **values})) == pytest.approx(expected, rel=1e-14)
    from sympy.parsing.sympy_parser import parse_expr

    text = parse_expr(repr(found).replace("^", "**"))
    assert float(text.subs(places)) == pytest.approx(expected, rel=1e-5)  # readable numbers have six digits
    powers = [k for k in found.terms if k]
    for written in (found.to_latex(), found._repr_latex_(), symbolic.to_latex()):
        assert [k for k in range(1, 4) if f"h^{{{k}}}" in written or (k == 1 and r"h\," in written)] == powers


@pytest.mark.parametrize("sign", [1, -1])
def test_values_at_points_have_the_shape_of_the_states_and_the_sign_of_the_step(sign):
    """A polynomial, and the same as functions: backward too, where odd terms change their sign."""
    algebra = co.algebras.A3_7(1.5)
    square = (lambda y: 0.5 * y * y, lambda y: y, lambda y: 1.0 + 0.0 * y)
    functions = co.LiePoissonSystem(algebra, co.Separable(dict.fromkeys(range(3), square)), sign=sign)
    plain = co.LiePoissonSystem(algebra, co.Polynomial({(2, 0, 0): 0.5, (0, 2, 0): 0.5, (0, 0, 2): 0.5}), sign=sign)
    method = co.Splitting(order=1, parts="coordinates")
    found, expected = (co.modified_hamiltonian(system, method, 3) for system in (functions, plain))
    x = np.random.default_rng(2).uniform(-1.0, 1.0, (2, 2, 3))
    for h in (0.5, -0.5):
        np.testing.assert_allclose(found(x, h), expected(x, h), rtol=1e-9)
        assert found(x[1, 0], h) == pytest.approx(found(x, h)[1, 0], rel=1e-14)
    assert np.max(np.abs(found(x, 0.5) - found(x, -0.5))) > 1e-3
    assert found(np.zeros((0, 3)), 0.5).shape == (0,)


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


# Correctors


def remaining_of(system, generator, term, starts, count):
    """Changes of H_p + sign {G, H} against those of H_p, each motion about its own mean."""
    before, after = [], []
    for x in starts:
        points = short_motion(system, np.asarray(x, dtype=float), count)[0]
        bracket = [
            np.dot(g, system.structure_matrix(y) @ system.hamiltonian.gradient(y))
            for y, g in zip(points, generator.gradient(points), strict=True)
        ]
        values = term(points)
        before.append(values - values.mean())
        rest = values + system.sign * np.array(bracket)
        after.append(rest - rest.mean())
    return np.max(np.abs(np.concatenate(after))) / np.max(np.abs(np.concatenate(before)))


@pytest.mark.thinned(4)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("order", [2, 4])
def test_what_a_corrector_leaves_is_measured_along_all_motions(sign, order):
    """Among motions of which one is twenty times as fast; in any order they make one corrector."""
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.3], linear=[0.1, 0.0, 0.2]), sign=sign)
    method = co.Splitting(order=order)
    starts = np.array([[1.0, 0.2, 0.5], [0.1, -0.3, 0.2], [2.0, 4.0, -3.0]])
    term = co.modified_hamiltonian(system, method, order).error_term.term
    found: list[Corrector] = []
    for places in ([0, 1, 2], [2, 0, 1], [1, 2, 0]):
        better = co.corrector(system, method, starts[places])
        degree = term.degree - 2 + 1
        monomials = sum((d + 1) * (d + 2) // 2 for d in range(1, degree + 1))
        count = max(4 * monomials // 3, 64)
        expected = remaining_of(system, better.generator, term, starts[places], count)
        # Sums of products of a thousand terms, in another order.
        assert better.remaining == pytest.approx(expected, rel=1e-6) and better.order == order
        found.append(better)
    x = starts[1]
    moved = [better(x, 0.1) - x for better in found]
    size = np.max(np.abs(moved[0]))
    assert size > 1e-11
    # Directions of the fit that hardly change the energy are found to some digits only.
    assert np.max(np.abs(np.array(moved) - moved[0])) < 1e-3 * size
    assert found[1].remaining == pytest.approx(found[0].remaining, rel=1e-3)


def heisenberg():
    ring = ExactPolynomials(co.algebras.get("A3,1"))
    x1, x2, x3 = ring.coordinates
    J = [[ring.bracket(a, b) for b in ring.coordinates] for a in ring.coordinates]
    return ring, J, (x1, x2, x3)


def test_a_derivation_is_poisson_without_a_hamiltonian() -> None:
    ring, J, (x1, x2, x3) = heisenberg()
    scaling = [2 * x1, x2, x3]  # [e2, e3] = e1 scales with it, and so does the Casimir x1
    assert bracket_change(ring, J, scaling) == 0.0
    assert hamiltonian_of(ring, J, scaling) is None
    assert bracket_change(ring, J, [x1, x2, x3]) == 1.0
    turned = [0 * x1, x3, x2]
    assert bracket_change(ring, J, turned) == 0.0 and hamiltonian_of(ring, J, turned) is None


def test_a_hamiltonian_of_several_degrees_is_found() -> None:
    ring, J, (x1, x2, x3) = heisenberg()
    H = x2**3 + x2 * x3 + x3 + x1 * x2
    found = hamiltonian_of(ring, J, ring.field(H))
    assert ring.field(found) == ring.field(H)
    with pytest.raises(ValueError, match="have the degrees"):
        hamiltonian_of(ring, [[0 * x1, x1, x2 * x2], [-x1, 0 * x1, x1], [-x2 * x2, -x1, 0 * x1]], ring.field(H))


def test_skew_factors_are_refused_where_there_are_none() -> None:
    ring = ExactPolynomials(co.algebras.so(3))
    x1, x2, x3 = ring.coordinates
    energy = (x1**2 + x2**2) / 2
    with pytest.raises(ValueError, match="does not vanish where grad H does"):
        skew_factor(ring, energy, [0 * x1, 0 * x1, 1 + 0 * x1])
    with pytest.raises(ValueError, match="does not keep the energy"):
        skew_factor(ring, energy, [x1, x2, 0 * x1])
    with pytest.raises(ValueError, match="not quadratic"):
        skew_factor(ring, x1**3, [0 * x1, x1, 0 * x1])
    K = skew_factor(ring, energy, [x2 * x3, -x1 * x3, x1 * x2])
    slope = ring.gradient(energy)
    assert [sum((a * b for a, b in zip(row, slope, strict=True)), ring.zero) for row in K] == [
        x2 * x3,
        -x1 * x3,
        x1 * x2,
    ]


@pytest.mark.parametrize("rates", [*permutations((1, 1, 0)), *permutations((1, 2, 8))])
def test_the_change_of_the_bracket_is_the_largest_of_all_entries(rates) -> None:
    """A field (a x1, b x2, c x3) changes the entry x3 of the bracket of so(3) by (c - a - b) x3, and so on."""
    ring = ExactPolynomials(co.algebras.so(3))
    J = [[ring.bracket(a, b) for b in ring.coordinates] for a in ring.coordinates]
    field = [rate * x for rate, x in zip(rates, ring.coordinates, strict=True)]
    total = sum(rates)
    assert bracket_change(ring, J, field) == max(abs(2 * rate - total) for rate in rates)
