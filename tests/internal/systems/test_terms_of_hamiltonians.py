"""Compiled formulas of functions, signatures of functions, and failing functions of JAX."""

import functools
import math

import mpmath as mp
import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.tables.invariants import invariants_table
from coadjoint.kernels.tables.recording import values_along
from coadjoint.systems.hamiltonians.user_hamiltonian import JaxFunction
from coadjoint.systems.user_functions import takes_time


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
