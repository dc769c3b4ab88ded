"""Torques of the surroundings on a body: gravity, a magnetic field, sunlight and thin air."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.forces.body_torque import (
    BodyTorque,
    check_value,
    cross,
    prescribed,
    read_prescribed,
    read_tensor,
    tensor,
    to_body,
)
from coadjoint.systems.time_spans import sample_time_of
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import as_tuples, read_finite, read_number, set_fields


@suggest_keywords
@dataclass(frozen=True)
class GravityGradient(BodyTorque):
    """The torque of the gradient of gravity on a body that moves along a prescribed path.

    Gravity is that of a centre with second moments: ``U(r) = -mu (1/r + (tr Q - 3 u . Q u)/(2 r^3))``, u the direction
    of r, and the torque is that of the inertia tensor I of the body in its gradient. From a point, Q = 0, it is ``3 mu
    r^-5 r cross I r``, r in the body frame. For a circular or elliptic orbit about a point
    `co.systems.satellite_on_orbit` has the same torque as a part of its energy, and refuses this force.

    Parameters
    ----------
    mu : float
        Gravitational constant times the mass of the centre (length cubed over time squared).
    position : (3,) or callable
        Of the body from the centre, in space: constant, or a function of the time t, compiled by Numba.
    quadrupole : float, (3,) or (3, 3)
        Q, the inertia tensor of the centre over its mass, in space (length squared); only its symmetric part
        without the trace matters.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes, a position that is zero, or a system that is not one body with its attitude in the state.

    Examples
    --------
    A satellite on a circular orbit librates about the line to the centre:

    >>> import coadjoint as co
    >>> import numpy as np
    >>> pull = co.forces.GravityGradient(1.0, lambda t: np.array([np.cos(t), np.sin(t), 0.0]))
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(pull)
    >>> x0 = sat.state(angular_velocity=(0, 0, 1.01))
    >>> sol = co.integrate(sat, x0, (0, 20), 0.05)
    >>> pitch = np.unwrap(sol.rotation.as_rotvec()[:, 2], period=2 * np.pi) - sol.t
    >>> bool(abs(pitch - 0.01 * np.sin(np.sqrt(1.2) * sol.t) / np.sqrt(1.2)).max() < 1e-3)
    True
    """

    mu: float
    position: Any
    quadrupole: Any = 0.0

    example: ClassVar = {"mu": 0.5, "position": (1.0, -0.5, 0.25)}

    def __post_init__(self) -> None:
        self._read(mu=read_number, position=read_prescribed, quadrupole=read_tensor)
        if not np.any(self.position(sample_time_of(self.position)) if callable(self.position) else self.position):
            raise ValueError("position of GravityGradient is zero; give that of the body from the centre")

    def check(self, system: Any) -> None:
        super().check(system)
        if system.frame_rate is not None:
            raise ValueError(
                f"the energy of {system.name} has the torque of GravityGradient already; leave it out, or take "
                "co.systems.body, or for another centre a co.forces.Torque"
            )

    def torque_on(self, system: Any) -> Callable[..., Any]:
        inertia = np.ascontiguousarray(system.inertias[0].anisotropic)
        mu, position, Q = self.mu, prescribed(self.position), tensor(self.quadrupole)
        Q = 0.5 * (Q + Q.T) - np.trace(Q) / 3.0 * np.eye(3)
        round_centre = not Q.any()

        def torque(x: Any, A: Any, t: Any) -> Any:
            r = position(t)
            square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
            fifth = mu / (square * square * np.sqrt(square))
            inside = to_body(A, r)
            lever = inertia[0] * inside[0] + inertia[1] * inside[1] + inertia[2] * inside[2]
            if round_centre:
                return 3.0 * fifth * cross(inside, lever)
            # The gradient is -(a r r + b (w r + r w) - c Q), with w = Q r.
            w = Q[0] * r[0] + Q[1] * r[1] + Q[2] * r[2]
            q = w[0] * r[0] + w[1] * r[1] + w[2] * r[2]
            a = 3.0 * fifth - 52.5 * fifth * q / (square * square)
            b = 15.0 * fifth / square
            other = to_body(A, w)
            moved = inertia[0] * other[0] + inertia[1] * other[1] + inertia[2] * other[2]
            result = cross(a * inside + b * other, lever) + b * cross(inside, moved)
            for k in range(3):
                first = inertia[0] * A[k, 0] + inertia[1] * A[k, 1] + inertia[2] * A[k, 2]
                result = result + 3.0 * fifth * cross(first, to_body(A, Q[k]))
            return result

        return torque


@suggest_keywords
@dataclass(frozen=True)
class MagneticDipole(BodyTorque):
    """The torque of a magnetic field on a dipole that is fixed in the body, ``moment cross B``.

    Parameters
    ----------
    moment : (3,)
        The dipole in the body frame (current times area).
    B : (3,) or callable
        B in space: constant, a function of the time t, or with `position` of ``(t, r)``; compiled by Numba.
    position : (3,) or callable, optional
        The argument r of the field, in space: constant, or a function of the time.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes or arguments, or a system that is not one body with its attitude in the state.

    Examples
    --------
    >>> import coadjoint as co
    >>> magnet = co.forces.MagneticDipole((0, 0, 0.5), B=(0.0, 0.1, 0.0))
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(magnet)
    >>> sat.vector_field(sat.state())[:3]
    array([-0.05,  0.  ,  0.  ])
    """

    moment: Any
    B: Any
    position: Any = None

    example: ClassVar = {"moment": (0.1, 0.2, -0.1), "B": (0.3, -0.2, 0.1)}

    def __post_init__(self) -> None:
        self._read(moment=read_prescribed)
        read_magnetic_field(self)
        if callable(self.moment):
            raise TypeError("moment of MagneticDipole is a function; give three numbers, or a co.forces.Magnetorquers")

    def torque_on(self, system: Any) -> Callable[..., Any]:
        moment, field = np.array(self.moment), magnetic_field(self)

        def torque(x: Any, A: Any, t: Any) -> Any:
            return cross(moment, to_body(A, field(t)))

        return torque


def read_magnetic_field(force: Any) -> None:
    """Validate `B` of a force in space, of (t), or with `position` of (t, r)."""
    what = f"B of {force.label}"
    if force.position is not None:
        force._read(position=read_prescribed)
    if force.position is None or not callable(force.B):
        force._read(B=read_prescribed)
    else:
        check_arguments(force.B, what, "t, r")
        t = sample_time_of(force.B, force.position)
        check_value(force.B, what, (3,), t, np.asarray(prescribed(force.position)(t), dtype=np.float64))
    if force.position is not None and not callable(force.B):
        raise TypeError(f"position of {force.label} was given, but its field is constant; give a function of (t, r)")


def magnetic_field(force: Any) -> Callable[..., Any]:
    """Return the magnetic field of a force, in space, as a function of the time for compiled functions."""
    if force.position is None:
        return prescribed(force.B)
    given, position = force.B, prescribed(force.position)
    return lambda t: given(t, position(t))


UNIT = 1e-6
"""Largest deviation of a unit vector from the length 1 that is taken for rounding, and removed."""


_PLATE = {"areas": (0.5,), "normals": ((0.6, 0.8, 0.0),), "centres": ((0.0, 0.2, 0.3),)}


def _read_plates(force: Any) -> None:
    """Validate the flat plates of a force, each of which has an area, an outward normal and a centre."""
    label = force.label
    areas, normals, centres = (
        read_finite(getattr(force, name), f"{name} of {label}") for name in ("areas", "normals", "centres")
    )
    if areas.ndim != 1 or not len(areas) or normals.shape != (len(areas), 3) or centres.shape != normals.shape:
        raise ValueError(
            f"areas, normals and centres of {label} have the shapes {areas.shape}, {normals.shape} and "
            f"{centres.shape}; give (p,), (p, 3) and (p, 3) for p plates"
        )
    lengths = np.sqrt((normals * normals).sum(axis=1))
    if (areas < 0.0).any() or (abs(lengths - 1.0) > UNIT).any():
        raise ValueError(f"areas of {label} must not be negative, and normals be unit vectors")
    plates = {"areas": areas, "normals": normals / lengths[:, None], "centres": centres}
    set_fields(force, **{name: as_tuples(array) for name, array in plates.items()})


@suggest_keywords
@dataclass(frozen=True)
class SolarPressure(BodyTorque):
    """The torque of sunlight on flat plates, which absorb it, reflect it, and scatter it.

    A plate of area a and normal n at c that is lit, ``s . n > 0`` with the unit vector s toward the sun, has at c the
    force ``-pressure a (s . n) ((1 - specular) s + 2 (specular s . n + diffuse / 3) n)``. Plates do not shade each
    other; a panel that is lit on both sides is two plates.

    Parameters
    ----------
    pressure : float
        Of sunlight that is absorbed: 4.56e-6 N/m^2 at the Earth.
    sun : (3,) or callable
        Unit vector toward the sun, in space: constant, or a function of the time t, compiled by Numba. A shorter vector
        is a weaker light, zero in a shadow.
    areas : (p,)
        Areas of the plates.
    normals : (p, 3)
        Outward unit normals, in the body frame.
    centres : (p, 3)
        Centres from the centre of mass, in the body frame.
    specular, diffuse : float or (p,)
        Shares of the light that are reflected as by a mirror, and scattered; the rest is absorbed.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes, shares that exceed 1, or a system that is not one body with its attitude in the state.

    Examples
    --------
    >>> import coadjoint as co
    >>> light = co.forces.SolarPressure(4.56e-6, (1, 0, 0), [2.0], [(1, 0, 0)], [(0, 0, 0.5)], specular=1.0)
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(light)
    >>> sat.vector_field(sat.state())[:3]
    array([ 0.00e+00, -9.12e-06,  0.00e+00])
    """

    pressure: float
    sun: Any
    areas: Any
    normals: Any
    centres: Any
    specular: Any = 0.0
    diffuse: Any = 0.0

    example: ClassVar = {"pressure": 0.05, "sun": (0.6, 0.0, 0.8), **_PLATE}
    selectors: ClassVar[tuple[str, ...]] = ("normals",)

    def __post_init__(self) -> None:
        _read_plates(self)
        share = self._read_share
        self._read(pressure=read_number, sun=read_prescribed, specular=share, diffuse=share)
        if (np.add(self.specular, self.diffuse) > 1.0).any():
            raise ValueError("specular and diffuse of SolarPressure exceed 1 together; they are shares of the light")

    def _read_share(self, value: Any, what: str) -> Any:
        """Validate numbers from 0 to 1, one or one for each plate; a number stays one."""
        array = read_finite(value, what)
        if array.shape not in ((), (len(self.areas),)) or (array < 0.0).any() or (array > 1.0).any():
            raise ValueError(f"{what} must be a number from 0 to 1, or one for each of {len(self.areas)} plates")
        return as_tuples(array)

    def torque_on(self, system: Any) -> Callable[..., Any]:
        pressure, sun, count = self.pressure, prescribed(self.sun), len(self.areas)
        a, n, c = np.array(self.areas), np.array(self.normals), np.array(self.centres)
        mirror, matt = (np.array(np.broadcast_to(share, count)) for share in (self.specular, self.diffuse))

        def torque(x: Any, A: Any, t: Any) -> Any:
            s, result = to_body(A, sun(t)), 0.0 * x[:3]
            for k in range(count):
                along = s[0] * n[k, 0] + s[1] * n[k, 1] + s[2] * n[k, 2]
                turned = (1.0 - mirror[k]) * s + 2.0 * (mirror[k] * along + matt[k] / 3.0) * n[k]
                result = result - pressure * a[k] * (along * (along > 0.0)) * cross(c[k], turned)
            return result

        return torque


@suggest_keywords
@dataclass(frozen=True)
class Drag(BodyTorque):
    """The torque of thin air on flat plates, with the force ``-density coefficient/2 a (v . n) v`` where v . n > 0.

    Parameters
    ----------
    density : float
        Of the air (mass over length cubed).
    velocity : (3,) or callable
        v, of the body relative to the air, in space: constant, or a function of the time t, compiled by Numba. That of
        the plates relative to the centre of mass is neglected.
    areas : (p,)
        Areas of the plates.
    normals : (p, 3)
        Outward unit normals, in the body frame.
    centres : (p, 3)
        Centres from the centre of mass, in the body frame.
    coefficient : float
        Drag coefficient, 2 to 2.5 in free molecular flow.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes, or a system that is not one body with its attitude in the state.

    Examples
    --------
    >>> import coadjoint as co
    >>> air = co.forces.Drag(1e-12, (7500.0, 0, 0), [2.0], [(1, 0, 0)], [(0, 0, 0.5)], coefficient=2.0)
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(air)
    >>> sat.vector_field(sat.state())[:3].round(10)
    array([ 0.000e+00, -5.625e-05,  0.000e+00])
    """

    density: float
    velocity: Any
    areas: Any
    normals: Any
    centres: Any
    coefficient: float = 2.2

    example: ClassVar = {"density": 0.05, "velocity": (1.0, 0.5, 0.0), **_PLATE}
    selectors: ClassVar[tuple[str, ...]] = ("normals",)

    def __post_init__(self) -> None:
        _read_plates(self)
        self._read(density=read_number, coefficient=read_number, velocity=read_prescribed)

    def torque_on(self, system: Any) -> Callable[..., Any]:
        factor, velocity, count = 0.5 * self.density * self.coefficient, prescribed(self.velocity), len(self.areas)
        a, n, c = np.array(self.areas), np.array(self.normals), np.array(self.centres)

        def torque(x: Any, A: Any, t: Any) -> Any:
            v, result = to_body(A, velocity(t)), 0.0 * x[:3]
            for k in range(count):
                along = v[0] * n[k, 0] + v[1] * n[k, 1] + v[2] * n[k, 2]
                result = result - factor * a[k] * (along * (along > 0.0)) * cross(c[k], v)
            return result

        return torque
