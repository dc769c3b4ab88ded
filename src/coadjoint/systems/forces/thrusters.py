"""Thrusters that fire for a part of each period, with a minimum impulse bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from coadjoint.systems.forces.body_torque import read_limits
from coadjoint.systems.forces.sampled import Sampled


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

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, what in (("max_torque", "torque of a pair while it fires"), ("min_impulse", "smallest impulse")):
            if getattr(self, name) is None:
                raise TypeError(f"{name} of Thrusters was not given; give the {what}")
        limits = read_limits(self.min_impulse, "min_impulse of Thrusters", zero=True)
        object.__setattr__(self, "min_impulse", limits)

    def _command(self, system: Any) -> Callable[..., Any]:
        full, least = (np.array(np.broadcast_to(value, 3)) for value in (self.max_torque, self.min_impulse))
        period = self.period

        def command(torque: Any, x: Any) -> Any:
            impulse = np.minimum(np.abs(torque), full) * period
            return np.where(impulse >= least, np.copysign(impulse / full, torque), 0.0)

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
