"""Formulas as text: polynomials and functions, parameters and names, and what is refused."""

import math
from contextlib import nullcontext
from fractions import Fraction

import mpmath
import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)


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
    assert co.formula(text, 3, None, parameters).monomials == co.formula(same, 3).monomials


def test_functions_of_numbers_are_rounded_once():
    found = co.formula("sqrt(2)*x1 + exp(-1)*x2 + cos(pi/3)*x3 + 2^0.5", 3).monomials
    with mpmath.workdps(60):
        wanted = [mpmath.sqrt(2), mpmath.exp(-1), mpmath.cos(mpmath.mpf(math.pi / 3)), mpmath.sqrt(2)]
    assert [found[e] for e in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0))] == [float(value) for value in wanted]
    assert co.formula("sin(1e22)*x1", 1).monomials[(1,)] == -0.8522008497671888  # W. Kahan's test value
    assert co.formula("0.3^5*x1", 1).monomials[(1,)] == float(Fraction(0.3) ** 5)


REFUSED = {
    "x²": "'x²'", "x1/": "its end", "1/2/": "its end", "(x1": "its end", "x1)": "')'", "2(x1)": "'(x1)'",
    "x1(2)": "'x1'", "x1, x2": "', x2'", "(x1, x2)": "parsed", "x1 < x2": "'< x2'", "x1 and x2": "'and x2'",
    "cos": "'cos'", "cos()": "parsed", "cos(1, 2)*x1": "cos of 2", "c*x1": "'c'", "1j*x1": "'j", "0x10": "'x10'",
    "1_000*x1": "'_000", "x1 if x2 else x3": "parsed", "[x1][0]": "parsed", "x1[0]": "name", "lambda: x1": "",
    "x1\n.real": "'.real'", "_0": "'_0'", "sqrt(-1)*x1": "sqrt", "log(0)*x1": "log", "exp(1000)*x1": "exp",
    "(0.0)^-1*x1": "zero", "x1/(1 - 1)": "zero", "x1/0": "zero", "__import__('os')": "", "x1.dim": "", "x1\0": "parsed",
    "'a'": "", "x4": "'x4'",
    # What no machine can hold.
    "x1**4000000000": "4000000000", "x1**n": "4000000000", "(x1*x2)**513": "1026", "x1**600*x2**600": "1200",
    "(x1 + x2 + x3 + 1)**1000": "terms", "(x1 + x2)**100*(x2 + x3)**100": "10201 terms",
    "2**4000000000*x1": "too large", "2**1024*x1": "too large", "10**300*10**300": "too large",
    "10**308 + 10**308*9": "too large", "9" * 5000: "5000 digits", "-" * 5000 + "1": "nested",
    "(" * 4900 + "1" + ")" * 4900: "nested", "x1+" * 200_000 + "x1": "600002", "x1*" * 1001 + "x1": "1000 operations",
    "(" + "x1+" * 1001 + "x1)": "1000 operations", "2" + "**2" * 61: "nested",
    "+".join(["(x1 + x2 + x3 + 1)**20"] * 40): "products",
}  # fmt: skip


@pytest.mark.parametrize("text", REFUSED, ids=lambda text: text[:20])
def test_formulas_that_are_refused(text):
    with refused(ValueError, REFUSED[text]) as caught:
        co.formula(text, 3, None, {"n": 4000000000})
    assert len(str(caught.value)) < 300 and "\n" not in str(caught.value)


def product_of_sums(*counts):
    """A sum of powers of x1 times one of powers of x2."""
    sums = ("(" + "+".join(f"x{k + 1}**{n}" for n in range(1, count + 1)) + ")" for k, count in enumerate(counts))
    return "*".join(sums)


LIMITS = {
    "letters": ("(x1)" + " " * (250_000 - 4), "(x1)" + " " * (250_001 - 4)),
    "nested": tuple("(" * depth + "x1" + ")" * depth for depth in (60, 61)),
    "operations": tuple("2/2" + "*1" * (count - 1) for count in (1000, 1001)),
    "terms": (product_of_sums(99, 99), product_of_sums(101, 101)),
    "digits": ("1".zfill(400), "1".zfill(401)),
    "degree": ("x1**1024", "x1**1025"),
    "too large": ("2**1023*x1", "2**1024*x1"),
}


@pytest.mark.parametrize("what", LIMITS)
def test_limits(what):
    inside, outside = LIMITS[what]
    assert isinstance(co.formula(inside, 2), co.Polynomial)
    with refused(ValueError, what):
        co.formula(outside, 2)


@pytest.mark.parametrize(("share", "accepted"), [(0.5, True), (2.0, False)])
def test_products_of_a_formula_are_bounded(share, accepted):
    """2^24, each product times the coordinates and 8: the last ones square the 286 terms of a tenth power."""
    text = "+".join(["(x1+x2+x3+1)**20"] * round(share * 2**24 / (286**2 * 16)))
    with nullcontext() if accepted else refused(ValueError, "products"):
        assert co.formula(text, 8).degree == 20


def test_powers_below_the_limits():
    assert co.formula("(x1 + x2)**60", 2).monomials[(30, 30)] == math.comb(60, 30)
    assert co.formula("x1**0 - 1", 2).monomials == {}
    assert co.formula("(-1)**1001*a**10", 2, None, {"a": 0.5}).monomials == {(0, 0): -(2.0**-10)}


@pytest.mark.parametrize("text", ["x1^x2", "x1^-1", "x1^0.5", "x1/x2", "log(x1)", "cos(x1 + 1)*x2", "2^x1"])
def test_formulas_that_are_no_polynomials_are_functions(text):
    H, x = co.formula(text, 3), np.array([1.25, 0.5, 2.0])
    assert isinstance(H, co.Hamiltonian)
    names = {"x1": x[0], "x2": x[1], "log": math.log, "cos": math.cos}
    assert H.value(x) == pytest.approx(eval(text.replace("^", "**"), names), rel=2.0**-50)


def test_leading_zeros_and_long_numbers():
    assert co.formula("007*x1 + " + "0" * 300 + "1", 1) == co.Polynomial({(1,): 7, (0,): 1})


def test_names_with_brackets_and_names_of_parameters():
    p = co.formula("2*S1[7]^2 - J", 2, ("S1[7]", "S2[7]"), {"J": 3})
    assert p.monomials == {(0, 0): -3, (2, 0): 2}
    for parameters in ({"x2": 1.0}, {"S1[7]": 1.0}, {"a b": 1.0}, {"": 1.0}):
        with refused(ValueError, "parameter"):
            co.formula("S1[7]", 2, ("S1[7]", "S2[7]"), parameters)
