"""Path of a body axis on the sphere of directions in space."""

from __future__ import annotations

from typing import Any

from coadjoint.pictures.globe import Globe, view_of
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import Paint, kind
from coadjoint.pictures.spatial import axis_in_space
from coadjoint.pictures.style import INK, colour, key


@kind("body axis")
def body_axis(
    drawn: PlottedRun, axis: Any = 2, up: Any = None, vertical: str = "", view: tuple[float, float] | None = None
) -> Paint:
    """Show where a body axis points in space; needs a run with attitude.

    Parameters
    ----------
    axis : int or array_like
        Number of the axis, 0 to 2, or a direction in the body.
    up : sequence of three ints or str, optional
        Coordinates of a body vector that is constant in space; it points up in the picture.
    vertical : str
        Label of that vector.
    view : (float, float), optional
        Direction of view in degrees: around the vertical, and above the horizon. By default from the side of the path.
    """
    drawn = drawn.between
    path, name = axis_in_space(drawn, axis, up)

    def paint(axes: Any) -> None:
        globe = Globe(axes, ("$X$", "$Y$", f"$Z$\n{vertical}" if vertical else "$Z$"), view or view_of(path[0]))
        several = len(path) > 1
        for m, own in enumerate(path):
            paint_with = colour(m if several else 0)
            globe.path(own[drawn.kept], paint_with, drawn.axis_joined, linewidth=0.9 if several else 1.1)
            globe.mark(own[0], colour(1), label="start" if m == 0 else None)
            globe.mark(own[-1], INK, label="end" if m == 0 else None, marker="s", size=4.0)
        axes.set_title(f"{name} in space", fontsize=9.5, color=INK)
        key(axes, loc="lower right")

    return paint
