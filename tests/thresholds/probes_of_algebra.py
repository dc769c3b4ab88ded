"""Thresholds of `algebra/`."""

import math
from fractions import Fraction

import numpy as np

import coadjoint as co
from coadjoint.algebra.exact.numbers import fits, parse_number
from coadjoint.algebra.exact.numerical_kernel import _row_echelon_form
from coadjoint.algebra.exact.ranks import rank_from_gap
from coadjoint.algebra.exact.rational_constants import as_fraction
from coadjoint.algebra.families.phase_space import moments
from coadjoint.algebra.group_elements import automorphism_violation
from coadjoint.algebra.invariants.logarithmic import LogarithmicSum
from coadjoint.algebra.polynomials.formulas import parse_formula
from coadjoint.algebra.representation import invariant_form
from commuting_actions import acting
from thresholds.probing import U, accepted, limit, perturbed, probe, sides

ELEMENTS, REPRESENTATION = "algebra/group_elements.py", "algebra/representation.py"
FORMULAS, TREES = "algebra/polynomials/formulas.py", "algebra/polynomials/formula_tree.py"
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def starts_at(system, attitude, *words):
    x0 = np.ones(system.dim)
    return accepted(lambda: co.integrate(system, x0, (0, 0.1), 0.1, attitude=attitude), *words)


@probe((ELEMENTS, "TOLERANCE"), at=2.0**-26)
def an_attitude_is_a_rotation(off):
    """g^T g - 1 has the entry `off` beside the diagonal."""
    return starts_at(co.systems.rigid_body((1, 2, 3)), TURN @ perturbed(np.eye(3), (0, 1), off), "orthogonal")


@probe((ELEMENTS, "TOLERANCE"), at=2.0**-26)
def an_element_leaves_a_vector_where_it_is(off):
    """The last row of an element of SE(3) is (0, 0, 0, 1)."""
    system = co.LiePoissonSystem(co.algebras.se(3), co.Quadratic(np.arange(1.0, 7.0)))
    return starts_at(system, perturbed(np.eye(4), (3, 3), off), "vector")


@probe((ELEMENTS, "TOLERANCE"), at=2.0**-26)
def an_element_of_sl2_has_determinant_one(off):
    system = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic((1.0, 2.0, 3.0)))
    return starts_at(system, np.diag([1.0 + off, 1.0]), "determinant")


@probe((ELEMENTS, "TOLERANCE"), at=2.0**-26)
def a_coadjoint_matrix_keeps_the_brackets(off):
    """Of the largest entry of |J(x)|; K stretches the axis of the largest x_k, which J(K x) has times 1 + off."""
    x = np.abs(np.random.default_rng(0).standard_normal(3))
    K = np.eye(3)
    K[np.argmax(x), np.argmax(x)] += off
    return automorphism_violation(K[None], co.algebras.so(3).structure_matrix) is None


@probe(("algebra/exact/sparse_sums.py", "DEFECT_FACTOR"), at=64 * U)
def the_jacobi_identity_holds(off):
    """Two matrices that act on a plane commute up to a difference of two products of one size."""
    r = math.pi
    first, second = np.array([[0.0, r], [r, 0.0]]), np.array([[0.0, r], [r * (1.0 + 2.0 * off), 0.0]])
    return accepted(lambda: acting(first, second), "Jacobi")


@limit(("algebra/invariants/logarithmic.py", "MAX_PERIOD_DENOMINATOR"), at=1000)
def two_angles_have_a_common_period(denominator):
    x, y = co.Polynomial.variable(0, 2), co.Polynomial.variable(1, 2)
    angle = LogarithmicSum.angle(y, x)
    period = (angle + angle * Fraction(1, denominator)).period
    assert period is None or math.isclose(period, 2 * math.pi / denominator)
    return period is not None


@limit(("algebra/families/matrix_algebra.py", "MAX_MATRIX_SIZE"), at=4096)
def a_matrix_algebra_is_not_too_large(N):
    return accepted(lambda: co.MatrixAlgebra("su", N), "4096")


@probe(("algebra/families/matrix_algebra.py", "MEMBERSHIP_TOLERANCE"), at=64 * U)
def a_matrix_is_in_its_algebra(off):
    """Times N = 4; the nearest skew matrix takes half of what one entry is off."""
    W = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -1, 0]])
    return accepted(lambda: co.MatrixAlgebra("so", 4).read(perturbed(W, (0, 2), 8 * off), "W"), "differs by")


@probe(("algebra/families/matrix_algebra.py", "TRACE_TOLERANCE"), at=8 * U)
def a_mean_of_the_diagonal_is_left(mean):
    W = 1j * (np.diag([1.0, -1.0]) + mean * np.eye(2)) / 2.0
    return bool(np.trace(co.MatrixAlgebra("su", 2).read(W, "W")))


@probe(
    ("algebra/exact/ranks.py", "MIN_RANK_GAP"),
    ("algebra/exact/ranks.py", "singular[rank - 1] < MIN_RANK_GAP * roundoff"),
    at=2.0**10,
)
def a_singular_value_is_not_clear(ratio):
    return not accepted(lambda: rank_from_gap(np.array([1.0, ratio * 1e-15]), 1e-15, "J(x)"), "rank")


