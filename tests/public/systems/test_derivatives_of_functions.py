"""Hamiltonians given by their value alone: derivatives of recorded operations, and by JAX."""

import pickle
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

SO3, SE3 = co.algebras.so(3), co.algebras.se(3)

WEIGHTS = np.array([1.0, 0.5, 0.4, 0.3, 0.2, 0.1])

X0 = np.array([1.0, 0.2, 0.5, 0.3, -0.4, 0.2])


def value(x):
    return 0.5 * x @ (WEIGHTS * x) + 0.1 * np.sum(np.cosh(x))


def gradient(x):
    return WEIGHTS * x + 0.1 * np.sinh(x)


def hessian(x):
    return np.diag(WEIGHTS) + 0.1 * np.diag(np.cosh(x))


def driven(x, t):
    return x[0] * np.cos(t) + x[1] ** 2 * x[2] * np.sin(2 * t)


UNARY = (
    "sin cos tan arcsin arccos arctan sinh cosh tanh arcsinh arccosh arctanh exp expm1 exp2 log log1p log2 log10 sqrt"
)


def recorded(function, n):
    return co.Hamiltonian(function).bind(n)


def inside(name):
    """Return a function of one name, whose argument is moved where it is defined: sample points are anywhere."""
    low, high = {"arccosh": (1.25, 0.5), "arcsin": (0.0, 0.5), "arccos": (0.0, 0.5), "arctanh": (0.0, 0.5)}.get(
        name, (0.125, 0.25)
    )
    return lambda x: getattr(np, name)(low + high / (1 + x[0] * x[0]))


