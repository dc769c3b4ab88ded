"""Gimbal motors of control-moment gyros."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from coadjoint.systems.forces.sampled import Sampled
from coadjoint.systems.user_functions import callable_from_compiled
from coadjoint.validation import read_positive


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

    selectors: ClassVar[tuple[str, ...]] = ("period", "first")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_rate is not None:
            object.__setattr__(self, "max_rate", read_positive(self.max_rate, f"max_rate of {self.label}"))
        share = read_positive(self.regularization, f"regularization of {self.label}")
        object.__setattr__(self, "regularization", share)

    def _count(self, system: Any) -> int:
        if not len(system.rotors.gyros):
            raise TypeError(f"{system.name} has no gyros; make it with co.systems.body(inertia, gyros=...)")
        return len(system.rotors.gyros)

    def _command(self, system: Any) -> Callable[..., Any]:
        gyros, count, wheels = system.rotors.gyros, self._count(system), len(system.rotors.wheels)
        begin, limit = system.first_carried + wheels, super()._command(system)
        limited, most = callable_from_compiled(limit), np.inf if self.max_rate is None else self.max_rate
        at_zero, at_right = (np.ascontiguousarray(gyros[:, k]) for k in (0, 1))
        added = self.regularization * float((at_zero * at_zero).sum()) / 3.0

        def command(torque: Any, x: Any) -> Any:
            N = limited(torque, x)
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
                rates[k] = min(max(-(b[0] * u + b[1] * v + b[2] * w), -most), most)
            return rates

        return command

    def _act(self, system: Any, begin: int) -> Callable[..., None]:
        count, start = self._count(system), system.first_carried + len(system.rotors.wheels)
        turned = callable_from_compiled(rotated)

        def act(y: Any, t: Any, tau: Any) -> None:
            for k in range(count):
                c, s = turned(y[start + 2 * k], y[start + 2 * k + 1], tau * y[begin + k])
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
