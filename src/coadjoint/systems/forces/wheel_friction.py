"""Friction in the bearings of reaction wheels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.bodies.inertia import moments_of_wheels
from coadjoint.systems.forces.actuators import count_wheels
from coadjoint.systems.forces.angular_velocity import velocity_of
from coadjoint.systems.forces.body_torque import check_one_body, read_limits
from coadjoint.systems.forces.torque import StateTorque

_READ_FRICTION = partial(read_limits, shape=(), zero=True)


@suggest_keywords
@dataclass(frozen=True)
class WheelFriction(StateTorque):
    """Friction in the bearings of the reaction wheels of a body, viscous and dry (Coulomb).

    At the speed s of a wheel relative to the body its torque on the wheel is ``-viscous s - coulomb s / sqrt(s^2 +
    transition_speed^2)``, and the opposite on the body: the momentum of all together does not change, in space to
    rounding. `LinearDamping` of the momenta of wheels would slow them down relative to space. Dry friction is smooth:
    steps shorter than ``moment transition_speed / coulomb`` resolve how a wheel stops.

    Parameters
    ----------
    viscous : float or (m,)
        Torque per speed (radians per time) of each wheel.
    coulomb : float or (m,)
        Torque of each wheel at speeds far above `transition_speed`.
    transition_speed : float or (m,), optional
        Speed below which dry friction falls to zero; needed with `coulomb`.

    Raises
    ------
    TypeError, ValueError
        Negative numbers, wrong shapes, dry friction without `transition_speed`, or a system that is not one body with
        wheels.

    Examples
    --------
    >>> import coadjoint as co
    >>> bearings = co.forces.WheelFriction(viscous=1e-3)
    >>> sat = co.systems.body((1.0, 2.0, 2.5), wheels=[(0.0, 0.0, 0.01)]).with_forces(bearings)
    >>> sol = co.integrate(sat, sat.state(wheel_speeds=[100.0]), (0, 200), 0.5)
    >>> bool(abs(sat.wheel_speeds(sol.x[-1])[0]) < 1e-5), sol.angular_velocity[-1].round(4)
    (True, array([0. , 0. , 0.4]))
    """

    viscous: Any = 0.0
    coulomb: Any = 0.0
    transition_speed: Any = None

    example: ClassVar = {"viscous": 0.02, "coulomb": 0.05, "transition_speed": 2.0}

    def __post_init__(self) -> None:
        self._read(viscous=_READ_FRICTION, coulomb=_READ_FRICTION, transition_speed=partial(read_limits, shape=()))
        if self.viscous is None or self.coulomb is None:
            raise TypeError("viscous or coulomb of WheelFriction is None; give a number, or one for each wheel")
        if np.any(self.coulomb) and self.transition_speed is None:
            raise TypeError(
                "transition_speed of WheelFriction was not given; give the speed below which dry friction falls to zero"
            )

    def check(self, system: Any) -> None:
        check_one_body(system, self.label)
        count_wheels(self, system, ("viscous", "coulomb", "transition_speed"))

    def on_state(self, system: Any) -> tuple[Callable[..., Any], str]:
        return _on_state(self, system)


# Systems are immutable, and forces too. Derivatives by differences return to some hundred systems in each step.
@lru_cache(maxsize=1024)
def _on_state(force: WheelFriction, system: Any) -> tuple[Callable[..., Any], str]:
    moments, velocity = moments_of_wheels(system.wheels), velocity_of(system, in_frame=False)
    axes, start, count = system.wheels / moments[:, None], system.first_carried, len(moments)
    transition = 1.0 if force.transition_speed is None else force.transition_speed
    c, f, w = (np.array(np.broadcast_to(one, count)) for one in (force.viscous, force.coulomb, transition))

    def friction(x: Any, t: Any) -> Any:
        omega, result = velocity(x, t), 0.0 * x
        for i in range(count):
            along = axes[i, 0] * omega[0] + axes[i, 1] * omega[1] + axes[i, 2] * omega[2]
            s = x[start + i] / moments[i] - along
            result[start + i] = -c[i] * s - f[i] * s / np.sqrt(s * s + w[i] * w[i])
        return result

    return friction, "x, t"
