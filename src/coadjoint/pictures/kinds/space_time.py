"""Coordinates of a chain over time as colours, for travelling waves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.style import plain_axes

MAX_ROWS = 400


@kind("space-time")
def space_time(
    drawn: PlottedRun,
    sites: Callable[[int], Sequence[int]],
    label: str,
    across: str = "site",
    centred: bool = False,
    title: str = "",
) -> Paint:
    """Show coordinates of the first member by colour, sites to the right and time upwards.

    Parameters
    ----------
    sites : callable
        Function of the dimension that returns the coordinates, in the order of the sites.
    label : str
        Name of the coordinates.
    across : str
        Label of the sites.
    centred : bool
        Whether zero is at the middle of the colour scale.
    title : str
        Title of the picture.
    """
    indices = list(sites(drawn.n))
    if len(indices) < 2:
        raise CannotShow("there are fewer than two sites")

    def paint(axes: Any) -> None:
        rows = spread(len(drawn.t), MAX_ROWS)
        values = drawn.x[0][rows][:, indices]
        limits: dict[str, Any] = {"cmap": "viridis"}
        if centred:
            size = float(np.nanmax(np.abs(values))) or 1.0
            limits = {"cmap": "RdBu_r", "vmin": -size, "vmax": size}
        mesh = axes.pcolormesh(
            np.arange(1, len(indices) + 1), drawn.t[rows], values, shading="nearest", rasterized=True, **limits
        )
        bar = axes.figure.colorbar(mesh, ax=axes, shrink=0.8, pad=0.02)
        bar.set_label(label, fontsize=9)
        bar.ax.tick_params(labelsize=8)
        axes.set(xlabel=across, ylabel="time $t$", title=title or f"{label} over {across} and time")
        plain_axes(axes)
        axes.grid(False)

    return paint
