"""Curves of members: series over time, paths in their colours, on a sphere too, and movies of paths up to a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.style import (
    colour,
    colour_bar,
    colour_scale,
    ink,
    legend,
    on_paper,
    paper,
    path_style,
    plain_axes,
    set_title,
    setting,
    thickness,
)
from coadjoint.systems.batch import differing_numbers

Floats = npt.NDArray[np.float64]

COLUMNS = 600
"""Number of time intervals that a printed line resolves."""
MAX_VALUE = 1e280  # the limits of a scale with margins for larger values overflow
MAX_CHANGE = 1e-5
"""Relative change of a series below which the change is drawn in place of the values."""
MAX_TURNING_POINTS = COLUMNS // 2
"""Number of turning points above which an envelope is drawn: two columns per half oscillation."""

MAX_KEYS = 8
"""Largest number of members in a legend: as many as there are colours."""
BAR_LABEL = "<colorbar of members>"
DARKEST, LIGHTEST = 0.0, 0.88
"""Part of the colour map viridis that is dark enough for lines on white."""
EQUAL_ENERGIES = 1e-6
"""Relative difference of energies below which all members have one colour."""

BALL_COLOUR, CIRCLE_COLOUR = "#EDF2F8", "#C3CEDB"
VIEW = (35.0, 22.0)
"""Direction of view in degrees: around the third axis from the first, and above the plane of the first two."""
FAR_ALPHA = 0.28
"""Opacity of paths on the far side."""
VIEW_OFFSET = 25.0
"""Degrees of azimuth from the middle of a path, so that the label of an axis there does not cover it."""


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


def draw_over_time(
    axes: Any,
    t: Floats,
    lines: Mapping[str, Floats],
    joined: bool,
    ylabel: str,
    title: str,
    members_of: PlottedRun | None = None,
) -> None:
    """Draw series (members, k) over time by label, with labels and a legend; a single one is coloured by member."""
    if members_of is not None and len(lines) == 1 and differing_parameters(members_of):
        draw_each_member(axes, members_of, t, next(iter(lines.values())), joined)
    else:
        for number, (label, members) in enumerate(lines.items()):
            draw_members(axes, t, members, joined, colour(number), label)
    axes.set(xlabel="time $t$", ylabel=ylabel, title=title)
    plain_axes(axes)
    legend(axes, beside=True)


def draw_each_member(axes: Any, drawn: PlottedRun, t: Floats, members: Floats, joined: bool) -> None:
    """Draw a series of each member in its colour: few by their parameters, in a legend, or as `MemberColours`."""
    shades, columns = MemberColours(drawn), differing_parameters(drawn)
    is_keyed = bool(columns) and len(members) <= MAX_KEYS
    for m, values in enumerate(members):
        settings = {name: column[m] for name, column in columns.items()}
        key = ", ".join(f"{name} = {v}" if isinstance(v, str) else f"{name} = {v:.4g}" for name, v in settings.items())
        style = {"color": colour(m), "label": key} if is_keyed else {"color": shades[m]}
        draw_series(axes, t, values, joined, linewidth=thickness(0.7), **style)
    if not is_keyed:
        shades.add_bar(axes)


def differing_parameters(drawn: PlottedRun) -> dict[str, npt.NDArray[Any]]:
    """Return the values of the axes of a batch, or else of its parameters, in which the drawn members differ."""
    system, members = drawn.solution.system, drawn.chosen
    if not system.is_batch:
        return {}
    if system.axes:
        indices = np.unravel_index(members, [axis.length for axis in system.axes.values()])
        pairs = zip(system.axes.items(), indices, strict=True)
        columns = {name: index if axis.values is None else axis.values[index] for (name, axis), index in pairs}
    else:
        numbers = differing_numbers(system).items()
        columns = {place.rpartition(".")[2]: values[members] for place, values in numbers}
    return {name: values for name, values in columns.items() if np.any(values != values[0])}


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
    """Colours of the drawn members by the energy at the start, or by a parameter if it is equal, or one colour."""

    def __init__(self, drawn: PlottedRun) -> None:
        from matplotlib import colormaps
        from matplotlib.colors import LinearSegmentedColormap

        energies = drawn.at_start("energy") if len(drawn.x) > 1 else np.zeros(1)
        finite = energies[np.isfinite(energies)]
        self.by_energy = finite.size > 1 and float(np.ptp(finite)) > EQUAL_ENERGIES * float(np.abs(finite).max())
        self._values, self._label, self._shades = energies, "energy $H$ at the start", None
        if len(drawn.x) > 1 and not self.by_energy:
            columns = differing_parameters(drawn)
            numeric = {name: values for name, values in columns.items() if values.dtype.kind in "if"}
            self._label, self._values = next(iter(numeric.items()), ("", np.full(len(drawn.x), np.nan)))
        finite = self._values[np.isfinite(self._values)]
        if self.by_energy or (len(drawn.x) > 1 and finite.size > 1):
            part = colormaps["viridis"](np.linspace(DARKEST, LIGHTEST, 256))
            self._shades = colour_scale(finite, LinearSegmentedColormap.from_list("members", part))

    def __getitem__(self, m: int) -> Any:
        if self._shades is None or not np.isfinite(self._values[m]):
            return colour(0)
        return self._shades.to_rgba(self._values[m])

    def add_bar(self, axes: Any) -> None:
        """Add a colour bar to axes if the colours differ, unless the figure has one."""
        children = [child for other in axes.figure.axes for child in other.child_axes]
        if self._shades is not None and all(child.get_label() != BAR_LABEL for child in children):
            bar = colour_bar(axes, self._shades, self._label)
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


def view_of(points: Floats) -> tuple[float, float]:
    """Return a view, as `VIEW`, of a path (k, 3) on a sphere: from the side of its finite points, if they have one."""
    x, y, _ = np.mean(points[np.isfinite(points).all(axis=1)], axis=0)
    return (float(np.degrees(np.arctan2(y, x))) + VIEW_OFFSET, VIEW[1]) if np.hypot(x, y) > 0.15 else VIEW


def unit_vectors(longitude: Floats, latitude: Floats) -> Floats:
    """Return the unit vectors (..., 3) at longitudes and latitudes in radians."""
    return np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1
    )


def view_frame(view: tuple[float, float]) -> Floats:
    """Return the rotation whose rows are the axes of a picture: to the right, upwards, and towards the viewer."""
    around, above = np.radians(view)
    towards, right = unit_vectors(around, above), np.array([-np.sin(around), np.cos(around), 0.0])
    return np.stack([right, np.cross(towards, right), towards])


def towards_viewer(axes: Any) -> Floats:
    """Return the direction to the viewer of three-dimensional axes, in the coordinates of the data."""
    towards = view_frame((axes.azim, axes.elev))[2]
    size = np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1)
    return np.asarray(towards * size / axes._box_aspect)


class Globe:
    """Sphere of a given radius in flat axes of equal aspect, seen from a `VIEW`, with labelled directions."""

    def __init__(
        self,
        axes: Any,
        names: Any,
        view: tuple[float, float] = VIEW,
        radius: float = 1.0,
        directions: Floats | None = None,
    ) -> None:
        self.axes, self.radius = axes, radius
        self.frame = view_frame(view)
        self._draw_ball()
        self._draw_axes(names, np.eye(3) if directions is None else directions)
        axes.set_aspect("equal")
        axes.set(xlim=(-1.42 * radius, 1.42 * radius), ylim=(-1.42 * radius, 1.42 * radius))
        axes.axis("off")

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Project points (..., 3) to (..., 2); also return their depth, positive on the near side."""
        turned = points @ self.frame.T
        return turned[..., :2], turned[..., 2]

    def _draw_ball(self) -> None:
        from matplotlib.patches import Circle

        self.axes.add_patch(
            Circle(
                (0.0, 0.0),
                self.radius,
                facecolor=on_paper(BALL_COLOUR, 0.1),
                edgecolor=on_paper(CIRCLE_COLOUR, 0.3),
                linewidth=0.8,
                zorder=0,
            )
        )
        turn = np.linspace(0.0, 2.0 * np.pi, 181)
        c, s, o = np.cos(turn), np.sin(turn), np.zeros_like(turn)
        circles = [np.stack(circle, axis=-1) for circle in ((c, s, o), (c, o, s), (o, c, s))]
        for circle in circles:
            self._path(
                self.radius * circle, near={"color": on_paper(CIRCLE_COLOUR, 0.3), "linewidth": 0.7}, far=None, zorder=1
            )

    def _draw_axes(self, names: Any, directions: Floats) -> None:
        for direction, name in zip(directions, names, strict=True):
            ends, depth = self.project(np.outer([1.0, 1.22], self.radius * direction))
            order = 2 if depth[0] > 0.0 else -1
            self.axes.annotate(
                "",
                xy=ends[1],
                xytext=ends[0],
                arrowprops={"arrowstyle": "-|>", "color": ink(), "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0},
                zorder=order,
            )
            position = ends[1] + 0.1 * self.radius * _outward(ends[1])
            near = depth[0] > 0.0
            box = {"facecolor": paper(), "edgecolor": "none", "alpha": 0.75, "pad": 0.8} if near else None
            text = {
                "color": ink(),
                "fontsize": setting("axes.titlesize"),
                "ha": "center",
                "va": "center",
                "zorder": 6 if near else -1,
            }
            self.axes.text(*position, name, bbox=box, **text)

    def path(
        self, points: Floats, colour: Any, joined: bool, linewidth: float = 1.1, label: str | None = None
    ) -> list[Any]:
        """Draw a path (k, 3) on the sphere, as lines if `joined`, else as dots; return the lines, each of k points."""
        near = {"color": colour, "alpha": 1.0, **path_style(len(points), joined, linewidth)}
        lines = self._path(points, near=near, far={**near, "alpha": FAR_ALPHA}, zorder=3, joined=joined)
        if lines and label is not None:
            lines[0].set_label(label)
        return lines

    def _path(
        self, points: Floats, near: dict[str, Any], far: dict[str, Any] | None, zorder: int, joined: bool = True
    ) -> list[Any]:
        flat, depth = self.project(points)
        front, lines = depth >= 0.0, []
        for side, style, order in ((front, near, zorder), (~front, far, zorder - 1)):
            if style is not None and side.any():
                # Segments across the edge belong to both sides, to avoid gaps.
                shown = side | np.append(side[1:], False) if joined else side
                lines += self.axes.plot(*np.where(shown[:, None], flat, np.nan).T, zorder=order, **style)
        return lines

    def mark(self, point: Floats, colour: Any, label: str | None = None, marker: str = "o", size: float = 5.0) -> Any:
        """Mark a point (3,) of the sphere, hollow on the far side; return the mark."""
        flat, depth = self.project(point)
        filled = colour if depth >= 0.0 else paper()
        (mark,) = self.axes.plot(
            *flat[:, None],
            marker=marker,
            markersize=size,
            color=colour,
            markerfacecolor=filled,
            linestyle="none",
            label=label,
            zorder=5,
        )
        return mark


def _outward(flat: Floats) -> Floats:
    size = float(np.linalg.norm(flat))
    return flat / size if size > 1e-3 else np.array([0.0, 1.0])
