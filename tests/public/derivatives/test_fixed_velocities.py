"""Derivatives by masses and inertias at fixed velocities: those of system.state(velocities), and of runs from it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from refusals import refused

S = co.systems
TURN, SPIN = Rotation.from_rotvec((0.3, -0.2, 0.4)), np.array([0.3, 0.5, -0.2])
PLACES, SPEEDS = [(0.0, 0, 0), (4.0, 1, 0)], [(0.0, -0.02, 0.01), (0.05, 0.3, -0.2)]
WHEELS, GYROS = 0.05 * np.eye(3)[:2], [[(0.3, 0, 0), (0, 0.3, 0)]]


def pair(masses=(3.0, 0.5), inertias=((1.0, 2.0, 2.5), (0.1, 0.15, 0.2))):
    system = S.bodies(inertias, masses)
    return system, system.state(PLACES, SPEEDS, [TURN, TURN.inv()], [SPIN, -SPIN])


def rods(masses=(3.0, 0.5)):
    system = S.bodies([(1.0, 1.0, 0.0), (0.0, 0.0, 0.0)], masses)
    return system, system.state(PLACES, SPEEDS, [TURN, TURN], [(0.3, 0.5, 0.0), (0.0, 0.0, 0.0)])


def rotors(inertia=(1.0, 2.0, 2.5), wheels=WHEELS):
    system = S.body(inertia, wheels=wheels, gyros=GYROS)
    return system, system.state(TURN, SPIN, wheel_speeds=(3.0, -2.0), gimbal_angles=(0.4,))


def top(inertia=(1.0, 2.0, 2.5)):
    system = S.heavy_top(inertia)
    return system, np.r_[system.momentum(SPIN), TURN.as_matrix()[2]]


def on_orbit(inertia=(1.0, 2.0, 2.5), mean_motion=0.7):
    system = S.satellite_on_orbit(inertia, mean_motion)
    return system, system.state(TURN, SPIN)


def tensor(inertia=((1.0, 0.1, 0.0), (0.1, 2.0, 0.2), (0.0, 0.2, 2.5))):
    system = S.body(inertia)
    return system, system.state(TURN, SPIN)


CASES = {
    "masses": (pair, "masses"),
    "inertias": (pair, "inertias"),
    "masses of a rod and a point": (rods, "masses"),
    "inertia with rotors": (rotors, "inertia"),
    "wheels": (rotors, "wheels"),
    "inertia of a top": (top, "inertia"),
    "inertia on an orbit": (on_orbit, "inertia"),
    "mean motion": (on_orbit, "mean_motion"),
    "a tensor": (tensor, "inertia"),
}
METHOD, H, SPAN = co.Splitting(), 1 / 8, (0.5, 1.5)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("case", CASES)
def test_states_and_runs_at_fixed_velocities(case):
    """Of states by differences of order four, and of runs by the chain rule; by default that of x0 is zero."""
    build, name = CASES[case]
    system, x0 = build()
    ready = co.prepare(system, METHOD, H)
    value, d = ready.parameters[name], 2.0**-8
    direction = np.cos(1.0 + np.arange(value.size)).reshape(value.shape) * np.where(value, np.abs(value), 0.0)
    direction = 0.5 * (direction + direction.T) if case == "a tensor" else direction
    tangents = ready.jvp(x0, SPAN, {name: direction}, 8, fixed="velocity")[1]
    near = [build(**{name: value + k * d * direction})[1] for k in (-2, -1, 1, 2)]
    wanted = (near[0] - 8 * near[1] + 8 * near[2] - near[3]) / (12 * d)
    np.testing.assert_allclose(tangents.x[0], wanted, rtol=0, atol=1e-9 * max(1.0, np.abs(wanted).max()))
    at_momentum = ready.jvp(x0, SPAN, {name: direction}, 8)[1].x
    through = ready.jvp(x0, SPAN, {"x0": wanted}, 8)[1].x
    np.testing.assert_allclose(tangents.x[-1], at_momentum[-1] + through[-1], rtol=0, atol=1e-8)
    row = np.sin(1.0 + np.arange(system.dim))
    gradient = ready.vjp(x0, SPAN, 8, fixed="velocity")[1](x=[0 * row, row])
    assert np.sum(gradient[name] * direction) == pytest.approx(row @ tangents.x[-1], rel=1e-9, abs=1e-10)
    assert not at_momentum[0].any()


@pytest.mark.long
def test_a_moon_by_its_mass():
    """The semi-major axis of a light moon of given velocity does not depend on its mass; at fixed momentum it does."""
    system = S.gravitating_bodies([(0.0, 0.0, 0.0)] * 2, [1.0, 1e-6])
    x0 = system.state([(0, 0, 0), (1, 0, 0)], [(0, 0, 0), (0, 1.1, 0)])
    ready, light = co.prepare(system, METHOD, 1 / 32), {"masses": [0.0, 1e-6]}
    place = system.dim - 4 + np.arange(3)
    moved = [ready.jvp(x0, (0, 1), light, 32, fixed=kept)[1].x[-1, place] for kept in ("velocity", "momentum")]
    assert np.abs(moved[0]).max() < 1e-5 < 0.1 < np.abs(moved[1]).max()


def test_members_batches_and_refusals():
    builds = [pair(), pair(masses=(2.0, 0.7))]
    batch = co.prepare(co.batch([system for system, _ in builds]), METHOD, H)
    x0 = np.stack([x for _, x in builds])
    directions = np.array([[1.0, 0.2], [0.3, -0.4]])
    tangents = batch.jvp(x0, SPAN, {"masses": directions}, 8, fixed="velocity")[1]
    row = np.ones((2, 2, x0.shape[1]))
    gradient = batch.vjp(x0, SPAN, 8, fixed="velocity")[1](x=row)
    for m, (system, x) in enumerate(builds):
        ready = co.prepare(system, METHOD, H)
        own = ready.jvp(x, SPAN, {"masses": directions[m]}, 8, fixed="velocity")[1]
        np.testing.assert_allclose(tangents.x[:, m], own.x, rtol=1e-12, atol=1e-13)
        single = ready.vjp(x, SPAN, 8, fixed="velocity")[1](x=row[:, m])
        np.testing.assert_allclose(gradient["masses"][m], single["masses"], rtol=1e-11)
    spins = co.prepare(S.spin_lattice(), co.SphericalMidpoint(), H)
    with refused(TypeError, "velocity", "spin_lattice", "momenta"):
        spins.jvp((1.0, 0, 0, 0, 1, 0), SPAN, {"exchange": 1.0}, fixed="velocity")
    with refused(ValueError, "fixed", "velocities"):
        batch.vjp(x0, SPAN, fixed="velocities")
