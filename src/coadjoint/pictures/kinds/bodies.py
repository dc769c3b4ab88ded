"""Bodies in space at one time: one with the path of an axis, or several, as boxes or as the sites of molecules."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.curves import PathUpdate, at_one_time, view_frame
from coadjoint.pictures.kinds.directions import axis_in_space, globe_in_space
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour, ink, set_title, thickness

Floats = npt.NDArray[np.float64]
Shapes = tuple[Callable[[Floats], Floats], Callable[[Floats], tuple[Floats, Floats]], float]
"""Functions of states: centres in the frame of a picture, and polygons with colours of one state; the largest size."""

BOX_COLOUR = np.array([0.72, 0.80, 0.88])
BOX_SIZE = 0.62
"""Half of the diagonal of the box, in units of the radius of the sphere."""
BODY_THINNEST, THINNEST = 0.12, 0.1
"""Smallest side of a box relative to the longest: of one body, and of several."""
DEFAULT_SIDES = (0.35, 0.6, 1.0)
"""Sides of the box of a body without principal moments."""
LIGHT = np.array([0.3, 0.5, 0.81])
"""Direction of the light in the frame of the picture: to the right, upwards, and towards the viewer."""
VIEW = (-60.0, 20.0)
SITE_RADIUS, OTHER_RADIUS = 0.3, 0.18
"""Radius of a site relative to its diameter sigma, and of sites without one relative to the largest."""
CORNERS = 40
MARGIN = 1.08


@kind("body", moves=True)
def body(
    drawn: PlottedRun,
    at: float = 1.0,
    axis: Any = 2,
    up: Any = None,
    vertical: str = "",
    view: tuple[float, float] | None = None,
) -> Paint:
    """Show the body in space at one time, with the path of one of its axes up to then; needs a run with attitude.

    The body is a box with the principal moments of the system, of the first member.

    Parameters
    ----------
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    axis : int or array_like
        Number of the axis from 0 (the first body axis) to 2, or a direction in the body.
    up : sequence of three ints or str, optional
        Coordinates of a body vector that is constant in space; it points up in the picture.
    vertical : str
        Label of that vector.
    view : (float, float), optional
        Direction of view in degrees: around the vertical, and above the horizon. By default from the side of the path.
    """
    k, fine = drawn.index_at(at), drawn.refined
    path, name = axis_in_space(fine, axis, up)
    frames = np.stack([axis_in_space(drawn, i, up)[0][0] for i in range(3)], axis=-1)
    if not np.isfinite(frames[k]).all():
        raise CannotShow(f"the first member has failed before t = {drawn.t[k]:g}")
    sides = _sides(drawn.unforced)
    ends = axis_in_space(drawn, axis, up)[0][0]

    def paint(axes: Any) -> Update:
        from matplotlib.collections import PolyCollection

        globe = globe_in_space(axes, drawn, path[0], up, vertical, view)
        title = f"body{drawn.of_member} in space, with {name}"
        trail = PathUpdate(drawn, axes, title)
        curve = path[0][fine.curve_indices]
        lines = globe.path(curve, colour(0), fine.axis_joined)
        end = globe.mark(ends[k], ink(), marker="s", size=4.0)
        trail.add(lines, fine.t[fine.curve_indices], globe.project(curve)[0], end)
        box = PolyCollection([], edgecolors=ink(), linewidths=thickness(0.5), zorder=4)
        axes.add_collection(box, autolim=False)
        (shaft,) = axes.plot([], [], color=colour(1), linewidth=thickness(1.4), zorder=4.5)
        set_title(axes, title)

        def update(j: int) -> None:
            attitude = frames[j] if np.isfinite(frames[j]).all() else np.eye(3)
            corners, brightness = _visible_faces(globe.frame @ (attitude * sides))
            box.set_verts(list(corners[..., :2]))
            box.set_facecolor(brightness[:, None] * BOX_COLOUR)
            flat, depth = globe.project(np.stack([0.0 * ends[j], ends[j]]))
            shaft.set_data(*flat.T)
            shaft.set_zorder(4.5 if depth[1] >= 0.0 else 3.5)
            trail(j)

        update(k)
        return update

    return paint


def _sides(system: Any) -> Floats:
    moments = np.asarray((system.parameters or {}).get("inertia", ()), dtype=np.float64)
    sides = np.array(DEFAULT_SIDES)
    if moments.shape == (3,) and np.all(moments > 0.0):
        # The moment about an axis is the sum of the squares of the other two sides, but for a factor.
        squares = moments.sum() / 2.0 - moments
        sides = np.sqrt(np.maximum(squares, 0.0))
    sides = np.maximum(sides, BODY_THINNEST * sides.max())
    return np.asarray(BOX_SIZE * sides / np.linalg.norm(sides))


def _visible_faces(edges: Floats) -> tuple[Floats, Floats]:
    """Return corners (3, 4, 3) and brightness of faces of a box, `edges` its half edges in columns, to the viewer."""
    corners, brightness = [], []
    for i in range(3):
        normal = edges[:, i] * (1.0 if edges[2, i] >= 0.0 else -1.0)
        across, up = edges[:, (i + 1) % 3], edges[:, (i + 2) % 3]
        corners.append([normal + a * across + b * up for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))])
        brightness.append(0.55 + 0.45 * max(0.0, float(normal @ LIGHT) / float(np.linalg.norm(normal))))
    return np.array(corners), np.array(brightness)


@kind("bodies", moves=True)
def bodies(drawn: PlottedRun, at: float = 1.0, view: tuple[float, float] = VIEW) -> Paint:
    """Show several bodies at their positions in space at one time, for the first member.

    Molecules have a disc for each site, in a periodic box where their centres are in it. Other bodies are homogeneous
    boxes with their masses and moments of inertia, in the scale of the positions.

    Parameters
    ----------
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    view : (float, float)
        Direction of view in degrees: around the third axis, and above the plane of the first two.
    """
    system, k = drawn.unforced, drawn.index_at(at)
    if not hasattr(system, "positions"):
        raise CannotShow(f"the states of {system.name} have no positions of bodies, as those of co.systems.bodies have")
    if not np.isfinite(drawn.x[0]).all():
        raise CannotShow(f"the first member has failed before t = {drawn.t[-1]:g}")
    frame = view_frame(view)
    centres, polygons, size = (_sites if hasattr(system, "tables") else _boxes)(system, frame)
    flat = centres(drawn.x[0])[..., :2] if len(drawn.t) else np.zeros((1, 1, 2))
    low, high = (end((0, 1)) for end in (flat.min, flat.max))
    middle, half = (low + high) / 2.0, MARGIN * ((high - low).max() / 2.0 + size)

    def paint(axes: Any) -> Update:
        from matplotlib.collections import PolyCollection

        drawn_shapes = PolyCollection([], edgecolors=ink(), linewidths=thickness(0.4))
        axes.add_collection(drawn_shapes, autolim=False)
        axes.set(xlim=middle[0] + half * np.array([-1, 1]), ylim=middle[1] + half * np.array([-1, 1]))
        axes.set_aspect("equal")
        axes.axis("off")

        def show(j: int) -> None:
            corners, colours = polygons(drawn.x[0, j])
            drawn_shapes.set_verts(list(corners))
            drawn_shapes.set_facecolor(list(map(tuple, colours.tolist())))

        show(k)
        return at_one_time(axes, drawn, "bodies in space", k, show)

    return paint


def _rgb(i: int) -> Floats:
    from matplotlib.colors import to_rgb

    return np.array(to_rgb(colour(i)))


def _sites(system: Any, frame: Floats) -> Shapes:
    """Return discs for the sites of molecules, the far ones first."""
    tables = system.tables
    kinds = np.repeat(np.arange(len(tables.types)), tables.types)
    a, b = np.diag(tables.a), np.diag(tables.b)
    sigma = np.divide(a, b, out=np.zeros_like(a), where=b > 0.0) ** (1.0 / 6.0)
    largest = sigma.max() or 2.0 * float(np.abs(tables.places).max()) or 1.0
    radii = np.where(sigma > 0.0, SITE_RADIUS * sigma, OTHER_RADIUS * largest)
    shades = np.where(sigma[:, None] > 0.0, [_rgb(i) for i in kinds.tolist()], 0.88)
    first = np.cumsum(tables.types) - tables.types
    numbers = [np.tile(np.arange(f, f + n), m) for f, n, m in zip(first, tables.types, tables.molecules, strict=True)]
    types = np.concatenate(numbers)
    radius, shade = radii[types, None, None], shades[types]
    owners = np.repeat(np.arange(int(tables.molecules.sum())), np.repeat(tables.types, tables.molecules))
    turn = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)

    def centres(x: Floats) -> Floats:
        sites = system.sites(x)
        if tables.box.any():
            sites -= tables.box * np.floor(system.positions(x) / tables.box)[..., owners, :]
        return np.asarray(sites @ frame.T)

    def polygons(x: Floats) -> tuple[Floats, Floats]:
        places = centres(x)
        order = np.argsort(places[:, 2], kind="stable")
        discs = places[order, None, :2] + radius[order] * circle
        return discs, shade[order]

    return centres, polygons, float(radii.max())


def _boxes(system: Any, frame: Floats) -> Shapes:
    """Return homogeneous boxes for bodies of any inertia, the far ones first."""
    moments, axes = np.linalg.eigh(np.stack([inertia.tensor for inertia in system.inertias]))
    # The moment about an axis is the sum of the squares of the other two half sides, times a third of the mass.
    squares = 1.5 * (moments.sum(axis=1)[:, None] - 2.0 * moments) / system.masses[:, None]
    sides = np.sqrt(np.maximum(squares, 0.0))
    size = float(sides.max()) or 0.1
    longest = np.where(sides.any(axis=1), sides.max(axis=1), 0.2 * size)[:, None]
    edges = axes * np.maximum(sides, THINNEST * longest)[:, None, :]

    def centres(x: Floats) -> Floats:
        return np.asarray(system.positions(x) @ frame.T)

    def polygons(x: Floats) -> tuple[Floats, Floats]:
        places, faces, colours = centres(x), [], []
        turned = np.einsum("ij,kjl,klm->kim", frame, system.attitudes(x), edges)
        for k in np.argsort(places[:, 2], kind="stable").tolist():
            corners, brightness = _visible_faces(turned[k])
            faces.append((places[k] + corners)[..., :2])
            colours.append(brightness[:, None] * _rgb(k))
        return np.concatenate(faces), np.concatenate(colours)

    return centres, polygons, size
