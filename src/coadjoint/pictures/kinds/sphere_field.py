"""Function on the sphere computed from the state, such as vorticity on a planet, seen from outside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.globe import VIEW, Globe
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import Paint, Update, kind
from coadjoint.pictures.style import colour_bar, set_title

Floats = npt.NDArray[np.float64]

PIXELS = 301  # of the diameter; odd, so that one is the centre


@kind("sphere field", moves=True)
def sphere_field(
    drawn: PlottedRun,
    values: Callable[[Any, Any], Any],
    at: float = 0.0,
    view: tuple[float, float] = VIEW,
    label: str = "vorticity",
) -> Paint:
    """Show a function on the sphere at one time, for the first member.

    Parameters
    ----------
    values : callable
        Function of the system and of a state that returns the values on a grid, (a, b): rows from the south pole to the
        north pole, both included, evenly in latitude; columns evenly in longitude from 0, without 2 pi.
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    view : (float, float)
        Direction of view: longitude and latitude in degrees.
    label : str
        Name of the function.
    """
    k = drawn.index_at(at)
    grid, size = drawn.evaluate(values, k)

    def paint(axes: Any) -> Update:
        globe = Globe(axes, ("$X$", "$Y$", "$Z$"), view)
        edge = np.linspace(-1.0, 1.0, PIXELS)
        across, up = np.meshgrid(edge, edge)
        height = 1.0 - across**2 - up**2
        towards = np.stack([across, up, np.sqrt(np.maximum(height, 0.0))], axis=-1) @ globe.frame

        def pixels(values: Floats) -> Floats:
            return np.where(height >= 0.0, on_grid(values, towards), np.nan)

        picture = axes.imshow(
            pixels(grid), extent=(-1, 1, -1, 1), origin="lower", cmap="RdBu_r", vmin=-size, vmax=size, zorder=0.5
        )
        axes.set(xlim=(-1.42, 1.42), ylim=(-1.42, 1.42))
        colour_bar(axes, picture, label)
        title = set_title(axes, f"{label}{drawn.of_member} at $t$ = {drawn.t[k]:.4g}")

        def update(j: int) -> None:
            picture.set_data(pixels(np.asarray(values(drawn.unforced, drawn.state(j)), dtype=np.float64)))
            title.set_text(f"{label}{drawn.of_member} at $t$ = {drawn.t[j]:.4g}")

        return update

    return paint


def on_grid(grid: Floats, towards: Floats) -> Floats:
    """Interpolate a grid (a, b) of `sphere_field` to unit vectors (..., 3), linearly in latitude and longitude.

    Examples
    --------
    >>> float(on_grid(np.array([[-1.0, -1.0], [0.0, 0.0], [1.0, 1.0]]), np.array([0.0, 0.8660254037844386, 0.5])))
    0.333...
    """
    rows, columns = grid.shape
    latitude = (np.arcsin(np.clip(towards[..., 2], -1.0, 1.0)) / np.pi + 0.5) * (rows - 1)
    longitude = np.arctan2(towards[..., 1], towards[..., 0]) / (2.0 * np.pi) * columns
    i = np.clip(np.floor(latitude).astype(np.int64), 0, max(rows - 2, 0))
    j = np.floor(longitude).astype(np.int64)
    up, along = latitude - i, longitude - j
    below, above = ((1.0 - along) * grid[row, j % columns] + along * grid[row, (j + 1) % columns] for row in (i, i + 1))
    interpolated: Floats = (1.0 - up) * below + up * above
    return interpolated
