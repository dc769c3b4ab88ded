"""Curves of members: series over time, paths in their colours, and movies of paths up to a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.style import colour, colour_bar, colour_scale, legend, plain_axes, set_title, thickness

Floats = npt.NDArray[np.float64]

COLUMNS = 600
"""Number of time intervals that a printed line resolves."""
MAX_VALUE = 1e280  # the limits of a scale with margins for larger values overflow
MAX_CHANGE = 1e-5
"""Relative change of a series below which the change is drawn in place of the values."""
MAX_TURNING_POINTS = COLUMNS // 2
"""Number of turning points above which an envelope is drawn: two columns per half oscillation."""

BAR_LABEL = "<colorbar of members>"
DARKEST, LIGHTEST = 0.0, 0.88
"""Part of the colour map viridis that is dark enough for lines on white."""
EQUAL_ENERGIES = 1e-6
"""Relative difference of energies below which all members have one colour."""


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


def draw_over_time(axes: Any, t: Floats, lines: Mapping[str, Floats], joined: bool, ylabel: str, title: str) -> None:
    """Draw series (members, k) over time by label, each in its colour, with labels of the axes and a legend."""
    for number, (label, members) in enumerate(lines.items()):
        draw_members(axes, t, members, joined, colour(number), label)
    axes.set(xlabel="time $t$", ylabel=ylabel, title=title)
    plain_axes(axes)
    legend(axes, beside=True)


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


class MemberColours:
    """Colours of the drawn members: one for equal energies at the start, otherwise by the energy."""

    def __init__(self, drawn: PlottedRun) -> None:
        from matplotlib import colormaps
        from matplotlib.colors import LinearSegmentedColormap

        energies = drawn.at_start("energy") if len(drawn.x) > 1 else np.zeros(1)
        finite = energies[np.isfinite(energies)]
        self.differ = finite.size > 1 and float(np.ptp(finite)) > EQUAL_ENERGIES * float(np.abs(finite).max())
        self._energies, self._shades = energies, None
        if self.differ:
            part = colormaps["viridis"](np.linspace(DARKEST, LIGHTEST, 256))
            self._shades = colour_scale(finite, LinearSegmentedColormap.from_list("energies", part))

    def __getitem__(self, m: int) -> Any:
        """Return the colour of a drawn member."""
        if self._shades is None or not np.isfinite(self._energies[m]):
            return colour(0)
        return self._shades.to_rgba(self._energies[m])

    def add_bar(self, axes: Any) -> None:
        """Add a colour bar to axes if the colours differ, unless the figure has one."""
        children = [child for other in axes.figure.axes for child in other.child_axes]
        if self._shades is not None and all(child.get_label() != BAR_LABEL for child in children):
            bar = colour_bar(axes, self._shades, "energy $H$ at the start")
            bar.ax.set_label(BAR_LABEL)


class PathUpdate:
    """Update of a picture of paths to another saved point, as movies need it; it shows the whole paths first."""

    def __init__(self, drawn: PlottedRun, axes: Any, title: str) -> None:
        self._axes, self._title, self._t = axes, title, drawn.t
        self._paths: list[tuple[Floats, Floats | None, list[tuple[Any, Any]], Any]] = []

    def add(self, lines: list[Any], times: Floats, points: Floats | None = None, head: Any = None) -> None:
        """Add lines of k points with their times (k,), and the points of a mark that moves with them (or a new one)."""
        full = [(line, line.get_data_3d() if hasattr(line, "get_data_3d") else line.get_data()) for line in lines]
        self._paths.append((times, points, full, head))

    def __call__(self, k: int) -> None:
        """Show the paths up to a saved point."""
        time, forward = self._t[k], 1.0 if self._t[-1] >= self._t[0] else -1.0
        for i, (times, points, lines, head) in enumerate(self._paths):
            count = int(np.count_nonzero(forward * (times - time) <= 0.0))
            for line, data in lines:
                _set_points(line, [np.asarray(values)[:count] for values in data])
            if points is None:
                continue
            if head is None:
                style = {"linestyle": "none", "marker": "o", "markersize": 5.0, "zorder": 7}
                (head,) = self._axes.plot(*points[:1].T, color=lines[0][0].get_color(), **style)
                self._paths[i] = (times, points, lines, head)
            _set_points(head, points[max(count - 1, 0) : max(count, 1)].T)
        self._axes.title.set_text(f"{self._title}, $t$ = {time:.4g}")


def _set_points(line: Any, data: Any) -> None:
    if len(data) == 3:
        line.set_data_3d(*data)
    else:
        line.set_data(*data)


def at_one_time(
    axes: Any, drawn: PlottedRun, subject: str, k: int, show: Callable[[int], None], more: str = ""
) -> Callable[[int], None]:
    """Set the title of a picture of the first member at saved point k; return what shows another one."""

    def title_at(j: int) -> str:
        return f"{subject}{drawn.of_member} at $t$ = {drawn.t[j]:.4g}{more}"

    title = set_title(axes, title_at(k))

    def update(j: int) -> None:
        show(j)
        title.set_text(title_at(j))

    return update
