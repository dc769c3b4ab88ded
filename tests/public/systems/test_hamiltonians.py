"""Separable, split, polynomial and general Hamiltonians, and formulas: values, derivatives, time."""

import copy
import math
import pickle
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

U = 2.0**-53


def bound(H, n):
    """Return a Hamiltonian as a system of n coordinates has it."""
    return co.LiePoissonSystem(co.LieAlgebra.from_brackets(n, {}), H, casimirs={}).hamiltonian


X = np.array([0.3, -0.7, 1.1, 0.4])

CUBIC = co.Polynomial({(3, 0): 1.0, (1, 2): -2.0, (0, 1): 0.5})


def general():
    return co.Hamiltonian(
        lambda x: np.cos(x[0]) * x[1] + x[2] ** 2 * x[3],
        lambda x: np.array([-np.sin(x[0]) * x[1], np.cos(x[0]), 2 * x[2] * x[3], x[2] ** 2]),
        lambda x: np.array(
            [
                [-np.cos(x[0]) * x[1], -np.sin(x[0]), 0, 0],
                [-np.sin(x[0]), 0, 0, 0],
                [0, 0, 2 * x[3], 2 * x[2]],
                [0, 0, 2 * x[2], 0],
            ]
        ),
    )


def separable():
    return co.Separable(
        {1: (np.sin, np.cos, lambda y: -np.sin(y)), 3: (lambda y: y**4, lambda y: 4 * y**3, lambda y: 12 * y**2)}
    )


def split():
    return co.SplitHamiltonian(
        [
            ((2, 0), co.Quadratic([[1.0, 0.5], [0.5, -2.0]], linear=[0.25, 0.0], constant=3.0)),
            ((0, 3), CUBIC),
            ((1,), co.Separable({0: (np.cosh, np.sinh, np.cosh)})),
            (
                (0, 3),
                co.Hamiltonian(
                    lambda y: y[0] * y[1] ** 2,
                    lambda y: np.array([y[1] ** 2, 2 * y[0] * y[1]]),
                    lambda y: np.array([[0, 2 * y[1]], [2 * y[1], 2 * y[0]]]),
                ),
            ),
        ]
    )


KINDS = [
    general(),
    separable(),
    split(),
    co.Polynomial({(2, 1, 0, 0): 1.5, (0, 0, 1, 3): -0.5, (0, 0, 0, 0): 2.0}),
    co.Quadratic(2.5),
]


@pytest.mark.parametrize("kind", KINDS, ids=repr)
def test_derivatives_and_terms(kind):
    """By complex steps, and as the sum of the terms that compiled loops use."""
    H = bound(kind, 4)
    step = 1e-30  # squares vanish: the derivative has no truncation error
    gradient, hessian = H.gradient(X), H.hessian(X)
    for i in range(4):
        moved = X + 1j * step * np.eye(4)[i]
        assert np.imag(H.value(moved)) / step == pytest.approx(gradient[i], rel=1e-14, abs=1e-14)
        np.testing.assert_allclose(np.imag(H.gradient(moved)) / step, hessian[i], rtol=1e-14, atol=1e-14)
    value, slope = 0.0, np.zeros(4)
    for term in H.terms():
        if isinstance(term, co.systems.QuadraticTerm):
            product = np.bincount(term.rows, weights=term.values * X[term.indices], minlength=4)
            value += term.constant + term.linear @ X + product @ X / 2
            slope += term.linear + product
        elif isinstance(term, co.systems.PolynomialTerm):
            value += term.polynomial(X)
            slope += term.polynomial.gradient(X)
        else:
            y = X[term.coordinates]
            value += term.value(y[0] if term.scalar else y)
            slope[term.coordinates] += term.gradient(y[0] if term.scalar else y)
    assert value == pytest.approx(H.value(X), rel=1e-14)
    np.testing.assert_allclose(slope, gradient, rtol=1e-14)


