"""Initial attitudes given as matrices, SciPy rotations and quaternions start the same run."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co

EPS = np.finfo(float).eps
STEP, SPAN, SCHEME = 0.1, (0.0, 1.0), co.Splitting(order=2)
MEMBERS = 5
TURNS = Rotation.from_rotvec(np.random.default_rng(5).normal(size=(MEMBERS, 3)))
# Tops have matrices of four rows, a rotation with a translation, and a satellite of five, a rotation between others.
BODIES = [
    (name, size)
    for name in co.systems.names()
    if np.shape(system := co.systems.get(name).representation)[-1:] in ((3,), (4,), (5,))
    for size in np.shape(system)[-1:]
    if size != 4 or not np.asarray(system)[:, 3].any()
]
SO3 = ("gyrostat", "paper_rigid_body", "rigid_body")


def elements(size, matrices):
    """Return rotation matrices as group elements."""
    found = np.broadcast_to(np.eye(size), (*matrices.shape[:-2], size, size)).copy()
    first = int(size == 5)
    found[..., first : first + 3, first : first + 3] = matrices
    return found


def rotates(name, size):
    """Whether the group of a system has all rotations."""
    system = co.systems.get(name)
    try:
        co.stepper(system, SCHEME, STEP).both(np.ones(system.dim), elements(size, TURNS[0].as_matrix()))
    except ValueError:
        return False
    return True


ROTATING = [(name, size) for name, size in BODIES if rotates(name, size)]


def test_bodies_and_tops_are_among_them():
    names = {name for name, _ in ROTATING}
    assert {*SO3, "heavy_top", "lagrange_top", "kirchhoff_body", "satellite"} <= names and "so_n_body" not in names


@pytest.mark.parametrize(("name", "size"), ROTATING)
def test_every_form_starts_the_same_run(name, size):
    """A rotation is its matrix, bit for bit; a quaternion is the same one to rounding, for one member and several."""
    system = co.systems.get(name)
    x0 = np.linspace(0.3, 1.0, system.dim)

    def run(attitude, members=()):
        return co.integrate(
            system, np.tile(x0, (*members, 1)) if members else x0, SPAN, STEP, SCHEME, attitude=attitude
        )

    for turn, members in ((TURNS[0], ()), (TURNS, (MEMBERS,))):
        expected = run(elements(size, turn.as_matrix()), members)
        assert np.array_equal(run(turn, members).attitude, expected.attitude)
        if not members or size != 4:
            quaternion = run(turn.as_quat(), members)
            # A unit quaternion has an error of 2 eps, its nine entries of 8; the flow is linear in the attitude.
            assert np.abs(quaternion.attitude - expected.attitude).max() <= 64 * EPS * np.abs(expected.attitude).max()
            negative = run(-turn.as_quat(), members)
            assert np.array_equal(negative.attitude, quaternion.attitude)
    mixed = [TURNS[0], *elements(size, TURNS[1:].as_matrix())]
    assert np.array_equal(run(mixed, (MEMBERS,)).attitude, run(TURNS, (MEMBERS,)).attitude)


def test_a_satellite_takes_the_rotation_of_its_solution():
    """A run continues from the last rotation of another one, and leads where one run of the whole span leads."""
    satellite, x0 = co.systems.satellite((1.0, 1.2, 2.0), 10.0), (0.1, 0.2, 0.3, 0, 10.0, 0, 1.0, 0.1, 0, 1)
    whole = co.integrate(satellite, x0, (0, 2), STEP, SCHEME, attitude=TURNS[2])
    half = co.integrate(satellite, x0, (0, 1), STEP, SCHEME, attitude=TURNS[2])
    rest = co.integrate(satellite, half.x[-1], (1, 2), STEP, SCHEME, attitude=half.rotation[-1])
    assert (whole.rotation[0].inv() * TURNS[2]).magnitude() <= 16 * EPS
    # A quaternion and back: 32 eps; the motion of 10 steps is the same.
    assert (rest.rotation[-1].inv() * whole.rotation[-1]).magnitude() <= 64 * EPS


def test_every_function_reads_them(tmp_path):
    """Prepared runs, steppers, choices, closed forms, fits and configuration files read one attitude alike."""
    body, x0, turn = co.systems.rigid_body(inertia=(1, 2, 3)), (0.1, 1.0, 0.2), TURNS[1]
    matrix, quaternion = turn.as_matrix(), turn.as_quat()
    expected = co.integrate(body, x0, SPAN, STEP, SCHEME, attitude=matrix)
    for given in (turn, quaternion, list(quaternion)):
        prepared = co.prepare(body, SCHEME, STEP, attitude=given)
        later = co.prepare(body, SCHEME, STEP, attitude=True)
        for sol in (prepared.run(x0, SPAN), later.run(x0, SPAN, attitude=given)):
            assert np.abs(sol.attitude - expected.attitude).max() <= 64 * EPS
        _, group = co.stepper(body, SCHEME, STEP).both(x0, given)
        assert np.abs(group - expected.attitude[1]).max() <= 64 * EPS
        _, exact = body.exact(x0, 1.0, attitude=given)
        assert np.abs(exact - body.exact(x0, 1.0, attitude=matrix)[1]).max() <= 64 * EPS
        chosen = co.choose(body, x0, SPAN, 1e-6, attitude=given)
        assert chosen.step == co.choose(body, x0, SPAN, 1e-6, attitude=matrix).step
        sampled = co.prepare(body, accuracy=1e-6, x0=x0, t_span=SPAN, attitude=given).run(x0, SPAN)
        assert np.abs(sampled.attitude[0] - matrix).max() <= 64 * EPS
        measured, sigma = {"attitude": expected.attitude}, {"attitude": 1e-3}
        fitted = co.fit(later, x0, SPAN, measured, {"x0": True}, sigma=sigma, attitude=given)
        assert np.abs(fitted.values["x0"] - x0).max() < 1e-9
    ensemble = co.prepare(body, SCHEME, STEP, attitude=TURNS)
    last = ensemble.run([x0] * MEMBERS, SPAN).attitude[:, -1]
    assert np.array_equal(last, co.integrate(body, x0, SPAN, STEP, SCHEME, attitude=TURNS[-1]).attitude)
