"""Where do the sites of a lattice lie in a picture?"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.register import CannotShow

Floats = npt.NDArray[np.float64]

HALF, HIGH = 0.5, math.sqrt(0.75)
# The two edges of a cell, and the places of its sites.
CELLS: dict[str, tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]]] = {
    "chain": (((1.0, 0.0),), ((0.0, 0.0),)),
    "square": (((1.0, 0.0), (0.0, 1.0)), ((0.0, 0.0),)),
    "triangular": (((1.0, 0.0), (HALF, HIGH)), ((0.0, 0.0),)),
    "honeycomb": (((2 * HIGH, 0.0), (HIGH, 1.5)), ((0.0, 0.0), (HIGH, HALF))),
    "kagome": (((2.0, 0.0), (1.0, 2 * HIGH)), ((0.0, 0.0), (1.0, 0.0), (HALF, HIGH))),
}


ROW = 30
"""Sites of a chain that are drawn in one row; a longer one is folded into rows, as text is."""


def sites_of_row(lattice: Any, count: int) -> int:
    """Return how many sites a row of a folded chain has; all where it is not folded.

    Examples
    --------
    >>> sites_of_row("chain", 20), sites_of_row("chain", 100), sites_of_row("square", 100)
    (20, 15, 100)
    """
    return count if lattice != "chain" or count <= ROW else math.ceil((2.0 * count) ** 0.5)


def places_of_sites(lattice: Any, shape: Any, count: int) -> Floats:
    """Return where the sites of a lattice lie in the plane; those of a ring or of any graph lie on a circle.

    Parameters
    ----------
    lattice : str or edges
        As the system has it.
    shape : int or tuple of int
        Cells along each axis.
    count : int
        Number of sites.

    Returns
    -------
    ndarray, shape (count, 2)
        Sites one cell after the other, along the last axis first. A long chain is folded into rows, the first above.

    Raises
    ------
    CannotShow
        The lattice fills space.

    Examples
    --------
    >>> places_of_sites("square", (2, 2), 4).tolist()
    [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]
    """
    if lattice == "cubic":
        raise CannotShow("the lattice fills space, and spins are drawn in a plane")
    if not isinstance(lattice, str) or lattice not in CELLS or shape is None:
        turn = 2.0 * np.pi * np.arange(count) / count
        return np.stack([np.sin(turn), np.cos(turn)], axis=-1) * max(1.0, count / 6.0)
    row = sites_of_row(lattice, count)
    if row < count:
        place = np.arange(count)
        return np.stack([place % row, -1.4 * (place // row)], axis=-1)
    edges, inside = (np.array(part) for part in CELLS[lattice])
    sizes = np.atleast_1d(shape).tolist()
    cells = np.indices(sizes).reshape(len(sizes), -1).T @ edges
    return (cells[:, None] + inside[None]).reshape(-1, 2)
