"""Fitted order of a scheme, from errors at several steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.validation import read_finite

MIN_POINTS = 3


class OrderFit(NamedTuple):
    """A fitted order.

    Parameters
    ----------
    order : float
        Slope of log(error) against log(step), by least squares.
    steps, errors : ndarray, shape (k,)
        The points used, largest step first.
    dropped : int
        Number of points on the round-off floor.
    """

    order: float
    steps: npt.NDArray[np.float64]
    errors: npt.NDArray[np.float64]
    dropped: int


def fit_order(steps: npt.ArrayLike, errors: npt.ArrayLike, floor: npt.ArrayLike = 0.0) -> OrderFit:
    """Fit an order to errors at several steps, without the points dominated by round-off.

    From the largest step down, points are used until one is at or below its `floor`, or until the error falls more
    slowly than the square root of the step (a plateau: no scheme has order 1/2).

    Parameters
    ----------
    steps : array_like, shape (k,)
        Positive, distinct steps.
    errors : array_like, shape (k,)
        Non-negative errors.
    floor : array_like, shape (k,) or a number
        Size of the round-off in each error, for instance the number of steps times 2^-53 times the size of the state.

    Returns
    -------
    OrderFit
        The slope and the points used.

    Raises
    ------
    ValueError
        Fewer than three points remain, or the input is not a set of positive steps with finite errors.

    Examples
    --------
    >>> fit_order([0.4, 0.2, 0.1, 0.05], [1.6e-1, 4e-2, 1e-2, 9.9e-3]).order.__round__(12)
    2.0
    """
    h, e = read_finite(steps, "steps"), read_finite(errors, "errors")
    if h.ndim != 1 or h.shape != e.shape:
        raise ValueError(f"steps and errors have the shapes {h.shape} and {e.shape}; they must both be (k,)")
    if not (np.all(h > 0.0) and len(np.unique(h)) == len(h)):
        raise ValueError(f"steps are {short(h.tolist())}; they must be positive and distinct")
    if not np.all(e >= 0.0):
        raise ValueError(f"errors are {short(e.tolist())}; they must be finite and not negative")
    least = read_finite(floor, "floor")
    if least.shape not in ((), h.shape):
        raise ValueError(f"floor has the shape {least.shape}; it must be a number or {h.shape}, as the errors are")
    down = np.argsort(-h)
    h, e, least = h[down], e[down], np.broadcast_to(least, h.shape)[down]
    kept = 0
    while kept < len(h) and e[kept] > least[kept]:
        if kept and e[kept] > e[kept - 1] * np.sqrt(h[kept] / h[kept - 1]):
            break
        kept += 1
    if kept < MIN_POINTS:
        raise ValueError(
            f"only {kept} of {len(h)} errors are above the round-off floor and falling; "
            f"an order needs {MIN_POINTS}, so take larger steps or more of them"
        )
    slope = float(np.polyfit(np.log(h[:kept]), np.log(e[:kept]), 1)[0])
    return OrderFit(slope, h[:kept], e[:kept], len(h) - kept)
