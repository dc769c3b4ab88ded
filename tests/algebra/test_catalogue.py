"""The catalogue: constants, Casimirs, names, refusals."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coadjoint.algebra import catalogue
from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.polynomials.polynomial import Polynomial

POLYNOMIAL = [catalogue.so(n) for n in (2, 3, 4, 5, 6)] + [catalogue.e(3), catalogue.sl(2), catalogue.heisenberg(2)]


@pytest.mark.parametrize("g", POLYNOMIAL, ids=str)
def test_polynomial_casimirs_commute_with_everything_exactly(g):
    rng = np.random.default_rng(5)
    assert g.casimirs_known
    for _ in range(5):
        x = np.array([Fraction(int(v), 7) for v in rng.integers(-50, 50, g.dim)], dtype=object)
        gradients = [casimir.gradient(x) for casimir in g.casimirs_known.values()]
        for gradient in gradients:
            assert all(g.structure_matrix(x) @ gradient == 0)
        rank = np.linalg.matrix_rank(np.array(gradients, dtype=float))
        assert rank == len(gradients)
    if g.name not in ("so(5)", "so(6)"):
        assert len(g.casimirs_known) == g.dim - g.generic_rank()


@pytest.mark.long
@settings(deadline=None)
@given(st.floats(-20, 20), st.lists(st.floats(0.1, 5), min_size=3, max_size=3), st.sampled_from([1, -1]))
def test_the_casimir_of_a37(a, x, side):
    g = catalogue.A3_7(a)
    casimir = g.casimirs_known["log C"]
    x = np.array(x) * [side, 1, side]
    gradient = casimir.gradient(x)
    size = np.abs(g.structure_matrix(x)) @ np.abs(gradient)
    assert (np.abs(g.structure_matrix(x) @ gradient) <= 64 * 2.0**-53 * (1 + size)).all()
    h = 1e-5 * 0.1  # central differences: error h^2 f'''/6 with f''' below (4 + 4 |a|) / |x|^3, and round-off 8 u f / h
    bound = h**2 * (4 + 4 * abs(a)) / 0.1**3 + 64 * 2.0**-53 * (10 + 8 * abs(a)) / h
    for i in range(3):
        step = h * np.eye(3)[i]
        assert abs((casimir(x + step) - casimir(x - step)) / (2 * h) - gradient[i]) <= bound
    assert casimir.period == 4 * math.pi * abs(a)


def test_the_casimir_of_a37_jumps_by_its_period():
    casimir = catalogue.A3_7(-2.0).casimirs_known["log C"]
    jump = casimir(np.array([-1.0, 1e-300, 0.0])) - casimir(np.array([-1.0, -1e-300, 0.0]))
    assert abs(jump) == casimir.period


@pytest.mark.long
@pytest.mark.parametrize("a", [0.0, 2.0])
def test_the_casimir_of_a37_compiles(a):
    import numba

    casimir = catalogue.A3_7(a).casimirs_known["log C"]
    x = np.array([0.3, -0.7, 2.0])
    assert abs(numba.njit(casimir.value)(x) - casimir(x)) <= 64 * 2.0**-53 * (1 + 2 * a * math.pi)
    assert np.abs(numba.njit(casimir.gradient)(x) - casimir.gradient(x)).max() <= 64 * 2.0**-53 * (4 + 4 * a)


def brackets(g):
    return sorted((int(i) + 1, int(j) + 1, int(k) + 1, float(c)) for i, j, k, c in zip(*g.triples, strict=True))


def test_constants_as_published():
    assert brackets(catalogue.so(3)) == [(1, 2, 3, 1.0), (1, 3, 2, -1.0), (2, 3, 1, 1.0)]
    assert brackets(catalogue.sl(2)) == [(1, 2, 1, 1.0), (1, 3, 2, -2.0), (2, 3, 3, 1.0)]
    assert brackets(catalogue.A3_7(2.0)) == [(1, 3, 1, 2.0), (1, 3, 2, -1.0), (2, 3, 1, 1.0), (2, 3, 2, 2.0)]
    assert brackets(catalogue.heisenberg(1)) == [(1, 2, 3, 1.0)]
    so3 = [(1, 2, 3, 1.0), (1, 3, 2, -1.0), (2, 3, 1, 1.0)]
    mixed = [(1, 5, 6, 1.0), (1, 6, 5, -1.0), (2, 4, 6, -1.0), (2, 6, 4, 1.0), (3, 4, 5, 1.0), (3, 5, 4, -1.0)]
    assert brackets(catalogue.e(3)) == sorted(so3 + mixed)
    so4 = "124- 135- 142 153 236- 241- 263 351- 362- 456- 465 564-".split()
    assert brackets(catalogue.so(4)) == sorted((int(t[0]), int(t[1]), int(t[2]), -1.0 if t[3:] else 1.0) for t in so4)


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
        ("A3_7", {"a": float("nan")}, ValueError, "a of A3_7 is nan; it must be finite"),
        ("A3_7", {"a": "two"}, TypeError, "a of A3_7 is 'two'; it must be a number"),
        ("A3_7", {"a": 1.0, "b": 2.0}, ValueError, "has no parameter 'b'; it takes: a"),
        ("so(4)", {"n": 4}, ValueError, "has no parameter 'n'; it takes: none"),
        ("so(1)", {}, ValueError, "from 2 up, not 1"),
        ("so(n)", {"n": 3.0}, ValueError, "from 2 up, not 3.0"),
        ("heisenberg(0)", {}, ValueError, "from 1 up, not 0"),
        ("sl(1)", {}, ValueError, r"n of sl\(n\) must be a whole number from 2 up, not 1"),
        ("e(1)", {}, ValueError, r"n of e\(n\) must be a whole number from 2 up, not 1"),
        ("gl(0)", {}, ValueError, "from 1 up, not 0"),
        ("su(1)", {}, ValueError, "from 2 up, not 1"),
        ("sp(3)", {}, ValueError, "must be even, not 3"),
        ("sp(2n)", {"n": 1.5}, ValueError, "from 1 up, not 1.5"),
        ("so(1,0)", {}, ValueError, "from 2 up, not 1"),
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
