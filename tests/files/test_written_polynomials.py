"""Parsing of polynomials and brackets: linear time, and bounded size of the result."""

import random
import re
from fractions import Fraction

import pytest

import coadjoint as co
from coadjoint.algebra.brackets import parse_brackets
from coadjoint.files.configuration.construction import parse_polynomial
from guards import bounded_work


def test_long_polynomials_are_parsed_in_linear_time():
    # Adding one polynomial per term would take hours.
    monomials = {(i % 50, i // 50 % 50, i // 2500): i + 1 for i in range(6000)}
    text = " + ".join(f"{c}*x1^{a}*x2^{b}*x3^{d}" for (a, b, d), c in monomials.items())
    with bounded_work():
        assert parse_polynomial(text, 3) == co.Polynomial(monomials)
        assert parse_polynomial([[c, list(e)] for e, c in monomials.items()], 3) == co.Polynomial(monomials)


def test_terms_are_added_in_order():
    assert parse_polynomial("0.1*x1 + 0.2*x1 + 0.3*x1 - 1e16*x2 + x2 + 1e16*x2", 2) == co.Polynomial(
        {(1, 0): 0.1 + 0.2 + 0.3, (0, 1): -1e16 + 1 + 1e16}
    )
    assert parse_polynomial("x1 - x1 + 2*x2 - 1/3*x2", 2) == co.Polynomial({(0, 1): Fraction(5, 3)})


def test_degree_and_coefficients_are_limited():
    assert parse_polynomial("x1^1000*x2^24", 2).degree == 1024
    with pytest.raises(ValueError, match=r"degree 1025; .*up to 1024"):
        parse_polynomial("x1^1000*x2^25", 2)
    assert parse_polynomial([[1, [1000, 24]]], 2).degree == 1024
    for exponents in ([1000, 25], [25, 1000], [1025, 0], [0, 1025], [600, 425]):
        with pytest.raises(ValueError, match=r"degree 1025; .*up to 1024"):
            parse_polynomial([[1, exponents]], 2)
    largest = int(1.7976931348623157e308)
    assert parse_polynomial(f"{largest}*x1", 1).monomials == {(1,): largest}
    for text in (f"{largest + 10**300}*x1", f"{largest}*x1 + {largest}*x1", f"{largest}*2*x1", f"1/{largest}*1/2*x1"):
        if text.startswith("1/"):
            assert parse_polynomial(text, 1).monomials == {(1,): Fraction(1, 2 * largest)}
        else:
            with pytest.raises(ValueError, match="is too large for float64"):
                parse_polynomial(text, 1)


def test_memory_is_checked_for_many_terms(monkeypatch):
    monkeypatch.setattr(
        "coadjoint.algebra.polynomials.formulas.check_available_memory",
        lambda count, what: wanted.append((count, what)),
    )
    wanted = []
    parse_polynomial(" + ".join(f"x{i + 1}" for i in range(1100)), 1100)
    assert [what for _, what in wanted] == ["a polynomial of 1024 terms or more in 1100 coordinates"]
    assert 1024 * 1100 * 8 < wanted[0][0] < 10 * 1024 * 1100 * 8


def test_many_brackets_are_parsed_in_linear_time():
    n = 20000
    basis = [f"e{i + 1}" for i in range(n)]
    lines = [f"[e{i}, e{i + 1}] = {i} e{i + 2} - 1/2*e{n}" for i in range(1, n - 2)]
    with bounded_work():
        found = parse_brackets(lines, basis)
    assert len(found) == n - 3 and found[10, 11] == {12: 11.0, n - 1: -0.5}


def bracket_term(k, c, basis, rng):
    number = {1.0: rng.choice(["", "1 ", "1*", "1.0 "])}.get(c, rng.choice([f"{c} ", f"{c}*", f"{c} * ", f"{c}"]))
    # A digit after a number would belong to it.
    return f"{number} {basis[k]}" if basis[k][0].isalnum() and not basis[k][0].isalpha() else f"{number}{basis[k]}"


@pytest.mark.parametrize(
    "basis",
    [
        ["e1", "e12", "e2", "e", "ee1"],
        ["J+", "J-", "J", "J+ J", "K z"],
        ["1", "2", "12", "3", "4"],
        ["a,b", "a", "b]", "[", "é"],
        ["x", "X", "x'", "x''", "x_1"],
    ],
    ids=repr,
)
def test_unusual_basis_names_are_parsed(basis):
    rng = random.Random(repr(basis))
    for _ in range(200):
        i, j = rng.sample(range(5), 2)
        terms = {k: rng.choice([1.0, 2.0, 0.5, 12.0, 3e-5]) for k in rng.sample(range(5), rng.randint(1, 4))}
        signs = [rng.choice("+-") for _ in terms]
        right = " ".join(
            f"{s} {bracket_term(k, c, basis, rng)}" for s, (k, c) in zip(signs, terms.items(), strict=True)
        )
        wanted = {k: -c if s == "-" else c for s, (k, c) in zip(signs, terms.items(), strict=True)}
        space = rng.choice(["", " ", "  "])
        line = f"{space}[{space}{basis[i]}{space},{space}{basis[j]}{space}]{space}={space}{right.removeprefix('+ ')}"
        assert parse_brackets([line], basis) == {(i, j): wanted}, line


@pytest.mark.parametrize(
    ("right", "message"),
    [
        ("1e308 e3 + 1e308 e3", "has a number that is too large for float64"),
        ("9" * 401 + " e3", "a number of 401 digits is too large for float64"),
        ("9" * 399 + " e3", "is too large for float64"),
        ("1/" + "9" * 399 + " e3", "is too large for float64"),
        ("1/0.0 e3", "divides by zero"),
        ("1e300/1e-300 e3", "is too large for float64"),
        ("e3 e1", "cannot be parsed from 'e1' on"),
        ("e34", "cannot be parsed from 'e34' on"),
        ("2", "cannot be parsed from '2' on"),
        ("", "cannot be parsed from 'its end' on"),
    ],
)
def test_invalid_brackets_are_refused(right, message):
    with pytest.raises(ValueError) as refused:
        parse_brackets([f"[e1, e2] = {right}"], ["e1", "e2", "e3"])
    assert message in str(refused.value) and len(str(refused.value)) < 300


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("x1^2/2", "1/2*x1^2"),
        ("x1**2/2 - x2**3", "1/2*x1^2 - x2^3"),
        ("x1/2*x2", "1/2*x1*x2"),
        ("x1/2/3", "1/6*x1"),
        ("12/2/3*x1", "2*x1"),
        ("x1*2/3/4*x2/5", "1/30*x1*x2"),
        ("x1/(1/2)", "2*x1"),
        ("-x1/4 + x2", "-1/4*x1 + x2"),
    ],
)
def test_notations_of_powers_and_quotients(text, same):
    assert parse_polynomial(text, 2) == parse_polynomial(same, 2)


def test_decimal_quotients_are_rounded_once():
    assert parse_polynomial("0.3*x1/3", 1).monomials[1,] == 0.3 / 3
    assert parse_polynomial("x1/3", 1).monomials[1,] == Fraction(1, 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x1/0", "divides by zero"),
        ("x1/x2", "divides by a coordinate"),
        ("x1/", "cannot be parsed from 'its end' on"),
        ("x1**-1", "has the power -1; powers are whole numbers from 0 up"),
        ("x1^2^-1", "has the power 1/2; powers are whole numbers from 0 up"),
    ],
)
def test_invalid_quotients_are_refused(text, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_polynomial(text, 2)
