"""Orbits in three dimensions on their coadjoint orbit, a level surface of a Casimir, by marching tetrahedra."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.pictures.curves import FAR_ALPHA, MemberColours, PathUpdate, towards_viewer
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour, ink, paper, path_style, set_title, setting, symbol
from coadjoint.short_repr import short
from coadjoint.systems.user_functions import takes_time
from coadjoint.validation import read_finite, read_integer, read_number

Floats = npt.NDArray[np.float64]

SURFACE_COLOUR = "#B8CCE0"
MAX_COORDINATE = 1e75  # larger coordinates, of members that fail, overflow in the normals of a surface
LABEL_PAD = -2.0  # points; labels closer to the axes than Matplotlib places them
LIGHT_DIRECTION = np.array([0.3, -0.5, 0.81])  # a direction from above and the left
TESTED_POINTS = 400  # of a line; each needs values along a ray
RAY_SAMPLES = 32
"""Samples along the ray from a point to the viewer, within the box of the picture."""

# A cube is six tetrahedra around its diagonal, one per order of the axes, so that neighbouring cubes match.
_TETRAHEDRA = np.array(
    [np.cumsum([[0, 0, 0], *(np.eye(3, dtype=int)[list(order)])], axis=0) for order in itertools.permutations(range(3))]
)


@kind("coadjoint orbit", projection="3d", moves=True)
def coadjoint_orbit(drawn: PlottedRun, view: tuple[float, float] = (-60.0, 30.0)) -> Paint:
    """Show orbits of three coordinates on the level surface of a Casimir.

    Parameters
    ----------
    view : (float, float)
        Direction of view in degrees: around the third axis, and above the plane of the others.
    """
    n, saved, drawn = drawn.n, drawn, drawn.refined
    if n != 3:
        raise CannotShow(f"the state has {n} coordinates, and a coadjoint orbit is drawn as a surface in 3")

    def paint(axes: Any) -> Update:
        shades, members = MemberColours(saved), drawn.x[:, drawn.curve_indices]
        on_surface = drawn.unexplained_change is None
        labels = [drawn.label(i) for i in range(3)]
        axes.view_init(azim=view[0], elev=view[1])
        lines, title = draw_orbit(axes, members, drawn.system.casimirs, labels, drawn.joined, on_surface, shades)
        shades.add_bar(axes)
        update = PathUpdate(saved, axes, title)
        for line, path in zip(lines, members, strict=True):
            update.add([line], drawn.t[drawn.curve_indices], path)
        return update

    return paint


def surface_casimir(casimirs: Mapping[str, Any]) -> str | None:
    """Return the name of the Casimir for the level surface: the first polynomial one, else the first invariant."""
    for preferred in (Polynomial, Invariant):
        for name, casimir in casimirs.items():
            if isinstance(casimir, preferred):
                return name
    return None


def draw_orbit(
    axes: Any,
    members: Floats,
    casimirs: Mapping[str, Any],
    names: Sequence[str] = ("$x_1$", "$x_2$", "$x_3$"),
    joined: bool = True,
    on_surface: bool = True,
    shades: MemberColours | None = None,
) -> tuple[list[Any], str]:
    """Draw orbits (members, k, 3) and the level surface of a Casimir; return their lines, and the title."""
    # The surface passes through the first point of the first orbit. Parts of orbits behind it are faint.
    from coadjoint.pictures.artists import FadingLine

    name = surface_casimir(casimirs)
    members = np.where(np.abs(members) < MAX_COORDINATE, members, np.nan)
    box = _box_of(members)
    subject = "orbit" if joined else "points of the orbit"
    title = f"{subject} (no Casimir is known)"
    triangles = np.empty((0, 3, 3))
    if name is not None:
        casimir = casimirs[name]
        level = float(casimir(members[0, 0]))
        triangles, box = _surface(casimir, level, members)
        title = f"{subject} on the level surface of {symbol(name)}"
        if not len(triangles):
            title = f"{subject}; the level set of {symbol(name)} is no surface"
        elif len(members) > 1:
            title = f"orbits, and the level surface of {symbol(name)} of the first"
        elif not on_surface:
            title = f"{subject}, and the level surface of {symbol(name)} at its start"
    if len(triangles):
        _draw_surface(axes, triangles)

    def hides(points: Floats, space: Any) -> npt.NDArray[np.bool_]:
        if not len(triangles):
            return np.zeros(len(points), dtype=np.bool_)
        return hidden_behind(points, towards_viewer(space), casimir, level, box, getattr(casimir, "period", 0.0))

    fading: Any = {"faint": FAR_ALPHA, "hollow": paper()}
    several, lines = len(members) > 1, []
    for m, orbit in enumerate(members):
        shade = colour(0) if shades is None else shades[m]
        style = path_style(len(orbit), joined, 0.9 if several else 1.1)
        line = FadingLine(orbit, hides, **fading, color=shade, zorder=5, **style)
        mark: dict[str, Any] = {"marker": "o", "markersize": 2.5 if several else 4.0, "linestyle": "none"}
        start = FadingLine(orbit[:1], hides, color=shade if several else colour(1), zorder=6, **mark, **fading)
        for artist in (line, start):
            axes.add_line(artist)
        lines.append(line)
    frame_space(axes, box, names)
    set_title(axes, title + "\n(dot: start)")
    return lines, title


def _surface(casimir: Any, level: float, members: Floats) -> tuple[Any, Any]:
    """Return the triangles of a level surface and its box: the complete surface if compact, else near the orbits."""
    period = getattr(casimir, "period", 0.0)
    radius = 1.1 * float(np.nanmax(np.linalg.norm(members, axis=-1))) or 1.0
    cube = np.array([[-radius, radius]] * 3)
    triangles = level_surface(casimir, level, cube, period=period)
    reach = float(np.max(np.abs(triangles), initial=0.0))
    # A surface that reaches the edge of the cube is treated as noncompact.
    if reach < radius * (1.0 - 2.0**-20):
        return triangles, cube
    box = _box_of(members)
    return level_surface(casimir, level, box, period=period), box


def _box_of(members: Floats) -> Floats:
    low, high = np.nanmin(members, axis=(0, 1)), np.nanmax(members, axis=(0, 1))
    widest = float(np.max(high - low)) or 1.0
    half = np.maximum(0.7 * (high - low), 0.05 * widest)
    middle = 0.5 * (low + high)
    return np.stack([middle - half, middle + half], axis=1)


def _draw_surface(axes: Any, triangles: Floats) -> None:
    from matplotlib.colors import to_rgb
    from matplotlib.tri import Triangulation

    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    valid = size[:, 0] > 0.0
    triangles, normals = triangles[valid], normals[valid] / size[valid]
    if not len(triangles):
        return
    # Triangles have no orientation, so both sides are lit alike.
    brightness = 0.72 + 0.28 * np.abs(normals @ LIGHT_DIRECTION)
    faces = np.column_stack([brightness[:, None] * np.array(to_rgb(SURFACE_COLOUR)), np.full(len(triangles), 0.35)])
    x, y, z = triangles.reshape(-1, 3).T
    mesh = Triangulation(x, y, np.arange(len(x)).reshape(-1, 3))
    surface = axes.plot_trisurf(mesh, z, linewidth=0.0, shade=False, zorder=1)
    surface.set(facecolors=faces, edgecolors="none", antialiased=True, rasterized=True)


def frame_space(axes: Any, box: Floats, names: Sequence[str]) -> None:
    """Set limits (the box, (3, 2)), labels and thin lines of three-dimensional axes."""
    axes.computed_zorder = False
    axes.set_proj_type("ortho")
    axes.set(xlim=box[0], ylim=box[1], zlim=box[2])
    axes.set_box_aspect((1, 1, 1), zoom=0.93)  # the layout ignores labels in space
    for axis, name in zip((axes.xaxis, axes.yaxis, axes.zaxis), names, strict=True):
        # Labels that follow the axes may be upside down.
        axis.set_rotate_label(False)
        axis.set_label_text(name, fontsize=setting("axes.labelsize"), rotation=0.0)
        axis.labelpad = LABEL_PAD
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis._axinfo["grid"].update(color=setting("grid.color"), linewidth=setting("grid.linewidth"))
        axis.line.set(linewidth=setting("axes.linewidth"), color=ink())
        axis.set_major_locator(_few_ticks())
    size, width = setting("xtick.labelsize"), setting("xtick.major.width")
    axes.tick_params(labelsize=size, width=width, pad=0, colors=setting("xtick.color"))


def _few_ticks() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(4)


@suggest_keywords
def level_surface(
    function: Callable[[Any], Any], level: float, box: npt.ArrayLike, cells: int = 36, period: float = 0.0
) -> Floats:
    """Return triangles of the surface function(x) = level inside a box.

    Parameters
    ----------
    function : Polynomial, Invariant or callable
        A function of x, shape (3,).
    level : float
        The value of the function on the surface.
    box : array_like, shape (3, 2)
        Smallest and largest value of each coordinate.
    cells : int
        Cells along each edge of the box.
    period : float
        Positive for a multivalued function, which is defined modulo this number: the surface has the values `level`
        plus any multiple of it.

    Returns
    -------
    ndarray, shape (triangles, 3, 3)
        Corners; empty if the surface does not meet the box.

    Raises
    ------
    ValueError
        The box is not (3, 2) with positive edges.

    Examples
    --------
    >>> sphere = level_surface(Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1}), 1.0, [(-1.2, 1.2)] * 3, cells=12)
    >>> bool(np.all(np.abs(np.linalg.norm(sphere, axis=2) - 1) < 0.02))
    True
    """
    takes_time(function, "function")
    edges, level, period = read_finite(box, "box"), read_number(level, "level"), read_number(period, "period")
    cells = read_integer(cells, "cells")
    if edges.shape != (3, 2) or not np.all(edges[:, 1] > edges[:, 0]):
        raise ValueError(f"box is {short(edges.tolist())}; it must be three pairs (smallest, largest)")
    axes = [np.linspace(low, high, cells + 1) for low, high in edges.tolist()]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = values_at(function, points) - level
    corner = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    triangles = []
    for tetrahedron in _TETRAHEDRA:
        where = tuple(np.moveaxis(corner + tetrahedron, -1, 0))
        triangles += _cut(points[where], _unwrap(values[where], period))
    surface = np.concatenate(triangles)
    # Drop triangles that degenerate to points, at grid corners on the surface.
    return surface[np.any(surface != surface[:, :1], axis=(1, 2))]


def values_at(function: Callable[[Any], Any], points: Floats) -> Floats:
    """Evaluate a function at points (..., 3); NaN where it is undefined."""
    if isinstance(function, Polynomial):
        total = np.zeros(points.shape[:-1])
        for exponents, coefficient in function.monomials.items():
            total = total + float(coefficient) * np.prod(points ** np.array(exponents), axis=-1)
        return total

    def value(x: Floats) -> float:
        try:
            return float(function(x))
        except (ArithmeticError, ValueError):  # such as a logarithm of zero or a division by zero
            return float("nan")

    with np.errstate(all="ignore"):
        return np.apply_along_axis(value, -1, points)


def _unwrap(values: Floats, period: float) -> Floats:
    """Shift values by periods so that they vary by less than half a period within a tetrahedron."""
    if period <= 0.0:
        return values
    with np.errstate(over="ignore", invalid="ignore"):
        first = values[:, :1] - period * np.rint(values[:, :1] / period)
        step = values - values[:, :1]
        step = step - period * np.rint(step / period)
        # Near the axis of a multivalued function a cell is too large to separate the branches.
        return np.where(np.max(np.abs(step), axis=1, keepdims=True) < 0.4 * period, first + step, np.nan)


def _cut(corners: Floats, values: Floats) -> list[Floats]:
    """Return the triangles in which tetrahedra (m, 4, 3) intersect the zero level of values (m, 4)."""
    finite = np.all(np.isfinite(values), axis=1)
    above = np.sum(values > 0.0, axis=1)
    order = np.argsort(values, axis=1)
    corners, values = np.take_along_axis(corners, order[..., None], axis=1), np.take_along_axis(values, order, axis=1)

    def crossing(chosen: npt.NDArray[np.bool_], below: int, over: int) -> Floats:
        low, high = values[chosen, below, None], values[chosen, over, None]
        share = low / (low - high)
        return corners[chosen, below] + share * (corners[chosen, over] - corners[chosen, below])

    triangles = []
    for count, sets in (
        (1, [(0, 3, 1, 3, 2, 3)]),
        (3, [(0, 1, 0, 2, 0, 3)]),
        (2, [(0, 2, 0, 3, 1, 2), (1, 2, 0, 3, 1, 3)]),
    ):
        chosen = finite & (above == count)
        for a, b, c, d, e, f in sets:
            triangles.append(np.stack([crossing(chosen, a, b), crossing(chosen, c, d), crossing(chosen, e, f)], axis=1))
    return triangles


def hidden_behind(
    points: Floats, towards: Floats, function: Callable[[Any], Any], level: float, box: Floats, period: float = 0.0
) -> npt.NDArray[np.bool_]:
    """Return whether the surface function(x) = level in a box (3, 2) hides points (k, 3) from a viewer."""
    tested = np.unique(np.linspace(0, len(points) - 1, min(len(points), TESTED_POINTS)).round().astype(np.int64))
    start = points[tested]
    with np.errstate(all="ignore"):
        exits = np.where(towards > 0.0, box[:, 1] - start, box[:, 0] - start) / towards
        length = np.nanmin(np.where(np.isfinite(exits), exits, np.nan), axis=1, initial=np.inf)
        shares = (np.arange(RAY_SAMPLES) + 1.0) / RAY_SAMPLES
        rays = start[:, None] + (np.maximum(length, 0.0)[:, None] * shares)[..., None] * towards
        distance = values_at(function, rays) - level
        if period > 0.0:
            distance = distance - period * np.rint(distance / period)
            distance[np.abs(distance) > 0.25 * period] = np.nan
        # A sample may lie on the surface.
        changes = (distance[:, :-1] < 0.0) != (distance[:, 1:] < 0.0)
        crossed: npt.NDArray[np.bool_] = np.any(changes & ~np.isnan(distance[:, :-1] + distance[:, 1:]), axis=1)
    nearest = np.searchsorted(tested, np.arange(len(points))).clip(0, len(tested) - 1)
    return np.asarray(crossed[nearest], dtype=np.bool_)
