"""Which power of the step do errors follow, and how sure is that?"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError

MOST_POINTS = 5
FEWEST_POINTS = 3
# Where rounding is 1/16 of an error, its logarithm is off by so much.
CLEAR = 16.0


class Slope(NamedTuple):
    """A power of the step.

    Parameters
    ----------
    value : float
        The slope at the smallest steps.
    uncertainty : float
        How far it may be from the slope in the limit of vanishing steps.
    steepening : float
        The slope at the smallest steps less that at the largest ones. Where errors fall ever faster, the order is not
        yet seen.
    steps, errors : ndarray, shape (k,)
        The points that it comes from, largest step first.
    """

    value: float
    uncertainty: float
    steepening: float
    steps: NDArray[np.float64]
    errors: NDArray[np.float64]

    def __str__(self) -> str:
        """Return the slope with its uncertainty."""
        return f"{self.value:.2f} +- {self.uncertainty:.2f}"


def slope(steps: list[float], errors: list[float], floors: list[float]) -> Slope | None:
    """Return the slope of the logarithms at the smallest steps whose errors stand above round-off.

    Parameters
    ----------
    steps, errors, floors : list of float
        Steps, errors, and what round-off alone may have made of each error; all positive.

    Returns
    -------
    Slope or None
        None where fewer than three points are above the floor.

    Notes
    -----
    With an error C h^p (1 + a h + ...) the slope of some points around the step h is p + a h + .... From the larger
    points to the smaller ones the step falls by a ratio r. So a h at the smaller ones is the change of the slope
    divided by r - 1. Round-off may be 1/16 of an error; what that does to the slope is added.

    Examples
    --------
    >>> found = slope([0.4, 0.2, 0.1], [1.6e-3, 4e-4, 1e-4], [1e-16] * 3)
    >>> round(found.value, 12), found.uncertainty < 1e-9
    (2.0, True)
    """
    points = [
        (step, error, floor)
        for step, error, floor in sorted(zip(steps, errors, floors, strict=True), reverse=True)
        if error > CLEAR * floor
    ][-MOST_POINTS:]
    if len(points) < FEWEST_POINTS:
        return None
    h, e, floor = (np.array(column) for column in zip(*points, strict=True))
    width = 3 if len(h) == MOST_POINTS else 2
    large, small = _slope(h[:width], e[:width]), _slope(h[-width:], e[-width:])
    ratio = math.exp(float(np.mean(np.log(h[:width])) - np.mean(np.log(h[-width:]))))
    rounded = float(floor[-1] / e[-1]) / math.log(h[-width] / h[-1])
    return Slope(small, abs(small - large) / (ratio - 1.0) + rounded, small - large, h, e)


def slope_of_defects(largest: float, count: int, look: Callable[[float], tuple[float, float]]) -> Slope | None:
    """Return the power of the step that a defect follows, from the largest step down by roots of two.

    Parameters
    ----------
    largest : float
        Step, with its sign.
    count : int
        Of steps.
    look : callable
        Of a step: the defect and its floor. Steps at which it fails are left out.

    Returns
    -------
    Slope or None
        As `slope`.
    """
    steps, defects, floors = [], [], []
    for k in range(count):
        h = largest / 2.0 ** (k / 2)
        try:
            defect, floor = look(h)
        except (IntegrationError, TypeError, ValueError):
            continue
        steps.append(abs(h))
        defects.append(defect)
        floors.append(floor)
    return slope(steps, defects, floors)


def _slope(h: NDArray[np.float64], e: NDArray[np.float64]) -> float:
    return float(np.polyfit(np.log(h), np.log(e), 1)[0])
