"""The Riccati equation on sl(2): the roots against its solutions by hand, real, double and complex."""

import numpy as np
import pytest
from two_steps import assert_order, errors_at_two_steps

import coadjoint as co

CASES = [(1.0, 0.0, 1.0), (1.0, 0.0, -1.0), (0.3, -0.7, 0.4), (-0.5, 0.25, 0.75), (0.25, 1.0, 1.0), (0.5, 0.3, 0.0)]


def solution(coefficients, w, t):
    """w(t) by separating the variables, for complex w: with the roots p, q of quadratic w^2 + linear w + constant."""
    c, b, a = coefficients
    if a == 0.0:
        return (w + c / b) * np.exp(b * t) - c / b
    root = np.sqrt(complex(b * b - 4 * a * c))
    p, q = (-b + root) / (2 * a), (-b - root) / (2 * a)
    if root == 0.0:
        return p + 1 / (1 / (w - p) - a * t)
    ratio = (w - p) / (w - q) * np.exp(a * (p - q) * t)
    return (p - q * ratio) / (1 - ratio)


def roots(x):
    return np.roots([x[0], -2 * x[1], -x[2]])


@pytest.mark.parametrize("coefficients", CASES)
@pytest.mark.parametrize("pair", [(0.2, 1.1), (-0.6, 0.4), (0.3 + 0.5j, 0.3 - 0.5j)])
def test_roots_obey_the_equation(coefficients, pair):
    system = co.systems.riccati(*coefficients)
    x0 = np.real([1.0, sum(pair) / 2, -pair[0] * pair[1]])
    for t in (0.4, -0.3, 1.7):
        wanted = np.array([solution(coefficients, w, t) for w in pair])
        distances = np.abs(wanted[:, None] - roots(system.exact(x0, t)))
        nearest = 1e-12 * np.abs(wanted).max()
        assert distances.min(axis=0).max() < nearest and distances.min(axis=1).max() < nearest


def test_field_by_hand():
    c, b, a = 0.3, -0.7, 0.4
    x1, x2, x3 = x = np.array([0.5, -1.2, 0.8])
    system = co.systems.riccati(c, b, a)
    wanted = [-b * x1 - 2 * a * x2, c * x1 + a * x3, -2 * c * x2 + b * x3]
    np.testing.assert_allclose(system.vector_field(x), wanted, rtol=0, atol=1e-15)
    # a root of the moved quadratic moves as the equation says: (x1 w^2 - 2 x2 w - x3)' = 0
    w = (x2 + np.sqrt(x2 * x2 + x1 * x3)) / x1
    d1, d2, d3 = wanted
    assert -(d1 * w * w - 2 * d2 * w - d3) / (2 * (x1 * w - x2)) == pytest.approx(c + b * w + a * w * w, rel=1e-14)
    assert system.energy(x) == pytest.approx(-c * x1 - b * x2 + a * x3) and system.sign == 1
    assert system.casimirs["discriminant"](x) == pytest.approx(x1 * x3 + x2 * x2)


@pytest.mark.parametrize("coefficients", CASES)
def test_runs_and_the_group_element(coefficients):
    system, x0 = co.systems.riccati(*coefficients), np.array([1.0, 0.65, -0.22])
    wanted, g = system.exact(x0, 1.5, attitude=True)
    assert np.linalg.det(g) == pytest.approx(1.0, rel=1e-14)
    moved = complex((g[0, 0] * 0.2 + g[1, 0]) / (g[0, 1] * 0.2 + g[1, 1]))
    assert moved == pytest.approx(solution(coefficients, 0.2, 1.5), rel=1e-12)
    run = co.integrate(system, x0, (0.0, 1.5), 0.05, co.Splitting(order=4), attitude=True)
    coarse = co.integrate(system, x0, (0.0, 1.5), 0.1, co.Splitting(order=4), attitude=True)
    errors = [np.abs(sol.attitude[-1] - g).max() for sol in (coarse, run)]
    assert errors[1] < errors[0] / 8 or errors[0] < 1e-13  # order four; one coefficient alone is one exact flow
    again = system.exact(x0, 1.5, attitude=np.array([[2.0, 1.0], [0.0, 0.5]]))[1]
    np.testing.assert_allclose(again, np.array([[2.0, 1.0], [0.0, 0.5]]) @ g, rtol=1e-14)
    if coefficients == (0.25, 1.0, 1.0):  # a double root: D is nilpotent, and the Cayley transform its exponential
        assert max(errors_at_two_steps(system, x0, 1.5, 0.05, co.GaussLegendre(stages=1), wanted)) < 1e-13
    else:
        assert_order(system, x0, 1.5, 0.05, co.GaussLegendre(stages=1), wanted)


def test_orders_of_a_splitting_into_single_coordinates():
    system, x0 = co.systems.riccati(0.3, -0.7, 0.4), np.array([1.0, 0.65, -0.22])
    wanted = system.exact(x0, 1.5)
    for order in (2, 4):
        assert_order(system, x0, 1.5, 0.125, co.Splitting(order=order, parts="coordinates"), wanted)


def test_through_a_pole():
    system = co.systems.riccati()
    x = system.exact([1.0, 0.0, 0.0], np.linspace(0.0, 3.0, 7))  # both roots start at 0: tan t
    np.testing.assert_allclose(x[:, 1] / x[:, 0], np.tan(np.linspace(0.0, 3.0, 7)), rtol=1e-12, atol=1e-14)
    assert np.isfinite(x).all()


def test_overflow_of_the_closed_form_is_refused():
    with pytest.raises(ValueError, match="the closed form overflows"):
        co.systems.riccati(0.0, 1.0, 0.0).exact([1.0, 0.0, 0.0], -1e4)
