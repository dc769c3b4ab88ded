"""Magnetic coils of a body: moments by a law that is sampled, and damping by the change of the field (B-dot)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.forces.angular_velocity import velocity_of
from coadjoint.systems.forces.body_torque import BodyTorque, cross, limited_by, read_limits, to_body
from coadjoint.systems.forces.environment_torques import magnetic_field, read_magnetic_field
from coadjoint.systems.forces.sampled import Sampled
from coadjoint.systems.forces.torque import attitude_of_body, check_attitude
from coadjoint.validation import read_choice, read_number

COMMANDS = ("torque", "moment")


@suggest_keywords
@dataclass(frozen=True)
class BDot(BodyTorque):
    """The B-dot law: coils whose moment is ``m = -gain B'``, which slows down a tumbling body.

    As a force it is continuous, with the change of the field as seen from the body that turns, ``B' = B cross Omega``:
    the torque ``m cross B`` is ``-gain`` times ``|B|^2 Omega`` without its part along B. The change of the field in
    space, along an orbit, is slower and left out. As the law of `Magnetorquers`, ``BDot(gain)`` is as a computer on
    board has it: B' is the difference of the fields measured at two samples, over the period.

    Parameters
    ----------
    gain : float
        Moment per change of the field in time, positive to slow down.
    B : (3,) or callable, optional
        B in space, as of `MagneticDipole`; for `Magnetorquers` none, since these have it.
    position : (3,) or callable, optional
        The argument r of the field, in space: constant, or a function of the time.
    max_moment : float or (3,), optional
        Limit of each component of the moment; for `Magnetorquers` none, since these have it.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes or arguments, no field, or a system that is not one body with its attitude in the state.

    Examples
    --------
    >>> import coadjoint as co
    >>> law = co.forces.BDot(gain=10.0, B=(0.0, 0.1, 0.0))
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(law)
    >>> sat.vector_field(sat.state(angular_velocity=(0.0, 0.3, 0.2)))[:3].round(3)
    array([-0.03,  0.  , -0.02])
    """

    gain: float
    B: Any = None
    position: Any = None
    max_moment: Any = None

    example: ClassVar = {"gain": 0.5, "B": (0.3, -0.2, 0.1)}

    def __post_init__(self) -> None:
        self._read(gain=read_number, max_moment=read_limits)
        if self.B is not None or self.position is not None:
            read_magnetic_field(self)

    @property
    def is_measured(self) -> bool:
        """Whether it is the law of coils, which measure the field."""
        return self.B is None

    def check(self, system: Any) -> None:
        if self.is_measured:
            raise TypeError("BDot has no field B; give it, or sample it by co.forces.Magnetorquers(BDot(gain), B=...)")
        super().check(system)

    def torque_on(self, system: Any) -> Callable[..., Any]:
        gain, field, velocity = self.gain, magnetic_field(self), velocity_of(system, in_frame=True)
        limited = limited_by(self.max_moment)

        def torque(x: Any, A: Any, t: Any) -> Any:
            b = to_body(A, field(t))
            return cross(limited(-gain * cross(b, velocity(x, t))), b)

        return torque


@suggest_keywords
@dataclass(frozen=True)
class Magnetorquers(Sampled):
    """Coils that give a body a magnetic moment, by a law that is sampled: the moment is held.

    In the field B the torque is ``m cross B``, with the held moment m, the attitude, and the field at each time. It has
    no part along B. From the torque N of a law the moment is ``B cross N / |B|^2``, whose torque is N without its part
    along B; such as ``-k h``, which unloads wheels with the momentum h. `BDot` slows down a tumbling body.

    Parameters
    ----------
    law : BDot, Torque, Pointing or another torque on a body
        The torque on the body, in its frame, of the state and the time at a sample; or the moment.
    period : float
        Time between samples, a whole number of steps.
    max_torque : float or (3,), optional
        Limit of each component of what the law returns.
    B : (3,) or callable
        B in space: constant, a function of the time t, or with `position` of ``(t, r)``; compiled by Numba.
    position : (3,) or callable, optional
        The argument r of the field, in space: constant, or a function of the time.
    max_moment : float or (3,), optional
        Limit of each component of the moment, in the body frame.
    commands : {"torque", "moment"}
        What the law returns.
    memory, delay, resolution : optional
        As of `Sampled`; the resolution is that of the moment. `BDot` remembers the last field, as ``B1, B2, B3``, and
        commands nothing at its first sample.
    noise, bias, seed, stream : optional
        The errors of what the law measures, as of `Sampled`, and of the field in the frame of the body, ``"field"``, in
        units of B, as of a magnetometer; with `BDot` there are no others.
    first : int
        Index of its first number among those that forces hold; ``with_forces`` sets it.

    Raises
    ------
    TypeError, ValueError
        As of `Sampled` and `MagneticDipole`, or a `BDot` with a field or a limit of its own.

    Examples
    --------
    A field that turns, as along a polar orbit, slows down all three axes, to about its own rate:

    >>> import coadjoint as co
    >>> import numpy as np
    >>> def B(t):
    ...     return np.array([0.2 * np.cos(0.2 * t), 0.0, 0.4 * np.sin(0.2 * t)])
    >>> coils = co.forces.Magnetorquers(co.forces.BDot(gain=4.0), period=0.25, B=B, max_moment=0.5)
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(coils)
    >>> sol = co.integrate(sat, sat.state(angular_velocity=(0.5, -0.3, 0.8)), (0, 300), 0.125)
    >>> bool(np.linalg.norm(sol.angular_velocity[-1]) < 0.3)
    True
    """

    B: Any = field(default=None, kw_only=True)
    position: Any = field(default=None, kw_only=True)
    max_moment: Any = field(default=None, kw_only=True)
    commands: str = field(default="torque", kw_only=True)

    example: ClassVar = {**Sampled.example, "B": (0.3, -0.2, 0.1)}
    command_name: ClassVar[str] = "magnetic moment"
    _limit_of_command: ClassVar[str] = "max_moment"
    _limits = dict.fromkeys(("max_torque", "max_moment"), read_limits) | {
        "commands": partial(read_choice, known=COMMANDS)
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.B is None:
            raise TypeError("B of Magnetorquers was not given; give the field in space, (3,) or a function")
        read_magnetic_field(self)
        if hasattr(self.law, "is_measured") and (not self.law.is_measured or self.law.max_moment is not None):
            raise TypeError(
                "the law of Magnetorquers is a BDot with a field or a limit of its own; give BDot(gain), and B and "
                "max_moment to Magnetorquers, whose field is measured"
            )

    @property
    def _measures(self) -> bool:
        return hasattr(self.law, "is_measured")

    @property
    def _measured(self) -> tuple[str, ...]:
        return ("field",) if self._measures else (*super()._measured, "field")

    @property
    def _remembered(self) -> tuple[tuple[str, int], ...]:
        return (("B", 3),) if self._measures else super()._remembered

    def check(self, system: Any) -> None:
        check_attitude(system, self.label)
        super().check(system)

    def _field_in_body(self) -> Callable[..., Any]:
        """Return the field in the body frame as a function of (x, t)."""
        field = magnetic_field(self)
        return lambda x, t: to_body(attitude_of_body(x, t), field(t))

    def _measured_field(self) -> Callable[..., Any]:
        """Return what a magnetometer measures as a function of (x, t, deviates)."""
        field, error = self._field_in_body(), self._error("field")
        if error is None:
            return lambda x, t, deviates: field(x, t)
        return lambda x, t, deviates: field(x, t) + error(deviates)

    def _law(self, system: Any) -> Callable[..., Any]:
        if not self._measures:
            return super()._law(system)
        measured, factor, begin = self._measured_field(), -self.law.gain / self.period, self._first_remembered(system)

        def evaluated(x: Any, t: Any, deviates: Any) -> Any:
            b, before = measured(x, t, deviates), x[begin : begin + 3]
            result = 0.0 * x[:6]
            if before[0] != 0.0 or before[1] != 0.0 or before[2] != 0.0:
                for i in range(3):
                    result[i] = factor * (b[i] - before[i])
            for i in range(3):
                result[3 + i] = b[i]
            return result

        return evaluated

    def _command(self, system: Any) -> Callable[..., Any]:
        measured = self._measured_field()
        first, last = limited_by(self.max_torque), limited_by(self.max_moment)

        def of_moment(moment: Any, x: Any, t: Any, deviates: Any) -> Any:
            return last(first(moment))

        def of_torque(torque: Any, x: Any, t: Any, deviates: Any) -> Any:
            b = measured(x, t, deviates)
            square = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
            return last(cross(b, first(torque)) / (square + (square == 0.0)))

        return of_moment if self._measures or self.commands == "moment" else of_torque

    def _act(self, system: Any, begin: int) -> Callable[..., None]:
        measured = self._field_in_body()

        def act(y: Any, t: Any, tau: Any) -> None:
            torque = cross(y[begin : begin + 3], measured(y, t + 0.5 * tau))
            for i in range(3):
                y[i] += tau * torque[i]

        return act
