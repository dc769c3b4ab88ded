"""Nutation of a body axis: its inclination over its azimuth."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.pictures.kinds.body_axis import axis_in_space
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import Paint, kind
from coadjoint.pictures.style import INK, colour, dots, legend, plain_axes


@kind("nutation")
def nutation(drawn: PlottedRun, axis: Any = 2, up: Any = None, turns: float = 0.5) -> Paint:
    """Show the inclination of a body axis to the vertical over its azimuth, both in degrees; needs attitude.

    Parameters
    ----------
    axis : int or array_like
        Number of the axis, 0 to 2, or a direction in the body.
    up : sequence of three ints or str, optional
        Coordinates of the body vector that is the vertical in space.
    turns : float
        Number of revolutions of the axis after which the curve ends.
    """
    drawn = drawn.refined
    path, name = axis_in_space(drawn, axis, up)

    def paint(axes: Any) -> None:
        truncated = False
        for m, directions in enumerate(path):
            points = directions[drawn.curve_indices]
            azimuth = np.degrees(np.unwrap(np.arctan2(points[:, 1], points[:, 0])))
            azimuth -= azimuth[0]
            inclination = np.degrees(np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2]))
            beyond = np.flatnonzero(np.abs(azimuth) > 360.0 * turns)
            last = int(beyond[0]) if beyond.size else len(azimuth)
            truncated |= bool(beyond.size)
            style: dict[str, Any] = {"linewidth": 1.1} if drawn.axis_joined else dots(len(points))
            axes.plot(azimuth[:last], inclination[:last], color=colour(m), **style)
            start = {"label": "start"} if m == 0 else {}
            axes.plot(azimuth[:1], inclination[:1], "o", markersize=5, color=colour(1), **start)
        axes.invert_yaxis()
        axes.set(xlabel="azimuth [degrees]", ylabel="inclination to the vertical [degrees]")
        axes.set_title(f"nutation of {name}" + (f", for the first {360.0 * turns:g} degrees" if truncated else ""))
        plain_axes(axes)
        axes.title.set_color(INK)
        legend(axes)

    return paint
