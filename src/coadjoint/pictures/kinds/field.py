"""Fields as colours: in the plane at one time, and along a chain over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour_bar, plain_axes, updating
from coadjoint.validation import read_positive

CELLS = 160  # along an edge; smaller than a line is wide
LEVELS = 21  # odd, so that one band is about zero

MAX_ROWS = 400  # times; as many as pixels of the picture


@kind("field", moves=True)
def field(
    drawn: PlottedRun,
    width: Callable[[Any], float],
    modes: Callable[..., Any] | None = None,
    values: Callable[[Any, Any], Any] | None = None,
    at: float = 0.0,
    label: str = "field",
) -> Paint:
    """Show a sum of modes weighted by the coordinates, or values of a function, at one time for the first member.

    Parameters
    ----------
    width : callable
        Function of the system that returns the width of the square.
    modes : callable
        Function of the system and of positions X, Y, (k, k), that returns the modes, (n, k, k).
    values : callable
        Alternative: function of the system and of a state that returns the values on a grid, (rows, columns), from one
        edge of the square to the other, both included: rows along Y, columns along X.
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    label : str
        Name of the field.
    """
    k, side = drawn.index_at(at), read_positive(width(drawn.unforced), "width")
    if values is not None:
        first, size = drawn.evaluate(values, k)

        def field_at(j: int) -> Any:
            return np.asarray(values(drawn.unforced, drawn.state(j)), dtype=np.float64)

    elif modes is not None:
        edge = np.linspace(0.0, side, CELLS + 1)
        waves = np.asarray(modes(drawn.unforced, *np.meshgrid(edge, edge)))
        if len(waves) != drawn.n:
            raise CannotShow(f"the field has {len(waves)} modes, and the state has {drawn.n} coordinates")

        def field_at(j: int) -> Any:
            return np.tensordot(drawn.x[0, j], waves, axes=1)

        first = field_at(k)
        # A bound on the sum of the modes, so that the scale is the same at all times.
        size = float(np.max(np.abs(drawn.x[0]) @ np.abs(waves).max(axis=(1, 2)))) or 1.0
    else:
        raise TypeError("a field needs its modes, or a function that gives its values")

    def paint(axes: Any) -> Update:
        from matplotlib.ticker import MaxNLocator

        coordinates = [np.linspace(0.0, side, count) for count in first.shape[::-1]]
        style = {"levels": np.linspace(-size, size, LEVELS), "cmap": "RdBu_r"}
        contours = axes.contourf(*coordinates, first, **style)
        colour_bar(axes, contours, label, ticks=MaxNLocator(5))
        plain_axes(axes)
        axes.grid(False)
        axes.set(xlabel="$X$", ylabel="$Y$")
        axes.set_aspect("equal")

        def show(j: int) -> None:
            nonlocal contours
            contours.remove()
            contours = axes.contourf(*coordinates, np.clip(field_at(j), -size, size), **style)

        return updating(axes, lambda j: f"{label}{drawn.of_member} at $t$ = {drawn.t[j]:.4g}", k, show)

    return paint


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