FUNCTIONS = {name: (inside(name),) * 2 for name in UNARY.split()} | {
    # a function, and the same one of complex numbers
    "power": (lambda x: (x[0] * x[0]) ** x[1], lambda x: np.exp(x[1] * np.log(x[0] * x[0]))),
    "whole powers": (lambda x: x[1] ** 3 - x[1] ** -2,) * 2,
    "other power": (lambda x: x[2] ** 2.5 - x[0] ** 0.5,) * 2,
    "constant base": (lambda x: 2.5 ** x[0] - x[1],) * 2,
    "cbrt": (lambda x: np.cbrt(x[2]), lambda x: x[2] ** (1 / 3)),
    "arctan2": (lambda x: np.arctan2(x[1], x[0]), lambda x: np.arctan(x[1] / x[0])),
    "hypot": (lambda x: np.hypot(x[0], x[1]), lambda x: np.sqrt(x[0] ** 2 + x[1] ** 2)),
    "norm": (lambda x: np.linalg.norm(x) ** 3, lambda x: (x @ x) ** 1.5),
    "matrix": (lambda x: 0.5 * x @ np.arange(9.0).reshape(3, 3) @ x,) * 2,
    "einsum": (lambda x: np.einsum("i,ij,j->", x, np.arange(9.0).reshape(3, 3), np.sin(x)),) * 2,
    "cross": (lambda x: np.cross(x, [1.0, 2.0, 3.0]) @ x**2,) * 2,
    "loop": (lambda x: sum(x[k] ** 2 / (k + 1) for k in range(len(x))),) * 2,
    "product": (lambda x: np.prod(x) + np.mean(np.exp(-x)) - x.sum(),) * 2,
    "quotient": (lambda x: x[0] / x[1] - 1 / x[2],) * 2,
    "constant": (lambda x: 3.0,) * 2,
    "reciprocal": (lambda x: np.sum(1 / (2 + np.square(x))) + np.float64(2.0) * x[0],) * 2,
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_against_complex_steps(name):
    """Values are those of the function up to the order of sums; a complex step has no cancellation."""
    (function, of_complex), x, step = FUNCTIONS[name], np.array([0.375, -0.5, 1.25]), 2.0**-100
    H, steps = recorded(function, 3), 1j * step * np.eye(3)
    assert H.value(x) == pytest.approx(float(function(x)), rel=1e-15)
    expected = [np.imag(of_complex(x + e)) / step for e in steps]
    np.testing.assert_allclose(H.gradient(x), expected, rtol=1e-13, atol=1e-15)
    if function is of_complex:
        expected = [np.imag(H.gradient(x + e)) / step for e in steps]
    else:  # central differences of gradients, of order four
        h = 2.0**-12
        moved = {k: [H.gradient(x + k * h * e) for e in np.eye(3)] for k in (-2, -1, 1, 2)}
        expected = (8 * np.subtract(moved[1], moved[-1]) - np.subtract(moved[2], moved[-2])) / (12 * h)
    np.testing.assert_allclose(H.hessian(x), expected, rtol=1e-13, atol=1e-15 if function is of_complex else 1e-9)
    np.testing.assert_array_equal(H.hessian(x), H.hessian(x).T)


# Each operation with a constant, and its derivative by the coordinate.
WITH_CONSTANTS = {
    "c + x": (lambda c, x: c + x, lambda c, x: 1.0),
    "x + c": (lambda c, x: x + c, lambda c, x: 1.0),
    "c - x": (lambda c, x: c - x, lambda c, x: -1.0),
    "x - c": (lambda c, x: x - c, lambda c, x: 1.0),
    "c * x": (lambda c, x: c * x, lambda c, x: c),
    "x * c": (lambda c, x: x * c, lambda c, x: c),
    "c / x": (lambda c, x: c / x, lambda c, x: -c / x**2),
    "x / c": (lambda c, x: x / c, lambda c, x: 1 / c),
    "x ** c": (lambda c, x: x**c, lambda c, x: c * x ** (c - 1)),
    "c ** x": (lambda c, x: c**x, lambda c, x: c**x * np.log(c)),
}


@pytest.mark.parametrize("name", WITH_CONSTANTS)
@pytest.mark.parametrize("c", [0, 0.0, 1, 1.0, -1, -1.0, 2, 2.5])
def test_operations_with_constants(name, c):
    """Those with 0, 1 and -1 need not be recorded."""
    operation, slope = WITH_CONSTANTS[name]
    if (name == "x / c" and c == 0) or (name == "c ** x" and c <= 0):
        return
    H, x, y = recorded(lambda x: x[0] * x[1] + operation(c, x[0]) * x[1], 2), 0.75, -0.5
    wanted = [y + slope(c, x) * y, x + operation(c, x)]
    assert H.value(np.array([x, y])) == pytest.approx(x * y + operation(c, x) * y, rel=1e-14, abs=1e-15)
    np.testing.assert_allclose(H.gradient(np.array([x, y])), wanted, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(H.hessian(np.array([x, y]))[0, 1], 1.0 + slope(c, x), rtol=1e-14, atol=1e-15)


def scaled(a, x):
    return a * x


def filled(x):
    y = np.zeros(3)
    for i in range(3):
        y[i] = scaled(i + 1.0, x[i])
    return 0.5 * np.dot(y, x)


def filled_matrix(x):
    M, ones = np.eye(3), np.ones(3)
    M[0, 1], M[2, 2] = x[2], np.sin(x[0])
    ones += x
    return ones @ M @ ones


def filled_by_a_helper(x):
    return filled(x) ** 2 + np.full(2, 0.5) @ x[:2]


@pytest.mark.parametrize("function", [filled, filled_matrix, filled_by_a_helper])
def test_functions_that_fill_new_arrays_have_derivatives(function):
    """Against central differences of order two of NumPy's values, whose third derivatives are below 10^2."""
    H, x, h = recorded(function, 3), np.array([0.3, -0.2, 0.5]), 2.0**-13
    assert H.value(x) == pytest.approx(function(x), rel=1e-14)
    slopes = [(function(x + h * e) - function(x - h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(H.gradient(x), slopes, rtol=0, atol=100 * h**2)
    curvatures = [(H.gradient(x + h * e) - H.gradient(x - h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(H.hessian(x), curvatures, rtol=0, atol=100 * h**2)


def test_number_of_operations_is_limited():
    """First the second derivatives are left out, then the function is refused: beyond 2000 operations."""

    def sums(count):
        return recorded(lambda x: sum(np.sin((k + 2) * x[0]) for k in range(count)), 1)

    assert sums(200).hessian([0.1]).shape == (1, 1)
    with refused(TypeError, "hessian="):
        sums(2000 // 6).hessian([0.1])
    with refused(TypeError, "2000", "gradient="):
        sums(2000 // 3)


def test_objects_and_complex_numbers():
    H = recorded(lambda x: 2 * x[0] ** 3 + x[1] * x[0], 2)
    exact = H.gradient(np.array([Fraction(1, 3), Fraction(2)], dtype=object))
    assert exact.tolist() == [Fraction(6, 9) + 2, Fraction(1, 3)]
    np.testing.assert_allclose(H.gradient([1j, 2.0]), [6 * (1j) ** 2 + 2, 1j], rtol=1e-15)


def runs(H, system=SE3, x0=X0, method=None, span=(1.0, 0.5)):
    ready = co.prepare(co.LiePoissonSystem(system, H), method or co.GaussLegendre(2), step=0.05)
    sol, pullback = ready.vjp(x0, span)
    return sol.x, pullback(np.cos(sol.x))["x0"]


FORMS = {
    "recorded": lambda: co.Hamiltonian(value),
    "jax": lambda: co.Hamiltonian(by_jax),
    "multiple of bound": lambda: 0.5 * (2 * co.Hamiltonian(by_jax).bind(6)),
    "sum": lambda: co.Hamiltonian(value) + co.Hamiltonian(by_jax) - co.Hamiltonian(value),
}


def jax_numpy():
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    return jax.numpy


def by_jax(x):
    jnp = jax_numpy()
    return 0.5 * jnp.sum(WEIGHTS * x * x) + 0.1 * jnp.sum(jnp.cosh(x))


@pytest.fixture(scope="module")
def given():
    return runs(co.Hamiltonian(value, gradient, hessian))


@pytest.mark.thinned(3)
@pytest.mark.parametrize("form", FORMS)
def test_runs_and_their_derivatives_are_those_of_given_functions(form, given):
    """In e(3), backward in time. Round-off of a gradient, 2^-52, is repeated in ten steps."""
    for ours, expected in zip(runs(FORMS[form]()), given, strict=True):
        np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-13)


def test_functions_of_time():
    jnp = jax_numpy()
    expected = co.Hamiltonian(
        driven,
        lambda x, t: np.array([np.cos(t), 2 * x[1] * x[2] * np.sin(2 * t), x[1] ** 2 * np.sin(2 * t)]),
        lambda x, t: 2 * np.sin(2 * t) * np.array([[0.0, 0.0, 0.0], [0.0, x[2], x[1]], [0.0, x[1], 0.0]]),
    )
    in_jax = co.Hamiltonian(lambda x, t: x[0] * jnp.cos(t) + x[1] ** 2 * x[2] * jnp.sin(2 * t))
    reference = runs(expected, SO3, X0[:3])
    for H in (co.Hamiltonian(driven), in_jax):
        for ours, exact in zip(runs(H, SO3, X0[:3]), reference, strict=True):
            np.testing.assert_allclose(ours, exact, rtol=1e-12, atol=1e-13)


def test_functions_that_jax_refuses():
    jnp = jax_numpy()
    with refused(TypeError, "JAX"):
        co.Hamiltonian(lambda x: jnp.sum(x) * np.cosh(float(x[0]))).bind(2)
    with refused(TypeError, "shape"):
        co.Hamiltonian(lambda x: jnp.cosh(x)).bind(2)
    H = co.Hamiltonian(lambda x: jnp.sum(x**2)).bind(2)
    with refused(TypeError, "complex128"):
        H.gradient([1j, 0.0])


@pytest.mark.parametrize(
    "code",
    [
        "import jax.numpy as jnp\ntry:\n    co.Hamiltonian(lambda x: jnp.sum(x)).bind(2)\n"
        "except TypeError as error:\n    assert 'jax_enable_x64' in str(error), error\nelse:\n    raise SystemExit(1)",
        "co.Hamiltonian(lambda x: x[0] ** 4).bind(2).hessian([1.0, 2.0])\nassert 'jax' not in sys.modules",
    ],
    ids=["jax without float64 is refused", "functions of NumPy do not import jax"],
)
def test_in_a_new_process(code):
    pytest.importorskip("jax")
    subprocess.run([sys.executable, "-c", f"import sys, coadjoint as co\n{code}"], check=True, timeout=100)


def test_pickled_functions_of_jax():
    H = co.Hamiltonian(by_jax).bind(6)
    H.gradient(X0)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(H)).gradient(X0), H.gradient(X0))


def differs_from_differences(system, x0, direction, step):
    """Return the error of the tangent of a run against central differences of runs, relative to its size."""
    prepared, eps = co.prepare(system, co.Splitting(), step=step), 1e-5
    _, tangents = prepared.jvp(x0, (0, 10 * step), {"x0": direction}, save_every=10)
    plus, minus = (prepared.run(x0 + e * direction, (0, 10 * step), save_every=10).x[-1] for e in (eps, -eps))
    change = (plus - minus) / (2 * eps)
    return np.abs(tangents.x[-1] - change).max() / np.abs(change).max()


@pytest.mark.long
def test_hessians_of_more_than_a_thousand_entries():
    """Numba takes tuples of 1000: 33 coordinates have 1089 second derivatives. Differences are right to eps^2."""
    n = 33
    kinetic = co.Quadratic(np.r_[np.ones(n), np.zeros(n + 1)])
    potential = co.Hamiltonian(lambda x: np.sin(x[33:66].sum() / 16))
    system = co.LiePoissonSystem(co.algebras.heisenberg(n), kinetic + potential, sign=-1)
    draw = np.random.default_rng(3).standard_normal((2, 2 * n))
    assert differs_from_differences(system, np.r_[draw[0], 1.0], np.r_[draw[1], 0.0], 0.1) < 1e-8


@pytest.mark.long
def test_tangents_of_a_rod_and_a_point_that_attract_each_other():
    """The gradient of their potential is divided into two vectors of 24 derivatives each."""
    pair = co.systems.gravitating_bodies([(0, 1.0, 1.0), (0, 0, 0)], (1.0, 1.0))
    x0 = pair.state([[1.0, 0, 0], [-1, 0.2, 0.1]], [[0, 0.5, 0], [0, -0.5, 0.1]])
    direction = np.r_[np.random.default_rng(1).standard_normal(pair.dim - 1), 0.0]
    assert differs_from_differences(pair, x0, direction, 0.05) < 1e-8
