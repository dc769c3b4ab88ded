"""Forces on a satellite: DOP853 in quaternions, closed forms, bits, archives and refusals."""

import dataclasses

import numpy as np
import pytest
from pairs_of_bodies import splitting
from scipy.spatial.transform import Rotation
from scipy.special import ellipj

import coadjoint as co
from long import long_beyond
from refusals import refused
from satellite_forces import (
    AREAS,
    CASES,
    CENTRES,
    DAMPING,
    LAW,
    NORMALS,
    PERIOD,
    PYRAMID,
    SPIN,
    STEP,
    STIFF,
    TENSOR,
    TOWARD,
    TURNED,
    WANTED,
    WHEELS,
    F,
    Q,
    S,
    error_of,
    reference,
)

each = pytest.mark.parametrize("name", CASES)


@pytest.mark.thinned(24)
@each
def test_a_run_by_dop853_in_quaternions(name):
    """Order two, with samples at their times; a plate that begins to be lit, and a pulse that ends, within a step."""
    case = CASES[name]
    wanted, x0 = reference(case, 4.0), case.start
    coarse, fine = (
        error_of(case, co.integrate(case.system, x0, (0, 4), h, splitting(2)).x[-1], wanted)
        for h in (STEP / 2, STEP / 16)
    )
    assert fine < 1e-5 and np.log2(coarse / fine) / 3 == pytest.approx(2, abs=0.3), (coarse, fine)


@each
@pytest.mark.thinned(16)
def test_members_archives_and_steps_have_the_same_bits(name, tmp_path, no_fsync):
    case, method, span = CASES[name], splitting(2), (0.0, 24 * STEP)
    system, x0 = case.system, case.start
    other = x0.copy()
    other[:3] *= 0.7
    members = np.stack([x0, other])
    whole = co.integrate(system, members, span, STEP, method)
    for k, one in enumerate(members):
        single = co.integrate(system, one, span, STEP, method)
        np.testing.assert_array_equal(whole.x[:, k], single.x)
        np.testing.assert_array_equal(
            whole.work[case.force.label]["energy"][:, k], single.work[case.force.label]["energy"]
        )
    assert whole.angular_velocity.shape == (25, 2, 3)
    batch = co.batch([system, case.build({})])
    np.testing.assert_array_equal(co.integrate(batch, members, span, STEP, method).x, whole.x)
    # Cut between two samples, where a command is held.
    first = co.integrate(system, members, (0.0, 5 * STEP), STEP, method)
    second = co.integrate(system, first.x[-1], (5 * STEP, 24 * STEP), STEP, method)
    np.testing.assert_array_equal(second.x, whole.x[5:])
    ready = co.prepare(system, method, STEP)
    np.testing.assert_array_equal(ready.end(x0, span), whole.x[-1, 0])
    step = co.stepper(system, method, STEP)
    np.testing.assert_array_equal(step(step(x0), STEP), whole.x[2, 0])
    path = tmp_path / "run.zarr"
    co.integrate(system, x0, (0.0, 5 * STEP), STEP, method, archive=path)
    resumed = co.resume(path, span[1], **({} if case.stored else {"system": system}))
    np.testing.assert_array_equal(resumed.to_xarray()["x"], whole.x[:, 0])


@each
def test_the_work_of_a_force_is_the_change_of_energy(name):
    """By a scheme that keeps the energy: to rounding."""
    case = CASES[name]
    system, x0 = case.system, case.start
    sol = co.integrate(system, x0, (0, 6), STEP, co.GaussLegendre(2))
    assert sol.balance()["energy"] < 2e-13 and abs(sol.energy[-1] - sol.energy[0]) > 1e-4
    assert {name for name, value in sol.balance().items() if value > 2e-13} == set()
    # The power while a command is held is the slope of the work.
    rate = sum(system.power(sol.x[3], sol.t[3]).values())
    energy = sol.work[case.force.label]["energy"]
    assert rate == pytest.approx((energy[4] - energy[2]) / (2 * STEP), abs=0.05 * np.abs(np.diff(energy)).max() / STEP)


