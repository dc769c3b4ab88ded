"""Polynomials and brackets as text: notations, exact coefficients, limits, and names of any kind."""

import random
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from configuration_files import OWN, changed
from guards import bounded_work

LARGEST = int(1.7976931348623157e308)


@pytest.mark.parametrize(
    "polynomial",
    [
        co.Polynomial({(2, 0, 0): 0.5, (0, 1, 1): -1}),
        co.Polynomial({(1, 0, 0): Fraction(-1, 3), (0, 0, 0): 1e-20, (0, 0, 4): 12}),
        co.Polynomial({}, dim=3),
    ],
    ids=repr,
)
def test_printed_polynomials_are_parsed(polynomial):
    assert co.Polynomial(repr(polynomial), dim=3) == polynomial


@pytest.mark.parametrize(
    ("text", "monomials"),
    [
        ("1/3*x1 + 2*x2*x1*3 - 0.5", {(1, 0): Fraction(1, 3), (1, 1): 6, (0, 0): -0.5}),
        ("0.1*x1 + 0.2*x1 + 0.3*x1 - 1e16*x2 + 3*x2 + 1e16*x2", {(1, 0): 0.1 + 0.2 + 0.3, (0, 1): -1e16 + 3 + 1e16}),
        ("x1 - x1 + 2*x2 - 1/3*x2", {(0, 1): Fraction(5, 3)}),
        ("x1**2/2 - x2**3", {(2, 0): Fraction(1, 2), (0, 3): -1}),
        ("x1/2*x2", {(1, 1): Fraction(1, 2)}),
        ("x1/2/3", {(1, 0): Fraction(1, 6)}),
        ("12/2/3*x1", {(1, 0): 2}),
        ("x1*2/3/4*x2/5", {(1, 1): Fraction(1, 30)}),
        ("x1/(1/2)", {(1, 0): 2}),
        ("-x1/4 + x2", {(1, 0): Fraction(-1, 4), (0, 1): 1}),
        ("0.3*x1/3", {(1, 0): 0.3 / 3}),
        ("x1^1000*x2^24", {(1000, 24): 1}),
        (f"{LARGEST}*x1", {(1, 0): LARGEST}),
        (f"1/{LARGEST}*1/2*x1", {(1, 0): Fraction(1, 2 * LARGEST)}),
    ],
)
def test_notations_and_exact_coefficients(text, monomials):
    """Quotients of whole numbers are exact, and a decimal number is rounded once."""
    found = co.Polynomial(text, dim=2).monomials
    assert found == monomials
    assert {k for k, v in found.items() if type(v) is float} == {k for k, v in monomials.items() if type(v) is float}


def test_numbers_just_inside_the_limits_are_read():
    assert co.Polynomial("0." + "3" * 399 + "*x1", dim=2).monomials == {(1, 0): 1 / 3}
    assert co.Polynomial("5e-324*x1 + 0e-400*x2 + 0.00", dim=2).monomials == {(1, 0): 5e-324}


def test_long_polynomials_are_parsed_in_linear_time(files):
    """Adding one polynomial for each term would take hours, as text and as a list."""
    monomials = {(i % 50, i // 50 % 50, i // 2500): i + 1 for i in range(6000)}
    text = " + ".join(f"{c}*x1^{a}*x2^{b}*x3^{d}" for (a, b, d), c in monomials.items())
    with bounded_work():
        assert co.Polynomial(text, dim=3) == co.Polynomial(monomials)


NAMES = [
    ["e1", "e12", "e2", "e", "ee1"],
    ["J+", "J-", "J", "J+ J", "K z"],
    ["1", "2", "12", "3", "4"],
    ["a,b", "a", "b]", "[", "é"],
    ["x", "X", "x'", "x''", "x_1"],
]


def term(name, c, rng):
    number = {1.0: rng.choice(["", "1 ", "1*", "1.0 "])}.get(c, rng.choice([f"{c} ", f"{c}*", f"{c} * ", f"{c}"]))
    # A digit after a number would belong to it.
    return f"{number} {name}" if name[0].isalnum() and not name[0].isalpha() else f"{number}{name}"


@pytest.mark.thinned(1)
@pytest.mark.parametrize("basis", NAMES, ids=repr)
def test_brackets_of_unusual_names_are_read(files, basis):
    """Of two generators, whose bracket is a sum of the others: an algebra whatever the coefficients."""
    rng = random.Random(repr(basis))
    quoted = ", ".join(f'"{name}"' for name in basis)
    for _ in range(3):
        i, j, *others = rng.sample(range(5), 5)
        terms = {k: rng.choice([1.0, 2.0, 0.5, 12.0, 3e-5]) for k in others[: rng.randint(1, 3)]}
        signs = [rng.choice("+-") for _ in terms]
        right = " ".join(f"{s} {term(basis[k], c, rng)}" for s, (k, c) in zip(signs, terms.items(), strict=True))
        space = rng.choice(["", " ", "  "])
        line = f"{space}[{space}{basis[i]}{space},{space}{basis[j]}{space}]{space}={space}{right.removeprefix('+ ')}"
        text = f"""
algebra = {{basis = [{quoted}], brackets = ["{line}"]}}
casimirs = {{}}
hamiltonian = {{M = 1.0}}
initial = {{x = [1.0, 0.5, 0.25, 0.0, 2.0]}}
run = {{t_span = [0, 0], step = 0.1}}
"""
        algebra = files.run(text).system.algebra
        wanted = np.zeros(5)
        for sign, (k, c) in zip(signs, terms.items(), strict=True):
            wanted[k] = -c if sign == "-" else c
        assert algebra.basis == tuple(basis)
        np.testing.assert_array_equal(algebra.bracket(np.eye(5)[i], np.eye(5)[j]), wanted, err_msg=line)


def test_many_brackets_are_read_in_bounded_time(files):
    lines = ", ".join(f'"[e{i}, e{i + 1}] = 0"' for i in range(1, 200))
    text = changed(OWN, ('"[e1, e2] = e3", "[e2, e3] = e1", "[e3, e1] = e2"', lines), ("dim = 3", "dim = 200"))
    text = text.replace("x1^2 + x2^2 + x3^2", "x1").replace("[1.0, 0.5, 0.25]", "1.0")
    with bounded_work():
        files.plan(changed(text, ("[1.0, 0.1, 0.5]", str([0.5] * 200))))
