"""Closed surfaces of triangles: whether they are closed and turned outward, and the moments of what they enclose."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MAX_PARTS = 1000
"""Largest number of separate surfaces whose nesting is checked."""
SMALLEST = 1e-60
"""Smallest size of a surface, whose inverse is the largest: their fourth powers are in the range of float64."""
BLOCK = 2**14
"""Triangles in one block of a sum."""


class Moments(NamedTuple):
    """Volume, centre, and means of products of two, three and four coordinates about it, and the surface: vertices from
    the centre, of which no two are equal, and triangles.
    """

    volume: float
    centre: Floats
    second: Floats
    third: Floats
    fourth: Floats
    radius: float
    points: Floats
    triangles: Integers


def moments_of(vertices: Floats, faces: Integers, what: str) -> Moments:
    """Return the moments of what a surface encloses; ValueError if it is open or turned inside out."""
    if not len(faces):
        raise ValueError(f"{what} has no triangles; give a surface, not points or lines")
    if not np.isfinite(vertices).all():
        raise ValueError(f"{what} has a vertex that is not finite")
    points, triangles = _merged(vertices, faces)
    low, high = 0.5 * points.min(axis=0), 0.5 * points.max(axis=0)
    middle, size = low + high, float((high - low).max())
    if not SMALLEST <= size <= 1.0 / SMALLEST:
        raise ValueError(
            f"{what} has the size {2.0 * size:g}, whose powers leave the range of float64; give another scale"
        )
    _check_closed(points, triangles, what)
    scaled = (points - middle) / size
    _check_turned(scaled, triangles, what)
    total, first = _integrals(scaled, triangles, np.zeros(3), 1)
    volume = float(total)
    if not volume > 0.0:
        raise ValueError(f"{what} encloses no volume; give a body with a thickness")
    centre = first / volume
    _, _, second, third, fourth = _integrals(scaled, triangles, centre, 4)
    radius = float(np.linalg.norm(scaled - centre, axis=1).max())
    return Moments(
        volume * size**3,
        centre * size + middle,
        second / volume * size**2,
        third / volume * size**3,
        fourth / volume * size**4,
        radius * size,
        (scaled - centre) * size,
        triangles,
    )


def _merged(vertices: Floats, faces: Integers) -> tuple[Floats, Integers]:
    """Return equal vertices as one, without triangles that have two equal ones."""
    points, inverse = np.unique(vertices + 0.0, axis=0, return_inverse=True)  # -0.0 is 0.0
    triangles = inverse.reshape(-1)[faces]
    a, b, c = triangles.T
    return points, triangles[(a != b) & (b != c) & (c != a)]


def _check_closed(points: Floats, triangles: Integers, what: str) -> None:
    """Raise ValueError unless each edge is passed as often in one direction as in the other."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    forward = edges[:, 0] < edges[:, 1]
    keys = np.where(forward, edges[:, 0] * len(points) + edges[:, 1], edges[:, 1] * len(points) + edges[:, 0])
    known, inverse = np.unique(keys, return_inverse=True)
    balance = np.bincount(inverse, weights=np.where(forward, 1.0, -1.0))
    wrong = np.flatnonzero(balance != 0.0)
    if not len(wrong):
        return
    first, second = divmod(int(known[wrong[0]]), len(points))
    where = " and ".join(f"({', '.join(f'{v:.6g}' for v in points[k])})" for k in (first, second))
    if (np.bincount(inverse)[wrong] % 2).any():
        raise ValueError(
            f"{what} is open: {len(wrong)} edges, such as that between {where}, have a triangle on one side only; "
            "close it in a program for meshes, and merge vertices that are near each other"
        )
    raise ValueError(
        f"{what} has triangles that are turned against their neighbours at {len(wrong)} edges, such as that between "
        f"{where}; turn all of them outward in a program for meshes"
    )