@pytest.mark.parametrize("error, share", [("sine", 1.0), ("quaternion", 0.5)])
def test_a_spring_is_a_pendulum(error, share):
    """About a principal axis, far from small angles: the angle, or half of it, is that of a pendulum."""
    K, moment, top = 0.7, 2.5, 2.0
    sat = S.body((1.0, 2.0, moment)).with_forces(F.Pointing(K, 0.0, Rotation.from_rotvec([0, 0, 0.5]), error=error))
    x0 = sat.state(Rotation.from_rotvec([0, 0, 0.5 + top]))
    sol = co.integrate(sat, x0, (0, 20), 1 / 512, save_every=64)
    k, rate = np.sin(share * top / 2), np.sqrt(K / moment)
    _, cn, dn, _ = ellipj(rate * sol.t, k * k)
    wanted = 2 * np.arcsin(k * cn / dn) / share
    angles = (Rotation.from_rotvec([0, 0, 0.5]).inv() * sol.rotation).as_rotvec()
    np.testing.assert_allclose(angles[:, 2], wanted, rtol=0, atol=1e-5)
    assert np.abs(angles[:, :2]).max() < 1e-13


def test_a_magnet_keeps_what_the_field_keeps():
    """Energy with that of the magnet, and the momentum in space along the field; a swing is a pendulum's."""
    m, B, sat = np.array([0.2, -0.3, 0.5]), np.array([0.3, 0.4, -0.1]), CASES["MagneticDipole"].system
    x0 = CASES["MagneticDipole"].start
    coarse, fine = (co.integrate(sat, x0, (0, 50), h, splitting(2)) for h in (1 / 32, 1 / 64))
    swings = []
    for sol in (coarse, fine):
        potential = -np.einsum("i,tij,j->t", B, sat.attitudes(sol.x), m)
        swings.append(np.ptp(sol.energy + potential))
        along = sat.angular_momentum(sol.x, frame="space") @ B
        assert np.ptp(along) < 1e-13
    assert swings[1] < 1e-5 and swings[0] / swings[1] == pytest.approx(4, abs=0.2)
    compass = S.body((1.0, 2.0, 2.5)).with_forces(F.MagneticDipole((2.0, 0, 0), (0.5, 0, 0)))
    sol = co.integrate(compass, compass.state(Rotation.from_rotvec([0, 0, 2.0])), (0, 20), 1 / 512, save_every=64)
    k = np.sin(1.0)
    _, cn, dn, _ = ellipj(np.sqrt(1 / 2.5) * sol.t, k * k)
    np.testing.assert_allclose(sol.rotation.as_rotvec()[:, 2], 2 * np.arcsin(k * cn / dn), rtol=0, atol=1e-5)


def test_a_sampled_damper_and_a_constant_torque_are_exact():
    """Of one axis: powers of 1 - period damping / moment, whatever the step, and a momentum that grows linearly."""
    for h in (0.5, 0.25, 1 / 64):
        sat = S.body((1.0, 2.0, 2.5)).with_forces(F.Sampled(F.Pointing(0.0, 1.5), 0.5))
        sol = co.integrate(sat, sat.state(angular_velocity=(0, 0, 0.8)), (0, 8), h)
        samples = sol.angular_velocity[:: round(0.5 / h), 2]
        np.testing.assert_allclose(samples, 0.8 * (1 - 0.5 * 1.5 / 2.5) ** np.arange(17), rtol=0, atol=1e-14)
        for law in (F.Torque((0.0, 0.25, 0.0)), F.Torque(lambda t: np.array([0.0, 0.25, 0.0]))):
            driven = S.body((1.0, 2.0, 2.5), attitude=False).with_forces(F.Sampled(law, 0.5))
            run = co.integrate(driven, driven.state(), (0, 8), h)
            np.testing.assert_array_equal(run.x[:, 1], 0.25 * run.t)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("period", "steps"), [(0.1, 5), (0.1, 3), (0.2, 5), (0.3, 2), (0.7, 2), (0.01, 10)])
