"""Fitted powers: orders of schemes and defects, and growth of deviations."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import record_repr, short
from coadjoint.validation import read_finite

Floats = NDArray[np.float64]

MIN_POINTS = 3  # of a fitted power
MAX_POINTS = 5  # of an order, at the smallest steps
# Errors below this multiple of their round-off are not fitted; at 16, the logarithm is off by 1/16.
FLOOR_FACTOR = 16.0
PLATEAU_POINTS = 3  # errors that no longer fall, whose largest is the size of the plateau

WINDOWS = 5
"""Number of windows of a growth: the last half of the run, the half before it, and so on."""
KINDS = ((-0.25, 0.25, "bounded"), (0.25, 0.75, "like sqrt(t)"), (0.75, 1.25, "linear"))


def fit_power(x: ArrayLike, y: ArrayLike) -> float:
    """Return the power p of y = c x^p, by least squares in the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


class OrderFit(NamedTuple):
    """A fitted order.

    Parameters
    ----------
    order : float
        Slope of log(error) against log(step) at the smallest steps.
    uncertainty : float
        Estimated distance from the slope in the limit of vanishing steps.
    steepening : float
        The slope at the smallest steps minus that at the largest ones. A positive value indicates that the asymptotic
        order is not yet reached.
    steps, errors : ndarray, shape (k,)
        The fitted points, at most five, largest step first.
    dropped : int
        Number of points excluded, dominated by round-off.
    """

    order: float
    uncertainty: float
    steepening: float
    steps: Floats
    errors: Floats
    dropped: int

    def __repr__(self) -> str:
        return record_repr(self)

    def __str__(self) -> str:
        """Format the order with its uncertainty."""
        return f"{self.order:.2f} +- {self.uncertainty:.2f}"


@suggest_keywords
def fit_order(steps: ArrayLike, errors: ArrayLike, floor: ArrayLike | None = None) -> OrderFit:
    """Fit an order to errors at several steps, without the points dominated by round-off.

    From the largest step down, points count until one is at or below its `floor`; without a `floor`, until the error
    falls more slowly than the square root of the step (a plateau: no scheme has order 1/2). Of these, errors below 16
    times the plateau are omitted if three others remain. The last five are fitted.

    Parameters
    ----------
    steps : array_like, shape (k,)
        Positive, distinct steps.
    errors : array_like, shape (k,)
        Non-negative errors.
    floor : array_like, shape (k,) or a number, optional
        Size below which an error may be round-off, such as 8 times the number of steps times 2^-53 times the size of
        the state.

    Returns
    -------
    OrderFit
        The slope, its uncertainty, and the points used.

    Raises
    ------
    ValueError
        Fewer than three points remain, or the input is not a set of positive steps with finite errors.

    Notes
    -----
    For an error C h^p (1 + a h + ...) the slope at points near the step h is p + a h + .... From the larger to the
    smaller points the step falls by a ratio r, so a h at the smaller ones is the change of the slope divided by
    r - 1. The uncertainty also includes the effect of round-off on the smallest error, taken as 1/16 of the floor, or
    as the plateau.

    Examples
    --------
    >>> fitted = fit_order([0.4, 0.2, 0.1, 0.05], [1.6e-1, 4e-2, 1e-2, 1e-5], floor=[1e-5] * 4)
    >>> round(fitted.order, 12), fitted.uncertainty < 1e-4, fitted.dropped
    (2.0, True, 1)
    """
    h, e = read_finite(steps, "steps"), read_finite(errors, "errors")
    if h.ndim != 1 or h.shape != e.shape:
        raise ValueError(f"steps and errors have the shapes {h.shape} and {e.shape}; they must both be (k,)")
    if not (np.all(h > 0.0) and len(np.unique(h)) == len(h)):
        raise ValueError(f"steps are {short(h.tolist())}; they must be positive and distinct")
    if not np.all(e >= 0.0):
        raise ValueError(f"errors are {short(e.tolist())}; they must be finite and not negative")
    floors = read_finite(0.0 if floor is None else floor, "floor")
    if floors.shape not in ((), h.shape):
        raise ValueError(f"floor has the shape {floors.shape}; it must be a number or {h.shape}, as the errors are")
    descending = np.argsort(-h)
    h, e, floors = h[descending], e[descending], np.broadcast_to(floors, h.shape)[descending]
    excluded = e <= floors
    if floor is None:
        excluded[1:] |= e[1:] > e[:-1] * np.sqrt(h[1:] / h[:-1])
    count = int(np.argmax(excluded)) if excluded.any() else len(h)
    if count < MIN_POINTS:
        raise ValueError(
            f"only {count} of {len(h)} errors are above the round-off floor and falling; "
            f"an order needs {MIN_POINTS}, so take larger steps or more of them"
        )
    if floor is None and count < len(h):
        plateau = float(np.max(e[count : count + PLATEAU_POINTS]))
        count = max(MIN_POINTS, int(np.count_nonzero(e[:count] > FLOOR_FACTOR * plateau)))
        floors = np.full(len(h), FLOOR_FACTOR * plateau)
    used, dropped = slice(max(0, count - MAX_POINTS), count), len(h) - count
    h, e, floors = h[used], e[used], floors[used]
    width = 3 if len(h) == MAX_POINTS else 2
    large, small = fit_power(h[:width], e[:width]), fit_power(h[-width:], e[-width:])
    ratio = math.exp(float(np.mean(np.log(h[:width])) - np.mean(np.log(h[-width:]))))
    rounding = float(floors[-1] / e[-1]) / FLOOR_FACTOR / math.log(h[-width] / h[-1])
    uncertainty = abs(small - large) / (ratio - 1.0) + rounding
    turns = np.abs(np.diff(np.diff(np.log(e)) / np.diff(np.log(h))))
    if floor is None and len(turns) > 1 and turns[-1] > turns[-2]:
        uncertainty = max(uncertainty, float(turns[-1]))  # slopes do not settle: a plateau below the last step
    return OrderFit(small, uncertainty, small - large, h, e, dropped)


