"""Positions of the sites of a lattice in pictures."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.register import CannotShow

Floats = npt.NDArray[np.float64]

COS_60, SIN_60 = 0.5, math.sqrt(0.75)
# The edges of a cell, and the positions of its sites.
CELL_GEOMETRY: dict[str, tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]]] = {
    "chain": (((1.0, 0.0),), ((0.0, 0.0),)),
    "square": (((1.0, 0.0), (0.0, 1.0)), ((0.0, 0.0),)),
    "triangular": (((1.0, 0.0), (COS_60, SIN_60)), ((0.0, 0.0),)),
    "honeycomb": (((2 * SIN_60, 0.0), (SIN_60, 1.5)), ((0.0, 0.0), (SIN_60, COS_60))),
    "kagome": (((2.0, 0.0), (1.0, 2 * SIN_60)), ((0.0, 0.0), (1.0, 0.0), (COS_60, SIN_60))),
}


SITES_PER_ROW = 30
"""Largest number of sites in one row; longer chains are folded into rows, like text."""


def sites_of_row(lattice: Any, count: int) -> int:
    """Return the sites per row of a folded chain; all if it is not folded.

    Examples
    --------
    >>> sites_of_row("chain", 20), sites_of_row("chain", 100), sites_of_row("square", 100)
    (20, 15, 100)
    """
    return count if lattice != "chain" or count <= SITES_PER_ROW else math.ceil((2.0 * count) ** 0.5)


def places_of_sites(lattice: Any, shape: Any, count: int) -> Floats:
    """Return the positions (count, 2) of sites in the plane, cell by cell, the last axis of `shape` first.

    Long chains are folded into rows, the first on top; rings and general graphs are drawn as a circle. Raises
    CannotShow for three-dimensional lattices.
    """
    if lattice == "cubic":
        raise CannotShow("the lattice is three-dimensional, and spins are drawn in a plane")
    if not isinstance(lattice, str) or lattice not in CELL_GEOMETRY or shape is None:
        turn = 2.0 * np.pi * np.arange(count) / count
        return np.stack([np.sin(turn), np.cos(turn)], axis=-1) * max(1.0, count / 6.0)
    row = sites_of_row(lattice, count)
    if row < count:
        place = np.arange(count)
        return np.stack([place % row, -1.4 * (place // row)], axis=-1)
    edges, inside = (np.array(part) for part in CELL_GEOMETRY[lattice])
    sizes = np.atleast_1d(shape).tolist()
    cells = np.indices(sizes).reshape(len(sizes), -1).T @ edges
    return (cells[:, None] + inside[None]).reshape(-1, 2)