@pytest.mark.parametrize("start", [0, -40])
def test_no_sample_is_missed_by_rounding(period, steps, start):
    """Of periods and steps that are not floats: times divided by them lie on either side of whole numbers."""
    sat = S.body(TENSOR).with_forces(F.Sampled(F.Torque(lambda t: np.array([t / 1024, 0.0, 0.0])), period))
    span = (start * period, (start + 100) * period)
    held = co.integrate(sat, sat.state(TURNED), span, period / steps, splitting(1)).x[1:, -3]
    wanted = np.repeat(period * np.arange(start, start + 100), steps)
    np.testing.assert_allclose(1024 * held, wanted, rtol=0, atol=100 * 2.0**-50)


@pytest.mark.parametrize("name", long_beyond(2, ["Thrusters", "ReactionWheels", "ControlMomentGyros", "Sampled"]))
def test_samples_are_at_the_multiples_of_the_period_on_both_sides_of_time_zero(name):
    """A law that does not depend on time makes the same run whole periods earlier or later, also between samples."""
    carried = {"ReactionWheels": {"wheels": WHEELS}, "ControlMomentGyros": {"gyros": PYRAMID}}.get(name, {})
    limit = {"max_torque": 0.2} if name == "Thrusters" else {}
    sat = S.body(TENSOR, **carried).with_forces(getattr(F, name)(F.Pointing(0.5, 1.5), PERIOD, **limit))
    x0 = sat.state(TURNED, SPIN)
    for start in (0.0, 3 * STEP):
        runs = [
            co.integrate(sat, x0, (begin, begin + 2 * PERIOD), STEP, splitting(2)).x
            for begin in start + PERIOD * np.array([0, -1, -2, -7, 1000])
        ]
        assert np.abs(np.diff(runs[0][:, -3:], axis=0)).max() > 1e-3
        for moved in runs[1:]:
            np.testing.assert_array_equal(moved, runs[0])


def test_a_sampled_controller_settles_as_its_matrix():
    """Small angles about a principal axis: the angle and the rate at samples are powers of a matrix."""
    K, C, I3, T = 0.8, 1.2, 2.5, 0.5
    sat = S.body((1.0, 2.0, I3)).with_forces(F.Sampled(F.Pointing(K, C), T))
    small = 1e-5
    sol = co.integrate(sat, sat.state(Rotation.from_rotvec([0, 0, small])), (0, 16), T / 4, save_every=4)
    step = np.array([[1 - T**2 * K / (2 * I3), T - T**2 * C / (2 * I3)], [-T * K / I3, 1 - T * C / I3]])
    wanted = np.array([np.linalg.matrix_power(step, k) @ [small, 0.0] for k in range(33)])
    np.testing.assert_allclose(sol.rotation.as_rotvec()[:, 2], wanted[:, 0], rtol=0, atol=1e-9 * small)
    np.testing.assert_allclose(sol.angular_velocity[:, 2], wanted[:, 1], rtol=0, atol=1e-9 * small)


@pytest.mark.parametrize("method", [co.Splitting(), co.GaussLegendre(2), co.Taylor(order=8)], ids=repr)
@pytest.mark.parametrize("name", ["ReactionWheels", "ControlMomentGyros"])
@pytest.mark.long
def test_motors_keep_the_momentum_in_space(name, method):
    """That of body and rotors together, to rounding; the norm of gimbals too."""
    case = CASES[name]
    sol = co.integrate(case.system, case.start, (0, 100), STEP, method)
    space = case.system.angular_momentum(sol.x, frame="space")
    assert np.abs(space - space[0]).max() < 2e-13
    assert np.abs(sol.angular_velocity[-1] - sol.angular_velocity[0]).max() > 0.1
    if name == "ControlMomentGyros":
        np.testing.assert_allclose(sol.x[:, 12:20:2] ** 2 + sol.x[:, 13:20:2] ** 2, 1.0, rtol=0, atol=1e-13)
        assert np.abs(np.diff(np.unwrap(case.system.gimbal_angles(sol.x), axis=0), axis=0)).max() <= 0.3 * STEP + 1e-14


