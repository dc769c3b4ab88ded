"""Formulas in exact numbers, their conditions and periods, and polynomials as text with rounded numbers."""

import math
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.invariants.invariant import LogarithmicSum
from coadjoint.algebra.polynomials.formulas import condition_holds, parse_formula
from coadjoint.algebra.polynomials.monomials import latex, plain, readable, readable_latex, rounded_if_long
from refusals import refused

pytestmark = pytest.mark.thinned(1)

Polynomial = co.Polynomial
X = {f"x{i + 1}": Polynomial.variable(i, 3) for i in range(3)}
PARAMETERS = {"a": Fraction(1, 2)}
NAMES = PARAMETERS, 3


def test_formulas():
    assert parse_formula("-(2 + a)*3/5", *NAMES) == Polynomial({(0, 0, 0): Fraction(-3, 2)})
    assert parse_formula("x1**2 - 2*x1*x3/4", *NAMES) == Polynomial({(2, 0, 0): 1, (1, 0, 1): Fraction(-1, 2)})
    summed = parse_formula("1 - log(x1)/2 + a*atan2(x2, x1 + 1) - x3/x1 + 2", *NAMES)
    x = np.array([2.0, 3.0, 5.0])
    assert summed.invariant()(x) == pytest.approx(3 - math.log(2) / 2 + math.atan2(3, 3) / 2 - 2.5, rel=2.0**-50)
    assert summed.period == math.pi
    assert parse_formula("0*log(x1)", *NAMES).terms == ()
    assert parse_formula("+".join(["1"] * 4000), *NAMES) == Polynomial({(0, 0, 0): 4000})
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
    with refused(ValueError, "period"):
        irrational.invariant()


@pytest.mark.parametrize("sign", [1, -1])
def test_long_coefficients_are_rounded_to_six_digits(sign):
    for value, shown in (
        (Fraction(1, 999_999), Fraction(1, 999_999)),
        (Fraction(999_999, 7), Fraction(999_999, 7)),
        (Fraction(1_234_567, 2), 617284.0),
        (Fraction(2, 3_000_001), 6.66666e-07),
        (1_234_567, 1234570.0),
        (999_999, 999_999),
        (1 / 3, 0.333333),
        (2.0, 2.0),
    ):
        found = rounded_if_long({(1,): sign * value, (2,): 1})
        assert found == {(1,): sign * shown, (2,): 1} and type(found[1,]) is type(sign * shown)
        assert readable({(1,): sign * value}, ["x"]) == plain({(1,): sign * shown}, ["x"])
        assert readable_latex({(1,): sign * value}, ["x1"]) == latex({(1,): sign * shown}, ["x1"])
    for count in (30, 31):
        monomials = {(k, 2): sign for k in range(count)}
        shown = count == 30
        assert readable(monomials, "xy") == (
            plain(monomials, "xy") if shown else "<31 monomials of degree 32 and less>"
        )
        assert readable_latex(monomials, "xy") == (latex(monomials, "xy") if shown else r"\text{31 monomials}")
