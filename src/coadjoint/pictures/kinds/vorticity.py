"""Vorticity of a fluid with a matrix state: a map of the sphere by a projection, or the square of the torus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.curves import VIEW, Globe, at_one_time, unit_vectors, view_frame
from coadjoint.pictures.kinds.spectra import fluid_of
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour_bar, ink, plain_axes, thickness
from coadjoint.systems.matrices.fluid_system import FluidSystem, large_scales
from coadjoint.validation import read_choice, read_integer, read_number, read_positive

Floats = npt.NDArray[np.float64]

PART_TITLES = {
    "all": "{}",
    "large": "{}, large scales",
    "small": "{}, small scales",
    "potential": "potential vorticity",
    "stream": "stream function",
    "carried": "carried field",
}
"""Titles of the parts, with the name of the field that is shown."""
COLUMNS = 720
"""Pixels across a map."""
MIN_GRID, MAX_GRID = 128, 720
"""Smallest and largest number of grid points along a side."""
GRID_SPACING = 30.0
"""Degrees between the grid lines of a map."""

PIXELS = 301  # of the diameter; odd, so that one is the centre

ArrayPair = tuple[Floats, Floats]


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
    layer: int = 0,
) -> Paint:
    """Show the vorticity of a quantized fluid, relative to its frame, at one time, for the first member.

    Of a surface quasi-geostrophic flow it is the buoyancy.

    Parameters
    ----------
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    part : {"all", "large", "small", "potential", "stream", "carried"}
        The vorticity; its large scales, which are constant along streamlines; the remainder; the potential vorticity
        of a quasi-geostrophic flow; the stream function; or the second field, which the fluid carries.
    projection : {"mollweide", "hammer", "outside"}
        Projection of the sphere: equal-area maps, or the view from outside.
    centre : (float, float)
        Longitude and latitude of the centre of the map, in degrees.
    limit : float, optional
        Largest absolute value of the colour scale; by default it covers start, end and this time.
    layer : int
        Number of the layer of a fluid that has several, from 0, the uppermost one.
    """
    fluid, system = fluid_of(drawn), drawn.unforced
    count = system.shape[0] if system.independent_layers else 1
    if not 0 <= read_integer(layer, "layer", 0) < count:
        raise CannotShow(f"layer is {layer}; {system.name} has {count} from 0")
    part = read_choice(part, "part of the vorticity", PART_TITLES)
    across = PROJECTIONS[read_choice(projection, "projection", PROJECTIONS)]
    middle = read_number(centre[0], "longitude of centre"), read_number(centre[1], "latitude of centre")
    if part == "carried" and (len(system.shape) != 3 or system.independent_layers):
        raise CannotShow(f"{drawn.unforced.name} carries no second field; reduced_mhd and passive_scalar do")
    owner = system if system.independent_layers else fluid
    if part == "potential" and "potential_vorticity" not in owner.shown_fields:
        raise CannotShow(f"{drawn.unforced.name} has no potential vorticity; sphere_qg and torus_qg have")
    title = PART_TITLES[part].format(next(iter(owner.shown_fields)))
    title += f", layer {layer}" if count > 1 else ""
    surface, k = fluid.surface, drawn.index_at(at)

    def on_fluid_grid(system: Any, state: Any) -> Floats:
        return part_on_grid(system, fluid, state, part, layer, _shape(fluid.algebra.N, surface))

    first, largest = drawn.evaluate(on_fluid_grid, k)
    size = largest if limit is None else read_positive(limit, "limit")

    def paint(axes: Any) -> Update:
        options, pixels = (_map if surface == "sphere" else _square)(axes, across, middle)
        style = {"cmap": "RdBu_r", "vmin": -size, "vmax": size, "origin": "lower"}
        image = axes.imshow(pixels(first), **options, **style)
        ends = "both" if largest > size else "neither"
        colour_bar(axes, image, title, extend=ends)

        def show(j: int) -> None:
            image.set_data(pixels(on_fluid_grid(drawn.unforced, drawn.state(j))))

        return at_one_time(axes, drawn, title, k, show)

    return paint


def part_on_grid(system: Any, fluid: FluidSystem, state: Any, part: str, layer: int, shape: tuple[int, int]) -> Floats:
    """Evaluate a part of the vorticity, the stream function or the carried field of a state on a grid."""
    if system.independent_layers:
        fields = {"potential": system.matrices, "stream": system.stream_of}
        shown = fields.get(part, system.relative)(state)[layer]
        if part in ("large", "small"):
            large = large_scales(system.stream_of(state)[layer], shown)
            shown = large if part == "large" else shown - large
        return fluid.to_grid(shown, shape, absolute=True)
    if part == "carried":
        # Of constant spectrum: the first of two fields.
        return fluid.to_grid(np.asarray(state)[0], shape, absolute=True)
    W = system.fluid_state(state)
    if part == "potential":
        _, matrices_of, mean = fluid.shown_fields["potential_vorticity"]
        return np.asarray(fluid.to_grid(matrices_of(W), shape, absolute=True) + mean)
    shown = fluid.relative(W)
    if part != "all":
        P = fluid.stream_of(W)
        large = large_scales(P, shown)
        shown = {"stream": P, "large": large, "small": shown - large}[part]
    return fluid.to_grid(shown, shape, absolute=True)


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

        def show(j: int) -> None:
            picture.set_data(pixels(np.asarray(values(drawn.unforced, drawn.state(j)), dtype=np.float64)))

        return at_one_time(axes, drawn, label, k, show)

    return paint


def on_grid(grid: Floats, towards: Floats) -> Floats:
    """Interpolate a grid (a, b) of `sphere_field` to unit vectors (..., 3), linearly in latitude and longitude."""
    rows, columns = grid.shape
    latitude = (np.arcsin(np.clip(towards[..., 2], -1.0, 1.0)) / np.pi + 0.5) * (rows - 1)
    longitude = np.arctan2(towards[..., 1], towards[..., 0]) / (2.0 * np.pi) * columns
    i = np.clip(np.floor(latitude).astype(np.int64), 0, max(rows - 2, 0))
    j = np.floor(longitude).astype(np.int64)
    up, along = latitude - i, longitude - j
    below, above = ((1.0 - along) * grid[row, j % columns] + along * grid[row, (j + 1) % columns] for row in (i, i + 1))
    interpolated: Floats = (1.0 - up) * below + up * above
    return interpolated


@dataclass(frozen=True)
class Projection:
    """A map of the sphere, in radians from its centre, into an ellipse; invisible points are NaN."""

    half_width: float
    project: Callable[[Floats, Floats], ArrayPair]
    unproject: Callable[[Floats, Floats], ArrayPair]

    def directions(self, columns: int, centre: tuple[float, float]) -> Floats:
        """Return unit vectors of square pixels (rows, columns, 3), lowest row first, NaN outside; centre in degrees."""
        rows = round(columns / self.half_width)
        x = self.half_width * ((2 * np.arange(columns) + 1) / columns - 1)
        x, y = np.meshgrid(x, (2 * np.arange(rows) + 1) / rows - 1)
        inside = (x / self.half_width) ** 2 + y**2 <= 1.0
        vectors = np.full((*x.shape, 3), np.nan)
        vectors[inside] = unit_vectors(*self.unproject(x[inside], y[inside])) @ turned(centre)
        return vectors

    def line(self, longitude: Floats, latitude: Floats, centre: tuple[float, float]) -> ArrayPair:
        """Project a line on the sphere, with NaN where it crosses an edge of the map."""
        vectors = unit_vectors(longitude, latitude) @ turned(centre).T
        across = np.arctan2(vectors[:, 1], vectors[:, 0])
        x, y = self.project(across, np.arcsin(np.clip(vectors[:, 2], -1.0, 1.0)))
        # Tested by the angle, since near the poles the edges of a map are close to each other.
        crosses = np.append(np.abs(np.diff(across)) > np.pi, False)
        return np.where(crosses, np.nan, x), y


def turned(centre: tuple[float, float]) -> Floats:
    """Return the rotation whose rows are the axes of the map: towards its centre, to the right, and upward."""
    return np.roll(view_frame(centre), 1, axis=0)


def _map_of_matplotlib(name: str) -> Projection:
    """Return an equal-area map of the whole sphere, which is larger in Matplotlib by the square root of two."""

    def transform() -> Any:
        from matplotlib.projections import get_projection_class

        return getattr(get_projection_class(name), f"{name.capitalize()}Transform")(1)

    def project(longitude: Floats, latitude: Floats) -> ArrayPair:
        x, y = transform().transform(np.column_stack([longitude, latitude])).T / np.sqrt(2)
        return x, y

    def unproject(x: Floats, y: Floats) -> ArrayPair:
        longitude, latitude = transform().inverted().transform(np.sqrt(2) * np.column_stack([x, y])).T
        return longitude, latitude

    return Projection(2.0, project, unproject)


def _outside_project(longitude: Floats, latitude: Floats) -> ArrayPair:
    x, y, z = np.moveaxis(unit_vectors(longitude, latitude), -1, 0)
    return np.where(x >= 0.0, y, np.nan), np.where(x >= 0.0, z, np.nan)


def _outside_unproject(x: Floats, y: Floats) -> ArrayPair:
    return np.arctan2(x, np.sqrt(np.maximum(1 - x**2 - y**2, 0.0))), np.arcsin(y)


PROJECTIONS = {
    "mollweide": _map_of_matplotlib("mollweide"),
    "hammer": _map_of_matplotlib("hammer"),
    "outside": Projection(1.0, _outside_project, _outside_unproject),
}

"""Mollweide and Hammer are equal-area maps of the whole sphere; "outside" is the orthographic view."""