def test_wheels_are_limited():
    law = F.Pointing(2.0, 4.0, WANTED := Rotation.from_rotvec([0, 0, 2.5]), error="quaternion")
    motors = F.ReactionWheels(law, PERIOD, max_torque=0.05, max_momentum=(0.3, 0.4, 0.5))
    free = S.body((1.0, 2.0, 2.5), wheels=0.1 * np.eye(3))
    sat = free.with_forces(motors)
    sol = co.integrate(sat, sat.state(), (0, 200), STEP)
    momenta, held = sol.x[:, 12:15], sol.x[:, -3:]
    assert np.abs(held).max() == 0.05
    assert momenta[:, 2].min() == -0.5 and np.abs(momenta[:, :2]).max() == 0.0
    assert (WANTED.inv() * sol.rotation[-1]).magnitude() < 1e-6
    # A slow wheel spins up as fast as its motor allows.
    np.testing.assert_allclose(sol.x[: round(1 / STEP), 14], -0.05 * sol.t[: round(1 / STEP)], rtol=1e-13, atol=1e-15)


LIMITS, BEYOND = np.array([0.3, 0.2, 0.1]), np.array([0.15, -0.5, 0.4])
WITHIN, LARGE = np.clip(BEYOND, -LIMITS, LIMITS), PERIOD * np.abs(BEYOND) >= LIMITS
# The force with limits of its own for each component, and one without them whose law has the torque within them.
LIMITED = {
    "Sampled": (F.Sampled(F.Torque(BEYOND), PERIOD, LIMITS), F.Sampled(F.Torque(WITHIN), PERIOD)),
    "ReactionWheels": (F.ReactionWheels(F.Torque(BEYOND), PERIOD, LIMITS), F.ReactionWheels(F.Torque(WITHIN), PERIOD)),
    "ControlMomentGyros": (
        F.ControlMomentGyros(F.Torque(BEYOND), PERIOD, LIMITS),
        F.ControlMomentGyros(F.Torque(WITHIN), PERIOD),
    ),
    "Thrusters": (F.Thrusters(F.Torque(BEYOND), PERIOD, LIMITS), F.Thrusters(F.Torque(WITHIN), PERIOD, LIMITS)),
    "Thrusters with a smallest pulse": (
        F.Thrusters(F.Torque(BEYOND), PERIOD, 1.0, LIMITS),
        F.Thrusters(F.Torque(np.where(LARGE, BEYOND, 0.0)), PERIOD, 1.0),
    ),
}


@pytest.mark.parametrize("name", LIMITED)
def test_each_component_has_its_own_limit(name):
    free = S.body(TENSOR, wheels=0.05 * np.eye(3), gyros=PYRAMID)
    found, wanted = (free.with_forces(force) for force in LIMITED[name])
    x0 = found.state(TURNED, SPIN)
    moved, expected = (one.flows[0][1].flow(one, x0, 0.0, PERIOD) for one in (found, wanted))
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-15)
    assert np.abs(moved - x0).max() > 0.01


@pytest.mark.parametrize("stiffness", [0.0, STIFF], ids=["damper", "spring"])
def test_each_component_of_a_pointing_law_has_its_own_limit(stiffness):
    free = S.body(TENSOR)
    x0 = free.state(TURNED, SPIN)
    torque, limited = (
        free.with_forces(F.Pointing(stiffness, DAMPING, max_torque=most)).vector_field(x0) - free.vector_field(x0)
        for most in (None, LIMITS)
    )
    assert (np.abs(torque[:3]) > LIMITS).any()
    np.testing.assert_allclose(limited[:3], np.clip(torque[:3], -LIMITS, LIMITS), rtol=0, atol=1e-15)


@pytest.mark.parametrize("stiffness", [0.0, STIFF], ids=["damper", "spring"])
@pytest.mark.parametrize("moving", [False, True])
def test_a_pointing_law_damps_toward_its_angular_velocity_in_space(stiffness, moving):
    free, t, w = S.body(TENSOR), 0.75, np.array([0.2, -0.3, 0.1])
    x0 = free.state(TURNED, SPIN)
    resting, following = (
        free.with_forces(F.Pointing(stiffness, DAMPING, rate=rate)).vector_field(x0, t)
        for rate in ((0.0, 0.0, 0.0), (lambda t: w * t) if moving else w)
    )
    wanted = DAMPING @ TURNED.as_matrix().T @ (w * t if moving else w)
    np.testing.assert_allclose(following[:3] - resting[:3], wanted, rtol=0, atol=1e-15)


