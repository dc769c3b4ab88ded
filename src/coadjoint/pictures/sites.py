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
        Sites one cell after the other, along the last axis first.

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
    if not isinstance(lattice, str) or lattice not in CELLS:
        turn = 2.0 * np.pi * np.arange(count) / count
        return np.stack([np.sin(turn), np.cos(turn)], axis=-1) * max(1.0, count / 6.0)
    edges, inside = (np.array(part) for part in CELLS[lattice])
    sizes = np.atleast_1d(shape).tolist()
    cells = np.indices(sizes).reshape(len(sizes), -1).T @ edges
    return (cells[:, None] + inside[None]).reshape(-1, 2)
