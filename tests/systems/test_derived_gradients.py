"""Hamiltonians given by their value alone: derivatives of recorded operations, and by JAX."""

import pickle
import subprocess
import sys
from fractions import Fraction

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.hamiltonians.jax_function import JaxFunction
from coadjoint.systems.hamiltonians.traced_function import (
    BINARY,
    MAX_OPERATIONS,
    UNARY,
    Graph,
    Traced,
    traced,
)

SO3, SE3 = co.algebras.so(3), co.algebras.se(3)
WEIGHTS = np.array([1.0, 0.5, 0.4, 0.3, 0.2, 0.1])
X0 = np.array([1.0, 0.2, 0.5, 0.3, -0.4, 0.2])
MPMATH = {"arcsin": "asin", "arccos": "acos", "arctan": "atan", "arctan2": "atan2"} | {
    f"arc{name}": f"a{name}" for name in ("sinh", "cosh", "tanh")
}


def value(x):
    return 0.5 * x @ (WEIGHTS * x) + 0.1 * np.sum(np.cosh(x))


def gradient(x):
    return WEIGHTS * x + 0.1 * np.sinh(x)


def hessian(x):
    return np.diag(WEIGHTS) + 0.1 * np.diag(np.cosh(x))


def driven(x, t):
    return x[0] * np.cos(t) + x[1] ** 2 * x[2] * np.sin(2 * t)


def in_mpmath(name, *arguments):
    if name == "expm1":
        return mpmath.exp(arguments[0]) - 1
    if name == "exp2":
        return mpmath.mpf(2) ** arguments[0]
    if name in ("log1p", "log2"):
        return mpmath.log(1 + arguments[0]) if name == "log1p" else mpmath.log(arguments[0], 2)
    return getattr(mpmath, MPMATH.get(name, name))(*arguments)


@pytest.mark.parametrize("name", UNARY)
def test_functions_against_50_digits(name):
    at = 1.75 if name == "arccosh" else 0.375
    _, slope, curvature = traced(lambda x: getattr(np, name)(x[0]), 1, False).derivatives()
    with mpmath.workdps(50):
        for order, derived in ((1, slope), (2, curvature)):
            expected = float(mpmath.diff(lambda z: in_mpmath(name, z), at, order))
            assert float(derived(np.array([at])).item()) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("base, exponent", [(-1.5, 3), (-1.5, -2), (1.5, 2.5), (-1.5, 2), (2.0, 1), (3.0, 0.5)])
def test_powers_with_constants(base, exponent):
    _, slope, curvature = traced(lambda x: x[0] ** exponent, 1, False).derivatives()
    x = np.array([base])
    assert slope(x).item() == pytest.approx(exponent * base ** (exponent - 1), rel=1e-15)
    assert curvature(x).item() == pytest.approx(exponent * (exponent - 1) * base ** (exponent - 2), rel=1e-15)


