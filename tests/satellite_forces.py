"""Forces on a satellite, each beside its own equations in quaternions, without this library."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import coadjoint as co

F, S = co.forces, co.systems
TENSOR = np.array([[1.2, 0.1, -0.05], [0.1, 2.0, 0.15], [-0.05, 0.15, 2.4]])
TURNED, SPIN = Rotation.from_rotvec([0.6, -0.4, 0.3]), np.array([0.2, -0.1, 0.3])
STEP, PERIOD = 1 / 16, 0.5
SHARE = 2.0**-7  # regularization of gyros: positive also where derivatives are differences
WHEELS = np.array([[0.05, 0.0, 0.0], [0.0, 0.04, 0.03], [0.0, -0.03, 0.04], [0.02, 0.02, 0.01]])
PYRAMID = np.array([[(-q, p, 0), (-0.6 * p, -0.6 * q, 0.8)] for p, q in ((1, 0), (0, 1), (-1, 0), (0, -1))])
AREAS, NORMALS = (0.7, 1.3, 0.4), ((0.6, 0.8, 0.0), (0.0, -0.6, 0.8), (-1.0, 0.0, 0.0))
CENTRES = ((0.5, 0.1, -0.2), (0.2, -0.3, 0.4), (-0.2, 0.6, 0.1))  # each beside its normal
MIRROR, MATT = (0.3, 0.5, 0.1), (0.2, 0.05, 0.6)
TOWARD = np.array([0.48, -0.6, 0.64])
Q = np.array([[0.3, 0.05, 0.0], [0.05, 0.1, -0.1], [0.0, -0.1, 0.2]])
# Neither is symmetric, as the gains of a controller need not be.
STIFF = np.array([[0.4, 0.05, 0.0], [-0.02, 0.5, 0.04], [0.03, 0.0, 0.6]])
DAMPING = np.array([[0.9, 0.1, -0.2], [0.0, 1.1, 0.15], [0.05, 0.0, 1.3]])
WANTED = Rotation.from_rotvec([0.1, 0.2, -0.3])


def path(t):
    return np.array([1.5 + 0.1 * np.sin(t), np.cos(t), 0.3 * t])


def dipole_field(t, r):
    return np.array([0.3 * r[1], 0.2 + 0.1 * np.cos(t), -0.1 * r[0]])


def nadir(t):
    c, s = np.cos(0.2 * t), np.sin(0.2 * t)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def gradient_of(r, mu, quadrupole):
    """Return the torque of the field in space on unit second moments: the matrix of second derivatives of U."""
    s = np.linalg.norm(r)

    def U(r):
        s = np.sqrt((r * r).sum())
        return -mu * (1 / s + (np.trace(quadrupole) - 3 * (r @ quadrupole @ r) / s**2) / (2 * s**3))

    h, E = 1e-3 * s, np.eye(3)  # sixth order in both directions: 1e-12
    weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    D = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for a, wa in weights.items():
                for b, wb in weights.items():
                    for p in (a, -a):
                        for q in (b, -b):
                            D[i, j] += np.sign(p * q) * wa * wb * U(r + h * (p * E[i] + q * E[j]))
    return D / h**2


def gravity(mu, place, quadrupole):
    def torque(t, omega, A):
        D = A.T @ gradient_of(place(t) if callable(place) else place, mu, quadrupole) @ A
        M = TENSOR @ D
        return np.array([M[1, 2] - M[2, 1], M[2, 0] - M[0, 2], M[0, 1] - M[1, 0]])

    return torque


def sunlight(t, omega, A):
    total, s = np.zeros(3), A.T @ TOWARD
    plates = zip(AREAS, np.array(NORMALS), np.array(CENTRES), MIRROR, MATT, strict=True)
    for a, n, c, mirror, matt in plates:
        lit = max(s @ n, 0.0)
        total += np.cross(c, -0.02 * a * lit * ((1 - mirror) * s + 2 * (mirror * lit + matt / 3) * n))
    return total


def thin_air(t, omega, A):
    total, v = np.zeros(3), A.T @ np.array([0.5 + 0.1 * t, 0.3, -0.2])
    for a, n, c in zip(AREAS, np.array(NORMALS), np.array(CENTRES), strict=True):
        total += np.cross(c, -0.5 * 0.2 * 2.2 * a * max(v @ n, 0.0) * v)
    return total


def pid(t, omega, A, memory):
    error = 0.5 * np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
    integral, rate = memory[:3] + PERIOD * error, memory[3:] + 0.4 * (omega - memory[3:])
    return -0.4 * error - 0.9 * rate - 0.2 * integral, np.concatenate((integral, rate))


def b_dot(t, omega, A):
    b = A.T @ dipole_field(t, path(t))
    return np.cross(-2.0 * np.cross(b, omega), b)


def change_of_field(t, omega, A, memory):
    b = A.T @ dipole_field(t, path(t))
    return (-1.5 * (b - memory) / PERIOD if memory.any() else np.zeros(3)), b


def bearings(speeds):
    return -0.02 * speeds - np.array([0.03, 0.02, 0.01, 0.04]) * speeds / np.sqrt(speeds**2 + 0.25)


def toward(kind, wanted=lambda t: WANTED.as_matrix(), rate=(0.0, 0.0, 0.0), limit=np.inf):
    def torque(t, omega, A):
        q = Rotation.from_matrix(wanted(t).T @ A).as_quat()
        e = 2 * np.sign(q[3]) * q[:3] * (1.0 if kind == "quaternion" else np.abs(q[3]))
        return np.clip(-STIFF @ e - DAMPING @ (omega - A.T @ np.array(rate)), -limit, limit)

    return torque


LAW = F.Pointing(STIFF, DAMPING, WANTED)


class Case(NamedTuple):
    """A force or several, a reference torque of (t, omega, A), arguments of the body, and which actuator there is."""

    force: Any
    torque: Callable[..., Any]
    body: Mapping[str, Any] = MappingProxyType({})
    actuator: str = ""
    stored: bool = True
    """Whether it has no functions."""
    of_momentum: bool = False
    """Whether the reference torque also takes the momentum in the body frame."""
    memory: int = 0
    """Size of the memory that the reference torque also takes, and returns."""
    delay: int = 0
    field: Callable[..., Any] | None = None
    """The field in which the commands are moments, as a function of the time."""
    friction: Callable[..., Any] | None = None
    """Torques on the wheels, as a function of their speeds."""

    @property
    def free(self):
        return S.body(TENSOR, **self.body)

    @property
    def system(self):
        return self.free.with_forces(*(self.force if isinstance(self.force, list) else [self.force]))

    @property
    def rotors(self):
        given = {"wheel_speeds": (1.0, -2.0, 0.5, 3.0)} if "wheels" in self.body else {}
        return given | ({"gimbal_angles": (0.2, -0.3, 0.4, 0.1)} if "gyros" in self.body else {})

    @property
    def start(self):
        return self.system.state(TURNED, SPIN, **self.rotors)

    def build(self, changed):
        """Return the system with other values of parameters."""
        own = {name: value for name, value in changed.items() if "." not in name}
        force = self.force
        for name, value in changed.items():
            *outer, field = name.split(".")[1:] or [""]
            if outer:
                force = replace(force, law=replace(force.law, **{field: value}))
            elif field:
                force = replace(force, **{field: value})
        return S.body(**{"inertia": TENSOR, **self.body, **own}).with_forces(force)


PLATES = {"areas": AREAS, "normals": NORMALS, "centres": CENTRES}
CASES = {
    "GravityGradient": Case(F.GravityGradient(0.8, (1.2, -0.5, 0.7)), gravity(0.8, np.array([1.2, -0.5, 0.7]), 0 * Q)),
    "GravityGradient of an oblate centre": Case(F.GravityGradient(0.8, path, Q), gravity(0.8, path, Q), stored=False),
    "MagneticDipole": Case(
        F.MagneticDipole((0.2, -0.3, 0.5), (0.3, 0.4, -0.1)),
        lambda t, omega, A: np.cross([0.2, -0.3, 0.5], A.T @ [0.3, 0.4, -0.1]),
    ),
    "MagneticDipole along a path": Case(
        F.MagneticDipole((0.2, -0.3, 0.5), dipole_field, path),
        lambda t, omega, A: np.cross([0.2, -0.3, 0.5], A.T @ dipole_field(t, path(t))),
        stored=False,
    ),
    "SolarPressure": Case(F.SolarPressure(0.02, TOWARD, **PLATES, specular=MIRROR, diffuse=MATT), sunlight),
    "Drag": Case(F.Drag(0.2, lambda t: np.array([0.5 + 0.1 * t, 0.3, -0.2]), **PLATES), thin_air, stored=False),
    "Pointing": Case(LAW, toward("sine")),
    "Pointing by quaternions": Case(
        F.Pointing(STIFF, DAMPING, nadir, (0.0, 0.0, 0.2), "quaternion"),
        toward("quaternion", nadir, (0.0, 0.0, 0.2)),
        stored=False,
    ),
    "Sampled": Case(F.Sampled(LAW, PERIOD, 0.4), toward("sine", limit=0.4), actuator="torque"),
    "ReactionWheels": Case(F.ReactionWheels(LAW, PERIOD), toward("sine"), {"wheels": WHEELS}, "wheels"),
    "ControlMomentGyros": Case(
        F.ControlMomentGyros(LAW, PERIOD, max_rate=0.3, regularization=SHARE),
        toward("sine"),
        {"gyros": PYRAMID},
        "gyros",
    ),
    "BDot": Case(F.BDot(2.0, dipole_field, path), b_dot, stored=False),
    "Magnetorquers": Case(
        F.Magnetorquers(LAW, PERIOD, B=(0.3, 0.4, -0.1)),
        toward("sine"),
        actuator="moment",
        field=lambda t: np.array([0.3, 0.4, -0.1]),
    ),
    "Magnetorquers by the change of the field": Case(
        F.Magnetorquers(F.BDot(1.5), PERIOD, B=dipole_field, position=path, delay=1),
        change_of_field,
        actuator="moment",
        stored=False,
        memory=3,
        delay=1,
        field=lambda t: dipole_field(t, path(t)),
    ),
    "WheelFriction": Case(
        F.WheelFriction(0.02, (0.03, 0.02, 0.01, 0.04), 0.5),
        lambda t, omega, A: np.zeros(3),
        {"wheels": WHEELS},
        friction=bearings,
    ),
    "Sampled with a memory and a delay": Case(
        F.Sampled(F.Torque(pid), PERIOD, memory={"integral": 3, "rate": 3}, delay=2),
        pid,
        actuator="torque",
        stored=False,
        memory=6,
        delay=2,
    ),
    "Thrusters": Case(F.Thrusters(LAW, PERIOD, (0.5, 0.4, 0.3), 0.01), toward("sine"), actuator="thrusters"),
}


def slope_of_attitude(q, omega):
    return 0.5 * np.r_[q[3] * omega + np.cross(q[:3], omega), -q[:3] @ omega]


def together(cases: Sequence[Case]) -> Case:
    """Return the forces of several cases on one body, in this order."""
    body = {key: value for case in cases for key, value in case.body.items()}
    return Case([case.force for case in cases], None, body)


def reference(case: Case, t_end: float) -> dict[str, np.ndarray]:
    """Return attitude, angular velocity and rotors at the end of a run with one force from time 0."""
    return reference_of([case], 0.0, t_end)


def reference_of(cases: Sequence[Case], begin: float, end: float) -> dict[str, np.ndarray]:
    """Return the end of a run with several forces by DOP853, between samples and ends of pulses."""
    unit, moments = WHEELS / np.linalg.norm(WHEELS, axis=1)[:, None], np.linalg.norm(WHEELS, axis=1)
    case, acting = together(cases), {case.actuator: case for case in cases if case.actuator}
    free, start = case.free, case.free.state(TURNED, SPIN, **case.rotors)
    wheeled, geared = "wheels" in case.body, "gyros" in case.body
    sizes = [len(WHEELS) if wheeled else 0, len(PYRAMID) if geared else 0]
    still = {
        "torque": np.zeros(3),
        "moment": np.zeros(3),
        "wheels": np.zeros(sizes[0]),
        "gyros": np.zeros(sizes[1]),
        "thrusters": np.zeros(3),
    }
    y = np.r_[TURNED.as_quat(), SPIN, free.wheel_speeds(start), free.gimbal_angles(start)]

    def parts(y):
        return np.split(y, np.cumsum([4, 3, sizes[0]]))

    def momenta(angles):
        c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
        return c * PYRAMID[:, 0] + s * PYRAMID[:, 1], c * PYRAMID[:, 1] - s * PYRAMID[:, 0]

    def slope(t, y, u):
        q, omega, speeds, angles = parts(y)
        A = Rotation.from_quat(q).as_matrix()
        L, inertia, N = TENSOR @ omega, TENSOR, u["torque"] + u["thrusters"]
        N = N + sum(np.cross(u["moment"], A.T @ one.field(t)) for one in cases if one.field)
        motors = u["wheels"] + sum(one.friction(speeds) for one in cases if one.friction)
        if wheeled:
            # The motors act on the wheels, and the body without their moments about the axes has the opposite torque.
            L, inertia, N = L + (moments * speeds) @ unit, TENSOR - (unit.T * moments) @ unit, N - motors @ unit
        if geared:
            h, dh = momenta(angles)
            L, N = L + h.sum(axis=0), N - u["gyros"] @ dh
        for one in cases:
            N = N if one.actuator else N + one.torque(t, omega, A, *([L] if one.of_momentum else []))
        turning = np.linalg.solve(inertia, np.cross(L, omega) + N)
        driven = motors / moments - unit @ turning if wheeled else speeds
        return np.r_[slope_of_attitude(q, omega), turning, driven, u["gyros"]]

    def follow(y, t, to, u):
        if to <= t:
            return y
        y = solve_ivp(slope, (t, to), y, method="DOP853", rtol=1e-13, atol=1e-13, args=(u,)).y[:, -1]
        return np.r_[y[:4] / np.linalg.norm(y[:4]), y[4:]]

    if not acting:
        y = follow(y, begin, end, still)
    memories = {actuator: np.zeros(one.memory) for actuator, one in acting.items()}
    waiting = {actuator: [still[actuator]] * one.delay for actuator, one in acting.items()}
    for t in np.arange(begin, end - 1e-9, PERIOD) if acting else ():
        q, omega, _, angles = parts(y)
        A, u, pulses = Rotation.from_quat(q).as_matrix(), dict(still), np.zeros(3)
        for actuator, one in acting.items():
            if one.memory:
                torque, memories[actuator] = one.torque(t, omega, A, memories[actuator])
            else:
                torque = one.torque(t, omega, A)
            u[actuator] = torque
            if actuator == "moment" and not one.memory:
                b = A.T @ one.field(t)
                u[actuator] = np.cross(b, torque) / (b @ b)
            if actuator == "wheels":
                u[actuator] = -np.linalg.pinv(unit.T) @ torque
            elif actuator == "gyros":
                B = momenta(angles)[1]
                share = SHARE * (PYRAMID[:, 0] ** 2).sum() / 3
                u[actuator] = np.clip(-B @ np.linalg.solve(B.T @ B + share * np.eye(3), torque), -0.3, 0.3)
            elif actuator == "thrusters":
                full = np.array([0.5, 0.4, 0.3])
                pulses = np.minimum(np.abs(torque) / full, 1.0) * PERIOD
                pulses[pulses * full < 0.01] = 0.0
                u[actuator] = np.sign(torque) * full
            waiting[actuator].append(u[actuator])
            u[actuator] = waiting[actuator].pop(0)
        since = 0.0
        for edge in sorted({*pulses, PERIOD} - {0.0}):
            on = u | {"thrusters": np.where(since < pulses, u["thrusters"], 0.0)}
            y, since = follow(y, t + since, t + edge, on), edge
    q, omega, speeds, angles = parts(y)
    return {"attitude": Rotation.from_quat(q).as_matrix(), "omega": omega, "speeds": speeds, "angles": angles}


def error_of(case: Case, x: np.ndarray, wanted: dict[str, np.ndarray]) -> float:
    """Return the largest difference of a state from the reference."""
    system = case.system
    found = {"attitude": system.attitudes(x), "omega": system.angular_velocity(x)}
    found |= {"speeds": system.wheel_speeds(x), "angles": system.gimbal_angles(x)}
    return max(np.abs(found[name] - wanted[name]).max(initial=0.0) for name in wanted)
