"""Short orbits with their tangent maps, which carry local errors to the end of an orbit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.methods.protocol.method import Method
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

STEPS = 128  # of an orbit, some 32 radians
RELATIVE_STEP = 0.25  # in units of the time in which the motion rotates by one radian or grows by a factor e
MIN_STEPS = 8  # of an orbit that leaves float64; fewer do not sample the motion


class ShortOrbit(NamedTuple):
    """States (k + 1, n), spaced evenly (negative: backward), and the derivative of each by its predecessor."""

    points: Floats
    tangents: Floats
    spacing: float

    @property
    def square(self) -> float:
        """The square of the largest momentum; 1 if all are zero."""
        return float(np.max(np.sum(self.points**2, axis=1))) or 1.0

    def propagated(self, fields: Floats) -> Floats:
        """Return the first-order errors (k + 1, n, m) of m perturbations of the field, by the trapezoidal rule."""
        half = 0.5 * self.spacing
        errors = np.zeros_like(fields)
        for k, tangent in enumerate(self.tangents):
            errors[k + 1] = _product(tangent, errors[k] + half * fields[k]) + half * fields[k + 1]
        return errors


def _product(matrix: Floats, columns: Floats) -> Floats:
    """Return a matrix times columns, summed in order: automatic choices must not depend on the BLAS."""
    total = matrix[:, :1] * columns[:1]
    for j in range(1, len(columns)):
        total = total + matrix[:, j : j + 1] * columns[j]
    return total


@ignore_overflow
def short_orbit(method: Method, system: System, x0: Floats, t: float = 0.0, steps: int = STEPS) -> ShortOrbit:
    """Return some dozens of radians of a motion, with tangents; it ends early if the motion overflows."""
    spacing = RELATIVE_STEP / rate_at(system, x0, t)
    points, tangents = [x0], []
    for k in range(steps):
        try:
            after, tangent = method.tangent(system, points[-1], t + k * spacing, spacing)
        except IntegrationError:
            break
        if not (np.all(np.isfinite(after)) and np.all(np.isfinite(tangent))):
            break
        points.append(after)
        tangents.append(tangent)
    if len(tangents) < MIN_STEPS:
        raise orbit_overflow_error(x0, spacing)
    return ShortOrbit(np.array(points), np.array(tangents), spacing)


def orbit_overflow_error(x0: Floats, spacing: float) -> ValueError:
    """Return the error for a motion that leaves the range of float64 within a few steps."""
    return ValueError(
        f"the motion from x0 = {short(x0.tolist())} cannot be followed: it overflows within {MIN_STEPS} steps of "
        f"{spacing:g}; take another state"
    )


@ignore_overflow
def rate_at(system: System, x0: Floats, t: float = 0.0) -> float:
    """Return the rate per unit of time at which the motion turns or grows: the larger of |f|/|x| and |(Df)^2|^(1/2)."""
    size, jacobian = float(np.linalg.norm(x0)), system.jacobian(x0, t)
    turning = float(np.linalg.norm(jacobian @ jacobian)) ** 0.5
    speed = float(np.linalg.norm(system.vector_field(x0, t))) / size if size > 0.0 else 0.0
    rate = max(turning, speed) or 1.0
    if not np.isfinite(rate):
        raise ValueError(f"the motion from x0 = {short(x0.tolist())} cannot be followed: its field overflows")
    return rate
