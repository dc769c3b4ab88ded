"""How is a series over time drawn? As a line, as an envelope where it is too dense, as dots where it is too sparse."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

COLUMNS = 600
"""Stretches of time that a printed line can tell apart."""
LARGEST = 1e280  # beyond it a scale with its margins leaves the range of float64
TOO_MANY = COLUMNS // 2
"""Turning points of a series that is drawn as an envelope: fewer than two columns for each half of an oscillation."""


def draw_series(axes: Any, t: Floats, values: Floats, joined: bool, label: str | None = None, **style: Any) -> None:
    """Draw a series as what can be known of it.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where.
    t, values : ndarray, shape (k,)
        Times and values; where a value is not finite, or beyond 1e280, nothing is drawn.
    joined : bool
        Whether lines between the points show what lies between them. Otherwise there are dots alone.
    label : str, optional
        For the key.
    **style
        ``color``, ``linewidth`` and ``alpha``.
    """
    values = np.where(np.abs(values) < LARGEST, values, np.nan)
    turns = turning_points(values)
    if turns > TOO_MANY or (len(t) > 8 * COLUMNS and not joined):
        middle, low, high = envelope(t, values, COLUMNS)
        strength = style.get("alpha", 1.0)
        # The edge shows an envelope that is narrower than a line.
        face, edge = ((style.get("color", "C0"), part * strength) for part in (0.35, 1.0))
        width = style.get("linewidth", 0.9)
        axes.fill_between(middle, low, high, facecolor=face, edgecolor=edge, linewidth=width, label=label)
        return
    if joined and not _mostly_alone(values):
        axes.plot(t, values, label=label, **style)
        return
    style.pop("linewidth", None)
    axes.plot(t, values, label=label, linestyle="none", marker="o", markersize=2.0, markeredgewidth=0.0, **style)


def draw_members(axes: Any, t: Floats, members: Floats, joined: bool, colour: str, label: str | None) -> None:
    """Draw a series of each member, thin and light where there are several.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where.
    t : ndarray, shape (k,)
        Times.
    members : ndarray, shape (members, k)
        Values.
    joined : bool
        As for `draw_series`.
    colour : str
        Of all.
    label : str or None
        For the key.
    """
    width, strength = (0.5, 0.5) if len(members) > 1 else (0.9, 1.0)
    for m, values in enumerate(members):
        shown = label if m == 0 else None
        draw_series(axes, t, values, joined, label=shown, color=colour, linewidth=width, alpha=strength)


def _mostly_alone(values: Floats) -> bool:
    """Say whether a tenth of the points stand between gaps, where a line does not show them."""
    known = np.isfinite(values)
    beside = np.append(known[1:], False) | np.insert(known[:-1], 0, False)
    return int(np.count_nonzero(known & ~beside)) > 0.1 * int(np.count_nonzero(known))


def turning_points(values: Floats) -> int:
    """Return how often a series turns from rising to falling or back.

    Parameters
    ----------
    values : ndarray, shape (k,)
        What is not finite is left out.

    Returns
    -------
    int

    Examples
    --------
    >>> turning_points(np.array([0.0, 1.0, 1.0, 2.0, 1.0, np.nan, 0.0, 3.0]))
    2
    """
    slopes = np.sign(np.diff(values[np.isfinite(values)]))
    slopes = slopes[slopes != 0.0]
    return int(np.count_nonzero(slopes[1:] != slopes[:-1]))


def envelope(t: Floats, values: Floats, columns: int) -> tuple[Floats, Floats, Floats]:
    """Return the smallest and the largest value in each of so many stretches of time, as many points in each.

    Parameters
    ----------
    t, values : ndarray, shape (k,)
        Times and values; those that are not finite do not count.
    columns : int
        How many stretches, at most.

    Returns
    -------
    middle, low, high : ndarray, shape (columns,)
        The times begin with the first one and end with the last one. NaN where nothing is finite.

    Examples
    --------
    >>> envelope(np.arange(6.0), np.array([0.0, 2.0, 1.0, 5.0, 4.0, 3.0]), 2)
    (array([0., 5.]), array([0., 3.]), array([2., 5.]))
    """
    starts = np.unique(np.linspace(0, len(t), min(columns, len(t)) + 1).astype(np.int64))[:-1]
    ends = np.append(starts[1:], len(t)) - 1
    middle = 0.5 * (t[starts] + t[ends])
    middle[0], middle[-1] = t[0], t[-1]
    known = np.isfinite(values)
    low = np.minimum.reduceat(np.where(known, values, np.inf), starts)
    high = np.maximum.reduceat(np.where(known, values, -np.inf), starts)
    nothing = ~np.isfinite(low)
    return middle, np.where(nothing, np.nan, low), np.where(nothing, np.nan, high)
