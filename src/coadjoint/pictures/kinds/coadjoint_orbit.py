"""Orbit in three dimensions on its coadjoint orbit, which is a surface."""

from __future__ import annotations

from typing import Any

from coadjoint.pictures.orbit import draw_orbit
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, kind


@kind("coadjoint orbit", projection="3d")
def coadjoint_orbit(drawn: PlottedRun, view: tuple[float, float] = (-60.0, 30.0)) -> Paint:
    """Show orbits of three coordinates on the level surface of a Casimir.

    Parameters
    ----------
    view : (float, float)
        Direction of view in degrees: around the third axis, and above the plane of the others.
    """
    n, drawn = drawn.n, drawn.between
    if n != 3:
        raise CannotShow(f"the state has {n} coordinates, and a coadjoint orbit is drawn as a surface in 3")

    def paint(axes: Any) -> None:
        labels = [drawn.label(i) for i in range(3)]
        draw_orbit(
            axes, drawn.x[:, drawn.kept], drawn.system.casimirs, labels, drawn.joined, drawn.unexplained_change is None
        )
        axes.view_init(azim=view[0], elev=view[1])  # type: ignore[attr-defined]

    return paint
