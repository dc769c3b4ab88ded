"""Correctors make the energy of the output wander less, and suggested steps keep it, as much as they say."""

import numpy as np
import pytest

import coadjoint as co
from long import long_where
from refusals import refused


def systems():
    rng = np.random.default_rng(1)
    full = rng.standard_normal((6, 6))
    return {
        "body": co.systems.rigid_body(inertia=(1, 2, 3)),
        "body, full": co.systems.rigid_body(((2.0, 0.3, 0.1), (0.3, 3.0, 0.2), (0.1, 0.2, 4.0))),
        "field": co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(np.zeros(3), linear=(1.0, 2.0, 0.5))),
        "top": co.LiePoissonSystem(
            co.algebras.e(3), co.Quadratic([1, 1.3, 0.7, 0, 0, 0], linear=[0, 0, 0, 0.1, 0.2, 1]), -1
        ),
        "so(4)": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(rng.uniform(0.5, 2, 6))),
        "so(4), full": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(full @ full.T / 6 + np.eye(6)), -1),
        "A3,7": co.LiePoissonSystem(co.algebras.get("A3,7", a=2.0), co.Quadratic((1, 2, 0.01)), -1),
    }


def spreads(system, scheme, x0, h, count):
    better = co.make_corrector(system, scheme, x0)
    run = co.integrate(system, better.inverse(x0, h), (0, count * h), h, scheme)
    output = np.array([system.energy(x) for x in better(run.x, h)])
    return better, np.ptp(run.energy), np.ptp(output)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", list(systems()))
def test_the_energy_of_the_output_wanders_less(name):
    """By the part that remains, up to the next term, which is of two orders higher: so at a small step."""
    system = systems()[name]
    x0 = np.random.default_rng(7).standard_normal(system.dim)
    rate = np.linalg.norm(system.vector_field(x0)) / np.linalg.norm(x0)
    better, plain, corrected = spreads(system, co.Splitting(), x0, 0.01 / rate, 1500)
    assert better.remaining < 0.5
    assert corrected < (2.0 * better.remaining + 0.05) * plain


def test_a_corrector_that_moves_states_far_is_undone_by_its_inverse():
    """By four times their size: an iteration of one step would end in another solution of its equations."""
    M = [[0.64, 0.3, 0.16, 0.02, -0.14], [0.3, 0.18, -0.42, -0.11, -0.23], [0.16, -0.42, -0.04, 0.47, 0.31]]
    M = co.Quadratic(np.array([*M, [0.02, -0.11, 0.47, 1.18, -0.44], [-0.14, -0.23, 0.31, -0.44, 1.64]]))
    system, x0 = co.LiePoissonSystem(co.algebras.get("A5_30", a=0.5), M, sign=-1), [0.702, -0.672, 0.709, -0.71, -0.881]
    better = co.make_corrector(system, co.Splitting(order=1, adjoint=True), x0)
    assert np.abs(better(better.inverse(x0, -0.125), -0.125) - x0).max() < 1e-13


@pytest.mark.parametrize(("order", "expected"), [(2, 4), (4, 6)])
def test_where_the_term_can_be_undone_the_order_is_two_higher(order, expected):
    """Of a spin in a field all brackets are linear, and what is left is along the field."""
    system, x0 = systems()["field"], np.array([0.3, -1.0, 0.8])
    found = [spreads(system, co.Splitting(order=order), x0, h, 400)[2] for h in (0.1, 0.05)]
    assert np.log2(found[0] / found[1]) == pytest.approx(expected, abs=0.1)
    assert co.make_corrector(system, co.Splitting(order=order), x0).remaining < 1e-13


