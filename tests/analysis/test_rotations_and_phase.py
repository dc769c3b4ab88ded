"""Angles between attitudes, and phases, against motions that are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from coadjoint.analysis.phase import phase_error
from coadjoint.analysis.reference_motion import motion_of
from coadjoint.analysis.rotations import attitude_angle, precession_error, twist

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


@pytest.mark.parametrize("size", [1.0, 1e-200, 1e200])
def test_twist_and_precession_against_vectors_and_quaternions(size: float) -> None:
    """Of drawn pairs in two leading axes; the axis has any length, and is not changed."""
    rng = np.random.default_rng(8)
    A, B = Rotation.random(12, random_state=1), Rotation.random(3, random_state=2)
    first, second = A.as_matrix().reshape(4, 3, 3, 3), B.as_matrix()
    unit = rng.normal(size=3)
    unit /= np.linalg.norm(unit)
    axis = size * 3.0 * unit
    given = axis.copy()
    ahead, turned = precession_error(first, second, axis), twist(first, second, axis)
    assert np.array_equal(axis, given) and ahead.shape == turned.shape == (4, 3)
    for i, j in np.ndindex(4, 3):
        between = A[3 * i + j] * B[j].inv()
        assert ahead[i, j] == pytest.approx(between.as_rotvec() @ unit, abs=64 * U)
        x, y, z, w = between.as_quat()
        wanted = 2.0 * np.arctan2(unit @ (x, y, z), w)
        assert np.remainder(turned[i, j] - wanted + 1.0, 2 * np.pi) == pytest.approx(1.0, abs=64 * U)
        assert precession_error(second[j], first[i, j], axis) == pytest.approx(-ahead[i, j], abs=64 * U)
        assert attitude_angle(first[i, j], second[j]) == pytest.approx(between.magnitude(), abs=64 * U)
    assert type(twist(np.eye(3), second[0], axis)) is type(precession_error(np.eye(3), second[0], axis)) is float


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.6, -0.8, 0.0), (1.0, -2.0, 2.0)])
def test_half_turns_about_the_axis_and_across_it(direction: tuple[float, float, float]) -> None:
    """At pi the sign is arbitrary; nearby it is that of the angle, to the round-off of the matrices."""
    axis = np.array(direction) / np.linalg.norm(direction)
    across = np.cross(axis, (0.0, 1.0, 0.0) if abs(axis[1]) < 0.5 else (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    half, over = (2.0 * np.outer(n, n) - np.eye(3) for n in (axis, across))
    near = [Rotation.from_rotvec(angle * axis).as_matrix() for angle in (np.pi - 1e-7, 1e-7 - np.pi)]
    assert abs(precession_error(over, np.eye(3), axis)) < 32 * U
    for angle in (precession_error, twist):
        assert abs(angle(half, np.eye(3), axis)) == pytest.approx(np.pi, abs=32 * U)
        both = angle(np.stack([half, *near]), np.eye(3), axis)
        assert both[1:] == pytest.approx([np.pi - 1e-7, 1e-7 - np.pi], abs=32 * U)
        turned = Rotation.from_rotvec([0.3, -0.4, 1.1]).as_matrix()
        assert abs(angle(half @ turned, turned, axis)) == pytest.approx(np.pi, abs=64 * U)


def test_leads_of_shuffled_times_are_shuffled() -> None:
    body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 2.0, 0.5)
    t = np.linspace(-4.0, 20.0, 13)
    x = body.exact(x0, t + 0.01 * t)
    order = np.random.default_rng(1).permutation(13)
    straight, shuffled = phase_error(body, x0, t, x), phase_error(body, x0, t[order], x[order])
    assert straight == pytest.approx(0.01 * t, abs=1e-10) and shuffled == pytest.approx(straight[order], abs=1e-10)
    assert phase_error(body, x0, t[:1], x[:1]) == pytest.approx(straight[:1], abs=1e-10)


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("several", [False, True])
def test_a_run_is_interpolated_on_an_uneven_grid_and_ends_where_it_ends(several: bool, sense: float) -> None:
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    starts = np.array([[1.0, 2.0, 0.5], [0.3, -1.0, 0.4]])
    saved = 3.0 + sense * np.sort(np.random.default_rng(4).permutation(200)[:120]) / 20.0
    run = co.integrate(body, starts if several else starts[1], (3.0, 3.0 + sense * 10.0), 0.05, t_eval=saved)
    run.x[:] = (
        np.stack([body.exact(x, run.t - 3.0) for x in starts], axis=1)
        if several
        else body.exact(starts[1], run.t - 3.0)
    )
    right = motion_of(body, run, starts[0], 1 if several else None)
    t = np.random.default_rng(5).uniform(min(saved), max(saved), 50)
    # The interpolation is right to its own bound, 2^-30 of the largest state.
    assert np.max(np.abs(right(t) - body.exact(starts[1], t - 3.0))) < 2.0**-30 * 3.0
    assert np.max(np.abs(right(run.t) - (run.x[:, 1] if several else run.x))) < 1e-12
    beyond = np.array([min(saved) - 0.01, t[0], max(saved) + 0.01])
    assert np.isnan(right(beyond)).all(axis=1).tolist() == [True, False, True]
    assert np.isnan(right(beyond[::2])).all()


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
