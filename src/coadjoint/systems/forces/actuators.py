"""Actuators of a body that are sampled: reaction wheels, control-moment gyros and thrusters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.bodies.inertia import inverse_of, moments_of_wheels
from coadjoint.systems.forces.body_torque import read_limits
from coadjoint.systems.forces.sampled import Sampled
from coadjoint.validation import read_positive

FLAT = 1e-9
"""Determinant of the products of axes below which wheels count as parallel or in a plane."""


@suggest_keywords
@dataclass(frozen=True)
class ReactionWheels(Sampled):
    """Motors that turn the wheels of a body, by a law that is sampled: the torque of each motor is held.

    The wheels are those of ``co.systems.body(inertia, wheels=...)``. A torque u of a motor acts on its wheel, and -u
    on the body: the momentum of all together does not change, in space to rounding. The work of motors
    is in ``sol.work``. The torque of the law is shared by the wheels with the smallest sum of squares; of one or two
    wheels, the part that they can give.

    Parameters
    ----------
    law : Torque, Pointing or another torque on a body
        The torque on the body, in its frame, of the state and the time at a sample.
    period : float
        Time between samples, a whole number of steps.
    max_torque : float or (m,), optional
        Largest torque of a motor.
    max_momentum : float or (m,), optional
        Largest momentum of a wheel about its axis in space, its moment times its largest speed. A motor does not drive
        a wheel beyond it.
    memory, delay, resolution : optional
        As of `Sampled`; the resolution is that of the torque of a motor.
    noise, bias, seed, stream : optional
        The errors of what the law measures, as of `Sampled`.
    first : int
        Index of its first number among those that forces hold; ``with_forces`` sets it.

    Raises
    ------
    TypeError, ValueError
        As of `Sampled`, or the body has no wheels, or those of three and more lie in a plane.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> law = co.forces.Pointing(stiffness=0.5, damping=1.5)
    >>> motors = co.forces.ReactionWheels(law, period=0.5, max_torque=0.1, max_momentum=0.6)
    >>> sat = co.systems.body((1.0, 2.0, 2.5), wheels=0.01 * np.eye(3)).with_forces(motors)
    >>> x0 = sat.state([0.0, 0.0, 0.6, 0.8], angular_velocity=(0.0, 0.0, 0.2))
    >>> sol = co.integrate(sat, x0, (0, 80), 0.05)
    >>> space = sat.angular_momentum(sol.x, frame="space")
    >>> bool(sol.rotation[-1].magnitude() < 1e-5), bool(abs(space - space[0]).max() < 1e-14)
    (True, True)
    >>> sat.wheel_speeds(sol.x[-1]).round(3)
    array([ 0.,  0., 50.])
    """

    max_momentum: Any = None

    command_name: ClassVar[str] = "torque of the motors"
    _limits = dict.fromkeys(("max_torque", "max_momentum"), partial(read_limits, shape=()))

    def _count(self, system: Any) -> int:
        return count_wheels(self, system, ("max_torque", "max_momentum"))

    def _command(self, system: Any) -> Callable[..., Any]:
        wheels, count = system.wheels, self._count(system)
        share = _shares(wheels / moments_of_wheels(wheels)[:, None])
        most = np.array(np.broadcast_to(np.inf if self.max_torque is None else self.max_torque, count))
        limited = self.max_torque is not None

        def command(torque: Any, x: Any, t: Any, deviates: Any) -> Any:
            motors = -(share[:, 0] * torque[0] + share[:, 1] * torque[1] + share[:, 2] * torque[2])
            return np.minimum(np.maximum(motors, -most), most) if limited else motors

        return command

    def _act(self, system: Any, begin: int) -> Callable[..., None]:
        count, start = self._count(system), system.first_carried
        most = np.array(np.broadcast_to(np.inf if self.max_momentum is None else self.max_momentum, count))

        def act(y: Any, t: Any, tau: Any) -> None:
            for i in range(count):
                change, k = tau * y[begin + i], y[start + i]
                up = np.minimum(np.maximum(change, 0.0), np.maximum(most[i] - k, 0.0))
                down = np.maximum(np.minimum(change, 0.0), np.minimum(-most[i] - k, 0.0))
                y[start + i] += up + down

        return act


def count_wheels(force: Any, system: Any, names: Sequence[str]) -> int:
    """Return the number of wheels of a body; raise an error without any, or for other numbers of these parameters."""
    count = len(getattr(system, "wheels", ()))
    if not count:
        raise TypeError(f"{system.name} has no wheels; make it with co.systems.body(inertia, wheels=...)")
    for name in names:
        shape = np.shape(getattr(force, name))
        if shape not in ((), (count,)):
            raise ValueError(f"{name} of {force.label} has the shape {shape}; {system.name} has {count} wheels")
    return count


def _shares(axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pseudoinverse of wheels (m, 3), by an inverse that is rounded correctly."""
    few = len(axes) < 3
    products = np.einsum("mi,ni->mn", axes, axes) if few else np.einsum("mi,mj->ij", axes, axes)
    # The trace is the number of wheels, since axes are unit vectors.
    if np.linalg.det(products) < FLAT:
        raise ValueError(
            "the axes of the wheels are parallel, or those of three and more lie in a plane, so that torques are not "
            "shared in one way; give one wheel, two that are not parallel, or more in all directions"
        )
    inverse = inverse_of(products, "axes of the wheels")
    return np.asarray(np.einsum("mn,ni->mi", inverse, axes) if few else np.einsum("mi,ij->mj", axes, inverse))