def test_pieces_are_numbered():
    terms = split().bind(4).terms()
    assert [term.piece for term in terms] == [0, 1, 2, 3]
    kinds = co.systems.QuadraticTerm, co.systems.PolynomialTerm, co.systems.FunctionTerm, co.systems.FunctionTerm
    assert tuple(type(term) for term in terms) == kinds
    assert terms[3].coordinates.tolist() == [0, 3]
    assert terms[2].scalar
    inner = co.SplitHamiltonian([((1,), co.Quadratic(2.0)), ((0,), co.Quadratic(1.0))])
    nested = co.SplitHamiltonian([((3, 1), inner)])
    assert [term.piece for term in nested.bind(4).terms()] == [0, 0]
    np.testing.assert_array_equal(nested.bind(4).gradient(X), [0.0, 2.0 * X[1], 0.0, X[3]])


def test_fractions_pass_through():
    x = np.array([Fraction(1, 3), Fraction(2), Fraction(-1, 7), Fraction(5)], dtype=object)
    H = co.SplitHamiltonian([((0, 1), CUBIC), ((2, 3), co.Quadratic([1.0, 0.5]))]).bind(4)
    assert H.gradient(x).tolist() == [x[0] ** 2 * 3 - 2 * x[1] ** 2, -4 * x[0] * x[1] + Fraction(1, 2), x[2], x[3] / 2]
    cubes = co.Separable({0: (lambda y: y**3, lambda y: 3 * y**2)}).bind(4)
    assert cubes.gradient(x)[0] == Fraction(1, 3)
    assert cubes.value(x) == Fraction(1, 27)


@pytest.mark.parametrize("frequency", [1.0, 50.0, 2000.0])
def test_right_functions_are_not_refused(frequency):
    w = frequency
    co.Hamiltonian(lambda x: np.sin(w * x[0]), lambda x: np.array([w * np.cos(w * x[0])])).bind(1)
    co.Separable({0: (lambda y: math.sin(w * y), lambda y: w * math.cos(w * y))}).bind(1)


def test_functions_with_a_domain():
    assert co.Separable({0: (math.log, lambda y: 1 / y)}).bind(1).value([2.0]) == math.log(2.0)
    for log in (math.log, np.log):
        with refused(ValueError, "dH_0", "H_0"):
            co.Separable({0: (log, lambda y: 2 / y)}).bind(1)


@pytest.mark.parametrize("known", [False, True], ids=["unbound", "bound"])
def test_every_hamiltonian_is_called(known):
    """H(x) is `value` at one state, and the same numbers at many states; H(x, t) takes the time."""
    timed = co.Separable({0: (lambda y, t: t * y**2, lambda y, t: 2 * t * y)})
    split = co.SplitHamiltonian([((0, 1), co.Quadratic([1.0, 2.0])), ((3,), co.Quadratic(3.0))])
    quadratic = co.Quadratic([1.0, 2.0, 3.0, 4.0], linear=[0.0, 1.0, 0.0, 0.0])
    states = np.stack([X, 2 * X, X[::-1]])
    for H in (timed, split, quadratic, co.Quadratic(2.0), general(), split + general(), 2 * timed):
        H = H.bind(4) if known else H
        assert H(X, 0.5) == H.value(X, 0.5) and H(X) == H.value(X)
        assert H(states, 0.5).tolist() == [H.value(x, 0.5) for x in states]
        assert H(states[None]).shape == (1, 3)
        assert H(X.tolist()) == H.value(X)
        if known:
            with refused(ValueError, "shape"):
                H(np.ones((2, 5)))
    assert bound(CUBIC, 2)([1.0, 2.0]) == CUBIC([1.0, 2.0])


TIMES = (0.0, 0.7, -1.3)
Y = np.array([0.4, -0.7, 1.1])
PARTS = {  # value, slope and curvature of a function of one coordinate and the time
    False: (np.cosh, np.sinh, np.cosh),
    True: tuple((lambda y, t, f=f: f(y) * np.exp(t)) for f in (np.cos, lambda y: -np.sin(y), lambda y: -np.cos(y))),
}
IN_TIME = {
    "separable": lambda parts: co.Separable(dict(enumerate(parts))),
    "split": lambda parts: co.SplitHamiltonian([((k,), co.Separable({0: part})) for k, part in enumerate(parts)]),
    "sum": lambda parts: sum(co.Separable({k: part}) for k, part in enumerate(parts)),
}


