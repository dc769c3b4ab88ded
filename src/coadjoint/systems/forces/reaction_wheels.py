"""Motors of reaction wheels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.bodies.inertia import inverse_of
from coadjoint.systems.forces.sampled import Sampled

FLAT = 1e-9
"""Determinant of the products of axes below which wheels count as parallel or in a plane."""


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

    def _read_limits(self, name: str, shape: tuple[int, ...] = ()) -> None:
        for limit in ("max_torque", "max_momentum"):
            super()._read_limits(limit, ())

    def _count(self, system: Any) -> int:
        count = len(system.rotors.wheels)
        if not count:
            raise TypeError(f"{system.name} has no wheels; make it with co.systems.body(inertia, wheels=...)")
        for name in ("max_torque", "max_momentum"):
            if np.shape(getattr(self, name)) not in ((), (count,)):
                raise ValueError(
                    f"{name} of {self.label} has the shape {np.shape(getattr(self, name))}; {system.name} has {count} "
                    "wheels"
                )
        return count

    def _command(self, system: Any) -> Callable[..., Any]:
        share, count = _shares(system.rotors.momenta[: len(system.rotors.wheels)]), self._count(system)
        most = np.array(np.broadcast_to(np.inf if self.max_torque is None else self.max_torque, count))
        limited = self.max_torque is not None

        def command(torque: Any, x: Any) -> Any:
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
