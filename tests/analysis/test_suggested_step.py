"""The step that the modified Hamiltonian suggests keeps the energy as well as it says, and hardly better."""

import numpy as np
import pytest

import coadjoint as co
from long import long_where

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


@pytest.mark.parametrize("scheme", [co.Splitting(), co.Splitting(order=4), co.Splitting(parts="coordinates")], ids=str)
@pytest.mark.parametrize("name", long_where(["so(4), full"], systems()))
def test_the_energy_stays_within_what_was_asked(name, scheme):
    system = systems()[name]
    for seed, wanted in ((1, 1e-4), (2, 1e-6)):
        x0 = np.random.default_rng(seed).standard_normal(system.dim)
        h = co.suggest_step(system, scheme, x0, energy=wanted)
        # The span that is looked at: 128 quarters of the time in which the motion turns by one.
        near = system.jacobian(x0)
        rate = max(np.linalg.norm(near @ near) ** 0.5, np.linalg.norm(system.vector_field(x0)) / np.linalg.norm(x0))
        count = int(32 / rate / h)
        run = co.integrate(system, x0, (0, count * h), h, scheme, save_every=max(count // 2000, 1))
        # The terms that are left out are of two orders higher, and the largest change may fall between the points.
        assert 0.7 * wanted < np.max(np.abs(run.energy - run.energy[0])) < 1.3 * wanted or h * rate > 0.99


def test_a_sample_takes_its_smallest_step():
    body = systems()["body"]
    states = np.random.default_rng(3).standard_normal((4, 3))
    alone = [co.suggest_step(body, co.Splitting(), x, energy=1e-6) for x in states]
    assert len(set(alone)) == 4
    for first in range(4):  # in whichever order they are given
        assert co.suggest_step(body, co.Splitting(), np.roll(states, first, axis=0), energy=1e-6) == min(alone)


def test_a_tenth_of_a_thousandth_of_the_energy_is_a_tenth_of_the_step():
    """Of order 2: the energy goes like h^2."""
    top, x0 = systems()["top"], np.random.default_rng(4).standard_normal(6)
    steps = [co.suggest_step(top, co.Splitting(), x0, energy=wanted) for wanted in (1e-6, 1e-8)]
    assert steps[0] / steps[1] == pytest.approx(10.0, rel=1e-3)


def test_what_has_no_modified_hamiltonian_is_refused():
    body = systems()["body"]
    with pytest.raises(TypeError, match="flows"):
        co.suggest_step(body, co.GaussLegendre(2), (1, 2, 3), energy=1e-6)
    with pytest.raises(ValueError, match="shape"):
        co.suggest_step(body, co.Splitting(), (1, 2), energy=1e-6)
    with pytest.raises(ValueError, match="energy"):
        co.suggest_step(body, co.Splitting(), (1, 2, 3), energy=0.0)


def test_of_a_body_the_step_goes_with_the_inverse_of_the_momentum():
    """x(t) -> c x(c t): energies go with c^2; a bound that is never reached leaves the time of one radian."""
    body, x0, factor = systems()["body"], np.array([0.3, -1.1, 0.7]), 30.0
    for energy in (1e-6, 1e9):
        plain = co.suggest_step(body, co.Splitting(), x0, energy=energy)
        scaled = co.suggest_step(body, co.Splitting(), factor * x0, energy=factor**2 * energy)
        assert factor * scaled == pytest.approx(plain, rel=1e-6)
        assert co.suggest_step(body, co.Splitting(), [x0], energy=energy) == plain
        assert co.suggest_step(body, co.Splitting(), [x0, x0 / 9.0], energy=energy) == plain
    near = body.jacobian(x0)
    rate = max(np.linalg.norm(near @ near) ** 0.5, np.linalg.norm(body.vector_field(x0)) / np.linalg.norm(x0))
    assert plain == pytest.approx(1.0 / rate, rel=1e-12)