@pytest.mark.parametrize("timed", [(), (0,), (1,), (2,), (0, 1, 2)], ids=str)
@pytest.mark.parametrize("kind", IN_TIME)
def test_any_part_may_depend_on_the_time(kind, timed):
    parts = [PARTS[k in timed] for k in range(3)]
    H = bound(IN_TIME[kind](parts), 3)
    system = co.LiePoissonSystem(co.algebras.so(3), H, casimirs={})
    assert H.timed == bool(timed)
    for t in TIMES:
        value, slope, curvature = (
            [part[level](y, *((t,) if k in timed else ())) for k, (part, y) in enumerate(zip(parts, Y, strict=True))]
            for level in range(3)
        )
        # Three numbers of the size of e^0.7 cosh(1.1) at most, each rounded a few times.
        assert abs(H.value(Y, t) - sum(value)) < 32 * U and abs(system.energy(Y, t) - sum(value)) < 32 * U
        np.testing.assert_allclose(H.gradient(Y, t), slope, rtol=0, atol=32 * U)
        np.testing.assert_allclose(H.hessian(Y, t), np.diag(curvature), rtol=0, atol=32 * U)
        np.testing.assert_allclose((-2 * H).hessian(Y, t), np.diag(curvature) * -2, rtol=0, atol=64 * U)
        np.testing.assert_allclose(system.vector_field(Y, t), np.cross(slope, Y), rtol=0, atol=64 * U)


@pytest.mark.parametrize("order", [(int, float, Fraction), (float, Fraction, int)], ids=str)
def test_equal_polynomials_of_other_numbers_stay_what_they_are(order):
    """Whole numbers and fractions are exact and floats are not, whichever was converted first."""
    for kind in order:
        H = bound(co.Polynomial({(2, 0): kind(7), (1, 1): kind(3), (0, 1): kind(5), (0, 0): kind(11)}), 2)
        assert H.exact == (kind is not float), kind


def test_sums_of_split_ones_have_the_dimension_that_is_known():
    def one(k):
        return co.SplitHamiltonian([((k,), co.Quadratic(float(k + 1)))])

    for H in (one(0).bind(4) + one(2), one(0) + one(2).bind(4), one(0).bind(4) + one(2).bind(4)):
        assert H.dim == 4
        np.testing.assert_array_equal(H.gradient(np.ones(4)), [1.0, 0.0, 3.0, 0.0])
    assert (one(0) + one(2)).dim is None
    with refused(ValueError, "4", "5", "coordinates"):
        one(0).bind(4) + one(2).bind(5)


TEXT = "a*x1^2/2 + cos(x2)*b - sqrt(1 + x3^2)/(3*a) + tanh(x1) - exp(-x2) + log(2 + x3) + atan(x1)"

PARAMETERS = {"a": 1.5, "b": Fraction(1, 3)}


def written(x):
    names = vars(np) | {"atan": np.arctan} | PARAMETERS | {f"x{k + 1}": x[k] for k in range(3)}
    return eval(TEXT.replace("^", "**"), names)


def test_values_and_derivatives_are_those_of_the_function():
    H, G = co.formula(TEXT, 3, parameters=PARAMETERS), co.Hamiltonian(written).bind(3)
    x = np.array([0.3, -0.7, 1.1])
    assert H.value(x) == pytest.approx(G.value(x), rel=2.0**-48)
    assert np.abs(H.gradient(x) - G.gradient(x)).max() < 2.0**-48
    assert np.abs(H.hessian(x) - G.hessian(x)).max() < 2.0**-47
    assert H.value(x + 1e-30j).imag / 1e-30 == pytest.approx(H.gradient(x).sum(), rel=2.0**-46)


