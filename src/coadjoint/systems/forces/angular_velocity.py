"""Angular velocities of bodies as functions of the state, which compiled functions call."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import SAMPLE_TIME, sample_points

PER_BODY = 12  # L, and the three space axes seen from the body


@lru_cache(maxsize=1024)
def velocity_map(system: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return W (3, dim) and w (3,) with the angular velocity W x + w, the derivative of the energy by the momentum."""

    def velocity(x: Any, t: float) -> NDArray[np.float64]:
        omega = np.asarray(system.hamiltonian.gradient(x, t))[:3]
        # The energy in a frame that turns has its rate times the momentum along the third axis.
        return omega if system.frame_rate is None else omega + system.frame_rate(t) * x[9:12]

    with np.errstate(all="ignore"):
        constant = velocity(np.zeros(system.dim), 0.0)
        W = np.stack([velocity(point, 0.0) - constant for point in np.eye(system.dim)], axis=1)
        x = sample_points(system.dim)[0]
        expected = W @ x + constant
        error = np.abs(velocity(x, SAMPLE_TIME) - expected).max()
    if error > CHANGED * np.abs(expected).max():
        raise TypeError(
            f"the angular velocity of {system.name}, the derivative of its energy by the momentum, depends on the time "
            "or is not linear in the state, and no force that reads it fits; write a co.forces.Torque"
        )
    return W, constant


CHANGED = 2.0**-30  # relative difference of an angular velocity from a linear function that is no rounding


def velocity_of(system: Any, *, in_frame: bool) -> Callable[..., Any]:
    """Return the angular velocity, relative to a frame that turns or not, of (x, t), for compiled functions."""
    W, w = velocity_map(system)

    def velocity(x: Any, t: Any) -> Any:
        omega = 0.0 * x[:3] + w
        for i in range(W.shape[1]):
            omega = omega + W[:, i] * x[i]
        return omega

    turning = system.frame_rate
    if turning is None or not in_frame:
        return velocity

    def relative(x: Any, t: Any) -> Any:
        return velocity(x, t) - turning(t) * x[9:12]

    return relative


def velocities_of(system: Any) -> Callable[..., Any]:
    """Return the angular velocities in the frames of bodies, (3,) or (k, 3), of (x, t), for compiled functions."""
    if not system.bodies:
        return velocity_of(system, in_frame=False)
    inverse, count = np.stack([one.inverse_matrix for one in system.inertias]), len(system.inertias)

    def velocities(x: Any, t: Any) -> Any:
        L = np.ascontiguousarray(x[: PER_BODY * count].reshape(count, 4, 3)[:, 0, :])
        return inverse[:, :, 0] * L[:, :1] + inverse[:, :, 1] * L[:, 1:2] + inverse[:, :, 2] * L[:, 2:]

    return velocities
