"""Bodies with running wheels and gyros: at rest, turning, with motors and a disturbance, by every choice of parts."""

import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import coadjoint as co
from satellite_forces import PYRAMID, TENSOR, WHEELS, F, S

MOMENTS = np.array([4.0, 5.5, 7.2])
TILTED = 0.002 * np.array([(1, 0, 1), (0, 1, 1), (-1, 0, 1), (0, -1, 1)]) / np.sqrt(2)
SPEEDS = np.array([500.0, 300.0, -200.0, 700.0])
UNIT = 2.0**-53

BODIES = {
    "pyramid": (MOMENTS, {"wheels": TILTED}, {"wheel_speeds": SPEEDS}),
    "skewed": (TENSOR, {"wheels": WHEELS}, {"wheel_speeds": SPEEDS / 100}),
    "one through a diagonal": (MOMENTS, {"wheels": [(0.01, 0.02, 0.02)]}, {"wheel_speeds": [100.0]}),
    "twenty": (TENSOR, {"wheels": np.tile(WHEELS, (5, 1)) / 5}, {"wheel_speeds": np.arange(20.0)}),
    "gyros": (MOMENTS, {"gyros": PYRAMID}, {"gimbal_angles": (0.2, -0.3, 3.0, 0.1)}),
    "wheels and gyros": (
        TENSOR,
        {"wheels": WHEELS, "gyros": PYRAMID[:2]},
        {"wheel_speeds": SPEEDS / 100, "gimbal_angles": (0.2, -0.3)},
    ),
}


def in_units(name, mass=1.0, time=1.0):
    """Return a body and its rotors in units of mass and time, at rest or at an angular velocity."""
    moments, rotors, running = BODIES[name]
    scaled = {key: np.asarray(one) * mass / (1.0 if key == "wheels" else time) for key, one in rotors.items()}
    turned = {key: np.asarray(one) / (time if key == "wheel_speeds" else 1.0) for key, one in running.items()}
    return S.body(np.asarray(moments) * mass, **scaled), turned