@pytest.mark.thinned(3)
@pytest.mark.parametrize("h", [0.05, -0.05])
@pytest.mark.parametrize("name", ["body", "top", "A3,7"])
def test_a_corrector_is_undone_by_its_inverse_and_keeps_casimirs(name, h):
    system = systems()[name]
    x0 = np.random.default_rng(8).standard_normal(system.dim)
    better = co.make_corrector(system, co.Splitting(), x0)
    moved = better(x0, h)
    # The flow of G over h^2 by one step of order four: what it leaves is of the order (h^2)^5.
    assert np.max(np.abs(better.inverse(moved, h) - x0)) < 1e-13 * np.linalg.norm(x0)
    assert np.max(np.abs(moved - x0)) > 1e-7
    for casimir in system.casimirs.values():
        value, gradient = getattr(casimir, "value", casimir), casimir.gradient(x0)
        bound = 1e-11 * np.linalg.norm(np.asarray(gradient, dtype=float)) * np.linalg.norm(x0)
        assert abs(float(value(moved)) - float(value(x0))) <= bound


@pytest.mark.parametrize("order", [1, 2, 4])
def test_a_step_back_moves_the_output_by_the_power_of_the_step(order):
    """The flow of G takes h^p: of odd order that of -h is the inverse of that of h, of even order it is the same."""
    system, x0 = systems()["body"], np.array([[1.0, 0.2, 0.5], [0.3, -0.4, 0.8]])
    better = co.make_corrector(system, co.Splitting(order=order), x0)
    forward, back = better(x0, 0.2), better(x0, -0.2)
    assert np.max(np.abs(forward - x0)) > 1e-9
    np.testing.assert_array_equal(back, better.inverse(x0, 0.2) if order % 2 else forward)


def test_shapes_and_refusals():
    body, x0 = systems()["body"], (1.0, 0.2, 0.5)
    better, other = (co.make_corrector(body, co.Splitting(), starts) for starts in ([x0, (5, 5, 9)], [(5, 5, 9), x0]))
    assert other.remaining == pytest.approx(better.remaining, rel=1e-3) and better.order == 2
    states = np.random.default_rng(0).standard_normal((4, 5, 3))
    assert better(states, 0.1).shape == (4, 5, 3)
    assert np.array_equal(better(states, 0.1)[2, 3], better(states[2, 3], 0.1))
    assert np.array_equal(better(states, 0.0), states)
    with refused(ValueError, "last axis"):
        better([1.0, 2.0], 0.1)
    with refused(TypeError, "flows"):
        co.make_corrector(body, co.GaussLegendre(2), x0)
    large = co.LiePoissonSystem(co.algebras.so(8), co.Quadratic(np.arange(1.0, 29.0)))
    with refused(ValueError, "monomials"):
        co.make_corrector(large, co.Splitting(), np.ones(28))
    alone = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic((1.0, 0.0, 0.0)))
    assert co.make_corrector(alone, co.Splitting(), x0).generator.monomials == {}


def time_of_a_radian(system, x0):
    near = system.jacobian(np.asarray(x0, dtype=float))
    speed = np.linalg.norm(system.vector_field(x0)) / np.linalg.norm(x0)
    return 1.0 / max(np.linalg.norm(near @ near) ** 0.5, speed)


SCHEMES = [
    co.Splitting(),
    co.Splitting(order=4),
    co.Splitting(parts="coordinates"),
    co.Composition(co.Splitting(), (0.4, 0.2, 0.4)),
]


@pytest.mark.thinned(3)
@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.parametrize("name", long_where(["so(4), full"], ["body", "top", "so(4), full", "A3,7"]))
def test_the_energy_stays_within_what_was_asked(name, scheme):
    system = systems()[name]
    for seed, wanted in ((1, 1e-4), (2, 1e-6)):
        x0 = np.random.default_rng(seed).standard_normal(system.dim)
        h = co.suggest_step(system, scheme, x0, energy=wanted)
        rate = 1.0 / time_of_a_radian(system, x0)
        count = int(max(2000, 128 / rate / h))
        change = co.integrate(system, x0, (0, count * h), h, scheme, save_every=count).drift()["energy"].absolute
        # The largest change of a longer run is hardly larger, unless the step is that of one radian.
        assert 0.7 * wanted < change < 1.5 * wanted or (h * rate > 0.99 and change < 1.5 * wanted)


