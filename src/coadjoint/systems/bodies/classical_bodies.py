"""Angular velocity and momentum of the classical bodies and tops, whose states begin with a momentum in the body."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

CLASSICAL_BODIES = frozenset(
    (
        "clebsch_body",
        "goryachev_chaplygin_top",
        "gyrostat",
        "heavy_top",
        "kirchhoff_body",
        "kovalevskaya_top",
        "lagrange_top",
        "rigid_body",
        "satellite",
    )
)
"""Systems whose first three coordinates are an angular momentum in the frame of the body, with sign -1."""


def classical_motion(system: Any, name: str) -> Callable[[Any], Floats] | None:
    """Return the function of states for "angular_velocity" or "angular_momentum" of a classical body; else None.

    The angular velocity is the derivative of the energy by the momentum.

    Examples
    --------
    >>> from coadjoint.systems.bodies.gyrostat import gyrostat
    >>> velocity = classical_motion(gyrostat((1.0, 2.0, 2.5), rotors=(0.0, 0.0, 2.0)), "angular_velocity")
    >>> velocity([1.0, 1.0, 1.0])
    array([ 1. ,  0.5, -0.4])
    """
    if system.name not in CLASSICAL_BODIES:
        return None

    def momentum(x: Any) -> Floats:
        return np.array(x, dtype=np.float64)[..., :3]

    def velocity(x: Any) -> Floats:
        states = np.asarray(x, dtype=np.float64)
        rows = states.reshape(-1, system.dim)
        slopes = np.array([system.hamiltonian.gradient(row)[:3] for row in rows])
        return slopes.reshape(*states.shape[:-1], 3)

    return {"angular_momentum": momentum, "angular_velocity": velocity}.get(name)