def test_wheels_in_a_plane_give_what_they_can():
    sat = S.body(TENSOR, wheels=WHEELS[:2]).with_forces(F.ReactionWheels(F.Torque((0.3, 0.2, 0.1)), PERIOD))
    held = co.integrate(sat, sat.state(), (0, PERIOD), PERIOD).x[-1, -2:]
    unit = WHEELS[:2] / np.linalg.norm(WHEELS[:2], axis=1)[:, None]
    np.testing.assert_allclose(held, -np.linalg.pinv(unit.T) @ [0.3, 0.2, 0.1], rtol=1e-13)


def test_thrusters_fire_by_whole_impulses():
    """A pulse that ends within a step is exact, and one below the smallest is left out."""
    for h in (0.5, 0.125):
        jets = F.Thrusters(F.Torque((0.05, -0.3, 0.004)), 0.5, (0.2, 0.2, 0.1), min_impulse=0.003)
        sat = S.body((1.0, 1.0, 1.0), attitude=False).with_forces(jets)
        sol = co.integrate(sat, sat.state(), (0, 2), h, save_every=round(0.5 / h))
        np.testing.assert_allclose(sol.x[:, 0], 0.025 * np.arange(5), rtol=0, atol=1e-16)
        np.testing.assert_allclose(sol.x[:, 1], -0.1 * np.arange(5), rtol=1e-15, atol=0)
        assert np.abs(sol.x[:, 2]).max() == 0.0


def test_several_sampled_forces_have_their_own_numbers():
    """Also at different rates; added one after the other as together."""
    both = F.ReactionWheels(LAW, 0.5), F.Thrusters(F.Pointing(0.0, 0.1), 1.0, 0.2)
    free = S.body(TENSOR, wheels=WHEELS)
    sat = free.with_forces(*both)
    assert sat.dim == 12 + 4 + 4 + 3 and sat.state().shape == (23,)
    assert [force.first for force in sat.forces] == [0, 4]
    chained = free.with_forces(both[0]).with_forces(both[1])
    x0 = sat.state(TURNED, SPIN)
    runs = [co.integrate(system, x0, (0, 3), STEP).x for system in (sat, chained)]
    np.testing.assert_array_equal(*runs)
    changes = np.any(np.diff(runs[0][:, -3:], axis=0) != 0, axis=1)
    assert set(np.flatnonzero(changes) % round(1 / STEP)) == {0}


@pytest.mark.parametrize("damping", [0.5, (0.5, 0.2, 0.1), DAMPING], ids=["number", "diagonal", "matrix"])
def test_dampers_act_on_classical_bodies(damping):
    """With the angular velocity of each, which a rotor shifts."""
    C = np.diag(np.broadcast_to(damping, 3)) if np.ndim(damping) < 2 else damping
    for system in (
        S.rigid_body(TENSOR),
        S.gyrostat((1.0, 2.0, 2.5), (0.1, 0.2, 0.3)),
        S.heavy_top(),
        S.kirchhoff_body(),
    ):
        damped, x = system.with_forces(F.Pointing(0.0, damping)), 0.3 + 0.1 * np.arange(system.dim)
        change = damped.vector_field(x) - system.vector_field(x)
        omega = system.hamiltonian.gradient(x)[:3]
        np.testing.assert_allclose(change, np.r_[-C @ omega, np.zeros(system.dim - 3)], atol=1e-15)
        assert damped.power(x)["Pointing"] < 0.0


