"""Angles between attitudes, and phases, against motions that are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from coadjoint.analysis.phase import phase_error
from coadjoint.analysis.rotations import attitude_angle, precession_error

U = 2.0**-53


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 0.3, 1.5, 3.0, np.pi - 1e-7, np.pi])
def test_angle_of_a_known_rotation(angle: float) -> None:
    axis = np.array([1.0, -2.0, 2.0]) / 3.0
    first = Rotation.from_rotvec([0.3, -0.4, 1.1])
    second = first * Rotation.from_rotvec(angle * axis)
    # Products of 3 x 3 matrices round each entry by a few u, and the arctangent does not magnify that.
    assert attitude_angle(first.as_matrix(), second.as_matrix()) == pytest.approx(angle, abs=32 * U)


def test_angles_broadcast() -> None:
    turns = Rotation.from_rotvec(np.outer(np.linspace(0.0, 3.0, 7), [0.0, 0.0, 1.0])).as_matrix()
    assert attitude_angle(np.eye(3), turns) == pytest.approx(np.linspace(0.0, 3.0, 7), abs=32 * U)


def test_precession_has_a_sign() -> None:
    axis = np.array([1.0, 2.0, 0.5])
    A = Rotation.from_rotvec([0.3, -0.4, 1.1])
    for angle in (-0.7, 0.2):
        ahead = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)) * A
        assert precession_error(ahead.as_matrix(), A.as_matrix(), axis) == pytest.approx(angle, abs=64 * U)


def test_precession_ignores_a_turn_across_the_axis() -> None:
    across = Rotation.from_rotvec([0.4, 0.0, 0.0]).as_matrix()
    assert abs(precession_error(across, np.eye(3), [0.0, 0.0, 1.0])) <= 4 * U


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"A has the shape \(2, 2\)"):
        attitude_angle(np.eye(2), np.eye(3))
    with pytest.raises(ValueError, match="not all zero"):
        precession_error(np.eye(3), np.eye(3), [0.0, 0.0, 0.0])
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    with pytest.raises(ValueError, match=r"it must be \(2, 3\)"):
        phase_error(body, (1.0, 2.0, 0.5), [0.0, 1.0], np.zeros((3, 3)))


@pytest.mark.parametrize("lead", [-0.2, -1e-6, 0.0, 0.05])
def test_phase_of_a_shifted_motion(lead: float) -> None:
    body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 2.0, 0.5)
    t = np.linspace(0.0, 20.0, 9)
    found = phase_error(body, x0, t, body.exact(x0, t + lead))
    # The exact motion has an error of some u t in the phase.
    assert found == pytest.approx(np.full(9, lead), abs=64 * U * 20.0)


def test_phase_of_a_driven_motion_follows_its_field_at_each_time() -> None:
    def rotating(t):
        return 0.9 * np.cos(2.0 * t), 0.9 * np.sin(2.0 * t), -1.0

    spin = co.systems.spin_lattice("chain", 1, field=rotating)
    better = co.integrate(spin, (0.6, 0.0, 0.8), (1.0, 9.0), 1 / 64, co.Splitting(order=6))
    t, lead = np.linspace(2.0, 8.0, 9), 0.01
    found = phase_error(spin, better.x[0], t, better.at(t + lead).x, better)
    # The interpolation of the run is right to its own bound, 2^-30 of the largest state, which moves by about 1 a time.
    assert found == pytest.approx(np.full(9, lead), abs=2.0**-28)


def test_phase_of_the_midpoint_rule_grows_linearly() -> None:
    body, x0 = co.systems.paper_rigid_body(), (1.0, 2.0, 0.5)
    run = co.integrate(body, x0, (0.0, 200.0), 0.05, co.GaussLegendre(1), save_every=400)
    phase = phase_error(body, x0, run.t, run.x)
    assert abs(phase[0]) <= 64 * U
    slopes = phase[2:] / run.t[2:]
    assert np.ptp(slopes) < 0.1 * abs(slopes.mean())
