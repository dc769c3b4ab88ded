"""Directions of vectors in the state, as paths on a sphere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.curves import MemberColours, PathUpdate
from coadjoint.pictures.globe import Globe, view_of
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import colour, legend, set_title
from coadjoint.validation import read_finite


@kind("directions", moves=True)
def directions(
    drawn: PlottedRun,
    vectors: Mapping[str, Any],
    axes_named: Sequence[str] = ("$e_1$", "$e_2$", "$e_3$"),
    title: str = "",
    view: tuple[float, float] | None = None,
) -> Paint:
    """Show the directions of vectors of three coordinates.

    If the length of such a vector is a Casimir, the sphere is a coadjoint orbit, or a factor of one.

    Parameters
    ----------
    vectors : mapping of str to three ints or str, or to array_like, shape (3, n)
        Name to coordinates, or to the linear forms whose values are the components.
    axes_named : sequence of three str
        Names of the axes.
    title : str
        Title of the picture.
    view : (float, float), optional
        Direction of view in degrees: around the third axis, and above the plane of the others. By default from the side
        of the paths.
    """
    saved, drawn = drawn, drawn.refined
    paths = {name: _unit(_components(drawn, vector)) for name, vector in vectors.items()}

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


def _components(drawn: PlottedRun, vector: Any) -> npt.NDArray[np.float64]:
    n = drawn.n
    if np.ndim(vector) == 2:
        forms = read_finite(vector, "forms of a vector")
        if forms.shape != (3, n):
            raise CannotShow(f"the vector is made of {forms.shape[1]} coordinates, and the state has {n}")
        return drawn.x @ forms.T
    if any(isinstance(i, int) and i >= n for i in vector):
        raise CannotShow(f"the vector has the coordinates {list(vector)}, and the state has {n}")
    return drawn.x[..., [drawn.index_of(i) for i in vector]]


def _unit(v: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    size = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.divide(v, size, out=np.full_like(v, np.nan), where=size > 0.0)