def test_bodies_with_rotors():
    """States from speeds and angles, and the energy of each part."""
    free = S.body(TENSOR, wheels=WHEELS, gyros=PYRAMID)
    speeds, angles = np.array([1.0, -2.0, 0.5, 3.0]), np.array([0.2, -0.3, 3.0, 0.1])
    x0 = free.state(TURNED, SPIN, wheel_speeds=speeds, gimbal_angles=angles)
    np.testing.assert_allclose(free.wheel_speeds(x0), speeds, rtol=1e-13)
    np.testing.assert_allclose(free.gimbal_angles(x0), angles, rtol=1e-13)
    np.testing.assert_allclose(free.angular_velocity(x0), SPIN, rtol=0, atol=1e-13)
    moments = np.linalg.norm(WHEELS, axis=1)
    unit = WHEELS / moments[:, None]
    kinetic = 0.5 * SPIN @ TENSOR @ SPIN + 0.5 * moments @ ((speeds + unit @ SPIN) ** 2 - (unit @ SPIN) ** 2)
    assert free.energy(x0) == pytest.approx(kinetic, rel=1e-13)
    degrees = free.state(
        TURNED, np.degrees(SPIN), wheel_speeds=np.degrees(speeds), gimbal_angles=np.degrees(angles), degrees=True
    )
    np.testing.assert_allclose(degrees, x0, rtol=0, atol=1e-14)
    sol = co.integrate(free, np.stack([x0, degrees]), (0, 10), STEP, observe=free.integrals)
    assert all(np.ptp(values[:, 0]) < 1e-13 for values in sol.observed.values()) and len(sol.observed) == 3
    np.testing.assert_array_equal(
        sol.x[:, :, 12:], np.broadcast_to(np.stack([x0, degrees])[:, 12:], sol.x[:, :, 12:].shape)
    )
    assert sol.system.wheel_speeds(sol.x).shape == (161, 2, 4)
    balanced = S.body((2.0, 2.0, 2.0), wheels=[(0, 0, 0.5)])
    turning = co.integrate(balanced, balanced.state(None, (0, 0, 0.3), wheel_speeds=[2.0]), (0, 5), 0.5)
    np.testing.assert_allclose(turning.rotation.as_rotvec()[:, 2], 0.3 * turning.t, rtol=0, atol=1e-14)


def test_what_is_refused():
    sampled, wheels = F.Sampled(LAW, 0.5), F.ReactionWheels(LAW, 0.5, max_torque=(1.0, 2.0))
    for force in (LAW, CASES["MagneticDipole"].force, sampled, wheels):
        with refused(TypeError, force.label, "co.systems.body"):
            S.gravitating_bodies().with_forces(force)
    with refused(TypeError, "Pointing", "rigid_body", "attitude"):
        S.rigid_body().with_forces(LAW)
    with refused(TypeError, "Sampled", "rigid_body", "co.systems.body"):
        S.rigid_body().with_forces(sampled)
    for force, name in ((wheels, "wheels"), (CASES["ControlMomentGyros"].force, "gyros")):
        with refused(TypeError, name, "co.systems.body"):
            S.body().with_forces(force)
    with refused(ValueError, "max_torque", "(2,)", "4"):
        S.body(TENSOR, wheels=WHEELS).with_forces(wheels)
    with refused(TypeError, "law", "LinearDamping"):
        F.Sampled(F.LinearDamping(0.1), 0.5)
    with refused(TypeError, "max_torque"):
        F.Thrusters(LAW, 0.5)
    sat = S.body().with_forces(sampled)
    x0 = sat.state()
    for step, span, named in ((0.3, (0, 3), "period"), (0.25, (0.1, 1.1), "start"), (2.0, (0, 2), "period")):
        with refused(ValueError, named, f"{step:g}"):
            co.integrate(sat, x0, span, step)
    with refused(ValueError, "Sampled", "backward"):
        co.integrate(sat, x0, (1, 0), 0.25)
    with refused(ValueError, "start", "0.1"):
        co.stepper(sat, co.Splitting(), 0.25)(x0, 0.1)
    with refused(ValueError, "start", "0.1"):
        co.prepare(sat, co.Splitting(), 0.25).end(x0, (0.1, 1.1))
    ready = co.prepare(sat, co.Splitting(), 0.25)
    ready.run(x0, (0, 1))
    with refused(ValueError, "start", "0.1"):
        ready.run(x0, (0.1, 1.1))
    with refused(ValueError, "(12,)", "15"):
        co.integrate(sat, S.body().state(), (0, 1), 0.25)
    with refused(ValueError, "[0.1, 0.2]", "(3,)"):
        S.body().with_forces(F.Sampled(F.Torque((0.1, 0.2)), 0.5))