class Growth(NamedTuple):
    """Growth of deviations over a run.

    Parameters
    ----------
    power : float
        The power of time, fitted over the windows; NaN if fewer than three windows have deviations.
    kind : str
        "bounded", "like sqrt(t)", "linear", or "like t^..."; "none" if no deviation differs from zero, and
        "undetermined" if fewer than three windows have deviations.
    times, sizes : ndarray, shape (windows,)
        Middle and root mean square of each window.
    """

    power: float
    kind: str
    times: Floats
    sizes: Floats

    def __repr__(self) -> str:
        return record_repr(self)


@suggest_keywords
def growth(t: Floats, deviations: Floats) -> Growth:
    """Return the power of time with which the root mean square of deviations grows.

    Parameters
    ----------
    t : ndarray, shape (k,)
        Times since the start, increasing in absolute value.
    deviations : ndarray, shape (k, members)
        Deviations from the initial value.

    Returns
    -------
    Growth

    Notes
    -----
    Each window is twice as long as the previous one, so the logarithm of the root mean square of a deviation c t^a
    rises by a log 2 from window to window, and the fitted slope is a. An oscillation with a period shorter than the
    windows has equal root mean squares. A kind is assigned within 1/4 of its power, half of the distance to the next
    kind. For a random walk of m members the slope has a standard deviation of about 0.3 / sqrt(m).

    Examples
    --------
    >>> t = np.linspace(0, 100, 201)
    >>> growth(t, 1e-3 * np.sin(9 * t)[:, None]).kind, growth(t, 1e-9 * t[:, None]).kind
    ('bounded', 'linear')
    """
    since = np.abs(t - t[0])
    edges = since[-1] / 2.0 ** np.arange(WINDOWS, -1, -1)
    times, sizes = [], []
    for k, (begin, end) in enumerate(pairwise(edges)):
        inside = (since > begin * (1 + 1e-9)) & (since <= end * (1 + 1e-9)) if k else (since > 0) & (since <= end)
        if np.any(inside):
            times.append(float(np.sqrt(begin * end)))
            sizes.append(float(np.sqrt(np.mean(deviations[inside] ** 2))))
    middle, size = np.array(times), np.array(sizes)
    positive = size > 0.0
    if not np.any(positive):
        return Growth(float("nan"), "none", middle, size)
    if np.count_nonzero(positive) < MIN_POINTS:
        return Growth(float("nan"), "undetermined", middle, size)
    power = fit_power(middle[positive], size[positive])
    kind = next((name for low, high, name in KINDS if low <= power < high), f"like t^{power:.1f}")
    return Growth(power, kind, middle, size)
