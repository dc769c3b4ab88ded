"""Plots of series over time: lines, envelopes of dense series, or dots of sparse ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.style import thickness

Floats = npt.NDArray[np.float64]

COLUMNS = 600
"""Number of time intervals that a printed line resolves."""
MAX_VALUE = 1e280  # the limits of a scale with margins for larger values overflow
MAX_CHANGE = 1e-5
"""Relative change of a series below which the change is drawn in place of the values."""
MAX_TURNING_POINTS = COLUMNS // 2
"""Number of turning points above which an envelope is drawn: two columns per half oscillation."""


def draw_series(axes: Any, t: Floats, values: Floats, joined: bool, label: str | None = None, **style: Any) -> None:
    """Draw a series as a line, an envelope or, unless `joined`, dots, without values beyond 1e280."""
    values = np.where(np.abs(values) < MAX_VALUE, values, np.nan)
    turns = turning_points(values)
    if turns > MAX_TURNING_POINTS or (len(t) > 8 * COLUMNS and not joined):
        middle, low, high = envelope(t, values, COLUMNS)
        alpha = style.get("alpha", 1.0)
        # The edge keeps envelopes visible that are narrower than a line.
        face, edge = ((style.get("color", "C0"), part * alpha) for part in (0.35, 1.0))
        width = style.get("linewidth", 0.9)
        axes.fill_between(middle, low, high, facecolor=face, edgecolor=edge, linewidth=width, label=label)
        return
    if joined and not _mostly_isolated(values):
        axes.plot(t, values, label=label, **style)
        return
    style.pop("linewidth", None)
    axes.plot(t, values, label=label, linestyle="none", marker="o", markersize=2.0, markeredgewidth=0.0, **style)


def draw_members(axes: Any, t: Floats, members: Floats, joined: bool, colour: Any, label: str | None) -> None:
    """Draw a series (members, k), thin and light if there are several; `joined` as for `draw_series`."""
    width, alpha = (thickness(0.5), 0.5) if len(members) > 1 else (thickness(0.9), 1.0)
    # The label is that of a member that is drawn.
    labelled = int(np.argmax(np.isfinite(members).any(axis=-1)))
    for m, values in enumerate(members):
        own = label if m == labelled else None
        draw_series(axes, t, values, joined, label=own, color=colour, linewidth=width, alpha=alpha)


def from_start(lines: Mapping[str, Floats]) -> tuple[dict[str, Floats], str]:
    """Return series less their first values, and a note, if they change by round-off of their size only."""
    # Otherwise axes would have an offset in place of numbers.
    with np.errstate(all="ignore"):
        for members in lines.values():
            size = np.abs(members).max(axis=-1)
            change = np.ptp(members, axis=-1)
            if not np.all(change < MAX_CHANGE * size) or not np.any(change > 0.0):
                return dict(lines), ""
    return {name: members - members[:, :1] for name, members in lines.items()}, " less its start"


def _mostly_isolated(values: Floats) -> bool:
    """Test whether more than a tenth of the points are isolated by gaps, so that lines do not show them."""
    finite = np.isfinite(values)
    has_neighbour = np.append(finite[1:], False) | np.insert(finite[:-1], 0, False)
    return int(np.count_nonzero(finite & ~has_neighbour)) > 0.1 * int(np.count_nonzero(finite))


def turning_points(values: Floats) -> int:
    """Count the changes between rising and falling of the finite values of a series."""
    slopes = np.sign(np.diff(values[np.isfinite(values)]))
    slopes = slopes[slopes != 0.0]
    return int(np.count_nonzero(slopes[1:] != slopes[:-1]))


def envelope(t: Floats, values: Floats, columns: int) -> tuple[Floats, Floats, Floats]:
    """Return (middle times, smallest, largest) of the finite values in at most `columns` groups of points."""
    starts = np.unique(np.linspace(0, len(t), min(columns, len(t)) + 1).astype(np.int64))[:-1]
    ends = np.append(starts[1:], len(t)) - 1
    middle = 0.5 * (t[starts] + t[ends])
    middle[0], middle[-1] = t[0], t[-1]
    finite = np.isfinite(values)
    low = np.minimum.reduceat(np.where(finite, values, np.inf), starts)
    high = np.maximum.reduceat(np.where(finite, values, -np.inf), starts)
    empty = ~np.isfinite(low)
    return middle, np.where(empty, np.nan, low), np.where(empty, np.nan, high)
