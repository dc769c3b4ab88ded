"""Controllers as they are flown: memories, delays, resolutions, coils, and friction and unloading of wheels."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import coadjoint as co
from long import long_where
from refusals import refused

F, S = co.forces, co.systems
MOMENTS, PERIOD, H = np.array([1.0, 2.0, 2.5]), 0.5, 0.125
TURNED, SPIN = Rotation.from_rotvec([0.6, -0.4, 0.3]), np.array([0.2, -0.1, 0.3])


def pid(omega, A, memory, t):
    error = 0.5 * np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
    integral = memory + PERIOD * error
    return (0.02 * t - 0.4) * error - 0.9 * omega - 0.1 * integral, integral


PID = F.Sampled(F.Torque(pid), PERIOD, memory={"integral": 3})


def sine_errors(A):
    B = np.swapaxes(A, -1, -2)
    return 0.5 * (A - B)[..., [2, 0, 1], [1, 2, 0]]


@pytest.mark.parametrize("begin", [0.0, -3.0])
def test_an_integral_is_the_sum_of_the_errors_at_samples(begin):
    """From a start that is given, of each member, whose bits are those alone and on other threads."""
    sat = S.body(MOMENTS).with_forces(F.Torque((0.02, 0.0, 0.01)), PID)
    starts = np.array([[0.1, -0.2, 0.3], [0.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    x0 = sat.state(TURNED, SPIN, memory={"integral": starts})
    span, every = (begin, begin + 10.0), round(PERIOD / H)
    sol = co.integrate(sat, x0, span, H, threads=1)
    errors = sine_errors(sat.attitudes(sol.x))[::every]
    wanted = starts + PERIOD * np.cumsum(errors[:-1], axis=0)
    np.testing.assert_allclose(sol.x[every::every, :, -3:], wanted, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(np.ptp(sol.x[1:].reshape(-1, every, 3, 18)[..., -3:], axis=1), 0.0)
    np.testing.assert_array_equal(co.integrate(sat, x0, span, H, threads=2).x, sol.x)
    for k, one in enumerate(x0):
        np.testing.assert_array_equal(co.integrate(sat, one, span, H).x, sol.x[:, k])


def test_memories_are_coordinates_with_names(tmp_path, no_fsync):
    """Of each law its own, numbered on; also in archives."""
    laws = {"integral": 2, "rate": 1}, {"rate": 3}

    def remember(x, memory):
        return -0.1 * x[:3], memory + 1.0

    sat = S.body(MOMENTS).with_forces(*(F.Sampled(F.Torque(remember), k / 2, memory=m) for k, m in enumerate(laws, 1)))
    names = "held1 held2 held3 integral1 integral2 rate1 held4 held5 held6 rate2 rate3 rate4".split()
    kinds = sat.layout["coordinates"]
    assert kinds["integral"] == kinds["rate"] == kinds["held"] == ("memory", "")
    x0 = sat.state(memory={"rate": (0.5, 10.0, 20.0, 30.0)})
    co.integrate(sat, x0, (0, 2), 0.25, archive=tmp_path / "run.zarr")
    found = co.load(tmp_path / "run.zarr").to_xarray()["x"]
    assert found["component"].values.tolist()[12:] == names
    assert found.sel(component=["integral2", "rate1", "rate2"])[-1].values.tolist() == [4.0, 4.5, 12.0]
    again = S.body(MOMENTS, held=names)
    assert again.held == 12 and again.layout == sat.unforced.layout


@pytest.mark.parametrize("delay", long_where([1], [0, 1, 3]))
def test_a_command_waits_acts_and_is_rounded(delay):
    """The command at a sample is the nearest multiple of the limited torque so many samples before."""
    unit, limit = 2.0**-6, 0.25
    law = F.Pointing(0.6, 0.9)
    sat = S.body(MOMENTS).with_forces(F.Sampled(law, PERIOD, limit, delay=delay, resolution=unit))
    sol = co.integrate(sat, sat.state(TURNED, SPIN), (0, 12), H)
    samples = sol.x[:: round(PERIOD / H)]
    torque = np.clip(-0.6 * sine_errors(sat.attitudes(samples)) - 0.9 * sat.angular_velocity(samples), -limit, limit)
    held = samples[1:, 12:15]
    assert np.abs(held).max() == limit and not np.fmod(held, unit).any()
    late = np.concatenate([np.zeros((delay, 3)), torque[: len(held) - delay]])
    assert np.abs(held - late).max() <= unit / 2 + 1e-14 and len(np.unique(held)) > 8
    assert sat.forces[0].held_at(sat.unforced, sol.x).shape == (97, 3)


def orbit_field(t):
    return np.array([0.2 * np.cos(0.2 * t), 0.05, 0.4 * np.sin(0.2 * t)])


def turning(t, y, torque):
    """Return the slope of a quaternion and an angular velocity, with a torque of the field in the body frame."""
    q, w = y[:4], y[4:]
    N = torque(t, w, Rotation.from_quat(q).as_matrix().T @ orbit_field(t))
    spin = (np.cross(MOMENTS * w, w) + N) / MOMENTS
    return np.r_[0.5 * (q[3] * w + np.cross(q[:3], w)), -0.5 * q[:3] @ w, spin]


def follow(y, begin, end, torque):
    return solve_ivp(turning, (begin, end), y, "DOP853", rtol=1e-11, atol=1e-12, args=(torque,)).y[:, -1]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("begin", [0.0, 40.0])
@pytest.mark.parametrize("sampled", [True, False])
def test_b_dot_slows_down_a_tumbling_body_as_by_dop853(sampled, begin):
    """To the rate at which the field turns, with coils at their limit first."""
    gain, limit, end = 6.0, 0.6, begin + 120.0
    start = np.array([0.9, -0.7, 0.8])
    y, before, steps = np.r_[TURNED.as_quat(), start], None, np.arange(begin, end, PERIOD)
    if sampled:
        for t, after in pairwise([*steps, end]):
            b = Rotation.from_quat(y[:4]).as_matrix().T @ orbit_field(t)
            m = np.zeros(3) if before is None else np.clip(-gain * (b - before) / PERIOD, -limit, limit)
            y, before = follow(y, t, after, lambda t, w, b, m=m: np.cross(m, b)), b
        coils = F.Magnetorquers(F.BDot(gain), PERIOD, B=orbit_field, max_moment=limit)
    else:
        y = follow(y, begin, end, lambda t, w, b: np.cross(np.clip(-gain * np.cross(b, w), -limit, limit), b))
        coils = F.BDot(gain, orbit_field, max_moment=limit)
    sat = S.body(MOMENTS).with_forces(coils)
    errors = []
    for h in (1 / 16, 1 / 32):
        x = co.integrate(sat, sat.state(TURNED, start), (begin, end), h).x[-1]
        errors.append(np.abs(sat.angular_velocity(x) - y[4:]).max())
        assert np.linalg.norm(sat.angular_velocity(x)) < 0.3 * np.linalg.norm(start)
    # Where a moment leaves its limit within a step, terms of order two change, and those of DOP853.
    assert errors[1] < 2e-3 and (errors[1] < 1e-6 or errors[0] / errors[1] > 3.0), errors


def test_moments_by_torques_and_as_they_are():
    """The torque is that of the law without its part along the field, and moments are limited after it."""
    b, wanted = np.array([0.3, -0.2, 0.1]), np.array([0.02, 0.05, -0.04])
    across = wanted - b * (b @ wanted) / (b @ b)
    for command, more, torque in (
        (wanted, {}, across),
        (wanted, {"max_torque": 0.03}, (low := np.clip(wanted, -0.03, 0.03)) - b * (b @ low) / (b @ b)),
        (wanted, {"max_moment": 0.05}, np.cross(np.clip(np.cross(b, wanted) / (b @ b), -0.05, 0.05), b)),
        (wanted, {"commands": "moment"}, np.cross(wanted, b)),
    ):
        sat = S.body(MOMENTS).with_forces(F.Magnetorquers(F.Torque(command), PERIOD, B=b, **more))
        end = sat.flows[0][1].flow(sat, sat.state(), 0.0, PERIOD)
        np.testing.assert_allclose(end[:3], PERIOD * torque, rtol=0, atol=1e-16)
    nothing = S.body(MOMENTS).with_forces(F.Magnetorquers(F.Torque(wanted), PERIOD, B=(0.0, 0.0, 0.0)))
    assert not co.integrate(nothing, nothing.state(), (0, 1), H).x[:, 12:].any()


@pytest.mark.parametrize("mass, time", [(1e-7, 1.0), (1e30, 1e5)])
def test_coils_in_other_units(mass, time):
    def motion(mass, time):
        coils = F.Magnetorquers(F.BDot(1.5 * mass / time), PERIOD * time, B=(0.3, -0.2, 0.4), max_moment=mass / time**2)
        sat = S.body(MOMENTS * mass).with_forces(coils)
        x0 = sat.state(TURNED, SPIN / time)
        return co.integrate(sat, x0, (3 * time, 13 * time), H * time).rotation[-1].as_quat()

    np.testing.assert_allclose(motion(mass, time), motion(1.0, 1.0), rtol=0, atol=1e-11)


AXES = 0.02 * np.eye(3)


def unload(x):
    return -0.02 * x[12:15]


@pytest.mark.long
def test_coils_unload_wheels_while_these_point():
    """As fast as the mean of the law across the field; the wheels along the axes have three numbers in the state."""
    wheels = F.ReactionWheels(F.Pointing(0.5, 1.5), PERIOD)
    coils = F.Magnetorquers(F.Torque(unload), PERIOD, B=orbit_field)
    sat = S.body(MOMENTS, wheels=AXES).with_forces(wheels, coils)
    x0 = sat.state(wheel_speeds=[40.0, -30.0, 20.0])
    sol = co.integrate(sat, x0, (0, 400), H, save_every=8)
    speeds = np.linalg.norm(sat.wheel_speeds(sol.x), axis=1)
    b = np.array([orbit_field(t) for t in 10 * np.pi * np.arange(512) / 512])
    b /= np.linalg.norm(b, axis=1)[:, None]
    slowest = 0.02 * (1.0 - np.linalg.eigvalsh(np.einsum("ti,tj->ij", b, b) / len(b))[-1])
    assert 0.0 < speeds[-1] < np.exp(-400.0 * slowest) * speeds[0] < 0.2 * speeds[0]
    # Coils that unload are a torque of at most 0.02 of the momentum.
    assert sol.rotation.magnitude().max() < 0.02 * 0.02 * speeds[0] / 0.5 * 1.5


def test_friction_of_wheels_slows_them_down_relative_to_the_body():
    """One axis in closed form, viscous and dry; the momentum of all stays."""
    J, moment, c, f = 0.02, 2.5, 0.01, 0.004
    rate = 1 / J + 1 / (moment - J)
    for force, wanted in (
        (F.WheelFriction(viscous=c), lambda t: 50.0 * np.exp(-c * rate * t)),
        (F.WheelFriction(coulomb=f, transition_speed=0.05), lambda t: 50.0 - f * rate * t),
    ):
        sat = S.body((1.0, 2.0, moment), wheels=[(0.0, 0.0, J)]).with_forces(force)
        sol = co.integrate(sat, sat.state(TURNED, (0.0, 0.0, 0.3), wheel_speeds=[50.0]), (0, 200), H)
        speeds, space = sat.wheel_speeds(sol.x)[:, 0], sat.angular_momentum(sol.x, frame="space")
        # Dry friction below its full size by (transition / speed)^2 / 2.
        np.testing.assert_allclose(speeds, wanted(sol.t), rtol=0, atol=2e-4)
        assert np.abs(space - space[0]).max() < 1e-13
        assert np.all(np.diff(sol.work["WheelFriction"]["energy"]) <= 0.0)
    stopping = sat.unforced.with_forces(F.WheelFriction(coulomb=0.05, transition_speed=0.5))
    sol = co.integrate(stopping, stopping.state(wheel_speeds=[10.0]), (0, 20), H / 4)
    assert abs(stopping.wheel_speeds(sol.x[-1])[0]) < 1e-12


def test_what_is_refused(tmp_path):
    free = S.body(MOMENTS, wheels=AXES)

    def short_memory(x, memory):
        return x[:3], memory[:2]

    for force, named in (
        (F.Torque(pid), ("memory", "Sampled")),
        (F.BDot(1.0), ("BDot", "B", "Magnetorquers")),
        (F.Sampled(F.BDot(1.0), PERIOD), ("BDot", "B")),
        (F.WheelFriction(viscous=(0.1, 0.2)), ("viscous", "(2,)", "3")),
        (F.Sampled(F.Torque(short_memory), PERIOD, memory={"a": 3}), ("Sampled", "(2,)", "(3,)")),
        (F.Sampled(F.Torque(lambda x, memory: x[:3]), PERIOD, memory={"a": 2}), ("Sampled", "(2,)")),
        (F.Sampled(F.Torque(pid), PERIOD, memory={"L": 3}), ("held", "L1")),
        (F.Sampled(F.Pointing(0.1, 0.2), PERIOD, 0.1, resolution=0.03), ("max_torque", "0.03")),
        (F.Sampled(F.Pointing(0.1, 0.2), PERIOD, resolution=(0.1, 0.2)), ("resolution", "(2,)")),
        (F.Magnetorquers(F.Pointing(0.0, 0.2), PERIOD, B=(0, 0, 1)), ("attitude",)),
    ):
        with refused((TypeError, ValueError), *named):
            (S.body(MOMENTS, attitude=False) if named == ("attitude",) else free).with_forces(force)
    for make, named in (
        (lambda: F.Sampled(F.Torque(pid), PERIOD), ("memory", "Sampled")),
        (lambda: F.Sampled(F.Pointing(0.1, 0.2), PERIOD, memory={"a": 3}), ("memory", "Sampled")),
        (lambda: F.Sampled(F.Torque(pid), PERIOD, memory={"a1": 3}), ("memory", "a1")),
        (lambda: F.Magnetorquers(F.BDot(1.0, (0, 0, 1)), PERIOD, B=(0, 0, 1)), ("BDot", "gain")),
        (lambda: F.Magnetorquers(F.Pointing(0.1, 0.2), PERIOD), ("B of Magnetorquers",)),
        (lambda: F.WheelFriction(coulomb=0.1), ("transition_speed",)),
        (lambda: free.state(memory={"integral": 1.0}), ("memory", "body")),
        (lambda: free.with_forces(PID).state(memory={"integrals": (0, 0, 0)}), ("integrals", "integral")),
        (lambda: free.with_forces(PID).state(memory={"integral": (0, 0)}), ("integral", "(3,)")),
    ):
        with refused((TypeError, ValueError), *named):
            make()
    for force in (PID, F.Magnetorquers(F.BDot(1.0), PERIOD, B=(0, 0, 1)), F.WheelFriction(0.1)):
        with refused(TypeError, force.label, "exported"):
            co.export_c(co.prepare(free.with_forces(force), co.Splitting(), H), tmp_path / "run.h")


def test_each_wheel_has_its_own_friction():
    """At speeds near those where dry friction falls to zero; wheels in another order have the same in that order."""
    rng, axes = np.random.default_rng(5), np.array([[0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.006, 0.0, 0.008]])
    viscous, coulomb, least = np.array([1e-3, 3e-3, 2e-3]), np.array([0.02, 0.01, 0.04]), np.array([0.5, 2.0, 8.0])
    speeds, omega = np.array([0.4, -2.5, 7.0]), rng.normal(size=3)
    s = speeds
    expected = -viscous * s - coulomb * s / np.sqrt(s * s + least * least)
    for order in ([0, 1, 2], [2, 0, 1]):
        force = F.WheelFriction(viscous[order], coulomb[order], least[order])
        sat = S.body(MOMENTS, wheels=axes[order]).with_forces(force)
        x = sat.state(angular_velocity=omega, wheel_speeds=speeds[order])
        found = sat.forces[0].field(sat.unforced, x, 0.0)
        np.testing.assert_allclose(found[12:], expected[order], rtol=1e-12)
        assert not found[:12].any()
