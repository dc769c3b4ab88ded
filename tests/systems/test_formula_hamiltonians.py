"""Energies as formulas and as plain functions: what systems accept, names, parameters, and pickling."""

import copy
import pickle
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co

TEXT = "a*x1^2/2 + cos(x2)*b - sqrt(1 + x3^2)/(3*a) + tanh(x1) - exp(-x2) + log(2 + x3) + atan(x1)"
PARAMETERS = {"a": 1.5, "b": Fraction(1, 3)}


def written(x):
    return (
        1.5 * x[0] ** 2 / 2
        + np.cos(x[1]) / 3
        - np.sqrt(1 + x[2] ** 2) / 4.5
        + np.tanh(x[0])
        - np.exp(-x[1])
        + np.log(2 + x[2])
        + np.arctan(x[0])
    )


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
    with pytest.raises(ValueError, match=r"^the Hamiltonian 'm1 \+ x1' has 'x1'; the coordinates are m1, m2, m3$"):
        co.LiePoissonSystem(algebra, "m1 + x1")


def test_a_polynomial_is_one():
    for text, M in (("(x1 + 2*x2)^2/2", [[1.0, 2.0], [2.0, 4.0]]), ("x1*x2", [[0.0, 1.0], [1.0, 0.0]])):
        plane = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1}})
        np.testing.assert_array_equal(co.LiePoissonSystem(plane, text).hamiltonian.hessian(np.zeros(2)), M)
    assert co.formula("a*(x1 - b)^2", 1, parameters={"a": 3, "b": Fraction(1, 3)}) == co.Polynomial(
        {(2,): 3, (1,): -2, (0,): Fraction(1, 3)}
    )
    assert co.Polynomial("w*q^2", basis=("q", "p"), parameters={"w": 2}) == co.Polynomial({(2, 0): 2})


def test_every_place_of_a_hamiltonian_takes_a_function():
    def wave(x):
        return np.cos(x[0])

    J = lambda x: np.array([[0.0, x[1]], [-x[1], 0.0]])  # noqa: E731
    x = np.array([0.4, 1.2])
    for H in (wave, co.Hamiltonian(wave), "cos(x1)"):
        assert co.PoissonSystem(J, H, dim=2).energy(x) == np.cos(0.4)
    with pytest.raises(TypeError, match="give dim="):
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

    with pytest.raises(TypeError, match="the Hamiltonian is a Incomplete"):
        co.LiePoissonSystem(co.algebras.so(3), Incomplete())


def named(x):
    return np.cosh(x[0]) + np.tanh(x[2]) + x[1] * x[2]


@pytest.mark.parametrize("H", [named, "2*x1^2 + sqrt(1 + x3^2)/3 - exp(-x2)", "cos(x1) + x2*x3"])
@pytest.mark.parametrize("factor", [1, 2.5])
def test_pickled_and_copied(H, factor):
    H = co.LiePoissonSystem(co.algebras.so(3), H).hamiltonian
    system = co.LiePoissonSystem(co.algebras.so(3), factor * H)
    x = np.array([0.3, -0.7, 1.1])
    for same in (pickle.loads(pickle.dumps(system)), copy.deepcopy(system), copy.copy(system)):
        assert same.energy(x) == system.energy(x)
        np.testing.assert_array_equal(same.vector_field(x), system.vector_field(x))
        np.testing.assert_array_equal(same.jacobian(x), system.jacobian(x))
        ends = [co.integrate(s, x, (0, 0.5), 0.1, co.GaussLegendre(2)).x for s in (same, system)]
        np.testing.assert_array_equal(*ends)
    for method in (co.Splitting(order=4), co.GaussLegendre(2)):
        prepared = co.prepare(system, method, 0.1)
        run = prepared.run(x, (0, 0.5)).x
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(prepared)).run(x, (0, 0.5)).x, run)


@pytest.mark.parametrize(
    "text", ["x1/(1 - 1) + cos(x1)", "cos(x1)/0", "log(x1, x2)", "cos(x1) + sqrt(-1)", "cos(x1) + y"]
)
def test_functions_that_are_undefined_are_refused(text):
    with pytest.raises(ValueError) as refused:
        co.formula(text, 3)
    assert "\n" not in str(refused.value)


def test_long_functions_are_refused():
    with pytest.raises(ValueError, match="more than 2000 operations"):
        co.formula("+".join(f"cos({k}*x1)" for k in range(1100)), 1)


def test_names_of_coordinates_are_pickled():
    # In another order than their numbers: without the names, the coordinates would be exchanged in silence.
    for names in (("m1", "m2", "m3"), ("x2", "x1", "x3")):
        H = co.formula(f"cos({names[0]}) + 2*{names[1]}^2 + {names[2]}^3", basis=names)
        x = np.array([0.1, 0.7, 0.4])
        again = pickle.loads(pickle.dumps(H))
        assert again.value(x) == H.value(x) == np.cos(0.1) + 2 * 0.7**2 + 0.4**3
        system = co.LiePoissonSystem(co.algebras.so(3), H)
        assert np.array_equal(pickle.loads(pickle.dumps(system)).vector_field(x), system.vector_field(x))
