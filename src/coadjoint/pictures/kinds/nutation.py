"""Nutation of a body axis: its inclination over its azimuth."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.pictures.kinds.body_axis import axis_in_space, declared_vertical
from coadjoint.pictures.paths import MemberColours
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import Paint, kind
from coadjoint.pictures.style import colour, dots, plain_axes, set_title, thickness


@kind("nutation")
def nutation(drawn: PlottedRun, axis: Any = 2, up: Any = None, turns: float = 0.5) -> Paint:
    """Show the inclination of a body axis to the vertical over its azimuth, both in degrees; needs attitude.

    Parameters
    ----------
    axis : int or array_like
        Number of the axis, 0 to 2, or a direction in the body.
    up : sequence of three ints or str, optional
        Coordinates of the body vector that is the vertical in space; by default that of the ready-made system, or else
        the third axis of space.
    turns : float
        Number of revolutions of the axis after which the curve ends.
    """
    saved, drawn = drawn, drawn.refined
    declared, vertical = declared_vertical(drawn)
    path, name = axis_in_space(drawn, axis, declared if up is None else up)
    vertical = "vertical" if up is not None else vertical if declared is not None else "third axis of space"

    def paint(axes: Any) -> None:
        shades = MemberColours(saved)
        truncated = False
        for m, directions in enumerate(path):
            points = directions[drawn.curve_indices]
            azimuth = np.degrees(np.unwrap(np.arctan2(points[:, 1], points[:, 0])))
            azimuth -= azimuth[0]
            inclination = np.degrees(np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2]))
            beyond = np.flatnonzero(np.abs(azimuth) > 360.0 * turns)
            last = int(beyond[0]) if beyond.size else len(azimuth)
            truncated |= bool(beyond.size)
            style: dict[str, Any] = {"linewidth": thickness(1.1)} if drawn.axis_joined else dots(len(points))
            curve = np.stack([azimuth[:last], inclination[:last]], axis=-1)
            axes.plot(*curve.T, color=shades[m], **style)
            axes.plot(azimuth[:1], inclination[:1], "o", markersize=5, color=colour(1))
        axes.invert_yaxis()
        axes.set(xlabel="azimuth [degrees]", ylabel=f"inclination to the {vertical} [degrees]")
        extent = f", for the first {360.0 * turns:g} degrees" if truncated else ""
        set_title(axes, f"nutation of {name}{extent} (dot: start)")
        plain_axes(axes)
        shades.add_bar(axes)

    return paint
