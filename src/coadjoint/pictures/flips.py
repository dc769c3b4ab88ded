"""When does a coordinate change its sign, and after which time again?"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.kinds import shape_of

Floats = npt.NDArray[np.float64]

HALVINGS = 52


def flips(system: Any, t: Floats, x: Floats, i: int, most: int | None = None) -> Floats:
    """Return the times at which a coordinate of a motion goes through zero.

    Between two points the motion is taken to be the cubic through both with its known slopes, so that the error is of
    the fourth order in the distance of the points.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        What moves; its field gives the slopes.
    t : ndarray, shape (k,)
        Times.
    x : ndarray, shape (k, n)
        States.
    i : int
        The coordinate.
    most : int, optional
        How many times are wanted, from the start on.

    Returns
    -------
    ndarray
        Rising or falling with t, as t does.

    Examples
    --------
    >>> import coadjoint as co
    >>> spin = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, 1]))  # turns with the period 2 pi
    >>> sol = co.integrate(spin, (1.0, 0.0, 0.5), (0, 10), 0.1)
    >>> (flips(spin, sol.t, sol.x, 0) / np.pi).round(6)
    array([0.5, 1.5, 2.5])
    """
    values = x[:, i]
    places = np.flatnonzero((values[:-1] != 0.0) & (np.sign(values[:-1]) * np.sign(values[1:]) <= 0.0))
    shape = shape_of(system)
    found = []
    for p in places[:most]:
        dt = float(t[p + 1] - t[p])
        before, after = (
            dt * float(np.asarray(system.vector_field(x[q].reshape(shape), float(t[q]))).ravel()[i]) for q in (p, p + 1)
        )
        found.append(float(t[p]) + dt * _root(float(values[p]), float(values[p + 1]), before, after))
    return np.array(found)


def _root(a: float, b: float, slope: float, end_slope: float) -> float:
    """Return where in [0, 1] a cubic is zero, with its values and slopes at both ends; it changes sign there."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        s = 0.5 * (low + high)
        r = 1.0 - s
        value = a * r * r * (1 + 2 * s) + b * s * s * (3 - 2 * s) + s * r * (slope * r - end_slope * s)
        low, high = (s, high) if (value > 0.0) == (a > 0.0) else (low, s)
    return 0.5 * (low + high)
