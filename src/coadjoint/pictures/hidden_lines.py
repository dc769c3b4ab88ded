"""Curves in space of which the parts behind a level surface are faint, for any direction of view."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from mpl_toolkits.mplot3d.art3d import Line3D

from coadjoint.pictures.globe import FAR_ALPHA, view_frame
from coadjoint.pictures.level_surface import values_at
from coadjoint.pictures.style import paper

Floats = npt.NDArray[np.float64]
Hides = Callable[[Floats, Floats], npt.NDArray[np.bool_]]
"""Function of points (k, 3) and of the direction to the viewer that returns whether the points are hidden, (k,)."""

TESTED_POINTS = 400  # of a line; each needs values along a ray
RAY_SAMPLES = 32
"""Samples along the ray from a point to the viewer, within the box of the picture."""


class FadingLine(Line3D):  # type: ignore[misc]
    """Line in space that is faint where it is hidden; a mark is hollow there. For orthographic projection."""

    def __init__(self, points: Floats, hides: Hides, **style: Any) -> None:
        super().__init__(*points.T, **style)
        self._hides, self._paper = hides, paper()

    def draw(self, renderer: Any) -> None:
        """Draw the hidden part and the visible one."""
        data, alpha, face = self.get_data_3d(), self.get_alpha(), self.get_markerfacecolor()
        points = np.stack([np.asarray(values, dtype=np.float64) for values in data], axis=-1)
        hidden = self._hides(points, towards_viewer(self.axes)) if len(points) else np.zeros(0, dtype=bool)
        is_mark = len(points) == 1
        for part, opacity in ((hidden, FAR_ALPHA), (~hidden, 1.0)):
            if not part.any():
                continue
            # Segments across the edge belong to both parts, to avoid gaps.
            shown = part if self.get_linestyle() == "None" else part | np.append(part[1:], False)
            self.set_data_3d(*np.where(shown[:, None], points, np.nan).T)
            self.set_alpha((1.0 if is_mark else opacity) * (1.0 if alpha is None else alpha))
            self.set_markerfacecolor(self._paper if is_mark and hidden[0] else face)
            super().draw(renderer)
        self.set_data_3d(*data)
        self.set_alpha(alpha)
        self.set_markerfacecolor(face)
        self.stale = False


def towards_viewer(axes: Any) -> Floats:
    """Return the direction to the viewer of three-dimensional axes, in the coordinates of the data."""
    towards = view_frame((axes.azim, axes.elev))[2]
    size = np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1)
    return np.asarray(towards * size / axes._box_aspect)


def hides_behind(function: Callable[[Any], Any], level: float, box: Floats, period: float = 0.0) -> Hides:
    """Return the test whether the surface function(x) = level, in a box (3, 2), hides points, as for `FadingLine`."""

    def hides(points: Floats, towards: Floats) -> npt.NDArray[np.bool_]:
        tested = np.unique(np.linspace(0, len(points) - 1, min(len(points), TESTED_POINTS)).round().astype(np.int64))
        start = points[tested]
        with np.errstate(all="ignore"):
            exits = np.where(towards > 0.0, box[:, 1] - start, box[:, 0] - start) / towards
            length = np.nanmin(np.where(np.isfinite(exits), exits, np.nan), axis=1, initial=np.inf)
            shares = (np.arange(RAY_SAMPLES) + 1.0) / RAY_SAMPLES
            rays = start[:, None] + (np.maximum(length, 0.0)[:, None] * shares)[..., None] * towards
            distance = values_at(function, rays) - level
            if period > 0.0:
                distance = distance - period * np.rint(distance / period)
                distance[np.abs(distance) > 0.25 * period] = np.nan
            # A sample may lie on the surface.
            changes = (distance[:, :-1] < 0.0) != (distance[:, 1:] < 0.0)
            crossed: npt.NDArray[np.bool_] = np.any(changes & ~np.isnan(distance[:, :-1] + distance[:, 1:]), axis=1)
        nearest = np.searchsorted(tested, np.arange(len(points))).clip(0, len(tested) - 1)
        return np.asarray(crossed[nearest], dtype=np.bool_)

    return hides
