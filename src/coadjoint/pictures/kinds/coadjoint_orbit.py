"""Orbits in three dimensions on their coadjoint orbit, a level surface of a Casimir."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.pictures.curves import MemberColours, PathUpdate
from coadjoint.pictures.globe import FAR_ALPHA, towards_viewer
from coadjoint.pictures.level_surface import hidden_behind, level_surface
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour, ink, paper, path_style, set_title, setting, symbol

SURFACE_COLOUR = "#B8CCE0"
MAX_COORDINATE = 1e75  # larger coordinates, of members that fail, overflow in the normals of a surface
LABEL_PAD = -2.0  # points; labels closer to the axes than Matplotlib places them
LIGHT_DIRECTION = np.array([0.3, -0.5, 0.81])  # a direction from above and the left


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
    members: npt.NDArray[np.float64],
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

    def hides(points: npt.NDArray[np.float64], space: Any) -> npt.NDArray[np.bool_]:
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


def _surface(casimir: Any, level: float, members: npt.NDArray[np.float64]) -> tuple[Any, Any]:
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


def _box_of(members: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return a box with margins around the orbits."""
    low, high = np.nanmin(members, axis=(0, 1)), np.nanmax(members, axis=(0, 1))
    widest = float(np.max(high - low)) or 1.0
    half = np.maximum(0.7 * (high - low), 0.05 * widest)
    middle = 0.5 * (low + high)
    return np.stack([middle - half, middle + half], axis=1)


def _draw_surface(axes: Any, triangles: npt.NDArray[np.float64]) -> None:
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


def frame_space(axes: Any, box: npt.NDArray[np.float64], names: Sequence[str]) -> None:
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
