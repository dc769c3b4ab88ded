"""Torques as inputs: a closed form, and several of them."""

import numpy as np
import pytest

import coadjoint as co

pytestmark = pytest.mark.thinned(3)


@pytest.mark.parametrize("parts", ["auto", "free_body"])
def test_changing_thruster_matches_the_closed_form(parts):
    """A symmetric body with N about its axis: x3 is the integral of N, the phase that of x3 (1/2 - 1)."""
    body = co.systems.rigid_body(inertia=(1.0, 1.0, 2.0)).with_forces(co.forces.Torque((0.0, 0.0, 0.0)))
    ready = co.prepare(body, co.Splitting(parts=parts), 0.125, inputs={"thruster": "Torque"})
    x, spin, phase = np.array([0.5, -0.2, 0.8]), 0.8, 0.0
    start = x[0] + 1j * x[1]
    for k, N in enumerate((0.4, 0.0, -1.5, 0.75)):
        x = ready.run(x, (0.5 * k, 0.5 * k + 0.5), 4, thruster=(0.0, 0.0, N)).x[-1]
        phase += -0.5 * (0.5 * spin + N * 0.125)
        spin += 0.5 * N
    assert abs(x[2] - spin) < 64 * 2.0**-53
    assert abs(x[0] + 1j * x[1] - start * np.exp(-1j * phase)) < 64 * 2.0**-53
    assert np.array_equal(ready.run(x, (0, 1)).x, co.integrate(body, x, (0, 1), 0.125, ready.method).x)


NAMES = ({"one": "Torque", "two": "Torque 2", "three": "Torque 3"}, {"three": "Torque 3", "one": "Torque"})


@pytest.mark.parametrize("method", [co.Splitting(), co.GaussLegendre(2)], ids=str)
@pytest.mark.parametrize("names", NAMES, ids=len)
def test_each_of_several_torques_has_its_own_place(names, method):
    """In any order of names, beside a force that is no input; alone, as final states and in a batch."""

    def steered(torques, inertia=(1.0, 2.0, 3.0)):
        first, second, third = torques
        forces = co.forces.Torque(first), co.forces.LinearDamping(0.1), co.forces.Torque(second)
        return co.systems.rigid_body(inertia).with_forces(*forces, co.forces.Torque(third))

    own = np.array([[0.3, -0.1, 0.2], [-0.4, 0.5, 0.1], [0.6, 0.2, -0.7]])
    given = dict(zip(("one", "two", "three"), np.roll(own, 1, axis=0) + 0.25, strict=True))
    taken = {name: given[name] for name in names}
    torques = [taken.get(name, value) for name, value in zip(given, own, strict=True)]
    x, span, h = np.array([0.5, -0.2, 0.8]), (1.0, 2.0), 0.125
    ready = co.prepare(steered(own), method, h, inputs=names)
    wanted = co.integrate(steered(torques), x, span, h, method).x
    np.testing.assert_array_equal(ready.run(x, span, **taken).x, wanted)
    np.testing.assert_array_equal(ready.end(x, span, **taken), wanted[-1])
    other = (1.0, 2.5, 3.0)
    together = co.prepare(co.batch([steered(own), steered(-own, other)]), method, h, inputs=names).run(x, span, **taken)
    negative = [taken.get(name, -value) for name, value in zip(given, own, strict=True)]
    np.testing.assert_array_equal(together.x[:, 0], wanted)
    np.testing.assert_array_equal(together.x[:, 1], co.integrate(steered(negative, other), x, span, h, method).x)


def test_torques_on_several_bodies_have_their_own_places():
    own = np.arange(12.0).reshape(2, 2, 3) / 16.0
    given = {"one": own[0] - 0.5, "two": 0.25 - own[1]}

    def pushed(torques):
        return co.systems.bodies(((1.0, 2.0, 2.5), (2.0, 1.5, 3.0))).with_forces(*map(co.forces.Torque, torques))

    ready = co.prepare(pushed(own), co.Splitting(), 0.125, inputs={"two": "Torque 2", "one": "Torque"})
    wanted = pushed(given.values())
    x, span = wanted.state(own[1], angular_velocities=own[0]), (0.0, 1.0)
    expected = co.integrate(wanted, x, span, 0.125, co.Splitting()).x
    np.testing.assert_array_equal(ready.run(x, span, **given).x, expected)
