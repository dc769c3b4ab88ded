"""Validation of attitudes (matrices, SciPy rotations, quaternions) and of angular velocities."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.representation import ORTHOGONALITY, is_rotation, matrices_of_quaternions
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.bodies.body_inertia import BodyInertia
from coadjoint.validation import read_bool, read_choice, read_finite, read_numbers

Floats = npt.NDArray[np.float64]

ROD_VELOCITY = 64 * UNIT_ROUNDOFF
"""Largest angular velocity along a rod, relative to the whole, that is taken for rounding."""
FRAMES = ("body", "space")


def read_states(system: Any, x: Any) -> Floats:
    """Validate states (..., dim) of a system of bodies."""
    states = read_numbers(x, "x")
    if states.shape[-1:] != (system.dim,):
        raise ValueError(f"x has shape {states.shape}; {system.name} needs (..., {system.dim})")
    return states


def read_vectors(values: Any, what: str, shape: tuple[int, ...]) -> Floats:
    """Validate vectors of the given shape, or with an axis of members before."""
    array = read_finite(values, what)
    if array.shape[-len(shape) :] != shape or array.ndim > len(shape) + 1:
        raise ValueError(f"{what} has shape {array.shape}; give {shape} or (members, {', '.join(map(str, shape))})")
    return array


def read_attitudes(attitude: Any, what: str, bodies: tuple[int, ...], scalar_first: bool) -> Floats:
    """Return attitudes as matrices (..., 3, 3) or (..., bodies, 3, 3), orthogonal to rounding."""
    scalar_first = read_bool(scalar_first, "scalar_first")
    if isinstance(attitude, list | tuple) and bodies and any(map(is_rotation, attitude)):
        attitude = np.stack([read_attitudes(one, f"{what}[{k}]", (), scalar_first) for k, one in enumerate(attitude)])
    if is_rotation(attitude):
        attitude = attitude.as_matrix()
    array = read_finite(attitude, what)
    tail = bodies
    # Four numbers are a quaternion: no shape of matrices ends with 4.
    if array.shape[-1:] == (4,):
        array = matrices_of_quaternions(array, what, scalar_first)
    if array.shape[-len(tail) - 2 :] != (*tail, 3, 3) or array.ndim > len(tail) + 3:
        count = f"{bodies[0]} of them" if bodies else "one"
        raise ValueError(
            f"{what} has shape {np.shape(attitude)}; give rotation matrices (3, 3), quaternions (4,) or a SciPy "
            f"Rotation, {count}, or with an axis of members before"
        )
    return _orthogonal(array, what)


def read_angular_velocities(
    values: Any, what: str, attitudes: Floats | None, bodies: tuple[int, ...], frame: str, degrees: bool
) -> Floats:
    """Return angular velocities in the body frames, in radians per time."""
    omega = read_vectors(values, what, (*bodies, 3))
    if read_bool(degrees, "degrees"):
        omega = np.deg2rad(omega)
    if read_choice(frame, "frame", FRAMES) == "body":
        return omega
    if attitudes is None:
        raise ValueError('frame is "space", but the state has no attitude; give the angular velocity in the body frame')
    return np.einsum("...ij,...i->...j", attitudes, omega)


def check_rods(omega: Floats, inertias: tuple[BodyInertia, ...], what: str) -> Floats:
    """Return angular velocities (..., bodies, 3) without rounding along rods; raise ValueError for more than that."""
    result = omega.copy()
    for k, inertia in enumerate(inertias):
        if inertia.rotating is None:
            continue
        turning = np.einsum("ij,...j->...i", inertia.rotating, omega[..., k, :])
        if np.abs(omega[..., k, :] - turning).max() > ROD_VELOCITY * np.abs(omega[..., k, :]).max():
            name = "a rod, about its axis" if inertia.tensor.any() else "a point"
            raise ValueError(
                f"{what} of body {k} is {short(omega[..., k, :].tolist())}, where its moment of inertia is zero, like "
                f"that of {name}; give an angular velocity without this component"
            )
        result[..., k, :] = turning
    return result


def _orthogonal(A: Floats, what: str) -> Floats:
    """Return the nearest rotations, by steps of Newton's iteration for the polar factor; refuse what is no rotation."""
    defect = np.abs(np.einsum("...ij,...kj->...ik", A, A) - np.eye(3)).max(initial=0.0)
    if not defect <= ORTHOGONALITY or (np.linalg.det(A) < 0.0).any():
        raise ValueError(f"{what} is no rotation: its rows are orthonormal to {defect:.2g}, or it has a reflection")
    for _ in range(2 if defect > 4 * UNIT_ROUNDOFF else 0):
        A = 1.5 * A - 0.5 * np.einsum("...ij,...kj,...kl->...il", A, A, A)
    return A