@pytest.mark.parametrize("name", [*BINARY, "constant base"])
def test_operations_of_two_coordinates_against_50_digits(name):
    operations = {
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "div": lambda a, b: a / b,
        "pow": lambda a, b: a**b,
        "constant base": lambda a, b: 2.5**a - b,
    }
    functions = {"arctan2": np.arctan2, "hypot": np.hypot}
    operation = operations.get(name) or functions[name]
    exact = operations.get(name) or (lambda a, b: in_mpmath(name, a, b))
    _, slope, curvature = traced(lambda x: operation(x[0], x[1]), 2, False).derivatives()
    at = 0.875, -1.25
    x = np.array(at)
    with mpmath.workdps(50):
        expected = [float(mpmath.diff(exact, at, n)) for n in ((1, 0), (0, 1))]
        second = [float(mpmath.diff(exact, at, n)) for n in ((2, 0), (1, 1), (0, 2))]
    np.testing.assert_allclose(slope(x), expected, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(curvature(x)[[0, 0, 1], [0, 1, 1]], second, rtol=1e-13, atol=1e-15)
    np.testing.assert_array_equal(curvature(x)[0, 1], curvature(x)[1, 0])


ARRAYS = {
    "matrix": lambda x: 0.5 * x @ np.arange(9.0).reshape(3, 3) @ x,
    "norm": lambda x: np.linalg.norm(x) ** 3,
    "einsum": lambda x: np.einsum("i,ij,j->", x, np.arange(9.0).reshape(3, 3), np.sin(x)),
    "cross": lambda x: np.cross(x, [1.0, 2.0, 3.0]) @ x**2,
    "loop": lambda x: sum(x[k] ** 2 / (k + 1) for k in range(len(x))),
    "product": lambda x: np.prod(x) + np.mean(np.exp(-x)) - x.sum(),
    "constant": lambda x: 3.0,
    "reciprocal": lambda x: np.sum(1 / (2 + np.square(x))) + np.float64(2.0) * x[0],
}


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_against_complex_steps(name):
    """Recorded values are bitwise those of the function up to the order of sums; a complex step has no cancellation."""
    function, x, step = ARRAYS[name], np.array([0.375, -0.5, 1.25]), 2.0**-100
    recorded, slope, curvature = traced(function, 3, False).derivatives()
    assert float(recorded(x)) == pytest.approx(float(function(x)), rel=1e-15)
    steps = 1j * step * np.eye(3)
    if name != "norm":  # of complex numbers it is another function
        np.testing.assert_allclose(slope(x), [np.imag(function(x + e)) / step for e in steps], rtol=1e-14, atol=1e-16)
    else:
        np.testing.assert_allclose(slope(x), 3 * np.linalg.norm(x) * x, rtol=1e-14)
    expected = [np.imag(slope(x + e)) / step for e in steps]
    np.testing.assert_allclose(curvature(x), expected, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize(
    "function, why",
    [
        (lambda x: abs(x[0]), "absolute value"),
        (lambda x: np.abs(x).sum(), "absolute value"),
        (lambda x: x[0] if x[0] > 0 else x[1], "compares"),
        (lambda x: x[0] * (x[0] == 0), "compares"),
        (lambda x: np.maximum(x[0], x[1]), "compares"),
        (lambda x: np.sum(np.array(x, dtype=float)), "plain number"),
        (lambda x: np.floor(x[0]), "plain number"),
        (lambda x: np.nan * x[0], "nan"),
        (lambda x: x[0] % 1, "%"),
        (lambda x: x, "shape"),
        (lambda x: 1j * x[0], "1j"),
    ],
)
def test_refused_functions(function, why):
    with pytest.raises((TypeError, ValueError), match=f"(?s){why}|array|1j") as raised:
        co.Hamiltonian(function).bind(3)
    assert why in str(raised.value) or why == "shape"
    assert "\n" not in str(raised.value)


def test_hessian_without_gradient_is_refused():
    with pytest.raises(TypeError, match="without gradient"):
        co.Hamiltonian(value, hessian=hessian)


def test_number_of_operations_is_limited():
    """First the second derivatives are left out, then the function is refused."""

    def sums(count):
        return lambda x: sum(np.sin((k + 2) * x[0]) for k in range(count))

    graph = Graph()
    for k in range(MAX_OPERATIONS):
        graph.record("variable", k)
    with pytest.raises(TypeError, match=f"more than {MAX_OPERATIONS} operations"):
        graph.record("variable", MAX_OPERATIONS)
    assert traced(sums(MAX_OPERATIONS // 10), 1, False).derivatives()[2] is not None
    with pytest.raises(TypeError, match="hessian="):
        co.Hamiltonian(sums(MAX_OPERATIONS // 6)).bind(1).hessian([0.1])
    with pytest.raises(TypeError, match=r"more than .*; give gradient="):
        co.Hamiltonian(sums(MAX_OPERATIONS // 3)).bind(1)


def test_objects_and_complex_numbers():
    H = co.Hamiltonian(lambda x: 2 * x[0] ** 3 + x[1] * x[0]).bind(2)
    exact = H.gradient(np.array([Fraction(1, 3), Fraction(2)], dtype=object))
    assert exact.tolist() == [Fraction(6, 9) + 2, Fraction(1, 3)]
    np.testing.assert_allclose(H.gradient([1j, 2.0]), [6 * (1j) ** 2 + 2, 1j], rtol=1e-15)
    assert Traced.__hash__ is None


def runs(H, system=SE3, x0=X0, method=None, span=(1.0, -1.0)):
    ready = co.prepare(co.LiePoissonSystem(system, H), method or co.GaussLegendre(2), step=0.05)
    sol, pullback = ready.vjp(x0, span)
    _, tangents = ready.jvp(x0, span, {"x0": np.eye(len(x0))})
    return sol.x, tangents.x, pullback(np.cos(sol.x))["x0"]


FORMS = {
    "recorded": lambda: co.Hamiltonian(value),
    "jax": lambda: co.Hamiltonian(by_jax),
    "multiple": lambda: 2 * co.Hamiltonian(value) / 2,
    "multiple of bound": lambda: 0.5 * (2 * co.Hamiltonian(by_jax).bind(6)),
    "sum": lambda: co.Hamiltonian(value) + co.Hamiltonian(by_jax) - co.Hamiltonian(value),
}


def by_jax(x):
    jnp = pytest.importorskip("jax.numpy")
    return 0.5 * jnp.sum(WEIGHTS * x * x) + 0.1 * jnp.sum(jnp.cosh(x))


@pytest.fixture(scope="module")
def given():
    return runs(co.Hamiltonian(value, gradient, hessian))


@pytest.fixture(autouse=True)
def x64():
    if "jax" in sys.modules:
        import jax

        jax.config.update("jax_enable_x64", True)


@pytest.mark.parametrize("form", FORMS)
def test_runs_and_their_derivatives_are_those_of_given_functions(form, given):
    """In e(3), backward in time. Round-off of a gradient, 2^-52, is repeated in 40 steps."""
    if form != "recorded":
        jax = pytest.importorskip("jax")
        jax.config.update("jax_enable_x64", True)
    for ours, expected in zip(runs(FORMS[form]()), given, strict=True):
        np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-13)


def test_stepper_and_members_of_ensembles():
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    for H in (co.Hamiltonian(value), co.Hamiltonian(by_jax)):
        system = co.LiePoissonSystem(SE3, H)
        members = X0 * np.linspace(0.5, 1.5, 5)[:, None]
        together = co.integrate(system, members, (1, 2), 0.05, co.GaussLegendre(2), threads=2)
        for k, x0 in enumerate(members):
            alone = co.integrate(system, x0, (1, 2), 0.05, co.GaussLegendre(2))
            np.testing.assert_array_equal(together.x[:, k], alone.x)
        step = co.stepper(system, co.GaussLegendre(2), 0.05)
        np.testing.assert_array_equal(step(X0), co.integrate(system, X0, (0, 0.05), 0.05, co.GaussLegendre(2)).x[-1])
        e, columns = 1e-5, np.eye(6)
        differences = np.transpose([(step(X0 + e * c) - step(X0 - e * c)) / (2 * e) for c in columns])
        np.testing.assert_allclose(step.tangent(X0), differences, atol=1e-9)


def test_pieces_of_a_splitting():
    jnp = pytest.importorskip("jax.numpy")
    pieces = [((0,), lambda y: jnp.cosh(y[0])), ((2,), lambda y: y[0] ** 4)]
    ours = co.SplitHamiltonian([(k, co.Hamiltonian(f)) for k, f in pieces])
    exact = co.Separable({0: (np.cosh, np.sinh, np.cosh), 2: (lambda y: y**4, lambda y: 4 * y**3, lambda y: 12 * y**2)})
    for method in (co.Splitting(order=4), co.GaussLegendre(2)):
        results = [runs(H, SO3, X0[:3], method) for H in (ours, exact)]
        for one, other in zip(*results, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-13)


def test_functions_of_time():
    jnp = pytest.importorskip("jax.numpy")
    import jax

    jax.config.update("jax_enable_x64", True)
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


def test_representation_names_the_rule():
    jnp = pytest.importorskip("jax.numpy")
    assert "recorded operations" in repr(co.Hamiltonian(value).bind(6))
    assert "by JAX" in repr(co.Hamiltonian(lambda x: jnp.sum(x)).bind(2))
    assert "derivatives" not in repr(co.Hamiltonian(value, gradient).bind(6))
    assert "derivatives" not in repr(co.Hamiltonian(value))
    np.testing.assert_array_equal(co.Hamiltonian(value).gradient(X0), co.Hamiltonian(value).bind(6).gradient(X0))
    np.testing.assert_array_equal(co.Hamiltonian(value).hessian(X0), co.Hamiltonian(value).bind(6).hessian(X0))


def test_functions_that_jax_refuses():
    jnp = pytest.importorskip("jax.numpy")
    with pytest.raises(TypeError, match="JAX cannot trace"):
        co.Hamiltonian(lambda x: jnp.sum(x) * np.cosh(float(x[0]))).bind(2)
    with pytest.raises(TypeError, match="shape"):
        co.Hamiltonian(lambda x: jnp.cosh(x)).bind(2)
    H = co.Hamiltonian(lambda x: jnp.sum(x**2)).bind(2)
    with pytest.raises(TypeError, match="complex128"):
        H.gradient([1j, 0.0])


def test_jax_without_float64_is_refused():
    pytest.importorskip("jax")
    code = (
        "import jax.numpy as jnp, coadjoint as co\n"
        "try:\n    co.Hamiltonian(lambda x: jnp.sum(x)).bind(2)\n"
        "except TypeError as error:\n    assert 'jax_enable_x64' in str(error), error\n"
        "else:\n    raise SystemExit(1)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100)


def test_functions_of_numpy_do_not_import_jax():
    code = (
        "import sys, coadjoint as co\n"
        "co.Hamiltonian(lambda x: x[0] ** 4).bind(2).hessian([1.0, 2.0])\n"
        "assert 'jax' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100)


def test_pickled_functions_of_jax():
    pytest.importorskip("jax")
    H = co.Hamiltonian(by_jax).bind(6)
    H.gradient(X0)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(H)).gradient(X0), H.gradient(X0))


def test_errors_in_functions_of_jax_end_the_run(monkeypatch):
    jax = pytest.importorskip("jax")
    system = co.LiePoissonSystem(SO3, co.Hamiltonian(lambda x: jax.numpy.sum(jax.numpy.cosh(x))))
    ready = co.prepare(system, co.GaussLegendre(1), step=0.1)
    step = co.stepper(system, co.GaussLegendre(1), 0.1)
    _, pullback = ready.vjp(X0[:3], (0, 1))
    plain, remaining = JaxFunction.__call__, []

    def failing(self, x, t=0.0):
        if not remaining:
            raise OSError("the disk is gone")
        remaining.pop()
        return plain(self, x, t)

    monkeypatch.setattr(JaxFunction, "__call__", failing)
    for call in (
        lambda: ready.run(X0[:3], (0, 1)),
        lambda: ready.jvp(X0[:3], (0, 1), {"x0": np.eye(3)}),
        lambda: pullback(np.ones((11, 3))),
        lambda: step(X0[:3]),
        lambda: step.tangent(X0[:3]),
    ):
        remaining[:] = range(20)
        for _ in range(20):  # a step takes a few calls
            try:
                call()
            except OSError as error:
                assert "disk" in str(error)
                break
        else:
            pytest.fail("no error")