def test_rotors_that_are_refused():
    for wheels, named in (([(0, 0, 1.0, 0)], "(1, 4)"), ([(0, 0, 0)], "wheels[0]"), ([(0, 0, 2.5)], "exceed")):
        with refused(ValueError, "wheels", named):
            S.body((1.0, 2.0, 2.5), wheels=wheels)
    for gyros, named in (
        ([(1, 0, 0)], "(1, 3)"),
        ([[(1, 0, 0), (0, 2, 0)]], "gyros[0]"),
        ([[(1, 0, 0), (1, 1, 0)]], "gyros[0]"),
    ):
        with refused(ValueError, "gyros", named):
            S.body((1.0, 2.0, 2.5), gyros=gyros)
    with refused(ValueError, "rod"):
        S.body((2.0, 2.0, 0.0), wheels=[(0.1, 0, 0)])
    with refused(ValueError, "wheel_speeds", "(2,)"):
        S.body(TENSOR, wheels=WHEELS).state(wheel_speeds=(1.0, 2.0))


@pytest.mark.parametrize("degrees", [40.0, 120.0, 179.0])
@pytest.mark.parametrize("main", range(3))
def test_the_error_of_quaternion_feedback_is_twice_the_vector_part(main, degrees):
    """Beyond 120 degrees by the largest component of the axis, whichever it is."""
    axis = np.array([0.2, -0.3, 0.1])
    axis[main] = 1.0
    axis /= np.linalg.norm(axis)
    law = F.Pointing(stiffness=0.5, damping=0.0, error="quaternion")
    sat = S.body(TENSOR).with_forces(law)
    x = sat.state(Rotation.from_rotvec(degrees * axis, degrees=True))
    wanted = -0.5 * 2.0 * np.sin(np.radians(degrees) / 2.0) * axis
    assert sat.vector_field(x)[:3] == pytest.approx(wanted, abs=1e-13)


def test_pulses_begin_with_their_periods_at_any_step():
    """Steps and periods that are no binary fractions: the times of samples are rounded."""
    jets = F.Thrusters(F.Torque((0.03, 0.0, 0.0)), period=1.1, max_torque=0.1)
    sat = S.body((1.0, 2.0, 2.5)).with_forces(jets)
    sol = co.integrate(sat, sat.state(), (0, 110), 0.1, save_every=11)
    assert sol.angular_momentum[:, 0] == pytest.approx(0.03 * sol.t, abs=1e-12)


def test_gyros_whose_momenta_are_not_orthogonal_are_refused():
    with pytest.raises(ValueError, match=r"gyros\[0\]"):
        S.body((1.0, 2.0, 2.5), gyros=[[(0.1, 0.0, 0.0), (0.06, 0.08, 0.0)]])


def test_the_symmetric_part_of_a_quadrupole_without_its_trace_matters():
    Q = np.array([[0.3, 0.2, 0.0], [-0.1, 0.1, -0.3], [0.0, 0.1, 0.2]])
    own, other = (
        S.body(TENSOR).with_forces(F.GravityGradient(1.0, (1.5, 0.3, -0.4), q))
        for q in (Q, 0.5 * (Q + Q.T) + 0.7 * np.eye(3))
    )
    x = own.state(TURNED)
    assert own.vector_field(x)[:3] == pytest.approx(other.vector_field(x)[:3], abs=1e-14)


