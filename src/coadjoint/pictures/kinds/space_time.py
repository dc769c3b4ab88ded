"""Coordinates of a chain over time as colours, for travelling waves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.style import colour_bar, plain_axes

MAX_ROWS = 400  # times; as many as pixels of the picture


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
        colour_bar(axes, mesh, label)
        full_title = (title or f"{label} over {across} and time") + drawn.of_member.replace(" of", ",")
        axes.set(xlabel=across, ylabel="time $t$", title=full_title)
        plain_axes(axes)
        axes.grid(False)

    return paint
