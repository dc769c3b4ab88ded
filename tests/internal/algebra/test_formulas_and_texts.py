"""Formulas in exact numbers, and polynomials as text and LaTeX with rounded numbers, names and symbols."""

import math
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.exact.numbers import fits
from coadjoint.algebra.families import matrix_bases, subspaces
from coadjoint.algebra.invariants.casimirs import embedded
from coadjoint.algebra.invariants.invariant import LogarithmicSum
from coadjoint.algebra.polynomials.exact_polynomials import SymbolicPolynomial
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


def test_gradients_take_any_number():
    formula = parse_formula("log(x1*x2) - a*atan2(x1, x3) + x2/x3", *NAMES)
    x = np.array([Fraction(1), Fraction(2), Fraction(3)])
    slope = formula.gradient(x)
    assert slope.tolist() == [1 - Fraction(3, 20), Fraction(1, 2) + Fraction(1, 3), Fraction(1, 20) - Fraction(2, 9)]
    assert formula.gradient(x.astype(float)).dtype == np.float64
    assert np.abs(formula.gradient(x.astype(float)) - slope.astype(float)).max() < 2.0**-48
    with pytest.raises(ZeroDivisionError):
        formula.gradient(x * 0)


def test_polynomials_in_other_coordinates():
    p = matrix_bases.quadratic([(0, 1, 1), (1, 0, 2), (2, 2, Fraction(1, 2))], 3) + 5 * X["x2"] + 7
    rows = [{0: 1, 1: 2}, {1: Fraction(1, 3)}, {}]
    x = np.array([Fraction(2), Fraction(5)])
    assert subspaces.substituted(p, rows, 2)(x) == p(np.array([x[0] + 2 * x[1], x[1] / 3, Fraction(0)]))
    y = np.array([Fraction(k) for k in range(5)])
    assert embedded(p, [1, 2, 3], 5)(y) == p(y[1:4])


def test_conditions_are_bounded_too():
    for text in ("2**4000000000 > a", "-" * 5000 + "1 > a", "1/(a - a) > 1"):
        with pytest.raises(ValueError, match=r"too large|nested|divides"):
            condition_holds(text, PARAMETERS)


def test_what_is_subtracted_is_written_with_a_minus():
    formula = parse_formula("-log(x1)/2 - x2/x3 - a*atan2(x2, x1)", *NAMES)
    assert str(formula).startswith("-1/2 log|x1| - (x2)/(x3) - ")
    assert "+ -" not in str(formula)


def test_long_fractions_do_not_fit():
    assert fits(Fraction(1, 2**4095)) and not fits(Fraction(1, 2**4096))


def test_symbols_are_grouped():
    p = SymbolicPolynomial(
        co.Polynomial({(1, 0, 1, 0): -1, (0, 2, 1, 1): 2, (0, 2, 0, 2): -3, (0, 0, 0, 1): 1}), ["m1", "m1_2"]
    )
    assert repr(p) == "m1_2 - m1*x1 + x2^2*(2*m1*m1_2 - 3*m1_2^2)"
    assert p.to_latex() == r"m_{1,2} - m_{1} x_{1} + x_{2}^{2} \, (2 m_{1} m_{1,2} - 3 m_{1,2}^{2})"
    assert p.with_values({"m1": Fraction(1, 2), "m1_2": 0.25}).monomials == {
        (0, 0): Fraction(1, 4),
        (1, 0): Fraction(-1, 2),
        (0, 2): Fraction(1, 16),
    }
    assert p.degree == 2 and p == SymbolicPolynomial(p._polynomial, p.symbols) and hash(p) is not None


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


@pytest.mark.parametrize("scale", [1, Fraction(1, 3), 0.5], ids=str)
@pytest.mark.parametrize("value", [2, Fraction(3, 2), 0.75, 3.0], ids=str)
def test_numbers_for_symbols_keep_their_kind(scale, value):
    """Exact numbers stay exact, and floats are exact numbers as long as no coefficient is a float."""
    p = SymbolicPolynomial(co.Polynomial({(1, 0, 2, 0): 3 * scale, (1, 0, 0, 1): scale, (0, 2, 0, 1): 4}), ["a", "b"])
    assert (p.dim, p.degree, p.symbols) == (2, 2, ("a", "b"))
    found = p.with_values({"b": value, "a": -2}).monomials
    a_term, b_term = Fraction(scale) * (12 + Fraction(value)), 4 * Fraction(value)
    assert found == {(1, 0): a_term, (0, 2): b_term} and list(found) == [(1, 0), (0, 2)]
    exact = int if a_term.denominator == 1 else Fraction
    assert type(found[1, 0]) is (float if isinstance(scale, float) else exact)
    assert type(found[0, 2]) is (int if b_term.denominator == 1 else Fraction)
    assert p.with_values({"a": 0, "b": 0}).monomials == {}
    for wrong, error in ((float("nan"), ValueError), ("2", TypeError), (True, TypeError)):
        with pytest.raises(error, match=r"^b is"):
            p.with_values({"a": 1, "b": wrong})
    assert p == SymbolicPolynomial(p._polynomial, ["a", "b"]) != SymbolicPolynomial(p._polynomial, ["b", "a"])


def test_polynomials_take_any_names_one_after_another():
    """In every printed form; the polynomial itself and those of other names keep theirs."""
    p, text = Polynomial({(2, 1): 3, (0, 1): -1}), "-{1} + 3*{0}^2*{1}"
    own = ("x1", "x2")
    for start in (p, p.named(("u", "v"))):
        kept, made = start.names, []
        for names in (("q", "p"), ("a", "b"), own, ("q", "p"), ("p", "q"), own, ("a", "b"), ("u", "v")):
            for found in (start.named(names), *(each.named(names) for each in made)):
                assert found == p and found.names == names and repr(found) == text.format(*names)
                assert found.to_latex() == latex(p.monomials, names)
                assert found.derivative(0).names == (found + 1).names == names
            made.append(start.named(names))
            assert start.names == kept and repr(start) == text.format(*kept)
        assert [repr(each) for each in made[:2]] == [text.format("q", "p"), text.format("a", "b")]