@pytest.mark.filterwarnings("error::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("method", [co.Splitting(), co.Splitting(order=4), co.Splitting(parts="coordinates")], ids=repr)
@pytest.mark.parametrize("mass, time", [(1.0, 1.0), (1e-7, 1.0), (1e30, 1e5)])
@pytest.mark.parametrize("name", BODIES)
def test_a_body_at_rest_stays_at_rest_while_its_rotors_run(name, mass, time, method):
    """Every part is zero there, up to the rounding of the angular velocity, of about n terms, in every step."""
    body, running = in_units(name, mass, time)
    x0 = body.state(Rotation.from_rotvec([0.3, -0.2, 0.5]), **running)
    for span in ((0.0, 100.0 * time), (7.0 * time, -93.0 * time)):
        sol = co.integrate(body, x0, span, 0.5 * time, method)
        carried = np.abs(x0[:3]).max() / (np.trace(np.atleast_2d(TENSOR)) * mass)
        angle = (sol.rotation[0].inv() * sol.rotation[-1]).magnitude()
        assert angle < 100.0 * time * 4 * body.dim * UNIT * carried + 1e-14
        assert np.abs(sol.angular_velocity[-1]).max() < 8 * body.dim * UNIT * carried


def motion(body, running, L, t):
    """Return L and the attitude by DOP853 in quaternions: I Omega and the momenta of the rotors add up to L."""
    moments, rotors, _ = BODIES[body]
    I, h = np.asarray(moments) if np.ndim(moments) == 2 else np.diag(moments), np.zeros(3)
    for wheel, k in zip(np.atleast_2d(rotors.get("wheels", np.zeros((0, 3)))), running["k"], strict=True):
        unit = wheel / np.linalg.norm(wheel)
        I = I - np.linalg.norm(wheel) * np.outer(unit, unit)
        h = h + k * unit
    for gyro, angle in zip(rotors.get("gyros", ()), running.get("gimbal_angles", ()), strict=True):
        h = h + np.cos(angle) * np.asarray(gyro[0]) + np.sin(angle) * np.asarray(gyro[1])
    inverse = np.linalg.pinv(I)

    def slope(t, y):
        omega, (x, yy, z, w) = inverse @ (y[:3] - h), y[3:]
        p, q, r = omega
        turned = 0.5 * np.array([w * p + yy * r - z * q, w * q + z * p - x * r, w * r + x * q - yy * p, 0.0])
        turned[3] = -0.5 * (x * p + yy * q + z * r)
        return np.concatenate([np.cross(y[:3], omega), turned])

    y = solve_ivp(slope, (0.0, t), [*L, 0, 0, 0, 1], method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    return y[:3], Rotation.from_quat(y[3:])


@pytest.mark.parametrize("name", BODIES)
def test_a_turning_body_with_rotors_by_dop853(name):
    """Order four, forward and back."""
    body, running = in_units(name)
    x0 = body.state(angular_velocity=(0.0, -0.02, 0.03), **running)
    wheels = len(BODIES[name][1].get("wheels", ()))
    L, turned = motion(name, {**running, "k": x0[12 : 12 + wheels]}, x0[:3], 20.0)
    other, errors = np.concatenate([0.9 * x0[:3], x0[3:]]), []
    for h in (0.5, 0.25):
        last = co.integrate(body, np.stack([other, x0]), (0, 20), h, co.Splitting(order=4)).x[-1, 1]
        angle = (turned.inv() * Rotation.from_matrix(body.attitudes(last))).magnitude()
        errors.append(max(np.abs(last[:3] - L).max(), angle))
        back = co.integrate(body, last, (20, 0), h, co.Splitting(order=4)).x[-1]
        np.testing.assert_allclose(back, x0, rtol=0, atol=1e-12)
    assert errors[0] < 1e-4 and np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.4), errors


@pytest.mark.parametrize("h", [0.5, 0.125])
@pytest.mark.parametrize("first", [0, 1], ids=["torque first", "motors first"])
def test_motors_hold_a_disturbance_at_the_angle_of_a_spring(first, h):
    """At rest the torque of the motors is that of the disturbance: the error is asin(|torque| / stiffness)."""
    torque, K = np.array([0.012, -0.02, 0.009]), 0.5
    forces = F.Torque(torque), F.ReactionWheels(F.Pointing(K, 2.4), period=0.5)
    sat = S.body(MOMENTS, wheels=TILTED).with_forces(*(forces[::-1] if first else forces))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("default", co.LongWait)  # of a busy machine
        sol = co.integrate(sat, sat.state(wheel_speeds=0.1 * SPEEDS), (0, 800), h)
    # The slowest mode decays at K / damping per unit of time; gyroscopic coupling slows it down.
    assert sol.rotation[-1].magnitude() == pytest.approx(np.arcsin(np.linalg.norm(torque) / K), abs=1e-8)
    assert np.abs(sol.angular_velocity[-1]).max() < 1e-9


def test_rotors_may_be_in_any_set_of_own_parts():
    """They generate no flow; what they are coupled with decides."""
    body, running = in_units("pyramid")
    x0 = body.state(angular_velocity=(0.01, -0.02, 0.03), **running)
    runs = [
        co.integrate(body, x0, (0, 10), 0.5, co.Splitting(parts=parts)).x
        for parts in (((0, 12, 13, 14, 15), (1,), (2,)), ((0,), (1, 13), (2, 12, 14, 15)))
    ]
    np.testing.assert_array_equal(*runs)
    with pytest.raises(ValueError, match="leave out k1"):
        co.integrate(body, x0, (0, 1), 0.5, co.Splitting(parts=((0,), (1,), (2,))))


@pytest.mark.parametrize("H", ["x1*x3 + x2^2/2 + x3^2", "x1^2/2 + x1*x2/4 + x1*x3 + x2*x3 + x3^2/3", "x1*x3 + x2*x3"])
@pytest.mark.parametrize("parts", ["auto", "coordinates"])
def test_products_with_a_central_coordinate_by_dop853(H, parts):
    """On the Heisenberg algebra, also where the others have no squares."""
    system = co.LiePoissonSystem(co.algebras.heisenberg(1), H)
    x0 = np.array([0.3, -0.2, 0.7])
    wanted = solve_ivp(lambda t, x: system.vector_field(x), (0, 2), x0, method="DOP853", rtol=1e-12, atol=1e-14).y[
        :, -1
    ]
    found = co.integrate(system, x0, (0, 2), 1 / 32, co.Splitting(order=6, parts=parts)).x[-1]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)
