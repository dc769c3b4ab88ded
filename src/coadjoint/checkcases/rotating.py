"""Systems of one body whose energy is quadratic in momentum and axes, and the columns of their states."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.checkcases.attitudes import state_columns
from coadjoint.checkcases.check_case import Columns
from coadjoint.checkcases.integration import IntegratedMotion
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.systems.bodies.body import body
from coadjoint.systems.forces.angular_velocity import PER_BODY
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem

Floats = npt.NDArray[np.float64]

METHODS = (GaussLegendre(8), GaussLegendre(6))


def with_axes(
    inertia: Floats,
    rates: Floats,
    attitude: Floats,
    step: float,
    rotors: Floats | None = None,
    lever: Floats | None = None,
) -> IntegratedMotion:
    """Return the motion of a body with ``H = (L - k) . I^-1 (L - k)/2 + lever . Z``, Z the vertical in the body.

    `attitude` is the matrix at the start, and `lever` is the weight times the centre of mass in the body, N m.
    """
    moving, k = body(inertia), np.zeros(3) if rotors is None else rotors
    inverse = np.linalg.inv(inertia)
    M, linear = np.zeros((PER_BODY, PER_BODY)), np.zeros(PER_BODY)
    M[:3, :3], linear[:3] = inverse, -inverse @ k
    linear[9:12] = 0.0 if lever is None else lever
    system: Any = LiePoissonSystem(moving.algebra, Quadratic((M + M.T) / 2.0, linear), sign=-1)
    x0 = np.concatenate([inertia @ rates + k, attitude.ravel()])

    def columns(x: Floats, t: Floats) -> Columns:
        return state_columns((x[:, :3] - k) @ inverse.T, x)

    return IntegratedMotion(system, x0, step, METHODS, columns)
