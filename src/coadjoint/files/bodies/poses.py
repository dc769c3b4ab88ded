"""Rotations as the formats of bodies write them: roll, pitch and yaw, quaternions, axes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.representation import quaternion_matrix
from coadjoint.systems.bodies.mass_properties import product

Floats = npt.NDArray[np.float64]


def about_axis(axis: Sequence[float] | Floats, angle: float) -> Floats:
    """Return the rotation by an angle (radians) about an axis of any length but zero."""
    n = np.array(axis) / math.hypot(*axis)
    cross = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + 2.0 * math.sin(0.5 * angle) ** 2 * product(cross, cross))


def by_euler_angles(angles: Sequence[float], sequence: str) -> Floats:
    """Return the product of rotations (radians) about axes: lower case of the turned frame, upper case of the fixed."""
    rotation = np.eye(3)
    for angle, letter in zip(angles, sequence, strict=True):
        one = about_axis(np.eye(3)["xyz".index(letter.lower())], angle)
        rotation = product(rotation, one) if letter.islower() else product(one, rotation)
    return rotation


def by_roll_pitch_yaw(angles: Sequence[float]) -> Floats:
    """Return the rotation about the fixed axes x, y and z, in this order (radians)."""
    return by_euler_angles(angles, "XYZ")


def by_quaternion(w: float, x: float, y: float, z: float) -> Floats | None:
    """Return the rotation of a quaternion, which is normalized; None if it is zero."""
    length = math.hypot(w, x, y, z)
    if length == 0.0:
        return None
    return quaternion_matrix(*(value / length for value in (w, x, y, z)))
