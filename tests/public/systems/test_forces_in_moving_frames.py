"""Forces on orbits and on a rotating sphere: their meaning in the frame, against a satellite in inertial space."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import coadjoint as co
from matrix.forces import force_text, functions
from refusals import refused

F, S = co.forces, co.systems
INERTIA, RATE = np.array([1.0, 2.0, 2.5]), 0.8
ORBITS = {e: S.satellite_on_orbit(INERTIA, RATE, e) for e in (0.0, 0.3)}
TILT = Rotation.from_euler("zyx", [20, 10, -5], degrees=True)
PLATE = {"areas": (0.5,), "normals": ((0.6, 0.8, 0.0),), "centres": ((0.0, 0.2, 0.3),)}
SUN, B, AIR = np.array([0.6, 0.0, 0.8]), np.array([0.3, -0.2, 0.1]), np.array([1.0, 0.5, 0.0])
AIMED = Rotation.from_rotvec([0.1, 0.2, -0.1])


def sine_error(A):
    return 0.5 * np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])


def lit(v, A):
    v = A.T @ v
    return v, max(v @ [0.6, 0.8, 0.0], 0.0)


def sunlight(omega, A, t, rate):
    s, along = lit(SUN, A)
    return np.cross([0.0, 0.2, 0.3], -0.05 * 0.5 * along * s)


def thin_air(omega, A, t, rate):
    v, along = lit(AIR, A)
    return np.cross([0.0, 0.2, 0.3], -0.5 * 0.05 * 2.2 * 0.5 * along * v)


# Each force, and its torque of the inertial angular velocity in the body frame, the attitude from the body to the
# orbital frame, the time, and the angular velocity of that frame along its own axes.
CASES = {
    "LinearDamping": (F.LinearDamping(0.2), lambda w, A, t, rate: -0.2 * INERTIA * (w - A.T @ rate)),
    "LinearDamping of each": (
        F.LinearDamping([0.1, 0.3, 0.2] + 9 * [0.0]),
        lambda w, A, t, rate: -np.array([0.1, 0.3, 0.2]) * INERTIA * (w - A.T @ rate),
    ),
    "LinearDamping toward a state": (
        F.LinearDamping(0.2, np.r_[0.1, 0.2, 0.3, np.zeros(9)]),
        lambda w, A, t, rate: -0.2 * (INERTIA * w - [0.1, 0.2, 0.3]),
    ),
    "DoubleBracketDamping": (F.DoubleBracketDamping(0.1), lambda w, A, t, rate: -0.2 * (w - A.T @ rate)),
    "Pointing": (F.Pointing(0.6, 0.9), lambda w, A, t, rate: -0.6 * sine_error(A) - 0.9 * (w - A.T @ rate)),
    "Pointing, a damper": (F.Pointing(0.0, 0.9), lambda w, A, t, rate: -0.9 * (w - A.T @ rate)),
    "Pointing at a rate": (
        F.Pointing(0.6, 0.9, AIMED, lambda t: np.array([0.1, 0.0, np.sin(t)])),
        lambda w, A, t, rate: (
            -0.6 * sine_error(AIMED.as_matrix().T @ A) - 0.9 * (w - A.T @ np.array([0.1, 0.0, np.sin(t)]))
        ),
    ),
    "MagneticDipole": (
        F.MagneticDipole((0.1, 0.2, -0.1), B),
        lambda w, A, t, rate: np.cross([0.1, 0.2, -0.1], A.T @ B),
    ),
    "BDot": (
        F.BDot(0.8, B),
        lambda w, A, t, rate: np.cross(-0.8 * np.cross(A.T @ B, w - A.T @ rate), A.T @ B),
    ),
    "SolarPressure": (F.SolarPressure(0.05, SUN, **PLATE), sunlight),
    "Drag": (F.Drag(0.05, AIR, **PLATE), thin_air),
    "Torque": (
        F.Torque(lambda x, A, t: np.cos(t) * A[1] - 0.1 * x[:3]),
        lambda w, A, t, rate: np.cos(t) * A[1] - 0.1 * INERTIA * w,
    ),
    "OwnForce": (
        F.OwnForce(lambda x, t, tau: np.concatenate((np.exp(-0.3 * tau) * x[:3], x[3:]))),
        lambda w, A, t, rate: -0.3 * INERTIA * w,
    ),
}


def at(e, t):
    """Return the radius, the true anomaly and its rate, by the eccentric anomaly."""
    M = RATE * t
    E = M
    for _ in range(100):
        E = M + e * np.sin(E)
    anomaly = E + 2 * np.arctan(e * np.sin(E) / (1 + np.sqrt(1 - e * e) - e * np.cos(E)))
    radius = 1 - e * np.cos(E)
    return radius, anomaly, RATE * np.sqrt(1 - e * e) / radius**2


def in_space(e, torque, span):
    """Return attitude in the orbital frame and angular velocity at the end of a motion in inertial space by DOP853."""

    def slope(t, y):
        radius, anomaly, rate = at(e, t)
        A = Rotation.from_euler("z", -anomaly).as_matrix() @ Rotation.from_quat(y[:4]).as_matrix()
        q, w = y[:4], y[4:]
        N = 3 * RATE**2 / radius**3 * np.cross(A[0], INERTIA * A[0]) + torque(w, A, t, np.array([0.0, 0.0, rate]))
        turning = (np.cross(INERTIA * w, w) + N) / INERTIA
        return np.r_[0.5 * (q[3] * w + np.cross(q[:3], w)), -0.5 * q[:3] @ w, turning]

    start = (Rotation.from_euler("z", at(e, span[0])[1]) * TILT).as_quat()
    y = solve_ivp(slope, span, np.r_[start, SPIN], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return (Rotation.from_euler("z", -at(e, span[1])[1]) * Rotation.from_quat(y[:4])).as_matrix(), y[4:]


SPIN = np.array([0.1, -0.2, 0.7])


@pytest.mark.parametrize("e", ORBITS)
def test_every_force_is_a_case_or_refused(e):
    orbit = ORBITS[e]
    space = {"np": np, "co": co, "f": functions, "system": orbit}
    acting = {name.split()[0].rstrip(",") for name in CASES} | {"HeatBath", "HamiltonianNoise", "RandomTorque"}
    for name in set(F.names()) - acting:
        with pytest.raises((TypeError, ValueError)):
            law = {"Sampled", "ReactionWheels", "ControlMomentGyros"}
            if name in law:
                orbit.with_forces(getattr(F, name)(F.Pointing(0.1, 0.2), 0.5))
            elif name == "Thrusters":
                orbit.with_forces(F.Thrusters(F.Pointing(0.1, 0.2), 0.5, 1.0))
            elif name == "Magnetorquers":
                orbit.with_forces(F.Magnetorquers(F.Pointing(0.1, 0.2), 0.5, B=B))
            else:
                orbit.with_forces(eval(force_text(name, orbit), space))
    with refused(ValueError, "GravityGradient", "satellite_on_orbit", "already"):
        orbit.with_forces(F.GravityGradient(1.0, (1.0, 0.0, 0.0)))
    with refused(ValueError, "LinearDamping", "matrix", "Pointing"):
        orbit.with_forces(F.LinearDamping(0.1 * np.eye(12)))


@pytest.mark.thinned(1)
@pytest.mark.parametrize("e", ORBITS)
@pytest.mark.parametrize("name", CASES)
def test_the_field_of_a_force_on_an_orbit(name, e):
    """At several times, and its flow as the field says: differences of order two."""
    (force, torque), orbit = CASES[name], ORBITS[e]
    x = orbit.state(TILT, SPIN)
    for t in (0.0, 1.7, -3.1):
        found = orbit.with_forces(force).vector_field(x, t) - orbit.vector_field(x, t)
        wanted = torque(SPIN, TILT.as_matrix(), t, np.array([0.0, 0.0, at(e, t)[2]]))
        np.testing.assert_allclose(found[:3], wanted, rtol=1e-9, atol=1e-10)
        assert np.abs(found[3:]).max() < 1e-12
        step = 2.0**-10
        flows = [force.flow(orbit, x, t - k * step, 2 * k * step) - x for k in (1, -1)]
        np.testing.assert_allclose((flows[0] - flows[1])[:3] / (4 * step), wanted, rtol=0, atol=1e-5)


LONG = [pytest.param(name, marks=pytest.mark.long) for name in CASES if name != "LinearDamping"]


@pytest.mark.parametrize("name", ["LinearDamping", *LONG])
def test_a_run_on_an_ellipse_by_dop853_in_inertial_space(name):
    """From a time other than zero, of order two and four, forward; and back."""
    (force, torque), orbit, span = CASES[name], ORBITS[0.3], (-1.0, 3.0)
    A, omega = in_space(0.3, torque, span)
    wanted = np.r_[INERTIA * omega, A.ravel()]
    system, x0 = orbit.with_forces(force), orbit.state(TILT, SPIN)
    errors = [
        np.abs(co.integrate(system, x0, span, h, co.Splitting(order=order)).x[-1] - wanted).max()
        for h, order in ((1 / 8, 4), (1 / 16, 4), (1 / 16, 2))
    ]
    smooth = name not in ("SolarPressure", "Drag")
    assert errors[1] < (1e-5 if smooth else 1e-3) and errors[2] < 1e-2, errors
    assert not smooth or errors[0] / errors[1] > 8, errors
    back = co.integrate(system, wanted, span[::-1], 1 / 16, co.Splitting(order=4))
    assert np.abs(back.x[-1] - x0).max() < (1e-4 if smooth else 1e-2)


def test_a_damped_pitch_libration_in_any_units():
    """From 20 degrees with a rate of 0.05 at the time 5: 9.8712 degrees, with n = 1 in any unit of time and mass."""
    for time, mass in ((1e-7, 1e30), (1e30, 1e-7)):
        orbit = S.satellite_on_orbit(mass * INERTIA, 1 / time)
        damped = orbit.with_forces(F.LinearDamping(0.05 / time))
        x0 = orbit.state(Rotation.from_euler("z", 20, degrees=True), (0, 0, 1 / time))
        sol = co.integrate(damped, x0, (0, 5 * time), 0.125 * time, co.Splitting(order=4))
        assert np.degrees(sol.rotation[-1].as_rotvec()[2]) == pytest.approx(9.8712, abs=1e-4)


def test_a_wanted_rate_is_inertial_and_by_default_that_of_the_orbit():
    circle = S.satellite_on_orbit(INERTIA)
    held = circle.with_forces(F.Pointing(0.0, damping=5.0, rate=(0, 0, 1)))
    sol = co.integrate(held, circle.state(angular_velocity=(0, 0, 1)), (0, 10), 0.05)
    np.testing.assert_allclose(sol.angular_velocity[-1], (0, 0, 1), rtol=0, atol=1e-13)
    x = circle.state(angular_velocity=(0, 0, 1))
    assert not circle.with_forces(F.Pointing(0.5, 1.5)).power(x)["Pointing"]


def test_members_and_derivatives_of_damping_on_an_orbit():
    """Members of different orbits have the bits of each alone; derivatives by the orbit contain those of the frame."""
    orbits = [S.satellite_on_orbit(INERTIA, n).with_forces(F.LinearDamping(0.2)) for n in (0.8, 1.1)]
    x0, h = ORBITS[0.0].state(TILT, SPIN), 1 / 8
    together = co.integrate(co.batch(orbits), np.stack([x0, x0]), (0, 1), h, co.Splitting())
    for k, one in enumerate(orbits):
        np.testing.assert_array_equal(together.x[:, k], co.integrate(one, x0, (0, 1), h, co.Splitting()).x)
    row = np.linspace(0.3, 1.0, 12)

    def end(n=RATE, inertia=INERTIA, rate=0.2):
        system = S.satellite_on_orbit(inertia, n).with_forces(F.LinearDamping(rate))
        x = x0
        for k in range(8):
            x = co.methods.Forced(co.Splitting()).step(system, x, k * h, h)
        return row @ x

    ready = co.prepare(S.satellite_on_orbit(INERTIA, RATE).with_forces(F.LinearDamping(0.2)), co.Splitting(), h)
    found, d = ready.vjp(x0, (0, 1), 8)[1](x=[0 * row, row]), 2.0**-12
    unit = np.eye(3)[2]
    for name, ahead, behind in (
        ("mean_motion", end(n=RATE + d), end(n=RATE - d)),
        ("LinearDamping.rate", end(rate=0.2 + d), end(rate=0.2 - d)),
    ):
        assert found[name] == pytest.approx((ahead - behind) / (2 * d), abs=1e-6)
    slope = (end(inertia=INERTIA + d * unit) - end(inertia=INERTIA - d * unit)) / (2 * d)
    assert found["inertia"][2] == pytest.approx(slope, abs=1e-6)


@pytest.mark.parametrize("rotation", [0.0, 0.8])
def test_damping_on_a_rotating_sphere_is_friction_of_all_scales(rotation):
    """A fluid at rest in the frame stays at rest; the state given as `toward` is a state, of absolute vorticity."""
    s = S.sphere_euler(6, rotation=rotation)
    W = s.from_modes({(2, 1): 0.3, (3, 0): 0.5, (1, 1): 0.2j}, absolute=False)
    x = s.to_vector(W)
    still = s.absolute(np.zeros((6, 6)))
    damping, friction = F.LinearDamping(0.3), F.Friction(0.3)
    np.testing.assert_allclose(damping.flow(s, x, 0.0, 2.0), friction.flow(s, x, 0.0, 2.0), rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        s.relative(s.from_vector(damping.flow(s, x, 0, 2.0))), np.exp(-0.6) * s.relative(W), atol=1e-14
    )
    method, span = co.IsospectralGauss(), (0, 2)
    for start in (W, still):
        runs = [co.integrate(s.with_forces(one), start, span, 0.125, method).x[-1] for one in (damping, friction)]
        np.testing.assert_allclose(runs[0], runs[1], rtol=0, atol=1e-13)
        assert start is W or np.abs(runs[0] - still).max() < 1e-14
    # A zonal flow stands still but for its damping.
    zonal = s.from_modes({(2, 0): 0.4}, absolute=False)
    run = co.integrate(s.with_forces(damping), zonal, span, 0.125, method)
    np.testing.assert_allclose(s.relative(run.x[-1]), np.exp(-0.6) * s.relative(zonal), rtol=0, atol=1e-13)
    other = F.LinearDamping(0.3, W).flow(s, s.to_vector(zonal), 0.0, 2.0)
    np.testing.assert_allclose(s.from_vector(other), W + np.exp(-0.6) * (zonal - W), rtol=0, atol=1e-14)
