"""The reader of formulas, sums with logarithms, and exact elimination."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import coadjoint as co
from coadjoint.algebra.exact.elimination import Span
from coadjoint.algebra.invariants.logarithmic import LogarithmicSum
from coadjoint.algebra.polynomials.formulas import condition_holds, parse_formula, parse_polynomial
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.quadratic_forms import embedded, linear, quadratic, substituted

X = {f"x{i + 1}": Polynomial.variable(i, 3) for i in range(3)}
PARAMETERS = {"a": Fraction(1, 2)}
NAMES = PARAMETERS, 3


def test_formulas():
    assert parse_formula("-(2 + a)*3/5", *NAMES) == Fraction(-3, 2)
    assert parse_formula("x1**2 - 2*x1*x3/4", *NAMES) == Polynomial({(2, 0, 0): 1, (1, 0, 1): Fraction(-1, 2)})
    summed = parse_formula("1 - log(x1)/2 + a*atan2(x2, x1 + 1) - x3/x1 + 2", *NAMES)
    x = np.array([2.0, 3.0, 5.0])
    assert summed.invariant()(x) == pytest.approx(3 - math.log(2) / 2 + math.atan2(3, 3) / 2 - 2.5, rel=2.0**-50)
    assert summed.period == math.pi
    assert parse_formula("0*log(x1)", *NAMES).terms == ()
    assert parse_formula("+".join(["1"] * 4000), *NAMES) == 4000
    assert parse_formula("-2**2 + 2**3**2 - (-x1)**2*(x1 - 2)/-4", *NAMES) == Polynomial(
        {(0, 0, 0): 508, (3, 0, 0): Fraction(1, 4), (2, 0, 0): Fraction(-1, 2)}
    )


TEXTS = (
    "x4; x1**-1; x1**a; log(2); log(x1, x2); sin(x1); log(x1)*x2; log(x1)*log(x2); 2/x1; log(x1)/x1; 1.5*x1; 'a'; True;"
    " x1 if a else x2; __import__('os'); x1.dim; x1[0]; x1 +; log(p=x1); 1 < 2; 2**log(x1)"
).split("; ")


@pytest.mark.parametrize("text", TEXTS)
def test_anything_else_is_refused(text):
    with pytest.raises(ValueError):
        parse_formula(text, *NAMES)


def test_conditions():
    assert condition_holds("a != 0 and -1 < a <= 1/2", PARAMETERS) and not condition_holds(
        "a == 0 or a > 1/2", PARAMETERS
    )
    assert condition_holds("a == 0 and a > 1 or a*4 >= 2 and a != -1/2", PARAMETERS)
    assert condition_holds("a == 0 or a < 1", PARAMETERS) and not condition_holds("0 < a < 1/4", PARAMETERS)
    for text in ("a", "not a", "a in (1, 2)", "a is 1"):
        with pytest.raises(ValueError, match="comparisons"):
            condition_holds(text, PARAMETERS)


def test_periods():
    one, two = LogarithmicSum.angle(X["x1"], X["x2"]), LogarithmicSum.angle(X["x2"], X["x3"])
    assert (one * 3).period == 6 * math.pi
    assert (one + two * Fraction(2, 3)).period == 2 * math.pi * (1 / 3)
    assert (one * 4 + two * 6).period == 4 * math.pi
    assert (one * -1.5 + two * 0.0).period == 3 * math.pi
    irrational = one + two * math.sqrt(2)
    assert irrational.period is None
    with pytest.raises(ValueError, match="no common period"):
        irrational.invariant()


@pytest.mark.parametrize("sine", [-2.0, 0.0, 2.0])
@pytest.mark.parametrize("cosine", [-3.0, 0.0, 3.0])
def test_angles_on_the_axes(sine, cosine):
    """In Python and in compiled loops; both zero, there is no angle."""
    angle = LogarithmicSum.angle(X["x1"], X["x2"]).invariant()
    wanted = math.atan2(sine, cosine) if sine or cosine else math.nan
    point = np.array([sine, cosine, 1.0])
    np.testing.assert_equal(angle(point), wanted)
    still = co.LiePoissonSystem(co.LieAlgebra.from_brackets(3, {}), co.Quadratic(1.0), casimirs={"angle": angle})
    np.testing.assert_equal(co.integrate(still, point, (0.0, 1.0), 0.5).casimirs["angle"], [wanted] * 3)


def test_gradients_take_any_number():
    formula = parse_formula("log(x1*x2) - a*atan2(x1, x3) + x2/x3", *NAMES)
    x = np.array([Fraction(1), Fraction(2), Fraction(3)])
    slope = formula.gradient(x)
    assert slope.tolist() == [1 - Fraction(3, 20), Fraction(1, 2) + Fraction(1, 3), Fraction(1, 20) - Fraction(2, 9)]
    assert formula.gradient(x.astype(float)).dtype == np.float64
    assert np.abs(formula.gradient(x.astype(float)) - slope.astype(float)).max() < 2.0**-48
    with pytest.raises(ZeroDivisionError):
        formula.gradient(x * 0)


SMALL = st.fractions(-3, 3, max_denominator=3)


@pytest.mark.long
@given(
    st.lists(st.lists(SMALL, min_size=4, max_size=4), min_size=1, max_size=4),
    st.lists(SMALL, min_size=4, max_size=4),
)
def test_combinations_add_up(rows, weights):
    vectors = [{i: v for i, v in enumerate(row) if v} for row in rows]
    try:
        span = Span(vectors)
    except ValueError as error:
        number = int(str(error).split()[1])
        assert Span(vectors[:number]).combination(vectors[number]) is not None
        return
    target = {i: v for i in range(4) if (v := sum(w * row[i] for w, row in zip(weights, rows, strict=False)))}
    found = span.combination(target)
    assert found == {i: w for i, w in enumerate(weights[: len(rows)]) if w}
    assert len(span.pivots) == len(rows) and not span.remainder(target)
    loose = {i: Fraction(i + 1) for i in range(4)}
    rest = span.remainder(loose)
    assert not set(rest) & span.pivots
    assert (span.combination(loose) is None) == bool(rest)


def test_polynomials_in_other_coordinates():
    p = quadratic([(0, 1, 1), (1, 0, 2), (2, 2, Fraction(1, 2))], 3) + 5 * linear({1: 1}, 3) + 7
    rows = [{0: 1, 1: 2}, {1: Fraction(1, 3)}, {}]
    x = np.array([Fraction(2), Fraction(5)])
    assert substituted(p, rows, 2)(x) == p(np.array([x[0] + 2 * x[1], x[1] / 3, Fraction(0)]))
    y = np.array([Fraction(k) for k in range(5)])
    assert embedded(p, 1, 5)(y) == p(y[1:4])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x1**4000000000", "has the degree 4000000000; there are degrees up to 1024"),
        ("x1**n", "has the degree 4000000000; there are degrees up to 1024"),
        ("(x1*x2)**513", "has the degree 1026"),
        ("x1**600*x2**600", "has the degree 1200"),
        ("(x1 + x2 + x3 + 1)**1000", "terms when it is multiplied out"),
        ("(x1 + x2)**100*(x2 + x3)**100", "has about 10201 terms when it is multiplied out"),
        ("2**4000000000", "is too large for float64"),
        ("2**1024", "is too large for float64"),
        ("(2**1000)**1000", "is too large for float64"),
        ("a**5000", "is too large for float64"),
        ("10**300*10**300", "is too large for float64"),
        ("10**308 + 10**308*9", "is too large for float64"),
        ("2**-1", "powers are whole numbers from 0 up"),
        ("1/(a - a)", "divides by zero"),
        ("x1/0", "divides by zero"),
        ("9" * 5000, "a number of 5000 digits is too large"),
        ("-" * 5000 + "1", "nested too deeply"),
        ("(" * 4900 + "1" + ")" * 4900, "nested too deeply"),
        ("1+" * 10000 + "1", "has 20001 letters; a formula has at most 10000"),
        ("x1\0", r"cannot be parsed from .* on"),
    ],
)
def test_what_no_machine_can_hold_is_refused(text, said):
    with pytest.raises(ValueError, match=said) as refused:
        parse_formula(text, {**PARAMETERS, "n": 4000000000}, 3)
    assert len(str(refused.value)) < 300


def test_conditions_are_bounded_too():
    for text in ("2**4000000000 > a", "-" * 5000 + "1 > a", "1/(a - a) > 1"):
        with pytest.raises(ValueError, match=r"too large|nested|divides"):
            condition_holds(text, PARAMETERS)


def test_powers_below_the_bounds():
    assert parse_formula("x1**1024", *NAMES).degree == 1024
    assert parse_formula("(x1 + x2)**60", *NAMES).monomials[(30, 30, 0)] == math.comb(60, 30)
    assert parse_formula("2**1023", *NAMES) == 2**1023 and parse_formula("x1**0 - 1", *NAMES).monomials == {}
    assert parse_formula("(-1)**1001*a**10", *NAMES) == -Fraction(1, 1024)


@pytest.mark.parametrize("text", ["x²", "x1^x2", "2**3*x1", "-x1*-2", "a*x1", "log(x1)", "x1/", "1/2/", "2^2", "((1))"])
def test_polynomials_that_are_not_multiplied_out(text):
    with pytest.raises(ValueError, match=r"^'.*' cannot be parsed from '.*' on; write sums of products such as"):
        parse_polynomial(text, 3)


def test_what_is_subtracted_is_written_with_a_minus():
    formula = parse_formula("-log(x1)/2 - x2/x3 - a*atan2(x2, x1)", *NAMES)
    assert str(formula).startswith("-1/2 log|x1| - (x2)/(x3) - ")
    assert "+ -" not in str(formula)
