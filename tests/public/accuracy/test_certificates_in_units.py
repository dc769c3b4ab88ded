"""Certificates of satellites in SI units: faults of the small coordinates are noticed beside the large ones."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co

GRAVITY, RADIUS, MASS = 3.986004418e14, 6.778e6, 4.0
INERTIA = np.array([0.0067, 0.0333, 0.0350])
RATE = np.sqrt(GRAVITY / RADIUS**3)
SATELLITE = co.systems.satellite(inertia=INERTIA, mass=MASS, gravity=GRAVITY)
C, S = np.cos(0.17), np.sin(0.17)
# Angular momentum 4e-5 kg m^2/s, momentum 3e4 kg m/s, position 7e6 m, and one.
X0 = np.r_[
    1e-6, 2e-6, INERTIA[2] * RATE, MASS * RADIUS * RATE * np.array([-S, C, 1e-3]), RADIUS * np.array([C, S, 3e-4]), 1
]
STEP = 20.0
DECLARED = co.methods.Properties(poisson=True, energy=False, casimirs="all", attitude="none")


@cache
def rows_of(fault):
    """Rows of Strang splitting whose angular momentum grows by `fault` in each step."""
    splitting = co.Splitting(order=2)

    def step(x, h):
        after = splitting.step(SATELLITE, x, 0.0, h)
        return np.concatenate([after[:3] * (1.0 + fault), after[3:]])

    found = co.certify(SATELLITE, step, X0, STEP, steps=8, order=2, symmetric=True, properties=DECLARED)
    return {row.key: row for row in found.rows}


@pytest.mark.long
def test_a_fault_of_a_millionth_of_the_small_group_is_noticed():
    right, wrong = rows_of(0.0), rows_of(1e-6)
    assert not [row for row in right.values() if row.verdict in ("fails", "not decidable here")]
    assert {"symmetry", "poisson", "reference", "order"} <= {
        key for key, row in wrong.items() if row.verdict == "fails"
    }
    # Both defects are proportional to the fault: the smallest that is noticed is small.
    for key in ("symmetry", "poisson"):
        assert 1e-6 * wrong[key].bound / wrong[key].value < 1e-9, str(wrong[key])


@pytest.mark.long
@pytest.mark.parametrize("key", ["symmetry", "poisson"])
def test_a_fault_of_the_small_group_is_noticed_from_the_bound_on(key):
    """The defect is proportional to the fault."""
    found = rows_of(1e-6)[key]
    threshold = 1e-6 * found.bound / found.value
    assert rows_of(threshold / 4)[key].verdict == "holds"
    assert rows_of(threshold * 4)[key].verdict == "fails"


@pytest.mark.parametrize("torque, noticed", [(1e-11, False), (0.0, False), (1e-9, True), (1e-6, True)])
@pytest.mark.thinned(2)
def test_a_wrong_torque_is_noticed_above_the_error_of_the_reference(torque, noticed):
    """Of a Runge-Kutta step, whose angular velocity and torque are off by a fraction; the reference has 7e-11."""

    def field(x):
        return np.concatenate([(1.0 + torque) * (f := SATELLITE.vector_field(x))[:3], f[3:]])

    def step(x, h):
        k1 = field(x)
        k2 = field(x + h / 2 * k1)
        k3 = field(x + h / 2 * k2)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + field(x + h * k3))

    found = co.certify(SATELLITE, step, X0, STEP, steps=8, order=4)
    assert (found["reference"].verdict == "fails") is noticed, str(found)
    assert found["reference"].bound < 2e-10


@pytest.mark.parametrize("name", ["satellite", "satellite_on_orbit", "gravitating_bodies"])
def test_bounds_of_satellites_are_far_below_one(name):
    """Relative to the largest group, in whose units they are; in one Euclidean norm they were up to 1e13."""
    if name == "satellite":
        system, x0, largest = SATELLITE, X0, RADIUS
    elif name == "satellite_on_orbit":
        system, largest = co.systems.satellite_on_orbit(INERTIA, RATE), 1.0
        x0 = system.state(Rotation.from_rotvec([0.1, 0.2, 0.3]), angular_velocity=(1e-4, 2e-4, RATE))
    else:
        system, largest = co.systems.gravitating_bodies([(0, 0, 0), INERTIA], [GRAVITY, MASS], G=1.0), GRAVITY
        x0 = system.state(
            [[0, 0, 0], [RADIUS, 0, 0]],
            [[0, 0, 0], [0, RATE * RADIUS, 0]],
            Rotation.from_rotvec([[0, 0, 0], [0, 0, 0.3]]),
            [[0, 0, 0], [0, 0, RATE]],
        )
    found = co.certify(system, co.Splitting(order=4), x0, STEP, steps=32)
    assert found.passed, str(found)
    assert found["reference"].bound < 1e-10
    assert found["symmetry"].bound < 1e-9 * largest
    for row in found.rows:
        if row.key.startswith("casimir"):
            assert row.bound < 1e-10, row
    assert "spatial momentum" in {row.key for row in found.rows}
