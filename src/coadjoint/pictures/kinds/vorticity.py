"""Vorticity of a fluid with a matrix state: a map of the sphere, or the square of the torus."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.fluids import fluid_of, part_on_grid
from coadjoint.pictures.kinds.sphere_field import on_grid
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.projections import PROJECTIONS, Projection
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour_bar, ink, plain_axes, set_title, thickness
from coadjoint.validation import read_choice, read_number, read_positive

Floats = npt.NDArray[np.float64]

PART_TITLES = {
    "all": "vorticity",
    "large": "vorticity, large scales",
    "small": "vorticity, small scales",
    "stream": "stream function",
    "carried": "carried field",
}
COLUMNS = 720
"""Pixels across a map."""
MIN_GRID, MAX_GRID = 128, 720
"""Smallest and largest number of grid points along a side."""
GRID_SPACING = 30.0
"""Degrees between the grid lines of a map."""


def _is_low(drawn: PlottedRun) -> bool:
    """Whether the picture is low: maps of the sphere are, squares of the torus are not."""
    return fluid_of(drawn).surface == "sphere"


@kind("vorticity", low=_is_low, moves=True)
def vorticity(
    drawn: PlottedRun,
    at: float = 1.0,
    part: str = "all",
    projection: str = "mollweide",
    centre: tuple[float, float] = (0.0, 0.0),
    limit: float | None = None,
) -> Paint:
    """Show the vorticity of a quantized fluid at one time, for the first member.

    Parameters
    ----------
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    part : {"all", "large", "small", "stream", "carried"}
        The vorticity; its large scales, which are constant along streamlines; the remainder; the stream function; or
        the second field, which the fluid carries.
    projection : {"mollweide", "hammer", "outside"}
        Projection of the sphere: equal-area maps, or the view from outside.
    centre : (float, float)
        Longitude and latitude of the centre of the map, in degrees.
    limit : float, optional
        Largest absolute value of the colour scale; by default it covers start, end and this time.
    """
    fluid = fluid_of(drawn)
    part = read_choice(part, "part of the vorticity", PART_TITLES)
    across = PROJECTIONS[read_choice(projection, "projection", PROJECTIONS)]
    middle = read_number(centre[0], "longitude of centre"), read_number(centre[1], "latitude of centre")
    if part == "carried" and len(drawn.unforced.shape) != 3:
        raise CannotShow(f"{drawn.unforced.name} carries no second field; reduced_mhd and passive_scalar do")
    surface, k = fluid.surface, drawn.index_at(at)

    def on_fluid_grid(system: Any, state: Any) -> Floats:
        return part_on_grid(fluid, state, part, _shape(fluid.algebra.N, surface))

    first, largest = drawn.evaluate(on_fluid_grid, k)
    size = largest if limit is None else read_positive(limit, "limit")

    def paint(axes: Any) -> Update:
        options, pixels = (_map if surface == "sphere" else _square)(axes, across, middle)
        style = {"cmap": "RdBu_r", "vmin": -size, "vmax": size, "origin": "lower"}
        image = axes.imshow(pixels(first), **options, **style)
        ends = "both" if largest > size else "neither"
        colour_bar(axes, image, PART_TITLES[part], extend=ends)
        title = set_title(axes, _title(drawn, part, k))

        def update(j: int) -> None:
            image.set_data(pixels(on_fluid_grid(drawn.unforced, drawn.state(j))))
            title.set_text(_title(drawn, part, j))

        return update

    return paint


def _title(drawn: PlottedRun, part: str, k: int) -> str:
    return f"{PART_TITLES[part]}{drawn.of_member} at $t$ = {drawn.t[k]:.4g}"


def _shape(N: int, surface: str) -> tuple[int, int]:
    """Return the size of a grid that is fine enough for the picture: with both poles, or a square."""
    side = min(max(MIN_GRID, 2 * N), MAX_GRID)
    return (side + 1, 2 * side) if surface == "sphere" else (side, side)


Pixels = tuple[dict[str, Any], Callable[[Floats], Floats]]
"""Options of `imshow`, and the function from grid values to pixels."""


def _map(axes: Any, across: Projection, centre: tuple[float, float]) -> Pixels:
    wide = across.half_width
    towards = across.directions(COLUMNS, centre)
    edge = np.linspace(0.0, 2 * np.pi, 361)
    axes.plot(wide * np.cos(edge), np.sin(edge), color=ink(), linewidth=thickness(0.6))
    turn, rise = np.radians(np.linspace(-180.0, 180.0, 361)), np.radians(np.linspace(-90.0, 90.0, 181))
    lines = {"color": ink(), "linewidth": thickness(0.3), "alpha": 0.4}
    for latitude in np.arange(-90.0 + GRID_SPACING, 89.0, GRID_SPACING):
        axes.plot(*across.line(turn, np.full_like(turn, np.radians(latitude)), centre), **lines)
    for longitude in np.arange(-180.0, 179.0, 2 * GRID_SPACING):
        axes.plot(*across.line(np.full_like(rise, np.radians(longitude)), rise, centre), **lines)
    axes.set_aspect("equal")
    axes.axis("off")
    inside = np.isfinite(towards[..., 0])

    def pixels(values: Floats) -> Floats:
        image = np.full(inside.shape, np.nan)
        # rows of the grid go from north to south
        image[inside] = on_grid(values[::-1], towards[inside])
        return image

    return {"extent": (-wide, wide, -1.0, 1.0)}, pixels


def _square(axes: Any, across: Projection, centre: tuple[float, float]) -> Pixels:
    ticks = {0.0: "0", np.pi: r"$\pi$", 2 * np.pi: r"$2\pi$"}
    axes.set_xticks(list(ticks), list(ticks.values()))
    axes.set_yticks(list(ticks), list(ticks.values()))
    axes.set(xlabel="$x$", ylabel="$y$")
    plain_axes(axes)
    axes.grid(False)
    axes.spines[:].set_visible(True)

    def pixels(values: Floats) -> Floats:
        # values at cell centres; the first ones are repeated at the opposite edge
        return np.pad(values.T, (0, 1), mode="wrap")

    return {"extent": (0.0, 2 * np.pi, 0.0, 2 * np.pi), "interpolation": "bilinear"}, pixels
