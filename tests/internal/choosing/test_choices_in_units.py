"""Schemes and steps for an accuracy in other units: how large groups of coordinates are beside others means nothing."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from coadjoint.systems.registry import gallery_entry_of
from long import long_where

# Powers of two near 1e-7 and 1e28, with the same rounding: schemes of nearly the same cost do not change places by it.
UNITS = [1.0, 2.0**-23, 2.0**93]
COST = 2.5
"""Largest ratio of the costs of choices: projections of Taylor series, and orders of parts, depend on the unit."""
BODIES = [1] * 3 + [0] * 9
# Systems whose masses have a unit: the powers of it in the parameters, and in the coordinates.
POWERS = {
    "bodies": ({"inertias": 1, "masses": 1}, BODIES * 2 + [1] * 6 + [0] * 7),
    "body": ({"inertia": 1}, BODIES),
    "double_spherical_pendulum": ({"masses": 1}, [0] * 6 + [1] * 6 + [0]),
    "goryachev_chaplygin_top": ({"equatorial": 1, "lever": 1}, BODIES[:6]),
    "gravitating_bodies": ({"inertias": 1, "masses": 1, "G": -1}, BODIES * 2 + [1] * 6 + [0] * 7),
    "gyrostat": ({"inertia": 1, "rotors": 1}, [1] * 3),
    "heavy_top": ({"inertia": 1, "lever": 1}, BODIES[:6]),
    "kirchhoff_body": ({"inertia": 1, "mass": 1}, [1] * 6),
    "kovalevskaya_top": ({"equatorial": 1, "lever": 1}, BODIES[:6]),
    "lagrange_top": ({"equatorial": 1, "axial": 1, "lever": 1}, BODIES[:6]),
    "paper_rigid_body": ({"masses": -1}, [1] * 3),
    "rigid_body": ({"inertia": 1}, [1] * 3),
    "satellite": ({"inertia": 1, "mass": 1}, [1] * 6 + [0] * 4),
    "satellite_on_orbit": ({"inertia": 1}, BODIES),
    "so_n_body": ({"inertia": 1}, [1] * 6),
}


def in_unit(name, unit):
    """Return a system and the start of its gallery entry, of one member, in a unit of mass."""
    powers, of_state = POWERS[name]
    entry = gallery_entry_of(name)
    parameters = dict(entry.parameters)
    parameters |= {
        key: unit**power * np.array(value)
        for key, value in co.systems.get(name, **parameters).parameters.items()
        if (power := powers.get(key))
    }
    x0 = np.array(entry.start(), dtype=float).reshape(-1, len(of_state))[0]
    return co.systems.get(name, **parameters), x0 * unit ** np.array(of_state)


@pytest.mark.thinned(5)
@pytest.mark.parametrize("span", [(0.0, 20.0), (3.0, -17.0)])
@pytest.mark.parametrize("name", long_where(["double_spherical_pendulum", "gravitating_bodies"], POWERS))
def test_every_unit_has_the_same_choice_and_every_group_its_accuracy(name, span):
    choices = []
    for unit in UNITS:
        system, x0 = in_unit(name, unit)
        choice = co.choose(system, x0, span, 1e-8)
        sol = co.integrate(system, x0, span, choice.step, choice.method, watch=False)
        errors = sol.error_estimate(by_group=True)
        # What starts at zero counts relative to the other components of its vector.
        assert sum(error > 1e-8 for error in errors.values()) <= np.count_nonzero(x0 == 0.0), (unit, errors)
        choices.append(choice)
    for other in choices[1:]:
        assert 1 / COST < other.cost / choices[0].cost < COST, (choices[0], other)


def orbit():
    """Mars and Phobos, in SI units."""
    moments = np.array([[2.7e36, 2.7e36, 2.8e36], [4e23, 5e23, 5.5e23]]) * 1e-7
    pair = co.systems.gravitating_bodies(moments, np.array([6.4e23, 1.07e16]) * 1e-7, 6.6743e-4)
    spins = [[0, 0, 7.088e-5], [0, 1e-6, 2.28e-4]]
    return pair, pair.state([[0, 0, 0], [9.376e6, 0, 0]], [[0, 0, 0], [0, 2138.0, 0]], angular_velocities=spins), 2e4


def tumbling(*inertia):
    """A small body, in SI units."""
    body = co.systems.body(inertia)
    return body, body.state([0.1, 0.1, 0.7, 0.7], angular_velocity=(0.01, 0.02, 0.05)), 600.0


SMALL_BESIDE_LARGE = {
    "5 g": lambda: tumbling(5e-7, 5e-7, 1e-6),
    "3U CubeSat": lambda: tumbling(0.005, 0.03, 0.031),
    "Mars and Phobos": orbit,
}


@pytest.mark.parametrize("name", SMALL_BESIDE_LARGE)
def test_small_coordinates_beside_large_ones_reach_their_accuracy(name):
    """Where the attitude has the size one, and momenta a millionth or 10^19; against a fine run of another scheme."""
    system, x0, time = SMALL_BESIDE_LARGE[name]()
    sol = co.integrate(system, x0, (0, time), accuracy=1e-9, watch=False)
    fine = co.integrate(system, x0, (0, time), time / 2**11, co.GaussLegendre(6), watch=False)
    three = np.linalg.norm((sol.x[-1] - fine.x[-1])[:12].reshape(-1, 3), axis=1)
    assert (three <= 1e-9 * np.linalg.norm(x0[:12].reshape(-1, 3), axis=1)).all()


def test_a_group_that_is_zero_but_for_rounding_refuses_no_accuracy():
    """A body at rest in the middle of a planar orbit: what turns it is the rounding of a torque."""
    satellite = co.systems.satellite((2.0, 2.0, 2.0), 1.0, 1.0)
    for L in (0.0, 1e-17):
        x0 = np.array([L, 0, L, -0.2, 0.98, 0.0, 0.98, 0.2, 0.0, 1.0])
        choice = co.choose(satellite, x0, (0, 20), 1e-9)
        assert choice.error <= 1e-9 and choice.step > 1e-3


def test_a_group_whose_rounding_grows_refuses_no_accuracy():
    """A body without rotation on an orbit about its axis of symmetry; its tensor is symmetric but for its last digits:
    its rest is unstable, so that rounding grows a million times, and is 1e-10 of the orbital momentum.
    """
    R = Rotation.random(random_state=0).as_matrix()
    tensor = R @ np.diag([1.0, 1.0, 2.0]) @ R.T
    satellite = co.systems.satellite((tensor + tensor.T) / 2, 100.0, 1.0)
    x0 = np.array([0.0, 0.0, 0.0, *(100.0 * 5.0**-0.5 * R[:, 1]), *(5.0 * R[:, 0]), 1.0])
    choice = co.choose(satellite, x0, (0, 300), 1e-9)
    assert choice.error <= 1e-9 and choice.step > 1.0


def test_prepared_runs_check_a_small_body_beside_a_large_one():
    """It turns as fast in the sample; ten times faster it needs shorter steps, alone and as a member."""
    pair = co.algebras.copies(co.algebras.so(3), 2)
    system = co.LiePoissonSystem(pair, co.Quadratic([1e-6, 5e-7, 4e-7, 1e3, 5e2, 4e2]))
    x0 = np.array([3e5, 1e6, 2e5, 3e-4, 1e-3, 2e-4])
    fast = np.append(x0[:3], 10 * x0[3:])
    ready = co.prepare(system, accuracy=1e-6, x0=x0, t_span=(0, 10), method=co.GaussLegendre(2))
    assert ready.serves(x0) and not ready.serves(fast)
    assert ready.serves([x0, x0]) and not ready.serves([x0, fast])
    sol = ready.run(fast, (0, 10))
    assert sol.choice.step < ready.choice.step and max(sol.error_estimate(by_group=True).values()) <= 1e-6
