"""Polynomials and formulas as text: exact arithmetic, every kind of number, printed forms, limits."""

import importlib.util
import math
from contextlib import nullcontext
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)

Polynomial = co.Polynomial
EXPONENTS = st.tuples(*[st.integers(0, 3)] * 3)
COEFFICIENTS = st.one_of(st.integers(-9, 9), st.fractions(-3, 3, max_denominator=7))
POLYNOMIALS = st.dictionaries(EXPONENTS, COEFFICIENTS, max_size=6).map(lambda m: Polynomial(m, dim=3))
POINTS = st.lists(st.fractions(-3, 3, max_denominator=5), min_size=3, max_size=3).map(
    lambda x: np.array([Fraction(v) for v in x], dtype=object)
)


def by_definition(p, x):
    return sum((c * x[0] ** a * x[1] ** b * x[2] ** d for (a, b, d), c in p.monomials.items()), Fraction(0))


@pytest.mark.long
@settings(deadline=None)
@given(POLYNOMIALS, POLYNOMIALS, POLYNOMIALS, POINTS)
def test_ring_operations_are_exact(p, q, r, x):
    assert p(x) == by_definition(p, x)
    assert (p + q)(x) == p(x) + q(x)
    assert (p - q)(x) == p(x) - q(x)
    assert (p * q)(x) == p(x) * q(x)
    assert p * (q + r) == p * q + p * r
    assert (p * q) * r == p * (q * r)
    assert p - p == Polynomial({}, dim=3)
    assert p + 2 - p == Polynomial({(0, 0, 0): 2})
    assert 3 - p == -(p - 3)
    assert Fraction(1, 3) * p * 3 == p
    assert p**3 == p * p * p
    assert hash(p + q) == hash(q + p)
    assert p**0 == Polynomial({(0, 0, 0): 1})


@pytest.mark.long
@settings(deadline=None)
@given(POLYNOMIALS, POLYNOMIALS, POINTS)
def test_derivatives_are_exact(p, q, x):
    for i in range(3):
        assert (p * q).derivative(i) == p.derivative(i) * q + p * q.derivative(i)
    assert p.gradient(x).tolist() == [p.derivative(i)(x) for i in range(3)]
    assert p.hessian(x).tolist() == [[p.derivative(i).derivative(j)(x) for j in range(3)] for i in range(3)]


@pytest.mark.parametrize("kind", [int, np.int8, np.float32, float, complex, Fraction])
@pytest.mark.parametrize("shape", [(), (4,), (2, 3), (0,), (5, 0, 2)])
def test_states_of_each_kind_of_numbers_and_shape(kind, shape):
    """Small multiples of a quarter, whose products are exact; contiguous in memory or not."""
    p = Polynomial(
        {(2, 1, 0): 3, (0, 0, 2): Fraction(1, 2), (1, 1, 1): -0.25, (0, 1, 0): 1, (0, 0, 0): Fraction(-5, 4)}
    )
    rng = np.random.default_rng(2)
    x = rng.integers(-4, 5, (*shape, 3)).astype(object)
    if kind is complex:
        x = (x + 1j * rng.integers(-4, 5, x.shape)) / 4
    elif kind not in (int, np.int8):
        x = x * Fraction(1, 4)
    x = x if kind is Fraction else x.astype(kind)
    dtype = {complex: np.complex128, Fraction: object}.get(kind, np.float64)
    rows = [[value if kind in (Fraction, complex) else Fraction(float(value)) for value in row]
            for row in x.reshape(-1, 3).tolist()]  # fmt: skip
    for points in (x, np.asfortranarray(x), np.repeat(x, 2, axis=-1)[..., ::2], x[::-1][::-1] if shape else x):
        value, gradient = p(points), p.gradient(points)
        assert np.shape(value) == shape and gradient.shape == x.shape and gradient.dtype == dtype
        assert np.ravel(value).tolist() == [by_definition(p, row) for row in rows]
        slopes = [[by_definition(p.derivative(i), row) for i in range(3)] for row in rows]
        assert gradient.reshape(-1, 3).tolist() == slopes
    if shape == ():
        second = [[by_definition(p.derivative(i).derivative(j), rows[0]) for j in range(3)] for i in range(3)]
        assert p.hessian(x).tolist() == second and p.hessian(x).dtype == dtype


def test_multiprecision_and_float_coefficients():
    p = Polynomial({(2, 1): 0.5, (0, 3): 0.1, (0, 0): 1})
    with mpmath.workdps(60):
        x = np.array([mpmath.sqrt(2), mpmath.sqrt(3)], dtype=object)
        wanted = mpmath.mpf(0.5) * x[0] ** 2 * x[1] + mpmath.mpf(0.1) * x[1] ** 3 + 1  # 0.1 is the float that it is
        assert abs(p(x) - wanted) < mpmath.mpf(10) ** -57
        assert abs(p.gradient(x)[0] - x[0] * x[1]) < mpmath.mpf(10) ** -57


def test_kinds_of_coefficients_are_kept():
    p = Polynomial({(1, 0): 2, (0, 1): Fraction(1, 3), (1, 1): 0.25, (2, 2): np.int64(4), (3, 0): np.float32(0.5)})
    assert [type(c) for c in p.monomials.values()] == [int, Fraction, float, float, int]
    assert type(p.monomials[2, 2]) is int
    assert type((p * p).monomials[2, 0]) is int
    assert type((p * p).monomials[0, 2]) is Fraction


