"""Directions of body axes and of vectors in the state: on a sphere, as nutation, and along a path through space."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.curves import Globe, MemberColours, PathUpdate, view_of
from coadjoint.pictures.kinds.coadjoint_orbit import frame_space
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour, ink, legend, path_style, plain_axes, set_title, thickness
from coadjoint.validation import read_finite, read_integer

Floats = npt.NDArray[np.float64]

MAX_ATTITUDES = 40
"""Largest number of attitudes drawn along the path."""
SAME_DIRECTION = 1e-4
"""Largest difference of the components of unit vectors that have one label: less than a pixel."""


@kind("body axis", moves=True)
def body_axis(
    drawn: PlottedRun, axis: Any = 2, up: Any = None, vertical: str = "", view: tuple[float, float] | None = None
) -> Paint:
    """Show the direction of a body axis in space; needs a run with attitude.

    Parameters
    ----------
    axis : int or array_like
        Number of the axis from 0 (the first body axis) to 2, or a direction in the body.
    up : sequence of three ints or str, optional
        Coordinates of a body vector that is constant in space, and points up in the picture; the axes of space, X, Y
        and Z, are drawn where they point then, if all members agree.
    vertical : str
        Label of that vector.
    view : (float, float), optional
        Direction of view in degrees: around the vertical, and above the horizon. By default from the side of the path.
    """
    saved, drawn = drawn, drawn.refined
    path, name = axis_in_space(drawn, axis, up)

    def paint(axes: Any) -> Update:
        globe = globe_in_space(axes, drawn, path[0], up, vertical, view)
        shades, update = MemberColours(saved), PathUpdate(saved, axes, f"{name} in space")
        several, indices = len(path) > 1, drawn.curve_indices
        for m, points in enumerate(path):
            curve = points[indices]
            lines = globe.path(curve, shades[m], drawn.axis_joined, linewidth=0.9 if several else 1.1)
            globe.mark(points[0], colour(1), label="start" if m == 0 else None)
            end = globe.mark(points[-1], ink(), label="end" if m == 0 else None, marker="s", size=4.0)
            update.add(lines, drawn.t[indices], globe.project(curve)[0], end)
        shades.add_bar(axes)
        set_title(axes, f"{name} in space")
        legend(axes, loc="lower right")
        return update

    return paint


def axis_in_space(drawn: PlottedRun, axis: Any, up: Any) -> tuple[Floats, str]:
    """Return the path of a body axis in space, unit vectors (members, k, 3), and the name of the axis."""
    A = drawn.rotation
    if A is None:
        raise CannotShow("the run has no attitude that is a rotation; integrate with attitude=True")
    if np.ndim(axis):
        vector = read_finite(axis, "axis")
        if vector.shape != (3,) or not vector.any():
            raise ValueError(f"axis is {vector.tolist()}; give the number of an axis, or a direction in the body, (3,)")
        direction, name = vector / np.linalg.norm(vector), "the axis of the body"
    else:
        number = read_integer(axis, "axis", 0, 2)
        direction, name = np.eye(3)[number], name_of_axis(number)
    return A @ direction @ np.swapaxes(_rotations_upward(drawn, up), 1, 2), name


def name_of_axis(number: int) -> str:
    """Return the name of a body axis by its number from 0."""
    return f"{('first', 'second', 'third')[number]} body axis"


def _rotations_upward(drawn: PlottedRun, up: Any) -> Floats:
    """Return the rotations (members, 3, 3) from space to a picture in which a body vector at the start points up."""
    A = drawn.rotation
    if up is None or A is None:
        return np.broadcast_to(np.eye(3), (len(drawn.x), 3, 3))
    indices = [drawn.index_of(i) for i in up]
    return np.stack([_rotation_to_vertical(A[m, 0] @ drawn.x[m, 0, indices]) for m in range(len(A))])


def globe_in_space(axes: Any, drawn: PlottedRun, path: Floats, up: Any, vertical: str, view: Any) -> Globe:
    """Draw the sphere of a picture, with the axes of space where they point, and the vector that points up."""
    turned = _rotations_upward(drawn, up)
    directions, names = [np.eye(3)[2]], [vertical or "up"]
    if np.abs(turned - turned[0]).max() < SAME_DIRECTION:
        space = ["$X$", "$Y$", "$Z$"]
        at_pole = [i for i in range(3) if turned[0, 2, i] > 1.0 - SAME_DIRECTION]
        for i in at_pole:
            space[i] += f"\n{vertical}" if vertical else ""
        kept = 0 if at_pole else 1
        directions, names = [*turned[0].T, *directions[:kept]], [*space, *names[:kept]]
    return Globe(axes, names, view or view_of(path), directions=np.array(directions))


def declared_vertical(drawn: PlottedRun) -> tuple[Any, str]:
    """Return the coordinates of the body vector that a ready-made system draws upward, and its name; None without."""
    pictures = () if drawn.gallery_entry is None else drawn.gallery_entry.pictures
    found = next((picture.options for picture in pictures if picture.kind == "body axis"), {})
    return found.get("up"), str(found.get("vertical", ""))


def _rotation_to_vertical(vertical: Floats) -> Floats:
    """Return the rotation of a vector to the third axis by the smallest angle."""
    size = float(np.linalg.norm(vertical))
    if size == 0.0:
        return np.eye(3)
    u = vertical / size
    if u[2] < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    v = np.array([u[1], -u[0], 0.0])  # u x e3
    hat = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.eye(3) + hat + hat @ hat / (1.0 + u[2])


@kind("nutation")
def nutation(drawn: PlottedRun, axis: Any = 2, up: Any = None, turns: float = 0.5) -> Paint:
    """Show the inclination of a body axis to the vertical over its azimuth, both in degrees; needs attitude.

    Parameters
    ----------
    axis : int or array_like
        Number of the axis from 0 (the first body axis) to 2, or a direction in the body.
    up : sequence of three ints or str, optional
        Coordinates of the body vector that is the vertical in space; by default that of the ready-made system, or else
        the third axis of space.
    turns : float
        Number of revolutions of the axis after which the curve ends.
    """
    saved, drawn = drawn, drawn.refined
    declared, vertical = declared_vertical(drawn)
    path, name = axis_in_space(drawn, axis, declared if up is None else up)
    vertical = "vertical" if up is not None else vertical if declared is not None else "third axis of space"

    def paint(axes: Any) -> None:
        shades = MemberColours(saved)
        truncated = False
        for m, directions in enumerate(path):
            points = directions[drawn.curve_indices]
            azimuth = np.degrees(np.unwrap(np.arctan2(points[:, 1], points[:, 0])))
            azimuth -= azimuth[0]
            inclination = np.degrees(np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2]))
            beyond = np.flatnonzero(np.abs(azimuth) > 360.0 * turns)
            last = int(beyond[0]) if beyond.size else len(azimuth)
            truncated |= bool(beyond.size)
            style = path_style(len(points), drawn.axis_joined, 1.1)
            axes.plot(azimuth[:last], inclination[:last], color=shades[m], **style)
            axes.plot(azimuth[:1], inclination[:1], "o", markersize=5, color=colour(1))
        axes.invert_yaxis()
        axes.set(xlabel="azimuth [degrees]", ylabel=f"inclination to the {vertical} [degrees]")
        extent = f", for the first {360.0 * turns:g} degrees" if truncated else ""
        set_title(axes, f"nutation of {name}{extent} (dot: start)")
        plain_axes(axes)
        shades.add_bar(axes)

    return paint


@kind("path in space", projection="3d", moves=True)
def path_in_space(drawn: PlottedRun, axis: int = 0) -> Paint:
    """Show the position in the group element of SE(3), and a body axis at evenly spaced times.

    Needs the attitude of a system whose group element has a position, such as a body in a fluid.

    Parameters
    ----------
    axis : int
        The body axis drawn, from 0 (the first one) to 2.
    """
    number = read_integer(axis, "axis", 0, 2)
    saved, drawn = drawn, drawn.refined
    g = drawn.attitude
    if g is None or g.shape[-1] != 4:
        raise CannotShow("the run has no group element of SE(3); integrate with attitude=True")
    points = g[:, drawn.curve_indices]
    positions, directions = points[..., :3, 3], points[..., :3, number]

    def paint(axes: Any) -> Update:
        shades, update = MemberColours(saved), PathUpdate(saved, axes, "path of the body in space")
        times = drawn.t[drawn.curve_indices]
        low, high = np.nanmin(positions, axis=(0, 1)), np.nanmax(positions, axis=(0, 1))
        reach = 0.09 * float(np.max(high - low)) or 1.0
        for m, (path, direction) in enumerate(zip(positions, directions, strict=True)):
            style = path_style(len(path), drawn.axis_joined, 1.2)
            update.add(axes.plot(*path.T, color=shades[m], **style), times, path)
            k = spread(len(path), MAX_ATTITUDES)
            ends = np.stack([path[k], path[k] + reach * direction[k], np.full((len(k), 3), np.nan)], axis=1)
            label, width = name_of_axis(number), thickness(0.9)
            (strokes,) = axes.plot(*ends.reshape(-1, 3).T, color=colour(1), linewidth=width, label=label)
            update.add([strokes], np.repeat(times[k], 3))
            axes.plot(*path[:1].T, "o", markersize=4, color=ink(), label="start")
            if m == 0:
                legend(axes, loc="upper right")
        middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 0.15 * float(np.max(high - low))) + reach
        frame_space(axes, np.stack([middle - half, middle + half], axis=1), ("$X$", "$Y$", "$Z$"))
        axes.set_box_aspect(tuple(half), zoom=0.93)
        set_title(axes, "path of the body in space")
        return update

    return paint


@kind("directions", moves=True)
def directions(
    drawn: PlottedRun,
    vectors: Mapping[str, Any] | Callable[[int], Mapping[str, Any]],
    axes_named: Sequence[str] = ("$e_1$", "$e_2$", "$e_3$"),
    title: str = "",
    view: tuple[float, float] | None = None,
) -> Paint:
    """Show the directions of vectors of three coordinates.

    If the length of such a vector is a Casimir, the sphere is a coadjoint orbit, or a factor of one.

    Parameters
    ----------
    vectors : mapping of str to three ints or str, or to array_like, shape (3, n), or callable
        Name to coordinates, or to the linear forms whose values are the components; or a function of the dimension that
        returns these.
    axes_named : sequence of three str
        Names of the axes.
    title : str
        Title of the picture.
    view : (float, float), optional
        Direction of view in degrees: around the third axis, and above the plane of the others. By default from the side
        of the paths.
    """
    saved, drawn = drawn, drawn.refined
    named = vectors(drawn.n) if callable(vectors) else vectors
    paths = {name: _unit(_components(drawn, vector)) for name, vector in named.items()}

    def paint(axes: Any) -> Update:
        points = np.concatenate([members.reshape(-1, 3) for members in paths.values()])
        globe = Globe(axes, axes_named, view or view_of(points))
        shades, update = MemberColours(saved), PathUpdate(saved, axes, title or "directions")
        several, indices = len(drawn.x) > 1, drawn.curve_indices
        for i, (name, members) in enumerate(paths.items()):
            for m, path in enumerate(members):
                shade = shades[m] if len(paths) == 1 else colour(i)
                curve = path[indices]
                label = name if m == 0 and len(paths) > 1 else None
                lines = globe.path(curve, shade, drawn.joined, linewidth=0.9 if several else 1.1, label=label)
                globe.mark(path[0], shade, label="start" if i == m == 0 else None, size=3.0 if several else 5.0)
                if lines:
                    update.add(lines, drawn.t[indices], globe.project(curve)[0])
        if len(paths) == 1:
            shades.add_bar(axes)
        set_title(axes, title or "directions")
        legend(axes, loc="lower right")
        return update

    return paint


def _components(drawn: PlottedRun, vector: Any) -> Floats:
    n = drawn.n
    if np.ndim(vector) == 2:
        forms = read_finite(vector, "forms of a vector")
        if forms.shape != (3, n):
            raise CannotShow(f"the vector is made of {forms.shape[1]} coordinates, and the state has {n}")
        return drawn.x @ forms.T
    return drawn.x[..., [drawn.index_of(i) for i in vector]]


def _unit(v: Floats) -> Floats:
    size = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.divide(v, size, out=np.full_like(v, np.nan), where=size > 0.0)
