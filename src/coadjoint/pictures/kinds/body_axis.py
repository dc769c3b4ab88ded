"""Path of a body axis in space, on the sphere of directions."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.globe import Globe, view_of
from coadjoint.pictures.paths import MemberColours, PathUpdate
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour, ink, legend, set_title
from coadjoint.validation import read_finite, read_integer

Floats = npt.NDArray[np.float64]


@kind("body axis", moves=True)
def body_axis(
    drawn: PlottedRun, axis: Any = 2, up: Any = None, vertical: str = "", view: tuple[float, float] | None = None
) -> Paint:
    """Show the direction of a body axis in space; needs a run with attitude.

    Parameters
    ----------
    axis : int or array_like
        Number of the axis, 0 to 2, or a direction in the body.
    up : sequence of three ints or str, optional
        Coordinates of a body vector that is constant in space, and points up in the picture.
    vertical : str
        Label of that vector.
    view : (float, float), optional
        Direction of view in degrees: around the vertical, and above the horizon. By default from the side of the path.
    """
    saved, drawn = drawn, drawn.refined
    path, name = axis_in_space(drawn, axis, up)

    def paint(axes: Any) -> Update:
        globe = Globe(axes, ("$X$", "$Y$", f"$Z$\n{vertical}" if vertical else "$Z$"), view or view_of(path[0]))
        shades, update = MemberColours(saved), PathUpdate(saved, axes, f"{name} in space")
        several, indices = len(path) > 1, drawn.curve_indices
        for m, points in enumerate(path):
            curve = points[indices]
            lines = globe.path(curve, shades[m], drawn.axis_joined, linewidth=0.9 if several else 1.1)
            globe.mark(points[0], colour(1), label="start" if m == 0 else None)
            end = globe.mark(points[-1], ink(), label="end" if m == 0 else None, marker="s", size=4.0)
            update.add(lines, drawn.t[indices], globe.project(curve)[0], end)
        shades.add_bar(axes)
        set_title(axes, f"{name} in space")
        legend(axes, loc="lower right")
        return update

    return paint


def axis_in_space(drawn: PlottedRun, axis: Any, up: Any) -> tuple[Floats, str]:
    """Return the path of a body axis in space, unit vectors (members, k, 3), and the name of the axis."""
    A = drawn.rotation
    if A is None:
        raise CannotShow("the run has no attitude that is a rotation; integrate with attitude=True")
    if np.ndim(axis):
        vector = read_finite(axis, "axis")
        if vector.shape != (3,) or not vector.any():
            raise ValueError(f"axis is {vector.tolist()}; give the number of an axis, or a direction in the body, (3,)")
        direction, name = vector / np.linalg.norm(vector), "the axis of the body"
    else:
        number = read_integer(axis, "axis", 0, 2)
        direction, name = np.eye(3)[number], f"body axis {number + 1}"
    path = A @ direction
    if up is not None:
        indices = [drawn.index_of(i) for i in up]
        for m in range(len(path)):
            path[m] = path[m] @ _rotation_to_vertical(A[m, 0] @ drawn.x[m, 0, indices]).T
    return path, name


def declared_vertical(drawn: PlottedRun) -> tuple[Any, str]:
    """Return the coordinates of the body vector that a ready-made system draws upward, and its name; None without."""
    pictures = () if drawn.gallery_entry is None else drawn.gallery_entry.pictures
    found = next((picture.options for picture in pictures if picture.kind == "body axis"), {})
    return found.get("up"), str(found.get("vertical", ""))


def _rotation_to_vertical(vertical: Floats) -> Floats:
    """Return the rotation of a vector to the third axis by the smallest angle."""
    size = float(np.linalg.norm(vertical))
    if size == 0.0:
        return np.eye(3)
    u = vertical / size
    if u[2] < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    v = np.array([u[1], -u[0], 0.0])  # u x e3
    hat = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.eye(3) + hat + hat @ hat / (1.0 + u[2])
