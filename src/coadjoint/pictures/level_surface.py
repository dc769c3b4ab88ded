"""Level surfaces of functions of three coordinates: triangles by marching tetrahedra, and hidden points."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.user_functions import takes_time
from coadjoint.validation import read_finite, read_integer, read_number

Floats = npt.NDArray[np.float64]

TESTED_POINTS = 400  # of a line; each needs values along a ray
RAY_SAMPLES = 32
"""Samples along the ray from a point to the viewer, within the box of the picture."""
BYTES_PER_CELL = 2000  # corners and values of its six tetrahedra

# A cube is six tetrahedra around its diagonal, one per order of the axes, so that neighbouring cubes match.
_TETRAHEDRA = np.array(
    [np.cumsum([[0, 0, 0], *(np.eye(3, dtype=int)[list(order)])], axis=0) for order in itertools.permutations(range(3))]
)


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
    check_available_memory(BYTES_PER_CELL * cells**3, f"a level surface with {short(cells)} cells along each edge")
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
