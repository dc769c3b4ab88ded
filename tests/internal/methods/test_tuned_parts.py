"""Parts for a state: the error that the h^2 term makes along a motion is the one that is measured, and the least."""

from functools import partial
from itertools import permutations

import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.numerics import tuned_parts
from coadjoint.methods.numerics.short_orbit import RELATIVE_STEP, rate_at, short_orbit
from coadjoint.methods.numerics.tuned_parts import PartOrderErrors
from coadjoint.program.modified_energy.modified_series import leading_term
from coadjoint.program.modified_energy.second_order import NestedBrackets, Samples
from coadjoint.program.parts.chosen_parts import ChosenParts
from coadjoint.program.parts.decompose import candidates, decompose
from coadjoint.program.parts.split import split
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


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", NAMES)
def test_brackets_with_weights_are_the_second_order_term(name):
    system = systems()[name]
    parts = decompose(system, "auto").parts if name != "body" else split(system, "coordinates")
    points = np.random.default_rng(1).standard_normal((4, system.dim))
    brackets, samples = NestedBrackets(system.algebra, parts), Samples([system.algebra], [parts], points)
    values = brackets.values(points)
    for order in list(permutations(range(len(parts))))[:24]:
        term = samples.second_order_terms([order])[0, 0]
        found = np.einsum("ip,ipk->k", brackets.weights(order), values)
        size = np.einsum("ip,ipk->k", np.abs(brackets.weights(order)), np.abs(values))
        assert np.all(np.abs(found - term) <= 1e-13 * size)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", NAMES)
def test_gradients_are_those_of_the_values(name):
    """Against a complex step's worth of accuracy: differences at two sizes of the step agree to their square."""
    system = systems()[name]
    parts = decompose(system, "auto").parts
    points = np.random.default_rng(2).standard_normal((3, system.dim))
    points[-1] = 0.0  # the origin, which has no size of its own
    brackets, along = NestedBrackets(system.algebra, parts), np.random.default_rng(3).standard_normal(system.dim)
    gradients = brackets.gradients(points)
    h = 1e-3
    one, two = (
        (brackets.values(points + d * along) - brackets.values(points - d * along)) / (2 * d) for d in (h, 2 * h)
    )
    expected = (4 * one - two) / 3
    assert np.max(np.abs(gradients @ along - expected)) <= 1e-7 * np.max(np.abs(gradients))


@pytest.mark.parametrize("name", long_beyond(2, NAMES))
def test_the_predicted_error_is_the_measured_one(name):
    """The run of order 2 differs from the motion by h^2 times the prediction, up to h^4, at two steps."""
    system = systems()[name]
    start = np.random.default_rng(4).standard_normal(system.dim)
    orbit = short_orbit(co.Splitting(order=6), system, start, steps=96)
    parts = decompose(system, "auto")
    errors = PartOrderErrors(system, parts.parts, [orbit])
    order = tuple(range(len(parts.parts)))
    predicted = errors.along(order)[0]
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


@pytest.mark.parametrize(("order", "step"), long_beyond(0, [(2, 0.03), (4, 0.15)]))
def test_tuned_is_seldom_worse_than_automatic(order, step):
    """Over states that nobody looked at; taking the term at the state alone was worse for two in five."""
    rng = np.random.default_rng(2026)
    ratios = []
    for name, system in systems().items():
        # The motions of the cubic one leave every bound; the many parts of the full one take long.
        if name in ("cubic", "so(4), full"):
            continue
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


def test_the_leading_term_is_that_of_the_modified_hamiltonian():
    for name in ("body, full", "top", "A3,7"):
        system = systems()[name]
        for method in (co.Splitting(order=2), co.Splitting(order=4), co.Splitting(scheme="blanes_moan4")):
            expected = co.modified_hamiltonian(system, method, order=2).error_term
            assert expected.power == method.order
            assert leading_term(system, method, method.order) == expected.term


def test_the_automatic_parts_stay_where_nothing_is_better():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    rest = co.Splitting.tuned(body, (0.0, 0.0, 0.0)).parts
    assert rest == decompose(body, "auto").choice


def test_a_motion_that_leaves_float64_is_refused():
    system = systems()["A3,7"]
    with pytest.raises(ValueError, match="cannot be followed"):
        co.Splitting.tuned(system, (1e200, 1e200, 1e200))


def measured(system, start, methods):
    """Return the squares of the largest errors of short runs, relative to the largest momentum."""
    spacing = RELATIVE_STEP / rate_at(system, start)
    given = {"t_span": (0.0, 32 * spacing), "step": spacing / 16, "save_every": 16, "watch": False}
    exact = co.integrate(system, start, method=co.GaussLegendre(6), **given).x
    runs = [co.integrate(system, start, method=method, **given).x for method in methods]
    return np.array([np.max(np.sum((x - exact) ** 2, axis=1)) for x in runs]) / np.max(np.sum(exact**2, axis=1))


@pytest.mark.parametrize(("name", "order", "seed"), [("body, full", 2, 102), ("body", 4, 100)])
def test_several_states_have_the_parts_with_the_least_error_of_all_of_them(monkeypatch, name, order, seed):
    """In whatever order they are given; for one of them alone other parts are better."""
    monkeypatch.setattr(tuned_parts, "short_orbit", partial(short_orbit, steps=32))
    system, starts = systems()[name], np.random.default_rng(seed).standard_normal((2, 3))
    every = [
        co.Splitting(order=order, parts=ChosenParts(places, candidate.shift))
        for candidate in candidates(system)
        for places in permutations(range(len(candidate.parts)))
    ]
    errors = np.array([measured(system, start, every) for start in starts])
    together = np.sqrt(errors.sum(axis=0))
    best = np.argmin(together)
    assert max(together[np.argmin(errors, axis=1)]) > 1.05 * together[best]
    for given in (starts, starts[::-1]):
        assert co.Splitting.tuned(system, given, order=order) == every[best]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", ["body, full", "A3,7"])
@pytest.mark.parametrize("limit", ["MAX_ORBIT_DIMENSION", "MAX_ORDERED"])
def test_several_states_of_systems_that_are_not_searched(monkeypatch, limit, name):
    """The order of the states does not matter, where each of them alone has other parts."""
    monkeypatch.setattr(tuned_parts, "short_orbit", partial(short_orbit, steps=32))
    monkeypatch.setattr(tuned_parts, limit, 1)
    system, starts = systems()[name], np.random.default_rng(104).standard_normal((2, 3))
    assert co.Splitting.tuned(system, starts[0]) != co.Splitting.tuned(system, starts[1])
    assert co.Splitting.tuned(system, starts) == co.Splitting.tuned(system, starts[::-1])
