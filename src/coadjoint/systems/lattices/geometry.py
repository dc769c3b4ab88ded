"""Positions of the sites of lattices in space, and their reciprocal lattices."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

COS_60, SIN_60 = 0.5, math.sqrt(0.75)  # directions of bonds of triangles and hexagons


class CellGeometry(NamedTuple):
    """Edges of a cell, positions of its sites, and corners of a path in reciprocal space, in reciprocal edges."""

    edges: tuple[tuple[float, ...], ...]
    sites: tuple[tuple[float, ...], ...]
    path: tuple[tuple[float, ...], ...]


TRIANGULAR_PATH = ((0.0, 0.0), (0.5, 0.0), (2.0 / 3.0, 1.0 / 3.0), (0.0, 0.0))  # Gamma, M, K, Gamma
_CHAIN = CellGeometry(((1.0, 0.0),), ((0.0, 0.0),), ((0.0,), (1.0,)))
CELL_GEOMETRY: Mapping[str, CellGeometry] = {
    "chain": _CHAIN,
    "ring": _CHAIN,
    "square": CellGeometry(((1.0, 0.0), (0.0, 1.0)), ((0.0, 0.0),), ((0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (0.0, 0.0))),
    "triangular": CellGeometry(((1.0, 0.0), (COS_60, SIN_60)), ((0.0, 0.0),), TRIANGULAR_PATH),
    "honeycomb": CellGeometry(((2 * SIN_60, 0.0), (SIN_60, 1.5)), ((0.0, 0.0), (SIN_60, COS_60)), TRIANGULAR_PATH),
    "kagome": CellGeometry(
        ((2.0, 0.0), (1.0, 2 * SIN_60)), ((0.0, 0.0), (1.0, 0.0), (COS_60, SIN_60)), TRIANGULAR_PATH
    ),
    "cubic": CellGeometry(
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, 0.0),),
        ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, 0.5, 0.5), (0.0, 0.0, 0.0)),
    ),
}
"""Lattice -> its cell; the distance between neighbours is one."""


def sizes_of(shape: Any) -> tuple[int, ...]:
    """Return the number of cells along each axis."""
    return tuple(np.atleast_1d(shape).tolist())


def lattice_positions(lattice: str, shape: Any) -> Floats:
    """Return the positions of all sites in space, (sites, 2 or 3), cell by cell, along the last axis first."""
    edges, sites = (np.array(part) for part in CELL_GEOMETRY[lattice][:2])
    return np.asarray(((_cells(shape) @ edges)[:, None] + sites).reshape(-1, edges.shape[1]))


def cell_coordinates(lattice: str, shape: Any) -> Floats:
    """Return the positions of all sites in units of the edges of the cell, (sites, axes)."""
    edges, sites = (np.array(part) for part in CELL_GEOMETRY[lattice][:2])
    within = (sites @ np.linalg.pinv(edges)).round(15)
    return np.asarray((_cells(shape)[:, None] + within).reshape(-1, len(edges)))


def reciprocal_edges(lattice: str) -> Floats:
    """Return the edges b of the reciprocal cell, (axes, 2 or 3): a_i . b_j = 2 pi delta_ij."""
    return np.asarray(2.0 * np.pi * np.linalg.pinv(np.array(CELL_GEOMETRY[lattice].edges)).T)


def _cells(shape: Any) -> Floats:
    sizes = sizes_of(shape)
    return np.indices(sizes).reshape(len(sizes), -1).T.astype(np.float64)
