"""Kahan's method: the polarised equation, the Hirota-Kimura top, many dimensions, and what is refused."""

import numpy as np
import pytest

import coadjoint as co
from drawn_matrices import full
from refusals import refused
from rounding import UNIT_ROUNDOFF

RNG = np.random.default_rng(12)


def on(algebra, sign=1):
    n = algebra.dim
    return co.LiePoissonSystem(algebra, co.Quadratic(full(n, n), linear=np.linspace(-0.3, 0.4, n)), sign=sign)


SYSTEMS = [
    on(co.algebras.e(3), -1),
    on(co.algebras.so(4)),
    on(co.algebras.A3_7(0.7), -1),
    on(co.algebras.get("A5,3")),
    on(co.algebras.sl(3)),
]


@pytest.mark.parametrize("system", SYSTEMS, ids=str)
@pytest.mark.parametrize("h", [0.2, -0.2])
def test_the_difference_is_the_polarised_field(system, h):
    """x' - x = h (2 f((x + x')/2) - f(x)/2 - f(x')/2), an equation that asks for no derivative."""
    x = RNG.uniform(-1, 1, system.dim)
    y = co.stepper(system, co.Kahan(), h)(x)
    f = system.vector_field
    right = h * (2 * f((x + y) / 2) - f(x) / 2 - f(y) / 2)
    size = np.max(np.abs(x)) + np.max(np.abs(y))
    assert np.max(np.abs(y - x)) > 1e-3
    assert np.max(np.abs(y - x - right)) < 64 * system.dim * UNIT_ROUNDOFF * size


def test_the_top_of_hirota_and_kimura_has_its_integral():
    """x_i' = a_i x_j x_k: (1 - e^2 a_3 a_1 x_2^2) / (1 - e^2 a_1 a_2 x_3^2) with e = h/2, though the energy is lost."""
    m, h, x0 = np.array([1.0, 0.5, 0.2]), 0.5, np.array([0.3, 1.0, 0.4])
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(m))
    a = np.array([system.vector_field(1 - unit)[i] for i, unit in enumerate(np.eye(3))])
    sol = co.integrate(system, x0, (0, 500), h, co.Kahan())
    square = (h / 2) ** 2 * sol.x**2
    integral = (1 - a[2] * a[0] * square[:, 1]) / (1 - a[0] * a[1] * square[:, 2])
    assert np.ptp(sol.energy) > 1e-3
    assert np.ptp(integral) < 1000 * 64 * UNIT_ROUNDOFF


def chain(count):
    rows, columns = np.arange(3 * (count - 1)), np.arange(3, 3 * count)
    M = np.zeros((3 * count, 3 * count))
    M[rows, columns] = M[columns, rows] = np.tile([1.0, 0.8, 0.6], count - 1)
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), count), co.Quadratic(M), casimirs={})


def test_many_dimensions_without_a_matrix_give_the_same():
    """300 dimensions, by GMRES, beside the dense formula."""
    system = chain(100)
    x0 = RNG.uniform(-1, 1, 300)
    found = co.stepper(system, co.Kahan(), 0.1)(x0)
    assert np.max(np.abs(found - co.Kahan().step(system, x0, 0.0, 0.1))) < 64 * UNIT_ROUNDOFF * 4
    back = co.stepper(system, co.Kahan(), -0.1)(found)
    assert np.max(np.abs(back - x0)) < 64 * UNIT_ROUNDOFF * 4


def test_a_singular_matrix_is_named():
    """x2' = x2 on [e1, e2] = e2 with H = x1, backward or forward: 1 - h/2 f' = 0 at |h| = 2."""
    system = co.LiePoissonSystem(co.algebras.get("A2,1"), co.Quadratic([0.0, 0.0], linear=[1.0, 1.0]))
    backward = np.sign(system.vector_field(np.array([0.5, 0.5]))[1])
    with refused(co.IntegrationError, "singular"):
        co.integrate(system, (0.5, 0.5), (0, 2 * backward), 2.0, co.Kahan())