@suggest_keywords
@dataclass(frozen=True)
class ControlMomentGyros(Sampled):
    """Motors that turn the gimbals of gyros, by a law that is sampled: the rate of each gimbal is held.

    The gyros are those of ``co.systems.body(inertia, gyros=...)``: gimbals without inertia, and rotors whose momentum
    is constant. The body has minus the rate of change of their momentum as torque, so that the momentum of all together
    does not change, in space to rounding. The rates are ``-B^T (B B^T + d)^-1 N`` with the torque N of the law and the
    derivatives B of the momenta by the angles; d, a share of the mean square of the momenta, keeps them finite near
    singular angles.

    Parameters
    ----------
    law : Torque, Pointing or another torque on a body
        The torque on the body, in its frame, of the state and the time at a sample.
    period : float
        Time between samples, a whole number of steps.
    max_torque : float or (3,), optional
        Limit of each component of the torque of the law.
    max_rate : float, optional
        Largest rate of a gimbal (radians per time).
    regularization : float
        The share d, positive.
    memory, delay, resolution : optional
        As of `Sampled`; the resolution is that of the rate of a gimbal.
    noise, bias, seed, stream : optional
        The errors of what the law measures, as of `Sampled`.
    first : int
        Index of its first number among those that forces hold; ``with_forces`` sets it.

    Raises
    ------
    TypeError, ValueError
        As of `Sampled`, or the body has no gyros.

    Examples
    --------
    Four gyros in a pyramid:

    >>> import coadjoint as co
    >>> axes = [(1, 0), (0, 1), (-1, 0), (0, -1)]
    >>> gyros = [[(-q, p, 0), (-0.6 * p, -0.6 * q, 0.8)] for p, q in axes]
    >>> law = co.forces.Pointing(stiffness=0.5, damping=1.5)
    >>> motors = co.forces.ControlMomentGyros(law, period=0.5, max_rate=0.5)
    >>> sat = co.systems.body((1.0, 2.0, 2.5), gyros=gyros).with_forces(motors)
    >>> sol = co.integrate(sat, sat.state([0.0, 0.0, 0.6, 0.8]), (0, 80), 0.05)
    >>> space = sat.angular_momentum(sol.x, frame="space")
    >>> bool(sol.rotation[-1].magnitude() < 1e-3), bool(abs(space - space[0]).max() < 1e-13)
    (True, True)
    """

    max_rate: Any = None
    regularization: float = 1e-3

    moves: ClassVar[tuple[str, ...]] = ("momentum", "angle")
    command_name: ClassVar[str] = "rate of the gimbals"
    _limit_of_command: ClassVar[str] = "max_rate"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_rate is not None:
            self._read(max_rate=read_positive)
        self._read(regularization=read_positive)

    def _count(self, system: Any) -> int:
        if not len(system.gyros):
            raise TypeError(f"{system.name} has no gyros; make it with co.systems.body(inertia, gyros=...)")
        return len(system.gyros)

    def _command(self, system: Any) -> Callable[..., Any]:
        gyros, count, wheels = system.gyros, self._count(system), len(system.wheels)
        begin, limit = system.first_carried + wheels, super()._command(system)
        most = np.inf if self.max_rate is None else self.max_rate
        at_zero, at_right = (np.ascontiguousarray(gyros[:, k]) for k in (0, 1))
        added = self.regularization * float((at_zero * at_zero).sum()) / 3.0

        def command(torque: Any, x: Any, t: Any, deviates: Any) -> Any:
            N = limit(torque, x, t, deviates)
            # B B^T with the columns of B, and its inverse by cofactors.
            xx, yy, zz, xy, xz, yz = added, added, added, 0.0, 0.0, 0.0
            for k in range(count):
                b = x[begin + 2 * k] * at_right[k] - x[begin + 2 * k + 1] * at_zero[k]
                xx, yy, zz = xx + b[0] * b[0], yy + b[1] * b[1], zz + b[2] * b[2]
                xy, xz, yz = xy + b[0] * b[1], xz + b[0] * b[2], yz + b[1] * b[2]
            A, B, C = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
            D, E, F = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
            size = xx * A + xy * B + xz * C
            u = (A * N[0] + B * N[1] + C * N[2]) / size
            v = (B * N[0] + D * N[1] + E * N[2]) / size
            w = (C * N[0] + E * N[1] + F * N[2]) / size
            rates = np.zeros(count)
            for k in range(count):
                b = x[begin + 2 * k] * at_right[k] - x[begin + 2 * k + 1] * at_zero[k]
                rates[k] = np.minimum(np.maximum(-(b[0] * u + b[1] * v + b[2] * w), -most), most)
            return rates

        return command

    def _act(self, system: Any, begin: int) -> Callable[..., None]:
        count, start = self._count(system), system.first_carried + len(system.wheels)

        def act(y: Any, t: Any, tau: Any) -> None:
            for k in range(count):
                c, s = rotated(y[start + 2 * k], y[start + 2 * k + 1], tau * y[begin + k])
                y[start + 2 * k], y[start + 2 * k + 1] = c, s

        return act


