"""Initial states for pictures, spread over a sphere."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt


def points_on_sphere(count: int, radius: float = 1.0) -> npt.NDArray[np.float64]:
    """Return `count` points, (count, 3), distributed about evenly on a sphere, along a spiral of the golden angle.

    Examples
    --------
    >>> np.linalg.norm(points_on_sphere(5, 2.0), axis=1)
    array([2., 2., 2., 2., 2.])
    """
    k = np.arange(count)
    height = 1.0 - (2.0 * k + 1.0) / count
    turn = math.pi * (3.0 - math.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - height**2)
    return radius * np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=-1)