def test_order_degree_and_repr():
    p = Polynomial(
        {(0, 1, 1): 1, (2, 0, 0): 0.5, (0, 0, 0): -3, (0, 0, 3): Fraction(-2, 3), (0, 1, 0): -1, (1, 1, 0): 0}
    )
    assert list(p.monomials) == [(0, 0, 0), (0, 1, 0), (2, 0, 0), (0, 1, 1), (0, 0, 3)]
    assert repr(p) == "-3 - x2 + 0.5*x1^2 + x2*x3 - (2/3)*x3^3"
    assert (p.degree, p.dim) == (3, 3)
    assert repr(Polynomial({(2, 0, 0): 0.5, (0, 1, 1): 1.0})) == "0.5*x1^2 + x2*x3"
    assert repr(Polynomial({}, dim=2)) == "0"
    assert Polynomial({}, dim=2).degree == 0
    with pytest.raises(TypeError):
        p.monomials[0, 0, 0] = 1


def test_equality_and_hash():
    p = Polynomial({(1, 0): 2, (0, 1): 1})
    assert p == Polynomial({(0, 1): 1.0, (1, 0): Fraction(2), (3, 3): 0})
    assert hash(p) == hash(Polynomial({(0, 1): 1.0, (1, 0): Fraction(2)}))
    assert p != Polynomial({(1, 0, 0): 2, (0, 1, 0): 1})
    assert p != 3
    constants = [Polynomial({(0,) * dim: value}, dim=dim) for dim in (1, 2, 3) for value in (0, 1, -1)]
    variables = [Polynomial.variable(i, dim) for dim in (1, 2, 3) for i in range(dim)]
    for k, one in enumerate(constants + variables):
        assert [one == other for other in constants + variables] == [k == m for m in range(15)]
    assert len({*constants, *variables}) == 15
    assert Polynomial.variable(0, 2) * 2 + Polynomial.variable(1, 2) == p


def test_latex():
    p = Polynomial({(0, 0): -1, (2, 0): Fraction(1, 2), (1, 1): -1.5e-7, (0, 12): 3, (1, 0): -1})
    assert p.to_latex() == r"-1 - x_{1} + \frac{1}{2} x_{1}^{2} - 1.5 \times 10^{-7} x_{1} x_{2} + 3 x_{2}^{12}"
    assert Polynomial({}, dim=2).to_latex() == "0"


@pytest.mark.skipif(importlib.util.find_spec("sympy") is None, reason="SymPy is not installed")
def test_sympy():
    import sympy

    x1, x2, h, m1 = sympy.symbols("x1 x2 h m1")
    assert Polynomial({(2, 0): Fraction(1, 3), (1, 1): -1}).to_sympy() == x1**2 / 3 - x1 * x2
    line = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0, 0]))
    method = co.Splitting(parts="coordinates", rotation="rational")
    assert co.modified_hamiltonian(line, method, 4).to_sympy() == sympy.Float(0.5) * x1**2 - h**2 * x1**4 / 48
    symbolic = co.modified_hamiltonian(line, co.Splitting(parts="coordinates"), 4, symbols=True)
    assert sympy.expand(symbolic.to_sympy() - m1 * x1**2 / 2) == 0


def test_many_states_are_those_one_by_one():
    """More states than are evaluated at once."""
    p = Polynomial({(2, 1): 0.5, (0, 3): 0.25, (2, 0): 1})
    x = np.arange(2.0 * 3 * 10**5).reshape(3, 10**5, 2) % 64
    places = np.random.default_rng(0).integers(0, 10**5, 50)
    value, gradient = p(x), p.gradient(x)
    assert value.shape == (3, 10**5) and gradient.shape == x.shape
    for k in range(3):
        for m in (0, 1, *places, 10**5 - 1):
            assert value[k, m] == p(x[k, m]) and gradient[k, m].tolist() == p.gradient(x[k, m]).tolist()


@pytest.mark.parametrize("combined", [lambda p, q: p + q, lambda p, q: p - q, lambda p, q: p * q], ids=["+", "-", "*"])
def test_names_are_those_of_the_operand_that_has_some(combined):
    named, plain = Polynomial("a*b", dim=2, basis=("a", "b")), Polynomial("x1 + 2*x2", dim=2)
    for one, other in ((named, plain), (plain, named)):
        result = combined(one, other)
        assert result.names == (3 * result).names == (result**2).names == result.derivative(0).names == ("a", "b")
    assert combined(plain, plain).names == ("x1", "x2")


def test_powers_up_to_the_limit():
    assert (Polynomial.variable(0, 1) ** 1024).degree == Polynomial({(1024,): 1}).degree == 1024
    assert Polynomial("a*b", dim=2, basis=("b", "a")) == Polynomial({(1, 1): 1})


def test_without_sympy_the_package_is_named(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *more: None if name == "sympy" else find(name, *more))
    with refused(ImportError, "sympy", "coadjoint[algebra]"):
        Polynomial({(1,): 1}).to_sympy()


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
