"""Fields and spins in the plane at one time, as colours and arrows, and fields along a chain over time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.curves import at_one_time
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour_bar, plain_axes, setting
from coadjoint.systems.lattices.geometry import has_cell, lattice_positions
from coadjoint.validation import read_choice, read_positive

Floats = npt.NDArray[np.float64]

CELLS_ALONG = 160  # along an edge of a field; smaller than a line is wide
LEVELS = 21  # odd, so that one band is about zero
MAX_ROWS = 400  # times; as many as pixels of the picture
FLAT = ("plane", "side")
SHADES = ("#0072B2", "#8A8A8A", "#D55E00")
"""Colours for down, in the plane, and up; the middle one is dark enough for arrows on white."""

SITES_PER_ROW = 30
"""Largest number of sites in one row; longer chains are folded into rows, like text."""


MAX_ARROWS = 2500
"""Largest number of spins drawn as arrows; more are drawn as colours."""
FLATTEST = 0.3
"""Smallest height of the picture relative to its width."""
DOT = 0.26
"""Diameter of the dots at the sites, in units of the distance between them."""
PIXELS = 720
"""Pixels along the longer side of an image of spins."""
SITE_RADIUS = 0.85
"""Largest distance of a pixel from the spin that colours it."""
SATURATION = 0.8  # of colours of directions; full colours are too loud beside lines


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
        edge = np.linspace(0.0, side, CELLS_ALONG + 1)
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

        return at_one_time(axes, drawn, label, k, show)

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


@kind("spins", moves=True)
def spins(drawn: PlottedRun, at: float = 1.0, seen: str = "plane") -> Paint:
    """Show the spins of a lattice at one time, for the first member.

    Of more than 2500 spins (50 x 50), colours alone show the directions: hues those in the plane, lightness the
    component perpendicular to it.

    Parameters
    ----------
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    seen : {"plane", "side"}
        "plane": arrows show the first two components, and colours the third. "side": arrows show the first and the
        third component, and colours the second.
    """
    n = drawn.n
    if n % 3:
        raise CannotShow(f"the state has {n} coordinates, which are not spins of three components")
    layout = drawn.unforced.layout or drawn.unforced.parameters or {}
    lattice = layout.get("lattice")
    positions = site_positions(lattice, layout.get("shape"), n // 3)
    if len(positions) != n // 3:
        raise CannotShow(f"the lattice has {len(positions)} sites, and there are {n // 3} spins")
    row = sites_of_row(lattice, n // 3)
    arrangement = "" if row == n // 3 else f"\nrows of {row} sites, the first one above"
    if n > 3 and row == n // 3 and lattice is None:
        arrangement = "\non a circle, since the lattice is not known"
    flat, out = ((0, 1), 2) if read_choice(seen, "way to see spins", FLAT) == "plane" else ((0, 2), 1)
    k = drawn.index_at(at)
    size = float(np.linalg.norm(drawn.x[0, k].reshape(-1, 3), axis=1).max()) or 1.0
    coloured = n // 3 > MAX_ARROWS

    def components(j: int) -> Floats:
        S = drawn.x[0, j].reshape(-1, 3) / size
        return S[:, [*flat, out]].T

    arrows = "" if coloured else f": arrows $(S_{flat[0] + 1}, S_{flat[1] + 1})$"

    def paint(axes: Any) -> Update:
        show = (_draw_colours if coloured else _draw_arrows)(axes, positions, components(k), flat, out)
        low, high = positions.min(axis=0) - 0.8, positions.max(axis=0) + 0.8
        # Single rows have room for a colour bar.
        lacking = max(0.0, FLATTEST * (high[0] - low[0]) - (high[1] - low[1]))
        low, high = low - [0.0, 0.5 * lacking], high + [0.0, 0.5 * lacking]
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[])
        axes.set_aspect("equal")
        axes.spines[:].set_visible(False)
        axes.grid(False)
        return at_one_time(axes, drawn, "spins", k, lambda j: show(components(j)), arrows + arrangement)

    return paint


Show = Callable[[Floats], None]


def _draw_arrows(axes: Any, positions: Floats, S: Floats, flat: tuple[int, int], out: int) -> Show:
    """Draw dots and arrows in the colour of the third of the components, (3, sites)."""
    from matplotlib.collections import EllipseCollection
    from matplotlib.colors import LinearSegmentedColormap

    shades = LinearSegmentedColormap.from_list("out of the plane", SHADES)
    # All sizes are in units of the distance between sites, so that arrows keep their shape.
    style = {"angles": "xy", "scale_units": "xy", "units": "xy", "scale": 1.05, "pivot": "mid", "cmap": shades}
    shape = {"width": 0.09, "headwidth": 4.0, "headlength": 4.0, "headaxislength": 3.5, "minlength": 0.0}
    arrows = axes.quiver(*positions.T, *S, clim=(-1.0, 1.0), zorder=3, **shape, **style)
    dot = np.full(len(positions), DOT)
    places: dict[str, Any] = {"units": "xy", "offsets": positions, "offset_transform": axes.transData, "cmap": shades}
    dots = EllipseCollection(dot, dot, np.zeros(len(positions)), linewidth=0.0, zorder=2, **places)
    dots.set_array(S[2])
    dots.set_clim(-1.0, 1.0)
    axes.add_collection(dots, autolim=False)
    colour_bar(axes, arrows, f"$S_{out + 1}$ over the largest $|S|$")

    def show(S: Floats) -> None:
        arrows.set_UVC(*S)
        dots.set_array(S[2])

    return show


def _draw_colours(axes: Any, positions: Floats, S: Floats, flat: tuple[int, int], out: int) -> Show:
    """Draw an image of the colours of the nearest spins, with a disc as key."""
    from scipy.spatial import KDTree

    low, high = positions.min(axis=0) - 0.5, positions.max(axis=0) + 0.5
    pixel = float(np.max(high - low)) / PIXELS
    x, y = (np.arange(low[i] + 0.5 * pixel, high[i], pixel) for i in range(2))
    distance, nearest = KDTree(positions).query(np.stack(np.meshgrid(x, y), axis=-1))
    outside = distance > SITE_RADIUS

    def image(S: Floats) -> Floats:
        pixels = direction_colours(S)[nearest]
        pixels[outside] = 1.0
        return pixels

    extent = (low[0], low[0] + pixel * len(x), low[1], low[1] + pixel * len(y))
    picture = axes.imshow(image(S), extent=extent, origin="lower", interpolation="nearest")
    key = axes.inset_axes((1.03, 0.72, 0.28, 0.28), label="<colorbar>")
    edge = np.linspace(-1.0, 1.0, 101)
    across, up = np.meshgrid(edge, edge)
    height = np.sqrt(np.maximum(1.0 - across**2 - up**2, 0.0))
    disc = direction_colours(np.stack([across.ravel(), up.ravel(), height.ravel()])).reshape(101, 101, 3)
    disc[across**2 + up**2 > 1.0] = 1.0
    key.imshow(disc, extent=(-1, 1, -1, 1), origin="lower")
    key.set(xticks=[], yticks=[])
    key.spines[:].set_visible(False)
    key.grid(False)
    key.set_xlabel(f"$S_{flat[0] + 1}$")
    key.set_ylabel(f"$S_{flat[1] + 1}$", rotation=0.0, labelpad=6.0)
    key.yaxis.set_label_position("right")
    note = f"white: $S_{out + 1}$ up\nblack: down"
    axes.text(1.03, 0.6, note, transform=axes.transAxes, va="top", fontsize=setting("legend.fontsize"))

    def show(S: Floats) -> None:
        picture.set_data(image(S))

    return show


def direction_colours(S: Floats) -> Floats:
    """Return colours (k, 3) of vectors (3, k): hue of the first two components, lightness of the third."""
    hue = np.arctan2(S[1], S[0]) / (2.0 * np.pi)
    lightness = 0.5 + 0.5 * np.clip(S[2], -1.0, 1.0)
    strength = SATURATION * np.minimum(lightness, 1.0 - lightness)
    # The formula of colours by hue, saturation and lightness.
    parts = (np.array([0.0, 8.0, 4.0])[:, None] + 12.0 * hue) % 12.0
    colours: Floats = lightness - strength * np.clip(np.minimum(parts - 3.0, 9.0 - parts), -1.0, 1.0)
    return colours.T


def sites_of_row(lattice: Any, count: int) -> int:
    """Return the number of sites per row of a long chain, ring or graph, which is folded; else `count`."""
    in_plane = has_cell(lattice) and lattice not in ("chain", "ring")
    return count if in_plane or count <= SITES_PER_ROW else math.ceil((2.0 * count) ** 0.5)


def site_positions(lattice: Any, shape: Any, count: int) -> Floats:
    """Return the positions (count, 2) of sites in the plane, cell by cell, along the last axis of `shape` first."""
    # Long chains, rings and general graphs are folded into rows, the first on top; short rings and graphs are circles.
    if lattice == "cubic":
        raise CannotShow("the lattice is three-dimensional, and spins are drawn in a plane")
    row = sites_of_row(lattice, count)
    if row < count:
        site = np.arange(count)
        return np.stack([site % row, -1.4 * (site // row)], axis=-1)
    if not has_cell(lattice) or lattice == "ring" or shape is None:
        turn = 2.0 * np.pi * np.arange(count) / count
        return np.stack([np.sin(turn), np.cos(turn)], axis=-1) * max(1.0, count / 6.0)
    return lattice_positions(lattice, shape)
