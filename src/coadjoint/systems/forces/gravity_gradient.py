"""The torque of the gradient of gravity along a prescribed path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from coadjoint.systems.forces.body_torque import (
    BodyTorque,
    body_products,
    prescribed,
    read_prescribed,
    read_tensor,
    tensor,
)
from coadjoint.validation import read_number


@dataclass(frozen=True)
class GravityGradient(BodyTorque):
    """The torque of the gradient of gravity on a body that moves along a prescribed path.

    Gravity is that of a centre with second moments: ``U(r) = -mu (1/r + (tr Q - 3 u . Q u)/(2 r^3))``, u the direction
    of r, and the torque is that of the inertia tensor I of the body in its gradient. From a point, Q = 0, it is ``3 mu
    r^-5 r cross I r``, r in the body frame. For a circular or elliptic orbit about a point
    `co.systems.satellite_on_orbit` has the same torque as a part of its energy.

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

    def __post_init__(self) -> None:
        object.__setattr__(self, "mu", read_number(self.mu, "mu of GravityGradient"))
        object.__setattr__(self, "position", read_prescribed(self.position, "position of GravityGradient"))
        object.__setattr__(self, "quadrupole", read_tensor(self.quadrupole, "quadrupole of GravityGradient"))
        if not callable(self.position) and not any(self.position):
            raise ValueError("position of GravityGradient is zero; give that of the body from the centre")

    def torque_on(self, system: Any) -> Callable[..., Any]:
        in_body, crossed = body_products()
        inertia = _inertia(system)
        mu, position, Q = self.mu, prescribed(self.position), _anisotropic(tensor(self.quadrupole))
        round_centre = not Q.any()

        def torque(x: Any, A: Any, t: Any) -> Any:
            r = position(t)
            square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
            fifth = mu / (square * square * np.sqrt(square))
            inside = in_body(A, r)
            lever = inertia[0] * inside[0] + inertia[1] * inside[1] + inertia[2] * inside[2]
            if round_centre:
                return 3.0 * fifth * crossed(inside, lever)
            # The gradient is -(a r r + b (w r + r w) - c Q), with w = Q r.
            w = Q[0] * r[0] + Q[1] * r[1] + Q[2] * r[2]
            q = w[0] * r[0] + w[1] * r[1] + w[2] * r[2]
            a = 3.0 * fifth - 52.5 * fifth * q / (square * square)
            b = 15.0 * fifth / square
            other = in_body(A, w)
            moved = inertia[0] * other[0] + inertia[1] * other[1] + inertia[2] * other[2]
            result = crossed(a * inside + b * other, lever) + b * crossed(inside, moved)
            for k in range(3):
                first = inertia[0] * A[k, 0] + inertia[1] * A[k, 1] + inertia[2] * A[k, 2]
                result = result + 3.0 * fifth * crossed(first, in_body(A, Q[k]))
            return result

        return torque


def _inertia(system: Any) -> Any:
    return np.ascontiguousarray(system.inertias[0].anisotropic)


def _anisotropic(Q: Any) -> Any:
    return 0.5 * (Q + Q.T) - np.trace(Q) / 3.0 * np.eye(3)