def rotated(c: Any, s: Any, angle: Any) -> Any:
    """Return (c, s) turned by an angle, with the same bits on every machine: sine and cosine by series, doubled."""
    doublings, small = 0, angle
    while np.abs(small) > 0.25 and doublings < 64:
        small, doublings = 0.5 * small, doublings + 1
    square, sine, less = small * small, small, 0.5 * small * small
    term, other = small, less
    # Terms up to the power 16 of a quarter: the next is below 2^-80.
    for k in range(1, 8):
        term = -term * square / ((2 * k) * (2 * k + 1))
        other = -other * square / ((2 * k + 1) * (2 * k + 2))
        sine, less = sine + term, less + other
    # `less` is 1 minus the cosine, which is not rounded to 1.
    for _ in range(doublings):
        sine, less = 2.0 * sine * (1.0 - less), 2.0 * sine * sine
    return c - (less * c + sine * s), s + (sine * c - less * s)


@suggest_keywords
@dataclass(frozen=True)
class Thrusters(Sampled):
    """Pairs of thrusters about the axes of the body, which fire at the begin of each period (pulse-width modulation).

    At a sample the law is a torque N. About each axis a pair fires with the torque `max_torque` for the time in which
    its impulse is that of N over the period, at most the period, and not at all if the impulse is less than
    `min_impulse`. Pulses end within steps: their impulse is exact.

    Parameters
    ----------
    law : Torque, Pointing or another torque on a body
        The torque on the body, in its frame, of the state and the time at a sample.
    period : float
        Time between samples, a whole number of steps.
    max_torque : float or (3,)
        Torque of the pair about each axis while it fires.
    min_impulse : float or (3,)
        The smallest impulse of a pulse (torque times time).
    memory, delay, resolution : optional
        As of `Sampled`; the resolution is that of the duration of a pulse.
    noise, bias, seed, stream : optional
        The errors of what the law measures, as of `Sampled`.
    first : int
        Index of its first number among those that forces hold, the signed durations; ``with_forces`` sets it.

    Raises
    ------
    TypeError, ValueError
        As of `Sampled`, or `max_torque` is not given.

    Examples
    --------
    A tumbling satellite is stopped, up to the velocity that the smallest pulse changes:

    >>> import coadjoint as co
    >>> damper = co.forces.Pointing(stiffness=0.0, damping=2.0)
    >>> jets = co.forces.Thrusters(damper, period=0.5, max_torque=0.1, min_impulse=0.002)
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(jets)
    >>> sol = co.integrate(sat, sat.state(angular_velocity=(0.1, 0.2, 0.3)), (0, 60), 0.05)
    >>> bool(abs(sol.angular_velocity[-1]).max() < 0.002)
    True
    """

    min_impulse: Any = 0.0

    example: ClassVar = {**Sampled.example, "max_torque": 0.2, "min_impulse": 0.004}
    _limit_of_command: ClassVar[str] = "period"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, what in (("max_torque", "torque of a pair while it fires"), ("min_impulse", "smallest impulse")):
            if getattr(self, name) is None:
                raise TypeError(f"{name} of Thrusters was not given; give the {what}")
        self._read(min_impulse=partial(read_limits, zero=True))

    def held_at(self, system: Any, x: NDArray[Any]) -> NDArray[Any]:
        """Return the mean torques of the pairs over the period."""
        return super().held_at(system, x) * np.asarray(self.max_torque) / self.period

    def _command(self, system: Any) -> Callable[..., Any]:
        full, least = (np.array(np.broadcast_to(value, 3)) for value in (self.max_torque, self.min_impulse))
        period = self.period

        def command(torque: Any, x: Any, t: Any, deviates: Any) -> Any:
            impulse = np.minimum(np.abs(torque), full) * period
            # A factor, since a choice is a branch in derivatives; 0.0 is added for the sign of zero.
            return np.copysign(impulse / full, torque) * np.greater_equal(impulse, least) + 0.0

        return command

    def _act(self, system: Any, begin: int) -> Callable[..., None]:
        full, period = np.array(np.broadcast_to(self.max_torque, 3)), self.period

        def act(y: Any, t: Any, tau: Any) -> None:
            since = t - period * np.floor((t + 0.25 * tau) / period)
            for i in range(3):
                length = np.abs(y[begin + i])
                burning = np.minimum(length, since + tau) - np.minimum(length, since)
                y[i] += np.copysign(full[i] * burning, y[begin + i])

        return act