def test_a_sample_takes_its_smallest_step():
    body = systems()["body"]
    states = np.random.default_rng(3).standard_normal((4, 3))
    alone = [co.suggest_step(body, co.Splitting(), x, energy=1e-6) for x in states]
    assert len(set(alone)) == 4
    for first in range(4):  # in whichever order they are given
        assert co.suggest_step(body, co.Splitting(), np.roll(states, first, axis=0), energy=1e-6) == min(alone)


def test_energies_that_grow_are_refused():
    body, x0 = systems()["body"], (1, 2, 3)
    driven = co.systems.spin_lattice("chain", 3, field=lambda t: [0, 0, t])
    for error, named, given in (
        (ValueError, "neither the bracket nor the energy", (body, co.ExplicitRungeKutta(), x0, 1e-6)),
        (ValueError, "time", (driven, co.Splitting(), np.ones(9), 1e-6)),
        (TypeError, "one LiePoissonSystem", (co.batch([body, body]), co.Splitting(), x0, 1e-6)),
        (ValueError, "shape", (body, co.Splitting(), (1, 2), 1e-6)),
        (ValueError, "energy", (body, co.Splitting(), x0, 0.0)),
    ):
        with refused(error, named):
            co.suggest_step(*given)
    radian = pytest.approx(time_of_a_radian(body, x0))
    assert co.suggest_step(body, co.Projected(co.Splitting()), x0, energy=1e-6) == radian


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_steps_below_those_that_are_tried_follow_from_the_order(order, factor):
    """On both sides of the least step that is tried, 1/128 of a radian."""
    body, x0, method = systems()["body"], np.array([0.3, -1.1, 0.7]), co.Splitting(order=order)
    h = factor * time_of_a_radian(body, x0) / 128.0
    count = 128 * 256
    change = co.integrate(body, x0, (0, count * h), h, method, save_every=count).drift()["energy"]
    assert co.suggest_step(body, method, x0, energy=change.absolute) == pytest.approx(h, rel=0.02)


def test_functions_as_energies_have_steps():
    def energy(x):
        return 0.5 * (x[0] ** 2 + x[1] ** 2 / 2 + x[2] ** 2 / 3)

    def gradient(x):
        return np.array([x[0], x[1] / 2, x[2] / 3])

    body, x0 = systems()["body"], (1.0, 0.2, 0.5)
    own = co.LiePoissonSystem(
        body.algebra, co.Hamiltonian(energy, gradient, lambda x: np.diag([1.0, 1 / 2, 1 / 3])), body.sign
    )
    steps = [co.suggest_step(system, co.SphericalMidpoint(), x0, energy=1e-5) for system in (own, body)]
    assert steps[0] == pytest.approx(steps[1], rel=1e-6)


def test_of_a_body_the_step_goes_with_the_inverse_of_the_momentum():
    """x(t) -> c x(c t): energies go with c^2; a bound that is never reached leaves the time of one radian."""
    body, x0, factor = systems()["body"], np.array([0.3, -1.1, 0.7]), 30.0
    for energy in (1e-6, 1e9):
        plain = co.suggest_step(body, co.Splitting(), x0, energy=energy)
        scaled = co.suggest_step(body, co.Splitting(), factor * x0, energy=factor**2 * energy)
        assert factor * scaled == pytest.approx(plain, rel=1e-6)
        assert co.suggest_step(body, co.Splitting(), [x0], energy=energy) == plain
        assert co.suggest_step(body, co.Splitting(), [x0, x0 / 9.0], energy=energy) == plain
    assert plain == pytest.approx(time_of_a_radian(body, x0), rel=1e-12)
