"""A short motion from a state, with its tangent map: what has an error that was made along it become at its end?"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.methods.base import Method
from coadjoint.systems.kinds import System
from coadjoint.systems.points import QUIET
from coadjoint.wording import short

Floats = NDArray[np.float64]

# Number of steps of an orbit. Their length is a part of the time in which the motion turns by one radian, or grows by a
# factor e.
STEPS = 128
PART = 0.25
FEWEST = 8


class ShortOrbit(NamedTuple):
    """States at evenly spaced times and the derivative of each with respect to the one before.

    Parameters
    ----------
    points : ndarray, shape (k + 1, n)
        Momenta.
    tangents : ndarray, shape (k, n, n)
        Derivatives of the steps between them.
    spacing : float
        Time between two of them, negative for backward.
    """

    points: Floats
    tangents: Floats
    spacing: float

    @property
    def square(self) -> float:
        """The square of the largest momentum; 1 where all are zero."""
        return float(np.max(np.sum(self.points**2, axis=1))) or 1.0

    def carried(self, fields: Floats) -> Floats:
        """Return the errors that a perturbed field has made up to each point, to first order.

        Parameters
        ----------
        fields : ndarray, shape (k + 1, n, m)
            What is added to the vector field at the points, for each of m perturbations.

        Returns
        -------
        ndarray, shape (k + 1, n, m)
            The difference of the perturbed motion from the motion, by the trapezoidal rule.
        """
        half = 0.5 * self.spacing
        found = np.zeros_like(fields)
        for k, tangent in enumerate(self.tangents):
            found[k + 1] = _product(tangent, found[k] + half * fields[k]) + half * fields[k + 1]
        return found


def _product(matrix: Floats, columns: Floats) -> Floats:
    """Return a matrix times columns, summed in order: what is chosen must not depend on a library."""
    total = matrix[:, :1] * columns[:1]
    for j in range(1, len(columns)):
        total = total + matrix[:, j : j + 1] * columns[j]
    return total


@QUIET
def short_orbit(method: Method, system: System, x0: Floats, t: float = 0.0, steps: int = STEPS) -> ShortOrbit:
    """Return the motion from a state over some dozens of radians, with its tangents.

    Parameters
    ----------
    method : Method
        The scheme that takes the steps, read in Python; of order two at least.
    system : LiePoissonSystem or PoissonSystem
        The system.
    x0 : ndarray, shape (n,)
        The state.
    t : float
        Time at the start.
    steps : int
        Number of steps.

    Returns
    -------
    ShortOrbit
        It is shorter where the motion leaves the range of float64.

    Raises
    ------
    ValueError
        The motion leaves the range of float64 within a few steps.
    """
    spacing = PART / rate_at(system, x0, t)
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
    if len(tangents) < FEWEST:
        raise cannot_follow(x0, spacing)
    return ShortOrbit(np.array(points), np.array(tangents), spacing)


def cannot_follow(x0: Floats, spacing: float) -> ValueError:
    """Return the error for a motion that leaves the range of float64 at once."""
    return ValueError(
        f"the motion from x0 = {short(x0.tolist())} cannot be followed: it overflows within {FEWEST} steps of "
        f"{spacing:g}; take another state"
    )


@QUIET
def rate_at(system: System, x0: Floats, t: float = 0.0) -> float:
    """Return how fast the motion turns or grows at a state, per unit of time.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    x0 : ndarray, shape (n,)
        The state.
    t : float
        The time.

    Returns
    -------
    float
        The larger of |f|/|x| and of |(Df)^2|^(1/2), f the vector field; 1 where nothing moves.

    Raises
    ------
    ValueError
        The field overflows there.
    """
    size, near = float(np.linalg.norm(x0)), system.jacobian(x0, t)
    turning = float(np.linalg.norm(near @ near)) ** 0.5
    speed = float(np.linalg.norm(system.vector_field(x0, t))) / size if size > 0.0 else 0.0
    rate = max(turning, speed) or 1.0
    if not np.isfinite(rate):
        raise ValueError(f"the motion from x0 = {short(x0.tolist())} cannot be followed: its field overflows")
    return rate
