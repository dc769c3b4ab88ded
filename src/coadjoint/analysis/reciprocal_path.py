"""Paths in reciprocal space through the wave vectors of a finite lattice."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.lattices.geometry import CELL_GEOMETRY, reciprocal_edges, sizes_of
from coadjoint.validation import read_finite

Floats = NDArray[np.float64]

COMMENSURATE = 1e-9  # distance from a whole number of waves, in waves
MAX_WAVES = 2**40  # whole numbers of waves up to here are exact in float64
BYTES_PER_POINT = 100  # of a path: coordinates, distance, and those of the result


class ReciprocalPath(NamedTuple):
    """Wave vectors (k, axes) in units of the reciprocal edges, their distances along the path (k,), and corners."""

    q: Floats
    distance: Floats
    corners: NDArray[np.int64]


def reciprocal_path(lattice: str, shape: Any, path: Any) -> ReciprocalPath:
    """Return the wave vectors that fit the lattice on straight lines between corners; None is the usual path."""
    sizes = np.array(sizes_of(shape))
    given = CELL_GEOMETRY[lattice].path if path is None else path
    corners = read_finite(given, "path")
    if len(sizes) == 1 and corners.ndim == 1:
        corners = corners[:, None]
    if corners.ndim != 2 or corners.shape[1] != len(sizes) or not len(corners):
        raise ValueError(
            f"path has shape {corners.shape}; give corners (corners, {len(sizes)}) in units of the reciprocal edges"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        waves = corners * sizes
    whole = np.rint(waves)
    with np.errstate(over="ignore", invalid="ignore"):
        fits = np.abs(waves - whole) <= COMMENSURATE * np.maximum(1.0, np.abs(waves))
    off = np.argwhere(~(fits & (np.abs(waves) < MAX_WAVES)))
    if off.size:
        corner = corners[off[0, 0]].tolist()
        subject = "the usual path" if path is None else "path"
        raise ValueError(
            f"{subject} has the corner {short(tuple(corner))}, which does not fit {short(shape)} cells: q times the "
            "cells of an axis must be a whole number; give path=, or take another shape"
        )
    points = [whole[:1].astype(np.int64)]
    for start, end in zip(whole[:-1].astype(np.int64), whole[1:].astype(np.int64), strict=True):
        count = math.gcd(*(end - start).tolist())
        check_available_memory(BYTES_PER_POINT * count, f"a path of {count} wave vectors", "give a shorter path")
        points.append(start + np.arange(1, count + 1)[:, None] * ((end - start) // max(count, 1)))
    q = np.concatenate(points) / sizes
    steps = np.linalg.norm(np.diff(q, axis=0) @ reciprocal_edges(lattice), axis=1)
    ends = np.cumsum([len(part) for part in points]) - 1
    return ReciprocalPath(q, np.concatenate([[0.0], np.cumsum(steps)]), np.unique(ends))
