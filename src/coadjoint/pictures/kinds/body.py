"""The body in space at one time: a box, with the path of one of its axes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.globe import Globe, view_of
from coadjoint.pictures.kinds.body_axis import axis_in_space
from coadjoint.pictures.paths import PathUpdate
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour, ink, set_title, thickness

Floats = npt.NDArray[np.float64]

BOX_COLOUR = np.array([0.72, 0.80, 0.88])
BOX_SIZE = 0.62
"""Half of the diagonal of the box, in units of the radius of the sphere."""
THINNEST = 0.12
"""Smallest side of the box relative to the longest."""
DEFAULT_SIDES = (0.35, 0.6, 1.0)
"""Sides of the box of a body without principal moments."""
DIRECTION_OF_LIGHT = np.array([0.3, 0.5, 0.81])
"""In the frame of the picture: to the right, upwards, and towards the viewer."""


@kind("body", moves=True)
def body(
    drawn: PlottedRun,
    at: float = 1.0,
    axis: Any = 2,
    up: Any = None,
    vertical: str = "",
    view: tuple[float, float] | None = None,
) -> Paint:
    """Show the body in space at one time, with the path of one of its axes up to then; needs a run with attitude.

    The body is a box with the principal moments of the system, of the first member.

    Parameters
    ----------
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    axis : int or array_like
        Number of the axis, 0 to 2, or a direction in the body.
    up : sequence of three ints or str, optional
        Coordinates of a body vector that is constant in space; it points up in the picture.
    vertical : str
        Label of that vector.
    view : (float, float), optional
        Direction of view in degrees: around the vertical, and above the horizon. By default from the side of the path.
    """
    k, fine = drawn.index_at(at), drawn.refined
    path, name = axis_in_space(fine, axis, up)
    frames = np.stack([axis_in_space(drawn, i, up)[0][0] for i in range(3)], axis=-1)
    if not np.isfinite(frames[k]).all():
        raise CannotShow(f"the first member has failed before t = {drawn.t[k]:g}")
    sides = _sides(drawn.unforced)
    ends = axis_in_space(drawn, axis, up)[0][0]

    def paint(axes: Any) -> Update:
        from matplotlib.collections import PolyCollection

        globe = Globe(axes, ("$X$", "$Y$", f"$Z$\n{vertical}" if vertical else "$Z$"), view or view_of(path[0]))
        title = f"body{drawn.of_member} in space, with {name}"
        trail = PathUpdate(drawn, axes, title)
        curve = path[0][fine.curve_indices]
        lines = globe.path(curve, colour(0), fine.axis_joined)
        end = globe.mark(ends[k], ink(), marker="s", size=4.0)
        trail.add(lines, fine.t[fine.curve_indices], globe.project(curve)[0], end)
        box = PolyCollection([], edgecolors=ink(), linewidths=thickness(0.5), zorder=4)
        axes.add_collection(box, autolim=False)
        (shaft,) = axes.plot([], [], color=colour(1), linewidth=thickness(1.4), zorder=4.5)
        set_title(axes, title)

        def update(j: int) -> None:
            corners, brightness = _visible_faces(sides, frames[j] if np.isfinite(frames[j]).all() else np.eye(3), globe)
            box.set_verts(list(corners))
            box.set_facecolor(brightness[:, None] * BOX_COLOUR)
            flat, depth = globe.project(np.stack([0.0 * ends[j], ends[j]]))
            shaft.set_data(*flat.T)
            shaft.set_zorder(4.5 if depth[1] >= 0.0 else 3.5)
            trail(j)

        update(k)
        return update

    return paint


def _sides(system: Any) -> Floats:
    """Return the half sides of a homogeneous box with the principal moments of a system, scaled to the picture."""
    moments = np.asarray((system.parameters or {}).get("inertia", ()), dtype=np.float64)
    sides = np.array(DEFAULT_SIDES)
    if moments.shape == (3,) and np.all(moments > 0.0):
        # The moment about an axis is the sum of the squares of the other two sides, but for a factor.
        squares = moments.sum() / 2.0 - moments
        sides = np.sqrt(np.maximum(squares, 0.0))
    sides = np.maximum(sides, THINNEST * sides.max())
    return np.asarray(BOX_SIZE * sides / np.linalg.norm(sides))


def _visible_faces(sides: Floats, frame: Floats, globe: Globe) -> tuple[Floats, Floats]:
    """Return the corners (faces, 4, 2) of the visible faces of a box, and their brightness; `frame` has its axes."""
    corners, brightness = [], []
    for i in range(3):
        across, up = frame[:, (i + 1) % 3] * sides[(i + 1) % 3], frame[:, (i + 2) % 3] * sides[(i + 2) % 3]
        for sign in (1.0, -1.0):
            normal = sign * frame[:, i]
            if globe.project(normal)[1] <= 0.0:
                continue
            middle = normal * sides[i]
            face = np.stack([middle + a * across + b * up for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))])
            corners.append(globe.project(face)[0])
            brightness.append(0.55 + 0.45 * max(0.0, float(globe.frame @ normal @ DIRECTION_OF_LIGHT)))
    return np.array(corners), np.array(brightness)
