"""The reader of formulas, sums with logarithms, and exact elimination."""

import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import coadjoint as co
from coadjoint.algebra.exact.elimination import Span
from coadjoint.algebra.invariants.logarithmic import LogarithmicSum
from coadjoint.algebra.polynomials.formulas import NotPolynomial, condition_holds, parse_formula, parse_polynomial
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
        ("x1+" * 200_000 + "x1", "has 600002 letters; a formula has at most 250000"),
        ("x1*" * 1001 + "x1", "has more than 1000 operations in one term"),
        ("(" + "x1+" * 1001 + "x1)", "has more than 1000 operations in one term"),
        ("2" + "**2" * 61, "nested too deeply"),
        ("+".join(["(x1 + x2 + x3 + 1)**20"] * 40), "has more than 1525201 products when it is multiplied out"),
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


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("(x1+x2)^2/2", "1/2*x1^2 + x1*x2 + 1/2*x2^2"),
        ("0.5*x1^2*(1+x2)", "0.5*x1^2 + 0.5*x1^2*x2"),
        ("-x1*-2", "2*x1"),
        ("-x1^2", "-1*x1^2"),
        ("(-x1)^2", "x1^2"),
        ("x1^2^2", "x1^4"),
        ("2^-1*x1**2.0", "1/2*x1^2"),
        ("x1/2^2", "1/4*x1"),
        ("((1))", "1"),
        ("a*(x1 - b)^2", "1/3*x1^2 - 1/3*x1 + 1/12"),
        ("lambda*x1 + is*x2", "0.1*x1 + 7*x2"),
        ("--+x1 - (x2 - -x3)", "x1 - x2 - x3"),
        ("0.1*3*x1", f"{0.1 * 3}*x1"),
    ],
)
def test_brackets_powers_and_parameters(text, same):
    parameters = {"a": Fraction(1, 3), "b": Fraction(1, 2), "lambda": 0.1, "is": 7}
    assert parse_polynomial(text, 3, None, parameters).monomials == parse_polynomial(same, 3).monomials


def test_functions_of_numbers_are_rounded_once():
    found = parse_polynomial("sqrt(2)*x1 + exp(-1)*x2 + cos(pi/3)*x3 + 2^0.5", 3).monomials
    with mpmath.workdps(60):
        wanted = [mpmath.sqrt(2), mpmath.exp(-1), mpmath.cos(mpmath.mpf(math.pi / 3)), mpmath.sqrt(2)]
    assert [found[e] for e in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0))] == [float(value) for value in wanted]
    assert parse_polynomial("sin(1e22)*x1", 1).monomials[(1,)] == -0.8522008497671888  # W. Kahan's test value
    assert parse_polynomial("0.3^5*x1", 1).monomials[(1,)] == float(Fraction(0.3) ** 5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x²", "has 'x²', which is not a known name"),
        ("x1/", "cannot be parsed from 'its end' on"),
        ("1/2/", "cannot be parsed from 'its end' on"),
        ("(x1", "cannot be parsed from 'its end' on"),
        ("x1)", r"cannot be parsed from '\)' on"),
        ("2(x1)", r"cannot be parsed from '\(x1\)' on"),
        ("x1(2)", "has the function 'x1'"),
        ("x1, x2", "cannot be parsed from ', x2' on"),
        ("(x1, x2)", "cannot be parsed from"),
        ("x1 < x2", "cannot be parsed from '< x2' on"),
        ("x1 and x2", "cannot be parsed from 'and x2' on"),
        ("cos", "has 'cos', which is not a known name"),
        ("cos()", "cannot be parsed from"),
        ("cos(1, 2)*x1", "has cos of 2 arguments; it takes one"),
        ("c*x1", "has 'c', which is not a known name"),
        ("1j*x1", "cannot be parsed from 'j"),
        ("0x10", "cannot be parsed from 'x10' on"),
        ("1_000*x1", "cannot be parsed from '_000"),
        ("x1 if x2 else x3", "cannot be parsed from"),
        ("[x1][0]", "cannot be parsed from"),
        ("x1[0]", "not a known name"),
        ("lambda: x1", "cannot be parsed from ': x1' on|'lambda', which is not"),
        ("x1\n.real", "cannot be parsed from '.real' on"),
        ("_0", "has '_0', which is not a known name"),
        ("sqrt(-1)*x1", "has sqrt of a number for which it is not a finite number"),
        ("log(0)*x1", "has log of a number for which it is not a finite number"),
        ("exp(1000)*x1", "has exp of a number for which it is not a finite number"),
        ("(0.0)^-1*x1", "divides by zero"),
        ("x1/(1 - 1)", "divides by zero"),
    ],
)
def test_formulas_that_are_refused(text, said):
    with pytest.raises(ValueError, match=said) as refused:
        parse_polynomial(text, 3)
    assert not isinstance(refused.value, NotPolynomial)
    assert len(str(refused.value)) < 300 and "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ["x1^x2", "x1^-1", "x1^0.5", "x1/x2", "log(x1)", "cos(x1 + 1)*x2", "2^x1"])
def test_formulas_that_are_no_polynomials(text):
    with pytest.raises(NotPolynomial):
        parse_polynomial(text, 3)
    assert isinstance(co.formula(text, 3), co.Hamiltonian)


def test_leading_zeros_and_long_numbers():
    assert parse_polynomial("007*x1 + " + "0" * 300 + "1", 1) == co.Polynomial({(1,): 7, (0,): 1})


def test_names_with_brackets_and_names_of_parameters():
    p = parse_polynomial("2*S1[7]^2 - J", 2, ("S1[7]", "S2[7]"), {"J": 3})
    assert p.monomials == {(0, 0): -3, (2, 0): 2}
    for parameters in ({"x2": 1.0}, {"S1[7]": 1.0}, {"a b": 1.0}, {"": 1.0}):
        with pytest.raises(ValueError, match="parameter"):
            parse_polynomial("S1[7]", 2, ("S1[7]", "S2[7]"), parameters)


def test_what_is_subtracted_is_written_with_a_minus():
    formula = parse_formula("-log(x1)/2 - x2/x3 - a*atan2(x2, x1)", *NAMES)
    assert str(formula).startswith("-1/2 log|x1| - (x2)/(x3) - ")
    assert "+ -" not in str(formula)
