"""Drawing of paths on a sphere seen from outside, fainter on the far side."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.style import ink, on_paper, paper, path_style, setting

Floats = npt.NDArray[np.float64]

FACE_COLOUR, LINES = "#EDF2F8", "#C3CEDB"
VIEW = (35.0, 22.0)
"""Direction of view in degrees: around the third axis from the first, and above the plane of the first two."""
FAR_ALPHA = 0.28
"""Opacity of paths on the far side."""
VIEW_OFFSET = 25.0
"""Degrees of azimuth from the middle of a path, so that the label of an axis there does not cover it."""


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
    """Sphere of a given radius in flat axes of equal aspect, with labels for its three axes and a view as `VIEW`."""

    def __init__(self, axes: Any, names: Any, view: tuple[float, float] = VIEW, radius: float = 1.0) -> None:
        self.axes, self.radius = axes, radius
        self.frame = view_frame(view)
        self._draw_ball()
        self._draw_axes(names)
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
                facecolor=on_paper(FACE_COLOUR, 0.1),
                edgecolor=on_paper(LINES, 0.3),
                linewidth=0.8,
                zorder=0,
            )
        )
        turn = np.linspace(0.0, 2.0 * np.pi, 181)
        c, s, o = np.cos(turn), np.sin(turn), np.zeros_like(turn)
        circles = [np.stack(circle, axis=-1) for circle in ((c, s, o), (c, o, s), (o, c, s))]
        for circle in circles:
            self._path(self.radius * circle, near={"color": on_paper(LINES, 0.3), "linewidth": 0.7}, far=None, zorder=1)

    def _draw_axes(self, names: Any) -> None:
        for direction, name in zip(np.eye(3), names, strict=True):
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
