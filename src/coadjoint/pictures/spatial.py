"""Paths of body axes in space."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow
from coadjoint.validation import read_finite, read_integer

Floats = npt.NDArray[np.float64]


def axis_in_space(drawn: PlottedRun, axis: Any, up: Any) -> tuple[Floats, str]:
    """Return the path of a body axis in space, unit vectors (members, k, 3), and the name of the axis.

    `axis` is a number, 0 to 2, or a direction in the body. `up` has the coordinates of a body vector that is constant
    in space (momentum, vertical), which becomes the third axis of the picture; None: space as in the attitude. Raises
    CannotShow without an attitude that is a rotation.
    """
    A = drawn.rotation
    if A is None:
        raise CannotShow("the run has no attitude that is a rotation; integrate with attitude=True")
    if np.ndim(axis):
        given = read_finite(axis, "axis")
        if given.shape != (3,) or not given.any():
            raise ValueError(f"axis is {given.tolist()}; give the number of an axis, or a direction in the body, (3,)")
        direction, name = given / np.linalg.norm(given), "the axis of the body"
    else:
        number = read_integer(axis, "axis", 0, 2)
        direction, name = np.eye(3)[number], f"body axis {number + 1}"
    path = A @ direction
    if up is not None:
        places = [drawn.place(i) for i in up]
        for m in range(len(path)):
            path[m] = path[m] @ _rotation_to_vertical(A[m, 0] @ drawn.x[m, 0, places]).T
    return path, name


def _rotation_to_vertical(vertical: Floats) -> Floats:
    """Return the shortest rotation of a vector to the third axis."""
    size = float(np.linalg.norm(vertical))
    if size == 0.0:
        return np.eye(3)
    u = vertical / size
    if u[2] < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    v = np.array([u[1], -u[0], 0.0])  # u x e3
    hat = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.eye(3) + hat + hat @ hat / (1.0 + u[2])