def test_systems_take_texts_in_either_names():
    algebra = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1}, (1, 2): {0: 1}, (2, 0): {1: 1}}, basis=("m1", "m2", "m3"))
    x = np.array([0.3, -0.7, 1.1])
    fields = [
        co.LiePoissonSystem(algebra, H).vector_field(x)
        for H in ("m1^2/2 + cos(m2)*m3", "x1^2/2 + cos(x2)*x3", lambda y: y[0] ** 2 / 2 + np.cos(y[1]) * y[2])
    ]
    np.testing.assert_allclose(fields[:2], [fields[2]] * 2, rtol=2.0**-48, atol=0)
    assert isinstance(co.LiePoissonSystem(algebra, "(m1 + m2)^2/2").hamiltonian, co.Quadratic)
    with refused(ValueError, "m1 + x1", "m1, m2, m3"):
        co.LiePoissonSystem(algebra, "m1 + x1")


def test_a_polynomial_is_one():
    for text, M in (("(x1 + 2*x2)^2/2", [[1.0, 2.0], [2.0, 4.0]]), ("x1*x2", [[0.0, 1.0], [1.0, 0.0]])):
        plane = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1}})
        np.testing.assert_array_equal(co.LiePoissonSystem(plane, text).hamiltonian.hessian(np.zeros(2)), M)


def test_every_place_of_a_hamiltonian_takes_a_function():
    def wave(x):
        return np.cos(x[0])

    J = lambda x: np.array([[0.0, x[1]], [-x[1], 0.0]])  # noqa: E731
    x = np.array([0.4, 1.2])
    for H in (wave, co.Hamiltonian(wave), "cos(x1)"):
        assert co.PoissonSystem(J, H, dim=2).energy(x) == np.cos(0.4)
    with refused(TypeError, "dim="):
        co.PoissonSystem(J, wave)
    y = np.array([0.4, 1.2, 0.7])
    split = co.SplitHamiltonian([((0,), wave), ((2,), "x1^4"), ((1,), co.Quadratic(1.0))])
    assert split.bind(3).value(y) == pytest.approx(np.cos(0.4) + 0.7**4 + 0.72, rel=2.0**-50)
    for H in (co.Quadratic(1.0) + wave, wave + co.Quadratic(1.0)):
        assert co.LiePoissonSystem(co.algebras.so(3), H).energy(y) == pytest.approx(np.cos(0.4) + y @ y / 2)
    timed = co.LiePoissonSystem(co.algebras.so(3), lambda x, t: t * x[0])
    assert timed.energy(y, 2.0) == 0.8


def test_incomplete_classes_are_not_taken_for_functions():
    class Incomplete:
        dim = 3

        def __call__(self, x):
            return x[0]

    with refused(TypeError, "Incomplete"):
        co.LiePoissonSystem(co.algebras.so(3), Incomplete())


def named(x):
    return np.cosh(x[0]) + np.tanh(x[2]) + x[1] * x[2]


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    ("H", "factor"),
    [
        (named, 2.5),
        ("2*x1^2 + sqrt(1 + x3^2)/3 - exp(-x2)", 1),
        (co.formula("cos(c) + 2*b^2 + a^3", basis=("c", "b", "a")), 1),
        (co.formula("a*cos(x2) + 2*x1^2 + x3^3/b", dim=3, parameters={"a": 0.7, "b": 3}), 2.5),
    ],
)
def test_pickled_and_copied(H, factor):
    system = co.LiePoissonSystem(co.algebras.so(3), factor * co.LiePoissonSystem(co.algebras.so(3), H).hamiltonian)
    x = np.array([0.3, -0.7, 1.1])
    for same in (pickle.loads(pickle.dumps(system)), copy.deepcopy(system), copy.copy(system)):
        assert same.energy(x) == system.energy(x)
        np.testing.assert_array_equal(same.vector_field(x), system.vector_field(x))
        np.testing.assert_array_equal(same.jacobian(x), system.jacobian(x))
        ends = [co.integrate(s, x, (0, 0.5), 0.1, co.GaussLegendre(2)).x for s in (same, system)]
        np.testing.assert_array_equal(*ends)