@probe(("algebra/exact/ranks.py", "singular > roundoff"), at=1.0)
def a_singular_value_is_zero(ratio):
    """Of the round-off; above, it is refused."""
    found = []
    return accepted(lambda: found.append(rank_from_gap(np.array([1.0, ratio * 1e-15]), 1e-15, "J(x)"))) and found == [1]


@probe(("algebra/exact/numerical_kernel.py", "MIN_PIVOT"), at=2.0**-20)
def a_leading_coefficient_is_not_clear(size):
    return not accepted(lambda: _row_echelon_form(np.array([[size, np.sqrt(1.0 - size**2)]]), 1e-14), "leading")


@limit(("algebra/families/phase_space.py", "MAX_DETERMINANT_DEGREE"), at=10)
def the_catalecticant_is_known(degree):
    return "catalecticant" in moments(degree + degree % 2).casimirs_known


@limit(("algebra/families/phase_space.py", "max(i, j) < 10"), at=9)
def moments_have_names_of_two_digits(degree):
    from coadjoint.algebra.families.phase_space import moment_name

    return "," not in moment_name(degree, 0)


@limit(("algebra/families/phase_space.py", "MAX_MOMENT_DEGREE"), at=100)
def a_degree_of_moments_is_in_range(degree):
    """An odd degree in range is refused for another reason."""
    try:
        moments(degree - 1 + 2 * (degree % 2) if degree == 100 else degree)
    except ValueError as refusal:
        return "must be even" in str(refusal)
    raise AssertionError("an odd degree is accepted")


@limit(("algebra/polynomials/polynomial.py", "MAX_DEGREE"), at=1024)
def a_degree_is_not_too_high(degree):
    x = co.Polynomial.variable(0, 1)
    by_power, by_mapping = (
        accepted(call, "1024") for call in (lambda: x**degree, lambda: co.Polynomial({(degree,): 1}))
    )
    assert by_power == by_mapping
    return by_mapping


@limit((TREES, "MAX_CHARACTERS"), at=250_000)
def a_formula_is_not_too_long(letters):
    text = "(x1)" + " " * (letters - 4)
    return accepted(lambda: parse_formula(text, {}, 2), "letters")


@limit((TREES, "MAX_NESTING"), at=60)
def brackets_are_not_nested_too_deeply(depth):
    return accepted(lambda: parse_formula("(" * depth + "x1" + ")" * depth, {}, 2), "nested")


@limit((TREES, "MAX_OPERATIONS"), at=1000)
def a_term_has_not_too_many_operations(count):
    return accepted(lambda: parse_formula("2/2" + "*1" * (count - 1), {}, 2), "operations")


@probe((FORMULAS, "MAX_WORK"), at=2.0**24)
def a_formula_has_not_too_many_products(work):
    """Powers of sums of four terms in eight coordinates: the last product squares the 286 terms of the tenth power."""
    text = "+".join(["(x1+x2+x3+1)**20"] * round(work / (286**2 * 16)))
    return accepted(lambda: parse_formula(text, {}, 8), "products")


@sides((FORMULAS, "MAX_TERMS"), below=(99, 99), above=(101, 101))
def a_product_has_not_too_many_terms(counts):
    """Powers up to 100 of x1, times powers up to 100 of x2: 10 000 terms."""
    factors = ("(" + "+".join(f"x{k + 1}**{n}" for n in range(1, count + 1)) + ")" for k, count in enumerate(counts))
    return accepted(lambda: parse_formula("*".join(factors), {}, 2), "terms")


@limit(("algebra/exact/numbers.py", "MAX_DIGITS"), at=400)
def a_written_number_has_not_too_many_digits(digits):
    """Leading zeros leave the number small."""
    return accepted(lambda: parse_number("1".zfill(digits)), "digits")


@limit(("algebra/exact/numbers.py", "value.denominator.bit_length() > 4096"), at=4096)
def a_fraction_is_not_too_long(bits):
    return fits(Fraction(1, 2 ** (bits - 1)))


@limit(("algebra/exact/rational_constants.py", "MAX_DENOMINATOR"), at=10**6)
def a_float_is_a_simple_fraction(denominator):
    return as_fraction(1 / denominator) is not None


@probe(("algebra/exact/rational_constants.py", "MAX_FRACTION_PRODUCT"), at=2.0**45)
def a_fraction_is_believed(size):
    """An odd numerator over 2^16."""
    return as_fraction((size / 2.0**16 + 1) / 2.0**16) is not None


@probe(
    (REPRESENTATION, "DEFECT_FACTOR * UNIT_ROUNDOFF * m * d * max(float(singular.max(initial=0.0)), UNIT_ROUNDOFF)"),
    at=64 * U * 4,
)
def a_generator_keeps_a_form(off):
    """diag(1, -1 + s) keeps P where (-1 + 1 + s) P_12 = 0: singular values 2, 2, s, s of the equations for P."""
    return invariant_form([np.diag([1.0, -1.0 + 2.0 * off])]) is not None
