"""Linear terms, polynomials and formulas inside Hamiltonians, signatures of functions, and failing functions of JAX."""

import functools
import math

import mpmath as mp
import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.tables.invariants import invariants_table
from coadjoint.kernels.tables.recording import values_along
from coadjoint.systems.coefficients import linear_of, with_linear
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.hamiltonians.sum_of_hamiltonians import polynomial_of
from coadjoint.systems.hamiltonians.user_hamiltonian import JaxFunction
from coadjoint.systems.user_functions import takes_time

X = np.array([0.3, -0.7, 1.1, 0.4])


def cosh():
    """A function without a linear term."""
    return co.Separable({0: (np.cosh, np.sinh, np.cosh)})


LINES = {  # Hamiltonians of four coordinates, even but for their linear terms
    "quadratic": lambda: co.Quadratic(np.diag([1.0, 2.0, -1.0, 0.5]), linear=[0.5, 0.0, -1.5, 2.0], constant=0.75),
    "polynomial": lambda: co.Polynomial("1.5*x1^2*x3^2 - 0.5*x1 + 3*x4 + x2^2", dim=4),
    "separable": lambda: co.Separable({1: (np.cosh, np.sinh, np.cosh), 3: (np.cosh, np.sinh, np.cosh)}),
    "split": lambda: co.SplitHamiltonian(
        [((3, 1), co.Quadratic([1.0, 2.0], linear=[2.0, -0.5])), ((0,), cosh()), ((2,), co.Quadratic(1.0, [0.5]))]
    ),
    "split in a split": lambda: co.SplitHamiltonian(
        [((3, 1), co.SplitHamiltonian([((1, 0), co.Quadratic([0.5, 1.0], linear=[1.0, -3.0]))]))]
    ),
    "split, separable and polynomial": lambda: LINES["split"]() + LINES["separable"]() + LINES["polynomial"](),
}


@pytest.mark.parametrize("kind", LINES)
def test_another_linear_term_changes_nothing_else(kind):
    system = co.LiePoissonSystem(co.LieAlgebra.from_brackets(4, {}), LINES[kind](), casimirs={})
    H, x = system.hamiltonian, np.array([0.3, -0.7, 1.1, 0.4])
    old = H.gradient(np.zeros(4))
    np.testing.assert_array_equal(linear_of(H), old)
    for new in (np.array([0.5, 0.0, -2.0, 1.0]), np.zeros(4), old + [0.0, 0.0, 0.0, 1.0], old):
        changed = with_linear(system, new).hamiltonian
        np.testing.assert_allclose(changed.gradient(np.zeros(4)), new, rtol=0, atol=2.0**-50)
        np.testing.assert_allclose(changed.gradient(x) - H.gradient(x), new - old, rtol=0, atol=2.0**-49)
        np.testing.assert_allclose(changed.value(x) - H.value(x), (new - old) @ x, rtol=0, atol=2.0**-48)
        np.testing.assert_array_equal(changed.hessian(x), H.hessian(x))
    np.testing.assert_array_equal(H.gradient(np.zeros(4)), old)


def test_the_polynomial_of_a_hamiltonian_has_all_of_its_parts():
    split = co.SplitHamiltonian(
        [
            ((2, 0), co.Quadratic([[1.0, 0.5], [0.5, 3.0]], linear=[0.25, -1.0], constant=-4.0)),
            ((1, 2), co.Polynomial("1/3*x1*x2^2 + 2", dim=2)),
            ((0,), co.Quadratic(2.0, linear=[1.0], constant=0.5)),
        ]
    ).bind(3)
    np.testing.assert_array_equal(linear_of(split), split.gradient(np.zeros(3)))
    both = as_hamiltonian(split + co.Polynomial({(1, 1, 1): 2.0, (0, 0, 0): 7.0}, dim=3), 3)
    for H in (split, both, as_hamiltonian(co.Quadratic(3.0, constant=1.0), 3)):
        polynomial = polynomial_of(H)
        for x in (np.zeros(3), X[:3], -2 * X[:3]):
            assert polynomial(x) == pytest.approx(H.value(x), rel=1e-14)
    assert polynomial_of(as_hamiltonian(split + co.Separable({0: (np.cosh, np.sinh)}), 3)) is None


def test_the_kernels_have_the_formula_and_its_multiples():
    """Value, slope and curvature of each function by its tables, also of 3 H: rounding of a few operations."""
    mass, kappa = 0.7, 1.25
    system = co.systems.separable_cosh("A3,7", (1.0, mass, -0.3), kappa, {"a": 1.5})
    points = np.concatenate([np.linspace(-3.0, 3.0, 25), [1e-12, -1e-5, 40.0, 565.0]])
    with mp.workdps(40):
        exact = {
            "value": [mass * 2 * (mp.sinh(mp.mpf(kappa * y) / 2) / kappa) ** 2 for y in points],
            "gradient": [mass * mp.sinh(mp.mpf(kappa * y)) / kappa for y in points],
            "hessian": [mass * mp.cosh(mp.mpf(kappa * y)) for y in points],
        }
    for factor, hamiltonian in ((1.0, system.hamiltonian), (3.0, 3.0 * system.hamiltonian)):
        term = hamiltonian.functions()[1]
        for which, wanted in exact.items():
            table = invariants_table([(which, co.Invariant(getattr(term, which)))], 1)
            found = np.empty((len(points), 1, 1))
            values_along(table.tables, points[:, None, None], np.zeros(len(points)), found)
            expected = [float(factor * number) for number in wanted]
            np.testing.assert_allclose(found[:, 0, 0], expected, rtol=2.0**-53 * 24)


class Callable:
    def __call__(self, x, t):
        return t * x


SIGNATURES = [  # a function, whether it takes the time
    (lambda x: x, False),
    (lambda x, t: x, True),
    (lambda y, s: y, True),
    (lambda x, m=2.0: x, False),
    (lambda x, t=0.0: x, True),
    (lambda x, m=2.0, t=0.0: x, False),
    (lambda x, *rest: x, False),
    (lambda x, *, m=2.0: x, False),
    (np.sin, False),
    (np.hypot, True),
    (math.sin, False),
    (Callable(), True),
    (functools.partial(lambda m, x: m * x, 2.0), False),
    (functools.partial(lambda m, x, t: m * x, 2.0), True),
    (np.linalg.norm, False),
]


@pytest.mark.parametrize(("function", "timed"), SIGNATURES)
def test_which_functions_take_the_time(function, timed):
    assert takes_time(function, "f") is timed


def test_errors_in_functions_of_jax_end_the_run(monkeypatch):
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    system = co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(lambda x: jax.numpy.sum(jax.numpy.cosh(x))))
    ready = co.prepare(system, co.GaussLegendre(1), step=0.1)
    step = co.stepper(system, co.GaussLegendre(1), 0.1)
    _, pullback = ready.vjp((1.0, 0.2, 0.5), (0, 1))
    plain, remaining = JaxFunction.__call__, []

    def failing(self, x, t=0.0):
        if not remaining:
            raise OSError("the disk is gone")
        remaining.pop()
        return plain(self, x, t)

    monkeypatch.setattr(JaxFunction, "__call__", failing)
    for call in (
        lambda: ready.run((1.0, 0.2, 0.5), (0, 1)),
        lambda: ready.jvp((1.0, 0.2, 0.5), (0, 1), {"x0": np.eye(3)}),
        lambda: pullback(np.ones((11, 3))),
        lambda: step((1.0, 0.2, 0.5)),
        lambda: step.tangent((1.0, 0.2, 0.5)),
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
