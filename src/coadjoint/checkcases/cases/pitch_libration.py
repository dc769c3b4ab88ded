"""Pitch libration of a satellite under the gradient of gravity, on circular and eccentric orbits."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

from coadjoint.checkcases.altered_motions import apply, cross, matrix_of
from coadjoint.checkcases.attitudes import body_columns
from coadjoint.checkcases.check_case import (
    ATTITUDE,
    RATES,
    BodyModel,
    CheckCase,
    Columns,
    DerivedQuantity,
    sample_times,
)
from coadjoint.checkcases.integration import IntegratedMotion
from coadjoint.checkcases.registry import checkcase
from coadjoint.methods.splitting import Splitting
from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.systems.bodies.satellite_on_orbit import satellite_on_orbit
from coadjoint.validation import read_number, read_positive

Floats = npt.NDArray[np.float64]

FRAME = (
    "Space has the third axis normal to the orbit; at t = 0 the first axis points from the centre of gravity to "
    "the satellite, which is at the pericentre, and the second along its motion. At t = 0 the body is turned about "
    "the third axis by the pitch angle, and at rest relative to the orbital frame. q is the attitude, from the "
    "body to space; wz is the angular velocity in inertial space."
)
METHODS = (Splitting(order=8), Splitting(order=6))
STEPS_PER_ORBIT = 1600


def about_third_axis(angle: Floats, rate: Floats) -> Columns:
    """Return the columns of a body turned about the third axis by an angle, with a rate."""
    zero = np.zeros_like(angle)
    turned = Rotation.from_rotvec(np.column_stack([zero, zero, np.remainder(angle, 2.0 * math.pi)]))
    return body_columns(np.column_stack([zero, zero, rate]), turned)


def pitching_body(
    moments: Floats, angle: float, rate: float, mean_motion: float, orbit: Callable[[Any], tuple[Any, Any, Any]]
) -> BodyModel:
    """Return the model of a satellite; `orbit` has the true anomaly, its rate and (a/r)^3, from times."""

    def torque(t: float, q: Floats, w: Floats, inertia: Floats) -> Floats:
        anomaly, _, cube = orbit(t)
        A = matrix_of(q)
        radial = A[0] * np.cos(anomaly) + A[1] * np.sin(anomaly)
        return 3.0 * mean_motion**2 * cube * cross(radial, apply(inertia, radial))

    attitude = np.array([math.cos(angle / 2.0), 0.0, 0.0, math.sin(angle / 2.0)])
    return BodyModel(
        np.diag(moments),
        np.array([0.0, 0.0, rate]),
        attitude=attitude,
        torque=torque,
        orbital_frame=lambda t: orbit(t)[:2],
    )


def read_pitching(inertia: npt.ArrayLike) -> Floats:
    """Validate three moments with the least about the first axis: zero pitch is stable."""
    moments = read_vector(inertia, "inertia")
    if not (moments > 0.0).all() or not moments[1] > moments[0]:
        raise ValueError(f"inertia is {moments.tolist()}; give positive moments, the second larger than the first")
    return moments


@checkcase
def pitch_libration(
    inertia: npt.ArrayLike = (80.0, 120.0, 150.0),
    mean_motion: float = 0.00107,
    pitch: float = 1.0,
    end: float = 20000.0,
    samples: int = 401,
) -> CheckCase:
    """Return the pitch libration of a satellite on a circular orbit under the gradient of gravity.

    Parameters
    ----------
    inertia : (3,)
        Principal moments, the second larger than the first, kg m^2.
    mean_motion : float
        Angular velocity of the orbit, rad/s.
    pitch : float
        Angle of the first axis from the radius at the start, rad, less than a right angle.
    end, samples
        As of `free_body`.
    """
    moments, n, last = read_pitching(inertia), read_positive(mean_motion, "mean_motion"), read_positive(end, "end")
    angle = read_number(pitch, "pitch")
    if not 0.0 < abs(angle) < math.pi / 2:
        raise ValueError(f"pitch is {angle:g}; give an angle of less than a right angle, and not zero")
    frequency, k = n * math.sqrt(3.0 * (moments[1] - moments[0]) / moments[2]), math.sin(abs(angle))
    quarter = float(ellipk(k * k))

    def motion(t: Floats) -> Columns:
        # sin(pitch) = k sn(u), from the largest pitch at u = K.
        sn, cn, dn, _ = ellipj(quarter + frequency * t, k * k)
        sign = math.copysign(1.0, angle)
        turned: Floats = sign * np.arctan2(k * sn, dn)
        return about_third_axis(n * t + turned, np.asarray(n + sign * frequency * k * cn))

    def energy(columns: Mapping[str, Floats]) -> Floats:
        theta = 2.0 * np.arctan2(columns["qz"], columns["qw"]) - n * columns["t"]
        return 0.5 * moments[2] * ((columns["wz"] - n) ** 2 + frequency**2 * np.sin(theta) ** 2)

    return CheckCase(
        name="pitch_libration",
        title="pitch libration under the gradient of gravity on a circular orbit",
        statement=(
            "The pitch theta, the angle of the first axis of the body from the radius, is a pendulum: theta'' = "
            f"-(3/2) n^2 ((I_y - I_x)/I_z) sin(2 theta), with the mean motion n. {FRAME} The attitude is turned "
            "about the third axis by n t + theta, and wz = n + theta'."
        ),
        parameters={
            "inertia": (moments, "kg m^2"),
            "mean_motion": (n, "rad/s"),
            "pitch": (angle, "rad"),
            "end": (last, "s"),
        },
        quantities=(RATES, ATTITUDE),
        motion=motion,
        times=sample_times(last, samples),
        accuracy=1e-11,
        basis="closed form, Jacobi's elliptic functions",
        source="V. V. Beletskii, Motion of an Artificial Satellite about its Center of Mass (1966)",
        body=pitching_body(moments, angle, n, n, lambda t: (n * t, n + 0.0 * t, 1.0)),
        invariants=(DerivedQuantity("energy of the libration", "J", energy, ("rates", "attitude")),),
        results={"period of the libration": (4.0 * quarter / frequency, "s")},
    )


@checkcase
def eccentric_libration(
    inertia: npt.ArrayLike = (80.0, 120.0, 150.0),
    mean_motion: float = 0.00107,
    eccentricity: float = 0.1,
    pitch: float = 0.3,
    end: float = 20000.0,
    samples: int = 401,
) -> CheckCase:
    """Return the pitch libration of a satellite on an eccentric orbit under the gradient of gravity.

    Parameters
    ----------
    inertia : (3,)
        Principal moments, the second larger than the first, kg m^2.
    mean_motion : float
        Mean angular velocity of the orbit, rad/s.
    eccentricity : float
        Of the orbit, at most 0.5.
    pitch : float
        Angle of the first axis from the radius at the start, rad.
    end, samples
        As of `free_body`.
    """
    moments, n, last = read_pitching(inertia), read_positive(mean_motion, "mean_motion"), read_positive(end, "end")
    angle, e = read_number(pitch, "pitch"), read_number(eccentricity, "eccentricity")
    if not 0.0 < e <= 0.5:
        raise ValueError(f"eccentricity is {e:g}; give a number above 0 and at most 0.5, or take pitch_libration")
    # In units of 1/n the torque is that of the ratios of the moments.
    system = satellite_on_orbit(tuple((moments / moments[2]).tolist()), 1.0, e)
    c, s = math.cos(angle), math.sin(angle)
    x0 = system.state(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), (0.0, 0.0, float(system.orbit(0.0).rate)))

    def columns(x: Floats, t: Floats) -> Columns:
        theta = np.arctan2(-x[:, 4], x[:, 3])
        return about_third_axis(system.orbit(t).anomaly + theta, n * x[:, 2])

    def on_orbit(t: Any) -> tuple[Any, Any, Any]:
        there = system.orbit(n * np.asarray(t))
        return there.anomaly, n * there.rate, there.radius**-3.0

    motion = IntegratedMotion(system, x0, 2.0 * math.pi / STEPS_PER_ORBIT, METHODS, columns, 1.0 / n)
    times = sample_times(last, samples)
    return CheckCase(
        name="eccentric_libration",
        title="pitch libration under the gradient of gravity on an eccentric orbit",
        statement=(
            "theta'' + f'' = -(3/2) n^2 (a/r)^3 ((I_y - I_x)/I_z) sin(2 theta), with the pitch theta, the angle of "
            "the first axis of the body from the radius, the true anomaly f, and (a/r) = (1 + e cos f)/(1 - e^2) "
            f"(Beletsky). {FRAME} The attitude is turned about the third axis by f + theta, and wz = f' + theta'."
        ),
        parameters={
            "inertia": (moments, "kg m^2"),
            "mean_motion": (n, "rad/s"),
            "eccentricity": (e, "1"),
            "pitch": (angle, "rad"),
            "end": (last, "s"),
        },
        quantities=(RATES, ATTITUDE),
        motion=motion,
        times=times,
        accuracy=1e-10,
        basis="this library, splittings of orders 8 and 6, and DOP853 agree",
        source="V. V. Beletskii, Motion of an Artificial Satellite about its Center of Mass (1966)",
        body=pitching_body(moments, angle, n * float(system.orbit(0.0).rate), n, on_orbit),
    )
