"""Lattice vectors from cell constants, or as given."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.lattices.space_groups import cosine
from coadjoint.validation import read_finite

MAX_LENGTH = 1e60  # cubes of lengths must be finite
FLAT = 1e-6  # least volume, in units of the product of the lengths


def lattice_of(values: Any, what: str) -> npt.NDArray[np.float64]:
    """Return lattice vectors, as rows, from (a, b, c, alpha, beta, gamma), angles in degrees, or from themselves."""
    given = read_finite(values, what)
    if given.shape == (6,):
        lengths, angles = given[:3].tolist(), given[3:].tolist()
        if min(angles) <= 0.0 or max(angles) >= 180.0:
            raise ValueError(f"{what} has the angles {angles}; give degrees between 0 and 180")
        if min(lengths) <= 0.0:
            raise ValueError(f"{what} has the lengths {lengths}; give positive ones")
        given = _vectors_of(lengths, angles)
    elif given.shape != (3, 3):
        raise ValueError(
            f"{what} has shape {given.shape}; give (a, b, c, alpha, beta, gamma), or three vectors as rows"
        )
    sizes = np.sqrt((given**2).sum(axis=1))
    if not sizes.max() < MAX_LENGTH or not sizes.min() > 1.0 / MAX_LENGTH:
        raise ValueError(f"{what} has vectors of the lengths {sizes.tolist()}; give lengths such as those in angstroms")
    unit = given / sizes[:, None]
    if not abs(float((np.cross(unit[0], unit[1]) * unit[2]).sum())) > FLAT:
        raise ValueError(f"{what} has no volume: its vectors lie in a plane; correct its angles or vectors")
    return given


def _vectors_of(lengths: list[float], angles: list[float]) -> npt.NDArray[np.float64]:
    a, b, c = lengths
    alpha, beta, gamma = map(cosine, angles)
    sine = math.sqrt(1.0 - gamma**2)
    y = (alpha - beta * gamma) / sine
    z = math.sqrt(max(0.0, 1.0 - beta**2 - y**2))
    return np.array([[a, 0.0, 0.0], [b * gamma, b * sine, 0.0], [c * beta, c * y, c * z]])
