"""`Splitting.tuned`: the parts for given states have the least error of those that are measured."""

from itertools import permutations

import numpy as np
import pytest

import coadjoint as co
from long import long_beyond
from refusals import refused


def systems():
    rng = np.random.default_rng(11)
    e3 = co.algebras.e(3)
    return {
        "body": co.systems.rigid_body(inertia=(1, 2, 2.5)),
        "body, full": co.systems.rigid_body(((2.0, 0.3, 0.1), (0.3, 3.0, 0.2), (0.1, 0.2, 4.0))),
        "top": co.LiePoissonSystem(e3, co.Quadratic(rng.uniform(0.5, 2, 6), linear=rng.normal(size=6)), -1),
        "so(4)": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(rng.uniform(0.5, 2, 6))),
        "A3,7": co.LiePoissonSystem(co.algebras.get("A3,7", a=0.3), co.Quadratic((1.0, 2.0, 0.3)), -1),
    }


@pytest.mark.parametrize(("order", "step"), long_beyond(0, [(2, 0.03), (4, 0.15)]))
def test_tuned_is_seldom_worse_than_automatic(order, step):
    """Over states that nobody looked at; taking the term at the state alone was worse for two in five."""
    rng = np.random.default_rng(2026)
    ratios = []
    for system in systems().values():
        for _ in range(3 if order == 2 else 2):
            start = rng.standard_normal(system.dim)
            rate = np.linalg.norm(system.vector_field(start)) / np.linalg.norm(start) + 0.5
            h = step / rate
            exact = co.integrate(system, start, (0.0, 600 * h), h, co.GaussLegendre(6), save_every=10).x
            methods = (co.Splitting.tuned(system, start, order=order), co.Splitting(order=order))
            runs = (co.integrate(system, start, (0.0, 600 * h), h, method, save_every=10).x for method in methods)
            tuned, auto = (np.max(np.abs(x - exact)) for x in runs)
            ratios.append(tuned / auto)
    assert np.exp(np.mean(np.log(ratios))) < 0.8
    assert np.mean(np.array(ratios) > 1.1) < 0.2


@pytest.mark.parametrize("order", long_beyond(1, [2, 4]))
def test_several_states_have_the_parts_with_the_least_error(order):
    """Of all orders of the coordinates; for one of the states alone another one is better."""
    body, starts = systems()["body"], np.random.default_rng(100).standard_normal((2, 3))
    every = [co.Splitting(order=order, parts=tuple((i,) for i in p)) for p in permutations(range(3))]
    exact = [co.integrate(body, x0, (0, 8), 0.1, co.GaussLegendre(6)).x for x0 in starts]

    def error(method):
        runs = [co.integrate(body, x0, (0, 8), 0.1, method).x for x0 in starts]
        return np.sqrt(sum(np.max(np.sum((x - y) ** 2, axis=1)) for x, y in zip(runs, exact, strict=True)))

    least = min(map(error, every))
    for given in (starts, starts[::-1]):
        assert error(co.Splitting.tuned(body, given, order=order)) < 1.1 * least


@pytest.mark.parametrize("name", ["body, full", "A3,7"])
def test_the_order_of_several_states_does_not_matter(name):
    system, starts = systems()[name], np.random.default_rng(104).standard_normal((2, 3))
    assert co.Splitting.tuned(system, starts) == co.Splitting.tuned(system, starts[::-1])


def test_the_automatic_parts_stay_where_nothing_is_better():
    body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (0.3, 0.5, 0.8)
    tuned = co.Splitting.tuned(body, (0.0, 0.0, 0.0))
    ends = [co.integrate(body, x0, (0, 1), 0.1, method).x for method in (tuned, co.Splitting())]
    assert np.array_equal(*ends)


def test_a_motion_that_leaves_float64_is_refused():
    with refused(ValueError, "cannot be followed"):
        co.Splitting.tuned(systems()["A3,7"], (1e200, 1e200, 1e200))
