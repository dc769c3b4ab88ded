"""Parts for a state: short orbits, and the error that the term of order h^2 makes along them."""

import math
from itertools import permutations

import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.numerics.tuned_parts import propagated_brackets, rate_at, short_orbit
from coadjoint.program.modified_series import leading_term
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.second_order import (
    bracket_gradients,
    nested_brackets,
    order_weights,
    part_derivatives,
)
from coadjoint.program.parts.split import split
from long import long_beyond
from rounding import UNIT_ROUNDOFF as U
from second_order_terms import second_order_term


def full(n, seed=0):
    matrix = np.random.default_rng(seed).standard_normal((n, n))
    return matrix @ matrix.T / n + np.eye(n)


def systems():
    rng = np.random.default_rng(11)
    e3 = co.algebras.e(3)
    cubic = co.Polynomial(
        {(2, 0, 0, 0, 0, 0): 0.5, (0, 2, 0, 0, 0, 0): 0.3, (0, 0, 0, 3, 0, 0): 0.05, (0, 0, 1, 0, 0, 0): 1}
    )
    return {
        "body": co.systems.rigid_body(inertia=(1, 2, 2.5)),
        "body, full": co.systems.rigid_body(((2.0, 0.3, 0.1), (0.3, 3.0, 0.2), (0.1, 0.2, 4.0))),
        "top": co.LiePoissonSystem(e3, co.Quadratic(rng.uniform(0.5, 2, 6), linear=rng.normal(size=6)), -1),
        "cubic": co.LiePoissonSystem(e3, cubic, 1),
        "so(4)": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(rng.uniform(0.5, 2, 6))),
        "so(4), full": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(full(6)), -1),
        "A3,7": co.LiePoissonSystem(co.algebras.get("A3,7", a=0.3), co.Quadratic((1.0, 2.0, 0.3)), -1),
    }


NAMES = list(systems())


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", NAMES)
def test_brackets_with_weights_are_the_second_order_term(name):
    system = systems()[name]
    parts = decompose(system, "auto").parts if name != "body" else split(system, "coordinates")
    points = np.random.default_rng(1).standard_normal((4, system.dim))
    (values,) = nested_brackets(system.algebra, [parts], points)
    for order in list(permutations(range(len(parts))))[:24]:
        term = second_order_term(system.algebra, part_derivatives(parts, points), points, order)
        found = np.einsum("ip,ipk->k", order_weights(order), values)
        size = np.einsum("ip,ipk->k", np.abs(order_weights(order)), np.abs(values))
        assert np.all(np.abs(found - term) <= 1e-13 * size)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", NAMES)
def test_gradients_are_those_of_the_values(name):
    """Against a complex step's worth of accuracy: differences at two sizes of the step agree to their square."""
    system = systems()[name]
    parts = decompose(system, "auto").parts
    points = np.random.default_rng(2).standard_normal((3, system.dim))
    points[-1] = 0.0  # the origin, which has no size of its own
    along = np.random.default_rng(3).standard_normal(system.dim)
    gradients = bracket_gradients(system.algebra, parts, points)

    def values(moved):
        return nested_brackets(system.algebra, [parts], moved)[0]

    h = 1e-3
    one, two = ((values(points + d * along) - values(points - d * along)) / (2 * d) for d in (h, 2 * h))
    expected = (4 * one - two) / 3
    assert np.max(np.abs(gradients @ along - expected)) <= 1e-7 * np.max(np.abs(gradients))


@pytest.mark.parametrize("name", long_beyond(2, NAMES))
def test_the_predicted_error_is_the_measured_one(name):
    """The run of order 2 differs from the motion by h^2 times the prediction, up to h^4, at two steps."""
    system = systems()[name]
    start = np.random.default_rng(4).standard_normal(system.dim)
    orbit = short_orbit(co.Splitting(order=6), system, start, steps=96)
    parts = decompose(system, "auto")
    order = tuple(range(len(parts.parts)))
    predicted = propagated_brackets(system, parts.parts, [orbit])[0] @ order_weights(order).ravel()
    chosen, count = co.Splitting(parts=parts.choice), len(orbit.points) - 1
    relative = []
    for finer in (8, 16):
        h = orbit.spacing / finer
        run = co.integrate(system, start, (0.0, count * finer * h), h, chosen, save_every=finer, watch=False)
        # The orbit itself is of order 6 at its coarse spacing: it starts the comparison, and the exact one ends it.
        exact = co.integrate(system, start, (0.0, count * finer * h), h, co.GaussLegendre(6), save_every=finer).x
        difference = (run.x - exact) / h**2
        relative.append(np.max(np.abs(difference - predicted)) / np.max(np.abs(difference)))
    assert relative[1] < 0.08
    assert relative[1] < 0.35 * relative[0] or relative[1] < 0.02


def test_the_leading_term_is_that_of_the_modified_hamiltonian():
    for name in ("body, full", "top", "A3,7"):
        system = systems()[name]
        for method in (co.Splitting(order=2), co.Splitting(order=4), co.Splitting(scheme="blanes_moan4")):
            expected = co.modified_hamiltonian(system, method, order=2).error_term
            assert expected.power == method.order
            assert leading_term(system, method, method.order) == expected.term


def driven(earlier=0.0):
    """Return a body in a field that varies with time; at the time t as another one at t + earlier."""

    def value(y, t):
        return 0.5 * y * y + math.sin(2.0 * (t + earlier)) * y

    def slope(y, t):
        return y + math.sin(2.0 * (t + earlier))

    def curvature(y, t):
        return 1.0 + 0.0 * y * t

    rest = {
        i: (lambda y, m=m: 0.5 * m * y * y, lambda y, m=m: m * y, lambda y, m=m: m + 0.0 * y)
        for i, m in ((1, 0.75), (2, 1.5))
    }
    return co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (value, slope, curvature), **rest}), sign=-1)


def test_a_short_orbit_begins_at_its_time():
    method, x0 = co.Splitting(parts="coordinates"), np.array([0.4, -0.7, 0.5])
    here, there = short_orbit(method, driven(), x0, 1.25, 16), short_orbit(method, driven(1.25), x0, 0.0, 16)
    assert abs(here.spacing - there.spacing) <= 16 * U * there.spacing
    # Round-off of 16 steps of a motion that turns by a quarter in each.
    assert np.abs(here.points - there.points).max() <= 4096 * U
    assert np.abs(here.tangents - there.tangents).max() <= 4096 * U
    assert np.abs(here.points - short_orbit(method, driven(), x0, 0.0, 16).points).max() > 1e-3


def test_the_rate_is_that_of_the_field_or_of_its_derivative():
    sheared = co.LiePoissonSystem(co.algebras.heisenberg(1), co.Quadratic(np.zeros(3), linear=[2.0, 0.0, 0.0]))
    # The derivative of the field is nilpotent, so that only |f|/|x| counts: x2' = 2 x3, up to its sign.
    assert math.isclose(rate_at(sheared, np.array([0.0, 3.0, 4.0])), 8.0 / 5.0, rel_tol=8 * U)
    body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 2.0, 4.0]))
    # At rest about the first axis, a perturbation turns at the frequency sqrt((2 - 1) (4 - 1)) |x|, in two components.
    assert math.isclose(rate_at(body, np.array([2.0, 0.0, 0.0])), 2.0 * math.sqrt(3.0 * math.sqrt(2.0)), rel_tol=8 * U)
    assert rate_at(sheared, np.zeros(3)) == 1.0
