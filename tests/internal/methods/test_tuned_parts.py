"""Parts for a state: the error that the term of order h^2 makes along a short orbit."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.numerics.tuned_parts import propagated_brackets, short_orbit
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.second_order import (
    order_weights,
)
from long import long_beyond


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