@pytest.mark.parametrize("name", ["SolarPressure", "Drag"])
def test_normals_that_are_unit_vectors_up_to_rounding(name):
    """Their length is removed up to a millionth, and refused beyond."""
    force = CASES[name].force
    system = CASES[name].system.unforced

    def field(length):
        normals = (length * np.array(force.normals)).tolist()
        return system.with_forces(dataclasses.replace(force, normals=normals)).vector_field(CASES[name].start)

    free = system.vector_field(CASES[name].start)
    push = np.abs(field(1.0) - free).max()
    for length in (1 - 9e-7, 1 + 9e-7):
        np.testing.assert_allclose(field(length), field(1.0), rtol=0, atol=16 * 2.0**-53 * (push + np.abs(free).max()))
        assert push * 9e-7 > 1e4 * 16 * 2.0**-53 * np.abs(free).max()
    for length in (1 - 2e-6, 1 + 2e-6):
        with refused(ValueError, name, "unit vectors"):
            field(length)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_wheel_that_starts_beyond_its_limit_is_driven_back_only(sign):
    """The body is at rest, so that the law is constant: against the motion of the wheel, and along it."""
    for torque, expected in ((0.01, 0.1 - 0.01), (-0.01, 0.1)):
        motors = F.ReactionWheels(F.Torque((sign * torque, 0.0, 0.0)), period=PERIOD, max_momentum=0.05)
        sat = S.body((1.0, 2.0, 2.5), wheels=[(0.01, 0.0, 0.0)]).with_forces(motors)
        x0 = sat.state()
        x0[12] = 0.1 * sign
        assert co.integrate(sat, x0, (0, 1), STEP).x[-1, 12] == pytest.approx(expected * sign, abs=1e-15)


@pytest.mark.long
def test_gyros_beside_wheels_point_the_body():
    """Their angles come after the speeds of the wheels in the state."""
    gyros = [[(-q, p, 0), (-0.6 * p, -0.6 * q, 0.8)] for p, q in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    law = co.forces.Pointing(stiffness=0.5, damping=1.5)
    motors = co.forces.ControlMomentGyros(law, period=0.5, max_rate=0.5)
    body = co.systems.body((1.0, 2.0, 2.5), wheels=0.01 * np.eye(3), gyros=gyros).with_forces(motors)
    run = co.integrate(body, body.state([0.0, 0.0, 0.6, 0.8]), (0, 80), 0.125)
    assert run.rotation[0].magnitude() > 1.0 and run.rotation[-1].magnitude() < 1e-6


PLATES = AREAS, NORMALS, CENTRES
PRESCRIBED = [
    (F.GravityGradient(0.8, (1.2, -0.5, 0.7), Q), "position"),
    (F.MagneticDipole((0.2, -0.3, 0.5), (0.3, 0.4, -0.1)), "B"),
    (F.SolarPressure(0.02, TOWARD, *PLATES), "sun"),
    (F.Drag(0.2, TOWARD, *PLATES), "velocity"),
    *(
        (F.Pointing(k, DAMPING, WANTED, (0.1, -0.2, 0.3)), field)
        for k in (STIFF, 0.0)
        for field in ("attitude", "rate")
    ),
]


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("force", "field"), PRESCRIBED)
def test_a_function_of_the_time_acts_as_the_constant_that_it_returns(force, field):
    """Each prescribed vector, also where it is all that a force has of the attitude."""
    free, value = S.body(TENSOR), np.array(getattr(force, field))
    given = dataclasses.replace(force, **{field: lambda t: value})
    x = free.state(TURNED, SPIN)
    constant, timed, none = (system.vector_field(x, 0.7) for system in (*map(free.with_forces, (force, given)), free))
    assert np.abs(constant - none).max() > 1e-4
    np.testing.assert_array_equal(timed, constant)


def test_the_smallest_impulse_fires_and_any_smaller_one_does_not():
    torque = np.array([0.25, -0.5, 0.125])
    for factor, fires in ((1.0, True), (np.nextafter(1.0, 2.0), False)):
        jets = F.Thrusters(F.Torque(torque), PERIOD, 1.0, min_impulse=factor * PERIOD * np.abs(torque))
        sat = S.body((1.0, 1.0, 1.0), attitude=False).with_forces(jets)
        end = sat.flows[0][1].flow(sat, sat.state(), 0.0, PERIOD)
        np.testing.assert_array_equal(end[:3], fires * PERIOD * torque)


@pytest.mark.parametrize("period", [1e-300, 1e-11, 0.04, 0.15, 0.2 + 1e-9])
def test_periods_of_other_than_whole_numbers_of_steps_are_refused(period):
    """Also those that are zero steps up to rounding."""
    sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(co.forces.Sampled(co.forces.Pointing(0.5, 1.5), period))
    with refused(ValueError, "period of Sampled", "whole number of steps"):
        co.integrate(sat, sat.state(), (0.0, 1.0), 0.1)
