"""Rotations given as SciPy objects or unit quaternions, as matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.validation import read_numbers

Floats = npt.NDArray[np.float64]

ORTHOGONALITY = 1e-6
"""Largest deviation from a rotation or a unit quaternion that is taken for rounding of the argument, and removed."""


def is_rotation(value: Any) -> bool:
    """Return whether a value is a rotation of SciPy, one or several."""
    return hasattr(value, "as_matrix")


def matrices_of_quaternions(quaternions: Floats, what: str, scalar_first: bool = False) -> Floats:
    """Return rotation matrices (..., 3, 3) of unit quaternions (..., 4), in the order of SciPy."""
    norms = np.sqrt((quaternions**2).sum(axis=-1))
    wrong = ~(np.abs(norms - 1.0) <= ORTHOGONALITY)
    if wrong.any():
        raise ValueError(f"{what} has a quaternion of norm {norms[wrong].flat[0]:g}; give unit quaternions")
    unit = quaternions / norms[..., None]
    w, x, y, z = np.moveaxis(unit if scalar_first else np.roll(unit, 1, axis=-1), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def group_elements(attitude: Any, size: int, affine: bool = False) -> Floats:
    """Return group elements (size, size), or with an axis of members before, also of rotations and quaternions.

    `affine`: the matrices have a rotation and a translation, which is zero if a rotation is given.
    """
    if isinstance(attitude, list | tuple) and any(map(is_rotation, attitude)):
        attitude = np.stack([group_elements(one, size, affine) for one in attitude])
    array = read_numbers(attitude.as_matrix() if is_rotation(attitude) else attitude, "attitude")
    rotates = size == 3 or affine
    # Four numbers are a quaternion: rows of 3 x 3 matrices have three. Four rows of four are one affine matrix.
    if rotates and array.shape[-1:] == (4,) and array.ndim <= (2 if size == 3 else 1):
        array = matrices_of_quaternions(array, "attitude")
    if not affine or array.shape[-2:] != (3, 3):
        return array
    elements = np.zeros((*array.shape[:-2], size, size))
    elements[..., :3, :3] = array
    elements[..., 3, 3] = 1.0
    return elements


def expected_elements(size: int, affine: bool = False) -> str:
    """Return the shapes of group elements, for messages."""
    rotation = ", a quaternion (4,) or a SciPy Rotation" if size == 3 or affine else ""
    return f"({size}, {size}){rotation}"