def _check_turned(points: Floats, triangles: Integers, what: str) -> None:
    """Raise ValueError for separate surfaces that are turned inside out, or that lie in each other."""
    parts = _parts(len(points), triangles)
    volumes = [float(_integrals(points, part, np.zeros(3), 0)[0]) for part in parts]
    if sum(volumes) < 0.0 and max(volumes) <= 0.0:
        raise ValueError(
            f"{what} is turned inside out: its triangles are clockwise as seen from outside, and its volume is "
            "negative; flip them in a program for meshes"
        )
    if len(parts) == 1:
        return
    if len(parts) > MAX_PARTS:
        raise ValueError(f"{what} has {len(parts)} separate surfaces; at most {MAX_PARTS} are read")
    boxes = [(points[part].min(axis=(0, 1)), points[part].max(axis=(0, 1))) for part in parts]
    for k, part in enumerate(parts):
        at = points[part[0, 0]]
        around = [j for j, (low, high) in enumerate(boxes) if j != k and (low <= at).all() and (at <= high).all()]
        depth = round(sum(_turns(points[parts[j]] - at) for j in around))
        if depth != (0 if volumes[k] > 0.0 else 1):
            reason = (
                "lies in another one, whose mass it would count twice"
                if volumes[k] > 0.0
                else ("is turned inside out, and is no cavity of another one")
            )
            raise ValueError(
                f"{what} has {len(parts)} separate surfaces, and that through ({', '.join(f'{v:.6g}' for v in at)}) of "
                f"its size {reason}; correct it in a program for meshes"
            )


def _parts(count: int, triangles: Integers) -> list[Integers]:
    """Return the triangles of each surface that is connected by its vertices."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    rows, columns = triangles[:, [0, 1]].ravel(), triangles[:, [1, 2]].ravel()
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(count, count))
    labels = connected_components(graph.tocsr(), directed=False)[1][triangles[:, 0]]
    order = np.argsort(labels, kind="stable")
    return np.split(triangles[order], np.flatnonzero(np.diff(labels[order])) + 1)


def _turns(corners: Floats) -> float:
    """Return how often a surface, (n, 3, 3), goes around the origin: the sum of its solid angles over 4 pi."""
    a, b, c = corners.swapaxes(0, 1)
    la, lb, lc = (np.linalg.norm(one, axis=1) for one in (a, b, c))
    triple = (a * np.cross(b, c)).sum(axis=1)
    below = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return float((2.0 * np.arctan2(triple, below)).sum()) / (4.0 * np.pi)


def _rule() -> tuple[Floats, Floats]:
    """Return weights and barycentric coordinates of six points of a triangle, exact to degree 4."""
    # Strang and Fix; Dunavant, Int. J. Numer. Methods Eng. 21, 1129 (1985).
    root = np.sqrt(38.0 - 44.0 * np.sqrt(0.4))
    spread = np.sqrt(213125.0 - 53320.0 * np.sqrt(10.0))
    weights, points = [], []
    for sign in (1.0, -1.0):
        a = (8.0 - np.sqrt(10.0) + sign * root) / 18.0
        for k in range(3):
            weights.append((620.0 + sign * spread) / 3720.0)
            points.append(np.roll([1.0 - 2.0 * a, a, a], k))
    return np.array(weights), np.array(points)


def _integrals(points: Floats, triangles: Integers, centre: Floats, order: int) -> list[Floats]:
    """Return the integrals of products of up to `order` coordinates about a centre over what a surface encloses."""
    # Of a homogeneous function of degree d they are sums over the tetrahedra of the triangles and the centre: their
    # volume times 3/(3 + d) times the mean of the function over the triangle.
    weights, barycentric = _rule()
    sums: list[Floats] = [np.zeros((3,) * degree) for degree in range(order + 1)]
    for begin in range(0, len(triangles), BLOCK):
        corners = points[triangles[begin : begin + BLOCK]] - centre
        volumes = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
        y = np.einsum("qk,nki->nqi", barycentric, corners).reshape(-1, 3)
        shares = (volumes[:, None] * weights).reshape(-1)
        weighted, squares = shares[:, None] * y, y[:, :, None] * y[:, None, :]
        for degree in range(order + 1):
            sums[degree] += 3.0 / (3.0 + degree) * SUMS[degree](shares, y, weighted, squares)
    return [_symmetric(one) for one in sums]


def _symmetric(tensor: Floats) -> Floats:
    """Return a tensor whose entries are those of the sorted indices."""
    if tensor.ndim < 2:
        return tensor
    ascending = np.sort(np.indices(tensor.shape), axis=0)
    return np.asarray(tensor[tuple(ascending)])


SUMS: tuple[Callable[..., Floats], ...] = (
    lambda shares, y, weighted, squares: shares.sum(),
    lambda shares, y, weighted, squares: weighted.sum(axis=0),
    lambda shares, y, weighted, squares: np.einsum("na,nb->ab", weighted, y),
    lambda shares, y, weighted, squares: np.einsum("na,nbc->abc", weighted, squares),
    lambda shares, y, weighted, squares: np.einsum("n,nab,ncd->abcd", shares, squares, squares),
)
"""Sums of products of 0, 1, ..., 4 coordinates."""
