"""The catalogue: constants, Casimirs, names, refusals."""

from fractions import Fraction

import numpy as np
import pytest

from coadjoint.algebra import catalogue
from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.polynomials.polynomial import Polynomial


def test_the_casimir_of_a37_jumps_by_its_period():
    casimir = catalogue.A3_7(-2.0).casimirs_known["log C"]
    jump = casimir(np.array([-1.0, 1e-300, 0.0])) - casimir(np.array([-1.0, -1e-300, 0.0]))
    assert abs(jump) == casimir.period


def test_the_pfaffian_is_a_square_root_of_the_determinant():
    g = catalogue.so(4)
    x = np.array([1.0, 2.0, -3.0, 5.0, 0.5, 4.0])
    matrix = np.tensordot(x, g.representation, 1)
    assert abs(g.casimirs_known["Pfaffian"](x) ** 2 - np.linalg.det(matrix)) < 1e-9


def test_names_and_get():
    assert catalogue.get("so(3)") == catalogue.so(3)
    assert catalogue.get("so(7)") == catalogue.get("so(n)", n=7) == catalogue.so(7)
    assert catalogue.get("A3,7", a=0.5) == catalogue.get("A3_7", a=0.5) == catalogue.A3_7(0.5)
    assert catalogue.get("e(3)") == catalogue.e(3)
    assert catalogue.get("sl(2)") == catalogue.sl(2)
    assert catalogue.get("heisenberg") == catalogue.heisenberg(1)
    assert catalogue.get("heisenberg(2)") == catalogue.get("heisenberg", n=2) == catalogue.heisenberg(2)
    assert catalogue.get("so(3, 1)") == catalogue.get("so(p,q)", p=3, q=1) == catalogue.so(3, 1)
    assert catalogue.get("sp(4)") == catalogue.get("sp(2n)", n=2) == catalogue.sp(4)
    assert catalogue.get("heisenberg(n)", n=2) == catalogue.heisenberg(2)
    families = {"e": 6, "gl": 9, "heisenberg": 7, "se": 6, "sl": 8, "so": 3, "su": 8, "u": 9}
    for family, dim in families.items():
        assert catalogue.get(f"{family}(3)") == catalogue.get(f"{family}(n)", n=3)
        assert catalogue.get(f"{family}(3)").dim == dim
        assert f"{family}(n)" in catalogue.names()
    assert set(catalogue.names()) > {"so(p,q)", "sp(2n)", "A2_1", "A5_40", "A3_7"}
    assert list(catalogue.names()) == sorted(catalogue.names())


@pytest.mark.parametrize("value", [1, 2.0, 0.5, Fraction(1, 3), -2 / 7, 0.1, 1e-7, 123456.789, 1.0 + 2.0**-40, -1e300])
def test_names_have_the_numbers_that_make_the_algebra(value):
    for name, parameters in (("A3_7", ("a",)), ("A5_33", ("a", "b")), ("A4_2", ("a",))):
        given = dict(zip(parameters, (value, -3), strict=False))
        g = catalogue.get(name, **given)
        head, _, numbers = g.name.rstrip(")").partition("(")
        read = {key: float(text) for key, _, text in (part.partition("=") for part in numbers.split(", "))}
        assert head == name and list(read) == list(parameters) and catalogue.get(head, **read) == g
    assert catalogue.A3_7(0.5).name == "A3_7(a=0.5)" and catalogue.get("A2,1").name == "A2_1"


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_signs_that_are_all_alike_are_those_of_rotations(n):
    for g in (catalogue.so(0, n), catalogue.so(n, 0), catalogue.get(f"so(0,{n})"), catalogue.get("so(p,q)", p=n, q=0)):
        assert g == catalogue.so(n) and g.name == f"so({n})" and g.casimirs_known == catalogue.so(n).casimirs_known
        assert np.array_equal(g.representation, catalogue.so(n).representation)


@pytest.mark.parametrize(
    ("name", "parameters", "error", "message"),
    [
        ("so4", {}, ValueError, r"unknown algebra 'so4'; did you mean 'so\(4\)'"),
        ("nonsense", {}, ValueError, "unknown algebra 'nonsense'"),
        ("so(n)", {}, ValueError, "needs the parameter 'n'"),
        ("A3_7", {}, ValueError, "needs the parameter 'a'"),
        ("A3_7", {"a": 1.0, "b": 2.0}, ValueError, "has no parameter 'b'; it takes: a"),
        ("so(4)", {"n": 4}, ValueError, "has no parameter 'n'; it takes: none"),
        ("sp(3)", {}, ValueError, "must be even, not 3"),
        ("so(0,1)", {}, ValueError, r"p of so\(p, q\) must be a whole number from 1 up, not 0"),
        ("so(p,q)", {"p": 3}, ValueError, "needs the parameter 'q'"),
        ("su(2,1)", {}, ValueError, "unknown algebra 'su\\(2,1\\)'"),
        ("A5-23", {"b": 1}, ValueError, "unknown algebra 'A5-23'"),
        ("A5,41", {}, ValueError, "unknown algebra 'A5,41'"),
        ("A4,9", {"b": 2}, ValueError, "it needs -1 < b <= 1, not b = 2"),
        (3, {}, TypeError, "must be a string"),
    ],
)
def test_wrong_names_and_parameters_are_refused(name, parameters, error, message):
    with pytest.raises(error, match=message):
        catalogue.get(name, **parameters)


def test_invariants():
    ratio = Invariant(lambda x: x[1] / x[0], period=2)
    assert ratio(np.array([2.0, 1.0])) == 0.5
    assert (ratio.gradient, ratio.period) == (None, 2.0)
    states = np.random.default_rng(0).uniform(1, 2, (2, 3, 2))
    for some in (states, states[0], states[:, 0], states[:, :1], states[:0], states[..., ::-1]):
        assert ratio(some).tolist() == (some[..., 1] / some[..., 0]).tolist()
    assert ratio(states[0].tolist()).tolist() == ratio(states[0]).tolist() and ratio([2, 1]) == 0.5
    assert repr(ratio).endswith(", period=2)") and "period" not in repr(Invariant(abs))
    with pytest.raises(AttributeError):
        ratio.period = 1.0
    for arguments, error, message in (
        ((3,), TypeError, "value of an Invariant must be a function"),
        ((abs, 3), TypeError, "gradient of an Invariant"),
        ((abs, None, -1.0), ValueError, "is -1.0; it must not be negative"),
        ((abs, None, float("nan")), ValueError, "is nan; it must be finite"),
        ((abs, None, "x"), TypeError, "period of an Invariant is 'x'; it must be a number"),
    ):
        with pytest.raises(error, match=message):
            Invariant(*arguments)
    assert isinstance(catalogue.e(3).casimirs_known["m.p"], Polynomial)
    with pytest.raises(TypeError):
        catalogue.e(3).casimirs_known["other"] = ratio
