"""Path of a body through space, with its attitude."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.pictures.kinds.coadjoint_orbit import frame_space
from coadjoint.pictures.paths import MemberColours, PathUpdate
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour, dots, ink, legend, set_title, thickness
from coadjoint.validation import read_integer

MAX_ATTITUDES = 40
"""Largest number of attitudes drawn along the path."""


@kind("path in space", projection="3d", moves=True)
def path_in_space(drawn: PlottedRun, axis: int = 0) -> Paint:
    """Show the position in the group element of SE(3), and a body axis at evenly spaced times.

    Needs the attitude of a system whose group element has a position, such as a body in a fluid.

    Parameters
    ----------
    axis : int
        The body axis drawn, 0 to 2.
    """
    number = read_integer(axis, "axis", 0, 2)
    saved, drawn = drawn, drawn.refined
    g = drawn.attitude
    if g is None or g.shape[-1] != 4:
        raise CannotShow("the run has no group element of SE(3); integrate with attitude=True")
    points = g[:, drawn.curve_indices]
    positions, directions = points[..., :3, 3], points[..., :3, number]

    def paint(axes: Any) -> Update:
        shades, update = MemberColours(saved), PathUpdate(saved, axes, "path of the body in space")
        times = drawn.t[drawn.curve_indices]
        low, high = np.nanmin(positions, axis=(0, 1)), np.nanmax(positions, axis=(0, 1))
        reach = 0.09 * float(np.max(high - low)) or 1.0
        for m, (path, direction) in enumerate(zip(positions, directions, strict=True)):
            style: dict[str, Any] = {"linewidth": thickness(1.2)} if drawn.axis_joined else dots(len(path))
            update.add(axes.plot(*path.T, color=shades[m], **style), times, path)
            k = spread(len(path), MAX_ATTITUDES)
            ends = np.stack([path[k], path[k] + reach * direction[k], np.full((len(k), 3), np.nan)], axis=1)
            label, width = f"body axis {number + 1}", thickness(0.9)
            (strokes,) = axes.plot(*ends.reshape(-1, 3).T, color=colour(1), linewidth=width, label=label)
            update.add([strokes], np.repeat(times[k], 3))
            axes.plot(*path[:1].T, "o", markersize=4, color=ink(), label="start")
            if m == 0:
                legend(axes, loc="upper right")
        middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 0.15 * float(np.max(high - low))) + reach
        frame_space(axes, np.stack([middle - half, middle + half], axis=1), ("$X$", "$Y$", "$Z$"))
        axes.set_box_aspect(tuple(half), zoom=0.93)
        set_title(axes, "path of the body in space")
        return update

    return paint
