"""Separable, split, polynomial and general Hamiltonians: values, terms, binding, and what is refused."""

import math
from fractions import Fraction

import numpy as np
import pytest

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.hamiltonian import (
    Hamiltonian,
    HamiltonianLike,
    PolynomialHamiltonian,
    as_hamiltonian,
)
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.separable import Separable
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm, QuadraticTerm

X = np.array([0.3, -0.7, 1.1, 0.4])
CUBIC = Polynomial({(3, 0): 1.0, (1, 2): -2.0, (0, 1): 0.5})


def general():
    return Hamiltonian(
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
    return Separable(
        {1: (np.sin, np.cos, lambda y: -np.sin(y)), 3: (lambda y: y**4, lambda y: 4 * y**3, lambda y: 12 * y**2)}
    )


def split():
    return SplitHamiltonian(
        [
            ((2, 0), Quadratic([[1.0, 0.5], [0.5, -2.0]], linear=[0.25, 0.0], constant=3.0)),
            ((0, 3), CUBIC),
            ((1,), Separable({0: (np.cosh, np.sinh, np.cosh)})),
            (
                (0, 3),
                Hamiltonian(
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
    Polynomial({(2, 1, 0, 0): 1.5, (0, 0, 1, 3): -0.5, (0, 0, 0, 0): 2.0}),
    Quadratic(2.5),
]


@pytest.mark.parametrize("kind", KINDS, ids=repr)
def test_derivatives_by_complex_steps(kind):
    H = as_hamiltonian(kind, 4)
    assert isinstance(H, HamiltonianLike)
    assert H.dim == 4
    step = 1e-30  # squares vanish: the derivative has no truncation error
    gradient, hessian = H.gradient(X), H.hessian(X)
    for i in range(4):
        moved = X + 1j * step * np.eye(4)[i]
        assert np.imag(H.value(moved)) / step == pytest.approx(gradient[i], rel=1e-14, abs=1e-14)
        np.testing.assert_allclose(np.imag(H.gradient(moved)) / step, hessian[i], rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("kind", KINDS, ids=repr)
def test_terms_add_up(kind):
    H = as_hamiltonian(kind, 4)
    value, gradient = 0.0, np.zeros(4)
    for term in H.terms():
        if isinstance(term, QuadraticTerm):
            product = np.bincount(term.rows, weights=term.values * X[term.indices], minlength=4)
            value += term.constant + term.linear @ X + product @ X / 2
            gradient += term.linear + product
        elif isinstance(term, PolynomialTerm):
            value += term.polynomial(X)
            gradient += term.polynomial.gradient(X)
        else:
            y = X[term.coordinates]
            value += term.value(y[0] if term.scalar else y)
            gradient[term.coordinates] += term.gradient(y[0] if term.scalar else y)
    assert value == pytest.approx(H.value(X), rel=1e-14)
    np.testing.assert_allclose(gradient, H.gradient(X), rtol=1e-14)


def test_pieces_are_numbered():
    terms = split().bind(4).terms()
    assert [term.piece for term in terms] == [0, 1, 2, 3]
    assert [type(term) for term in terms] == [QuadraticTerm, PolynomialTerm, FunctionTerm, FunctionTerm]
    assert terms[3].coordinates.tolist() == [0, 3]
    assert terms[2].scalar
    nested = SplitHamiltonian([((3, 1), SplitHamiltonian([((1,), Quadratic(2.0)), ((0,), Quadratic(1.0))]))])
    assert [term.piece for term in nested.bind(4).terms()] == [0, 0]
    np.testing.assert_array_equal(nested.bind(4).gradient(X), [0.0, 2.0 * X[1], 0.0, X[3]])


def test_low_degree_polynomials_become_quadratic():
    H = as_hamiltonian(Polynomial({(2, 0): 0.5, (0, 0): 4.0}), 2)
    assert isinstance(H, Quadratic)
    assert H.value([2.0, 0.0]) == 6.0
    assert isinstance(as_hamiltonian(CUBIC, 2), PolynomialHamiltonian)
    with pytest.raises(ValueError, match="2 variables but the system has dimension 3"):
        as_hamiltonian(CUBIC, 3)


def test_fractions_pass_through():
    x = np.array([Fraction(1, 3), Fraction(2), Fraction(-1, 7), Fraction(5)], dtype=object)
    H = SplitHamiltonian([((0, 1), CUBIC), ((2, 3), Quadratic([1.0, 0.5]))]).bind(4)
    assert H.gradient(x).tolist() == [x[0] ** 2 * 3 - 2 * x[1] ** 2, -4 * x[0] * x[1] + Fraction(1, 2), x[2], x[3] / 2]
    cubes = Separable({0: (lambda y: y**3, lambda y: 3 * y**2)}).bind(4)
    assert cubes.gradient(x)[0] == Fraction(1, 3)
    assert cubes.value(x) == Fraction(1, 27)


def test_functions_of_other_arguments_are_refused():
    with pytest.raises(TypeError, match=r"value takes \(x, t\) but gradient takes \(x\)"):
        Hamiltonian(lambda x, t: 0.0, lambda x: np.zeros(2))


@pytest.mark.parametrize(
    ("value", "gradient", "message"),
    [
        (lambda x: x[0] ** 2, lambda x: 2 * x[:1], r"gradient returns shape \(1,\)"),
        (lambda x: x**2, lambda x: 2 * x, r"value returns shape \(2,\)"),
        (lambda x: None, lambda x: x, "returns None"),
        (lambda x: x[7], lambda x: x, "value: index 7"),
    ],
)
def test_wrong_functions_are_refused(value, gradient, message):
    with pytest.raises(ValueError, match=message):
        Hamiltonian(value, gradient).bind(2)


@pytest.mark.parametrize("frequency", [1.0, 50.0, 2000.0])
def test_right_functions_are_not_refused(frequency):
    w = frequency
    Hamiltonian(
        lambda x: np.sin(w * x[0]) + np.exp(x[1]), lambda x: np.array([w * np.cos(w * x[0]), np.exp(x[1])])
    ).bind(2)
    Separable({0: (lambda y: math.sin(w * y), lambda y: w * math.cos(w * y))}).bind(1)


def test_functions_with_a_domain():
    assert Separable({0: (math.log, lambda y: 1 / y)}).bind(1).value([2.0]) == math.log(2.0)
    with pytest.raises(ValueError, match="dH_0 contradicts H_0"):
        Separable({0: (math.log, lambda y: 2 / y)}).bind(1)
    with pytest.raises(ValueError, match="dH_0 contradicts H_0"):
        Separable({0: (np.log, lambda y: 2 / y)}).bind(1)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: Separable({0: (np.sin, np.cos, np.sin)}).bind(3), ValueError, "d2H_0 contradicts dH_0"),
        (lambda: Separable({0: (lambda a, b, c: a, np.cos)}), TypeError, "takes 3"),
        (lambda: SplitHamiltonian([((0, 0), Quadratic(1.0))]), ValueError, "different numbers"),
        (lambda: SplitHamiltonian([((0, 1), Quadratic([1.0]))]), ValueError, "piece 0, of 2 coordinates"),
        (lambda: SplitHamiltonian([((0, 9), Quadratic(1.0))]).bind(4), ValueError, "coordinate 9"),
        (lambda: as_hamiltonian(3.0, 2), TypeError, "float"),
        (lambda: as_hamiltonian(Quadratic, 2), TypeError, "the Hamiltonian is the class Quadratic"),
        (lambda: general().bind(4).bind(5), ValueError, "bound to dimension 4"),
        (lambda: Hamiltonian(lambda x: 0.0, lambda x: 0 * x).hessian([1.0]), TypeError, "hessian="),
        (lambda: Separable({0: (np.sin, np.cos)}).hessian([1.0]), TypeError, "coordinate 0"),
    ],
)
def test_refusals(make, error, message):
    with pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize("bound", [False, True], ids=["unbound", "bound"])
def test_every_hamiltonian_is_called(bound):
    """H(x) is `value` at one state, and the same numbers at many states; H(x, t) takes the time."""
    timed = Separable({0: (lambda y, t: t * y**2, lambda y, t: 2 * t * y)})
    split = SplitHamiltonian([((0, 1), Quadratic([1.0, 2.0])), ((3,), Quadratic(3.0))])
    quadratic = Quadratic([1.0, 2.0, 3.0, 4.0], linear=[0.0, 1.0, 0.0, 0.0])
    states = np.stack([X, 2 * X, X[::-1]])
    for H in (timed, split, quadratic, Quadratic(2.0), general(), split + general(), 2 * timed):
        H = H.bind(4) if bound else H
        assert H(X, 0.5) == H.value(X, 0.5) and H(X) == H.value(X)
        assert H(states, 0.5).tolist() == [H.value(x, 0.5) for x in states]
        assert H(states[None]).shape == (1, 3)
        assert H(X.tolist()) == H.value(X)
        if bound:
            with pytest.raises(ValueError, match="shape"):
                H(np.ones((2, 5)))
    assert PolynomialHamiltonian(CUBIC)([1.0, 2.0]) == CUBIC([1.0, 2.0])
