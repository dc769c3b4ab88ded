"""Polynomials: exact arithmetic, evaluation in every kind of number, refusals, text, LaTeX and SymPy."""

import importlib.util
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import coadjoint as co
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.polynomial_format import latex, plain, readable, readable_latex, rounded_if_long
from coadjoint.algebra.polynomials.symbolic_polynomial import SymbolicPolynomial
from coadjoint.optional_packages import MissingPackageError
from guards import bounded_work

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


@settings(deadline=None, max_examples=40)
@given(POLYNOMIALS, POINTS)
def test_floats_agree_with_fractions(p, x):
    # at most 6 monomials of degree 9, coefficients below 9, derivatives at most 9 * 8 times as large
    bound = 64 * 2.0**-53 * 6 * 9 * 72 * 3.0**9
    f = x.astype(float)
    assert abs(p(f) - float(p(x))) <= bound
    assert np.abs(p.gradient(f) - p.gradient(x).astype(float)).max() <= bound
    assert np.abs(p.hessian(f) - p.hessian(x).astype(float)).max() <= bound
    assert p.gradient(f).dtype == p.hessian(f).dtype == np.float64


@pytest.mark.long
@settings(deadline=None)
@given(st.lists(POLYNOMIALS, min_size=1, max_size=4), st.lists(POINTS, min_size=1, max_size=5))
def test_many_states_at_once_are_those_one_by_one(polynomials, points):
    x = np.array([points, points[::-1]])
    together = Polynomial.side_by_side(polynomials).along(x)
    assert together.shape == (2, len(points), len(polynomials))
    for k, p in enumerate(polynomials):
        assert together[..., k].tolist() == p(x).tolist() == [[by_definition(p, y) for y in row] for row in x]
        assert p.gradient(x).tolist() == [[p.gradient(y).tolist() for y in row] for row in x]
        # as in the test above
        assert np.abs(p(x.astype(float)) - p(x).astype(float)).max() <= 64 * 2.0**-53 * 6 * 9 * 72 * 3.0**9


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


def test_more_states_than_are_held_at_once(monkeypatch):
    monkeypatch.setattr("coadjoint.algebra.polynomials.monomials.MAX_NUMBERS", 10)
    p = Polynomial({(2, 1): 0.5, (0, 3): 0.25, (2, 0): 1})
    x = np.arange(20.0).reshape(10, 2)
    assert p.gradient(x).tolist() == [p.gradient(y).tolist() for y in x]


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


@pytest.mark.long
def test_ten_thousand_monomials():
    rng = np.random.default_rng(0)
    monomials = {tuple(e): int(c) for *e, c in rng.integers(0, 12, (12_000, 7)).tolist() if c}
    with bounded_work():  # below 1 s on an idle machine; quadratic work would take minutes
        p = Polynomial(monomials)
        assert len(p.monomials) > 10_000
        x = rng.uniform(-1, 1, 6)
        value, gradient = p(x), p.gradient(x)
    exponents = np.array(list(p.monomials))
    products = np.prod(x**exponents, axis=1) * np.array(list(p.monomials.values()), dtype=float)
    # 10^4 terms of at most 66 factors each
    bound = 2.0**-53 * 200 * np.abs(products).sum()
    assert abs(value - products.sum()) <= bound
    assert abs(gradient @ x - (products * exponents.sum(axis=1)).sum()) <= 72 * 6 * bound  # Euler
    assert len((p + p * 2).monomials) == len(p.monomials)


@pytest.mark.parametrize(
    ("monomials", "dim", "error", "message"),
    [
        ({(1, 0): 1, (1,): 2}, None, ValueError, r"\(1,\) have length 1; this Polynomial has dimension 2"),
        ({(1, 0): 1}, 3, ValueError, "has dimension 3"),
        ({}, None, ValueError, "dim must be given"),
        ({(): 1}, None, ValueError, "at least one coordinate"),
        ({(1,): 1}, 0, ValueError, "whole number from 1 up, not 0"),
    ],
)
def test_wrong_polynomials_are_refused(monomials, dim, error, message):
    with pytest.raises(error, match=message):
        Polynomial(monomials, dim=dim)


