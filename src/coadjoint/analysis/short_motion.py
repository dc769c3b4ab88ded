"""Short reference trajectories, along which functions of the state are sampled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.methods.numerics.short_orbit import MIN_STEPS, RELATIVE_STEP, STEPS, orbit_overflow_error, rate_at
from coadjoint.methods.suggested_scheme import reference_scheme
from coadjoint.runs.integrate import integrate
from coadjoint.systems.lie_poisson import LiePoissonSystem

Floats = NDArray[np.float64]


def short_motion(system: LiePoissonSystem, start: Floats, count: int = STEPS) -> tuple[Floats, float]:
    """Return states (count + 1, n) along the motion, a quarter of a radian apart, and the rate of the motion.

    Fewer states are returned if the motion leaves the range of float64; ValueError if that happens within a few steps.
    """
    rate = rate_at(system, start)
    spacing = RELATIVE_STEP / rate
    try:
        states = integrate(system, start, (0.0, count * spacing), spacing, reference_scheme(6), watch=False).x
    except IntegrationError as error:
        if error.partial is None or len(error.partial.x) <= MIN_STEPS:
            raise orbit_overflow_error(start, spacing) from None
        states = error.partial.x
    return np.asarray(states), rate
