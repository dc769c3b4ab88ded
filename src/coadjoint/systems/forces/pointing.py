"""A spring and a damper toward an attitude: the law of controllers with proportional and derivative gains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from coadjoint.systems.bodies.body_states import read_attitudes
from coadjoint.systems.forces.body_torque import (
    BodyTorque,
    body_products,
    prescribed,
    read_limits,
    read_prescribed,
    read_tensor,
    tensor,
    velocity_of,
)
from coadjoint.systems.user_functions import callable_from_compiled
from coadjoint.validation import read_choice

ERRORS = ("sine", "quaternion")


@dataclass(frozen=True)
class Pointing(BodyTorque):
    """A spring and a damper toward an attitude: libration dampers, PD control, and quaternion feedback.

    The torque in the body frame is ``-stiffness e - damping (Omega - w)``, with the angular velocity Omega, a wanted
    one w, and the error e of the attitude. If the body is turned from the wanted attitude by the angle a about the
    unit vector n, e is ``sin(a) n``, or ``2 sin(a/2) n`` by the shorter way, which is quaternion feedback. For small
    angles both are the rotation vector. In a computer on board it is sampled: ``Sampled(Pointing(...), period)``, or
    the law of `ReactionWheels`, `ControlMomentGyros` and `Thrusters`.

    Parameters
    ----------
    stiffness : float, (3,) or (3, 3)
        Torque per radian, in the body frame; zero for a damper alone, which also acts on bodies without an attitude.
    damping : float, (3,) or (3, 3)
        Torque per angular velocity, in the body frame.
    attitude : (3, 3), (4,), scipy.spatial.transform.Rotation or callable, optional
        The wanted attitude, from the body to space; by default that of space. A function of the time returns a matrix.
    rate : (3,) or callable
        The wanted angular velocity w, in space: constant, or a function of the time.
    error : {"sine", "quaternion"}
        The error of the attitude. That of the sine vanishes at half a turn as well, where it is unstable.
    max_torque : float or (3,), optional
        Limit of each component.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes, no rotation, or a system that is not one body, for a spring with its attitude in the state.

    Examples
    --------
    >>> import coadjoint as co
    >>> law = co.forces.Pointing(stiffness=0.5, damping=1.5, error="quaternion", max_torque=0.2)
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(law)
    >>> x0 = sat.state([0.6, 0.0, 0.0, 0.8], angular_velocity=(0.1, 0.2, 0.3))
    >>> sol = co.integrate(sat, x0, (0, 80), 0.05)
    >>> bool(sol.rotation[-1].magnitude() < 1e-6)
    True
    """

    stiffness: Any
    damping: Any
    attitude: Any = None
    rate: Any = (0.0, 0.0, 0.0)
    error: str = "sine"
    max_torque: Any = None

    selectors: ClassVar[tuple[str, ...]] = ("attitude",)

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping"):
            object.__setattr__(self, name, read_tensor(getattr(self, name), f"{name} of Pointing"))
        what = "attitude of Pointing"
        if callable(self.attitude) and not hasattr(self.attitude, "as_matrix"):
            read_prescribed(self.attitude, what, shape=(3, 3))
        elif self.attitude is not None:
            A = read_attitudes(self.attitude, what, (), False)
            object.__setattr__(self, "attitude", read_prescribed(A, what, shape=(3, 3)))
        object.__setattr__(self, "rate", read_prescribed(self.rate, "rate of Pointing"))
        read_choice(self.error, "error", ERRORS)
        object.__setattr__(self, "max_torque", read_limits(self.max_torque, "max_torque of Pointing"))

    @property
    def sees_attitude(self) -> bool:
        """Whether there is a spring, or a wanted angular velocity."""
        return bool(np.any(self.stiffness)) or callable(self.rate) or any(self.rate)

    def torque_on(self, system: Any) -> Callable[..., Any]:
        in_body, _ = body_products()
        K, C, velocity = tensor(self.stiffness), tensor(self.damping), velocity_of(system)
        wanted = prescribed(np.eye(3) if self.attitude is None else self.attitude)
        rate, limited = prescribed(self.rate), limited_by(self.max_torque)
        error = callable_from_compiled(sine_error if self.error == "sine" else quaternion_error)

        def damper(x: Any, t: Any) -> Any:
            omega = velocity(x)
            return limited(-(C[:, 0] * omega[0] + C[:, 1] * omega[1] + C[:, 2] * omega[2]))

        def spring(x: Any, A: Any, t: Any) -> Any:
            D = wanted(t)
            # The rows of the relative attitude, from the body to the wanted one.
            e = error(in_body(A, D[:, 0]), in_body(A, D[:, 1]), in_body(A, D[:, 2]))
            d = velocity(x) - in_body(A, rate(t))
            pull = K[:, 0] * e[0] + K[:, 1] * e[1] + K[:, 2] * e[2]
            return limited(-(pull + C[:, 0] * d[0] + C[:, 1] * d[1] + C[:, 2] * d[2]))

        return spring if self.sees_attitude else damper


def limited_by(limits: Any) -> Callable[..., Any]:
    """Return the function that limits each component of a vector; None is no limit."""
    if limits is None:
        return callable_from_compiled(lambda v: v)
    most = np.array(np.broadcast_to(limits, 3))

    def limited(v: Any) -> Any:
        return np.minimum(np.maximum(v, -most), most)

    return callable_from_compiled(limited)


def sine_error(X: Any, Y: Any, Z: Any) -> Any:
    """Return sin(a) n of the rotation with these rows, by the angle a about n; Numba compiles it."""
    result = 0.0 * X
    result[0], result[1], result[2] = 0.5 * (Z[1] - Y[2]), 0.5 * (X[2] - Z[0]), 0.5 * (Y[0] - X[1])
    return result


def quaternion_error(X: Any, Y: Any, Z: Any) -> Any:
    """Return 2 sin(a/2) n of the rotation with these rows, a at most half a turn, by Shepperd's formula."""
    result = 0.0 * X
    result[0], result[1], result[2] = Z[1] - Y[2], X[2] - Z[0], Y[0] - X[1]
    trace = X[0] + Y[1] + Z[2]
    if trace >= 0.0:
        return result / np.sqrt(1.0 + trace)
    if X[0] >= Y[1] and X[0] >= Z[2]:
        k, size, other, third = 0, 1.0 + X[0] - Y[1] - Z[2], X[1] + Y[0], X[2] + Z[0]
    elif Y[1] >= Z[2]:
        k, size, other, third = 1, 1.0 + Y[1] - Z[2] - X[0], Y[2] + Z[1], Y[0] + X[1]
    else:
        k, size, other, third = 2, 1.0 + Z[2] - X[0] - Y[1], Z[0] + X[2], Z[1] + Y[2]
    # The scalar part has the sign of the k-th component of the antisymmetric part.
    root = np.sqrt(size) if result[k] >= 0.0 else -np.sqrt(size)
    result[k], result[(k + 1) % 3], result[(k + 2) % 3] = root, other / root, third / root
    return result
