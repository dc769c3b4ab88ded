"""Angles between rotations of space."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.validation import read_finite


@suggest_keywords
def attitude_angle(A: npt.ArrayLike, B: npt.ArrayLike) -> Any:
    """Return the angle of the rotation from one attitude to another.

    Parameters
    ----------
    A, B : array_like, shape (..., 3, 3)
        Rotation matrices; their leading shapes broadcast.

    Returns
    -------
    float or ndarray, shape (...)
        Angle of A^T B in radians, from 0 to pi, to a few units of round-off everywhere.

    Raises
    ------
    ValueError
        The matrices are not 3 x 3.

    Notes
    -----
    With R = A^T B, ``atan2(|axial vector of (R - R^T)/2|, (tr R - 1)/2)``; the arccosine alone would lose half of the
    digits near 0 and pi.

    Examples
    --------
    >>> quarter = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    >>> attitude_angle(np.eye(3), quarter) == np.pi / 2
    True
    """
    first, second = _read_matrices(A, "A"), _read_matrices(B, "B")
    angle = _axis_and_angle(np.swapaxes(first, -1, -2) @ second)[1]
    return float(angle) if angle.ndim == 0 else angle


@suggest_keywords
def precession_error(A: npt.ArrayLike, B: npt.ArrayLike, axis: npt.ArrayLike) -> Any:
    """Return the angle by which an attitude is ahead of another one in its rotation about an axis fixed in space.

    About the angular momentum A x, which is fixed in space, it is the signed phase error of a rigid body.

    Parameters
    ----------
    A, B : array_like, shape (..., 3, 3)
        Computed and exact attitude, from the body to space.
    axis : array_like, shape (3,)
        Non-zero vector in space.

    Returns
    -------
    float or ndarray, shape (...)
        Component along the axis of the rotation vector of A B^T, in radians; of either sign for half turns.

    Raises
    ------
    ValueError
        The matrices are not 3 x 3, or the axis is not a non-zero vector of three numbers.

    Examples
    --------
    >>> quarter = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    >>> precession_error(np.eye(3), quarter, [0.0, 0.0, 5.0]) == -np.pi / 2
    True
    """
    rotation_axis, angle, direction = _relative_rotation(A, B, axis)
    along = rotation_axis @ direction * angle
    return float(along) if along.ndim == 0 else along


@suggest_keywords
def twist(A: npt.ArrayLike, B: npt.ArrayLike, axis: npt.ArrayLike) -> Any:
    """Return the twist about an axis fixed in space of the rotation from one attitude to another.

    Near zero it equals `precession_error`; over many turns, where a rotation vector jumps, it remains the angle modulo
    2 pi.

    Parameters
    ----------
    A, B, axis
        As for `precession_error`.

    Returns
    -------
    float or ndarray, shape (...)
        Angle from -pi to pi of the factor of A B^T that rotates about the axis; of either sign for half turns about it,
        and arbitrary for half turns across it.

    Raises
    ------
    ValueError
        The matrices are not 3 x 3, or the axis is not a non-zero vector of three numbers.

    Examples
    --------
    >>> quarter = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    >>> round(twist(np.eye(3), quarter, [0.0, 0.0, 5.0]) / np.pi, 12)
    -0.5
    """
    rotation_axis, angle, direction = _relative_rotation(A, B, axis)
    twisted = 2.0 * np.arctan2(rotation_axis @ direction * np.sin(0.5 * angle), np.cos(0.5 * angle))
    return float(twisted) if twisted.ndim == 0 else twisted


def acts_by_rotations(system: Any) -> bool:
    """Return whether the group elements of a system are rotations of space that carry its momentum."""
    rotations: Any = catalogue.so(3).representation
    return np.array_equal(system.representation, rotations)


def _relative_rotation(
    A: npt.ArrayLike, B: npt.ArrayLike, axis: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return axis and angle of A B^T, and the unit vector along `axis`."""
    direction = read_finite(axis, "axis")
    if direction.shape != (3,) or not np.any(direction):
        raise ValueError(f"axis is {short(axis)}; it must be three numbers, not all zero")
    direction /= np.max(np.abs(direction))  # so that its square does not overflow
    rotation_axis, angle = _axis_and_angle(_read_matrices(A, "A") @ np.swapaxes(_read_matrices(B, "B"), -1, -2))
    return rotation_axis, angle, direction / np.linalg.norm(direction)


def _read_matrices(value: npt.ArrayLike, name: str) -> npt.NDArray[np.float64]:
    matrices = read_finite(value, name)
    if matrices.shape[-2:] != (3, 3):
        raise ValueError(f"{name} has the shape {matrices.shape}; it must be (..., 3, 3)")
    return matrices


def _axis_and_angle(R: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the axis (zero for the identity, of either sign for half turns) and the angle, 0 to pi, of rotations."""
    axial = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    sine, cosine = 0.5 * np.linalg.norm(axial, axis=-1), 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    axis = axial / np.where(sine > 0.0, 2.0 * sine, 1.0)[..., None]
    # The axial vector vanishes at half turns. The symmetric part, (1 - cos) n n^T + cos, determines n up to its sign.
    outer = 0.5 * (R + np.swapaxes(R, -1, -2)) - cosine[..., None, None] * np.eye(3)
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    column = np.where(np.sum(column * axial, axis=-1, keepdims=True) < 0.0, -column, column)
    obtuse = cosine < 0.0
    length = np.where(obtuse, np.linalg.norm(column, axis=-1), 1.0)
    return np.where(obtuse[..., None], column / length[..., None], axis), np.arctan2(sine, cosine)