def test_wrong_operations_are_refused():
    p, q = Polynomial({(1, 0): 1}), Polynomial({(1, 0, 0): 1})
    with pytest.raises(ValueError, match="in 2 and in 3 coordinates"):
        p + q
    with pytest.raises(ValueError, match="in 2 and in 3 coordinates"):
        p * q
    with pytest.raises(TypeError):
        p + "x"
    for power in (-1, 0.5, True):
        with pytest.raises(ValueError, match="power of a Polynomial must be a whole number"):
            p**power
    for wrong in (-1, 2, 1.0):
        for call in (p.derivative, lambda i: Polynomial.variable(i, 2)):
            with pytest.raises(ValueError, match=f"of a coordinate must be a whole number from 0 to 1, not {wrong}"):
                call(wrong)
    for call in (p, p.gradient, p.hessian):
        with pytest.raises(ValueError, match=r"shape \(2,\), not \(3,\)"):
            call([1.0, 2.0, 3.0])
    for call in (p, p.gradient):
        with pytest.raises(ValueError, match=r"shape \(..., 2\), not \(2, 3\)"):
            call(np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"shape \(2,\), not \(4, 2\)"):
        p.hessian(np.zeros((4, 2)))
    for divisor in (0, 0.0, Fraction(0)):
        with pytest.raises(ValueError, match="divided by a number other than 0"):
            p / divisor
    for dim, basis in ((3, ("a", "b")), (2, ("a", "b", "c"))):
        with pytest.raises(ValueError, match=f"dim is {dim}, and basis has {len(basis)} names"):
            Polynomial("a*b", dim=dim, basis=basis)
    assert Polynomial("a*b", dim=2, basis=("b", "a")) == Polynomial({(1, 1): 1})
    with pytest.raises(TypeError, match="must be an array of real numbers"):
        p(["a", "b"])
    with pytest.raises(ValueError, match="constant is nan"):
        p + float("nan")
    with pytest.raises(ValueError, match="overflows; it must stay within float64"):
        Polynomial({(1,): 1e300}) ** 2


def test_latex():
    p = co.Polynomial({(0, 0): -1, (2, 0): Fraction(1, 2), (1, 1): -1.5e-7, (0, 12): 3, (1, 0): -1})
    assert p.to_latex() == r"-1 - x_{1} + \frac{1}{2} x_{1}^{2} - 1.5 \times 10^{-7} x_{1} x_{2} + 3 x_{2}^{12}"
    assert p._repr_latex_() == f"${p.to_latex()}$"
    assert co.Polynomial({}, dim=2).to_latex() == "0"


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


@pytest.mark.skipif(importlib.util.find_spec("sympy") is None, reason="SymPy is not installed")
def test_sympy():
    import sympy

    x1, x2, h, m1 = sympy.symbols("x1 x2 h m1")
    assert co.Polynomial({(2, 0): Fraction(1, 3), (1, 1): -1}).to_sympy() == x1**2 / 3 - x1 * x2
    line = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0, 0]))
    method = co.Splitting(parts="coordinates", rotation="rational")
    assert co.modified_hamiltonian(line, method, 4).to_sympy() == sympy.Float(0.5) * x1**2 - h**2 * x1**4 / 48
    symbolic = co.modified_hamiltonian(line, co.Splitting(parts="coordinates"), 4, symbols=True)
    assert sympy.expand(symbolic.to_sympy() - m1 * x1**2 / 2) == 0


def test_without_sympy_the_package_is_named(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *more: None if name == "sympy" else find(name, *more))
    with pytest.raises(MissingPackageError, match=r"coadjoint.algebra."):
        co.Polynomial({(1,): 1}).to_sympy()


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
