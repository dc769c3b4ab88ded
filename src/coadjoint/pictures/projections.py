"""Projections of the sphere to the plane: equal-area maps, and the orthographic view, from any direction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
ArrayPair = tuple[Floats, Floats]

TABLE_SIZE = 4001  # points of the table of Mollweide's angle, linear between them: an error of 1e-6


@dataclass(frozen=True)
class Projection:
    """A map of the sphere into an ellipse with the half axes `half_width` and 1.

    `half_width` is 2 for maps of the whole sphere, 1 for the view from outside. `project` maps longitudes and latitudes
    in radians, relative to the centre, to x, y, and `unproject` inverts it; invisible points are NaN.
    """

    half_width: float
    project: Callable[[Floats, Floats], ArrayPair]
    unproject: Callable[[Floats, Floats], ArrayPair]

    def directions(self, columns: int, centre: tuple[float, float]) -> Floats:
        """Return the unit vectors of square pixels, (rows, columns, 3), lowest row first; NaN outside the map.

        `centre` is the longitude and latitude of the middle of the map in degrees.
        """
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


def unit_vectors(longitude: Floats, latitude: Floats) -> Floats:
    """Return the unit vectors (..., 3) at longitudes and latitudes in radians."""
    return np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1
    )


def turned(centre: tuple[float, float]) -> Floats:
    """Return the rotation whose rows are the axes of the map: towards its centre, to the right, and upward.

    Examples
    --------
    >>> turned((90.0, 0.0)).round(12) + 0.0
    array([[ 0.,  1.,  0.],
           [-1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    longitude, latitude = np.radians(centre)
    middle = unit_vectors(longitude, latitude)
    right = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    return np.stack([middle, right, np.cross(middle, right)])


def _mollweide_project(longitude: Floats, latitude: Floats) -> ArrayPair:
    turn = np.linspace(-np.pi / 2, np.pi / 2, TABLE_SIZE)
    theta = np.interp(np.sin(latitude), (2 * turn + np.sin(2 * turn)) / np.pi, turn)
    return 2 * longitude / np.pi * np.cos(theta), np.sin(theta)


def _mollweide_unproject(x: Floats, y: Floats) -> ArrayPair:
    theta = np.arcsin(y)
    return np.pi * x / (2 * np.cos(theta)), np.arcsin(np.clip((2 * theta + np.sin(2 * theta)) / np.pi, -1.0, 1.0))


def _hammer_project(longitude: Floats, latitude: Floats) -> ArrayPair:
    size = np.sqrt(1 + np.cos(latitude) * np.cos(longitude / 2))
    return 2 * np.cos(latitude) * np.sin(longitude / 2) / size, np.sin(latitude) / size


def _hammer_unproject(x: Floats, y: Floats) -> ArrayPair:
    z = np.sqrt(1 - x**2 / 8 - y**2 / 2)
    return 2 * np.arctan2(np.sqrt(2) * z * x, 2 * (2 * z**2 - 1)), np.arcsin(np.clip(np.sqrt(2) * z * y, -1.0, 1.0))


def _outside_project(longitude: Floats, latitude: Floats) -> ArrayPair:
    x, y, z = np.moveaxis(unit_vectors(longitude, latitude), -1, 0)
    return np.where(x >= 0.0, y, np.nan), np.where(x >= 0.0, z, np.nan)


def _outside_unproject(x: Floats, y: Floats) -> ArrayPair:
    return np.arctan2(x, np.sqrt(np.maximum(1 - x**2 - y**2, 0.0))), np.arcsin(y)


PROJECTIONS = {
    "mollweide": Projection(2.0, _mollweide_project, _mollweide_unproject),
    "hammer": Projection(2.0, _hammer_project, _hammer_unproject),
    "outside": Projection(1.0, _outside_project, _outside_unproject),
}
"""Mollweide and Hammer are equal-area maps of the whole sphere; "outside" is the orthographic view."""
