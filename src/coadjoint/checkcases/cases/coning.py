"""The coning motion of a symmetric body."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from coadjoint.checkcases.cases.free_body import FREE, free_case
from coadjoint.checkcases.check_case import CheckCase
from coadjoint.checkcases.registry import checkcase
from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.validation import read_positive


@checkcase
def coning(
    transverse: float = 2.0,
    axial: float = 1.0,
    rates: npt.ArrayLike = (0.5, 0.0, 6.0),
    end: float = 20.0,
    samples: int = 201,
) -> CheckCase:
    """Return the coning of a free symmetric body: its axis moves along a circle about the angular momentum.

    Parameters
    ----------
    transverse, axial : float
        Moments of inertia across the axis of symmetry and about it, kg m^2.
    rates, end, samples
        As of `free_body`.
    """
    across, along = read_positive(transverse, "transverse"), read_positive(axial, "axial")
    w = read_vector(rates, "rates")
    length = float(np.linalg.norm([across * w[0], across * w[1], along * w[2]]))
    angle = math.atan2(across * math.hypot(w[0], w[1]), along * w[2])
    results = {
        "rate of precession of the axis about the angular momentum": (length / across, "rad/s"),
        "rate of the rates in the body frame": ((1.0 - along / across) * w[2], "rad/s"),
        "half angle of the cone": (angle, "rad"),
    }
    return free_case(
        "coning",
        "coning of a free symmetric body",
        (across, across, along),
        w,
        end,
        samples,
        statement=f"{FREE} The third axis is one of symmetry; its angle to the angular momentum is constant.",
        basis="closed form, two rotations at constant rates",
        source="L. D. Landau, E. M. Lifshitz, Mechanics (1976), section 33",
        results=results,
    )
