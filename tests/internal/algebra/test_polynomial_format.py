"""Polynomials as text and LaTeX with rounded coefficients, with names and with symbols."""

from fractions import Fraction

import pytest

import coadjoint as co
from coadjoint.algebra.polynomials.polynomial_format import latex, plain, readable, readable_latex, rounded_if_long
from coadjoint.algebra.polynomials.symbolic_polynomial import SymbolicPolynomial

pytestmark = pytest.mark.thinned(1)

Polynomial = co.Polynomial


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
