"""The step that short runs suggest keeps the energy as well as it says, and hardly better."""

import numpy as np
import pytest

import coadjoint as co
from long import long_where
from refusals import refused

pytestmark = pytest.mark.thinned(3)


def systems():
    rng = np.random.default_rng(5)
    full = rng.standard_normal((6, 6))
    return {
        "body": co.systems.rigid_body(inertia=(1, 2, 2.5)),
        "top": co.LiePoissonSystem(
            co.algebras.e(3), co.Quadratic(rng.uniform(0.5, 2, 6), linear=rng.normal(size=6)), -1
        ),
        "so(4), full": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(full @ full.T / 6 + np.eye(6))),
        "A3,7": co.LiePoissonSystem(co.algebras.get("A3,7", a=0.3), co.Quadratic((1.0, 2.0, 0.3)), -1),
    }


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


@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.parametrize("name", long_where(["so(4), full"], systems()))
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
        return 0.5 * (x[0] ** 2 + x[1] ** 2 / 2 + x[2] ** 2 / 2.5)

    def gradient(x):
        return np.array([x[0], x[1] / 2, x[2] / 2.5])

    body, x0 = systems()["body"], (1.0, 0.2, 0.5)
    own = co.LiePoissonSystem(
        body.algebra, co.Hamiltonian(energy, gradient, lambda x: np.diag([1.0, 0.5, 0.4])), body.sign
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
