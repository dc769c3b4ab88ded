"""Fitted power of the step in errors, with an uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError

MAX_POINTS = 5
MIN_POINTS = 3
# Points with errors below this multiple of their round-off are excluded; at 16, the logarithm is off by 1/16.
FLOOR_FACTOR = 16.0


class Slope(NamedTuple):
    """A fitted power of the step.

    Parameters
    ----------
    value : float
        The slope at the smallest steps.
    uncertainty : float
        Estimated distance from the slope in the limit of vanishing steps.
    steepening : float
        The slope at the smallest steps minus that at the largest ones. A positive value indicates that the asymptotic
        order is not yet reached.
    steps, errors : ndarray, shape (k,)
        The fitted points, largest step first.
    """

    value: float
    uncertainty: float
    steepening: float
    steps: NDArray[np.float64]
    errors: NDArray[np.float64]

    def __str__(self) -> str:
        """Format the slope with its uncertainty."""
        return f"{self.value:.2f} +- {self.uncertainty:.2f}"


def slope(steps: list[float], errors: list[float], floors: list[float]) -> Slope | None:
    """Return the slope of log(error) against log(step) at the smallest steps whose errors are above round-off.

    Parameters
    ----------
    steps, errors, floors : list of float
        Steps, errors, and the round-off of each error; all positive.

    Returns
    -------
    Slope or None
        None if fewer than three points are above the floor.

    Notes
    -----
    For an error C h^p (1 + a h + ...) the slope at points near the step h is p + a h + .... From the larger to the
    smaller points the step falls by a ratio r, so a h at the smaller ones is the change of the slope divided by
    r - 1. The uncertainty also includes the effect of round-off, which may be 1/16 of an error.

    Examples
    --------
    >>> found = slope([0.4, 0.2, 0.1], [1.6e-3, 4e-4, 1e-4], [1e-16] * 3)
    >>> round(found.value, 12), found.uncertainty < 1e-9
    (2.0, True)
    """
    points = [
        (step, error, floor)
        for step, error, floor in sorted(zip(steps, errors, floors, strict=True), reverse=True)
        if error > FLOOR_FACTOR * floor
    ][-MAX_POINTS:]
    if len(points) < MIN_POINTS:
        return None
    h, e, floor = (np.array(column) for column in zip(*points, strict=True))
    width = 3 if len(h) == MAX_POINTS else 2
    large, small = _slope(h[:width], e[:width]), _slope(h[-width:], e[-width:])
    ratio = math.exp(float(np.mean(np.log(h[:width])) - np.mean(np.log(h[-width:]))))
    rounded = float(floor[-1] / e[-1]) / math.log(h[-width] / h[-1])
    return Slope(small, abs(small - large) / (ratio - 1.0) + rounded, small - large, h, e)


def slope_of_defects(largest: float, count: int, measure: Callable[[float], tuple[float, float]]) -> Slope | None:
    """Return the power of the step with which a defect scales, at `count` steps from the largest one down by factors
    sqrt(2).

    `measure` maps a signed step to the defect and its floor; steps at which it fails are skipped.
    """
    steps, defects, floors = [], [], []
    for k in range(count):
        h = largest / 2.0 ** (k / 2)
        try:
            defect, floor = measure(h)
        except (IntegrationError, TypeError, ValueError):
            continue
        steps.append(abs(h))
        defects.append(defect)
        floors.append(floor)
    return slope(steps, defects, floors)


def _slope(h: NDArray[np.float64], e: NDArray[np.float64]) -> float:
    return float(np.polyfit(np.log(h), np.log(e), 1)[0])
