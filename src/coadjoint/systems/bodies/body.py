"""One rigid body with its attitude in the state, for torques and controllers that see the attitude."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.bodies.attitude_algebra import PER_BODY, attitude_algebra, axis_products, momentum_in_space
from coadjoint.systems.bodies.body_inertia import inverse_of_moving, read_body_inertia
from coadjoint.systems.bodies.body_systems import BodySystem
from coadjoint.systems.bodies.rigid_body import rotations
from coadjoint.systems.closed_forms.closed_form import reject_attitude, start_and_times
from coadjoint.systems.closed_forms.free_rigid_body import exact_solution
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_bool

Floats = npt.NDArray[np.float64]


def _energy(inertia: npt.NDArray[Any], *, attitude: bool) -> tuple[npt.NDArray[Any]]:
    return (_in_state(inverse_of_moving(inertia), attitude),)


def _in_state(M: npt.NDArray[Any], attitude: bool) -> npt.NDArray[Any]:
    """Return the matrix of the energy from the inverse inertia, (3,) or (3, 3)."""
    if not attitude:
        return M
    matrix = np.zeros((PER_BODY,) * M.ndim, dtype=M.dtype)
    matrix[tuple(slice(0, 3) for _ in M.shape)] = M
    return matrix


@ready_made(
    energy=_energy,
    symmetric=("inertia",),
    gallery_entry=GalleryEntry(
        x0=(0.01, 1.0, 0.01, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        t_span=(0.0, 90.0),
        step=0.05,
        caption="A body that spins about its middle axis, with its attitude in the state: the axis flips periodically "
        "in space. Left, the vertical as seen from the body, which its attitude turns.",
        pictures=(Picture("body axis", axis=1, up=(6, 7, 8), vertical="second axis of space"),),
        components=Picture("components", chosen=(6, 7, 8), quantity="second axis of space, seen from the body"),
        quantity="state",
    ),
)
def body(inertia: npt.ArrayLike = (1.0, 2.0, 2.5), attitude: bool = True) -> BodySystem:
    """Return a rigid body with its attitude in the state: a satellite, a gyroscope, a rod.

    Choose it if a torque depends on the attitude, such as that of a pointing controller: ``co.forces.Torque(lambda x,
    A, t: ...)``. For the free motion of the momentum alone `rigid_body` is cheaper, and for bodies with positions see
    `bodies`. The state is (L, X, Y, Z): the angular momentum in the body frame, and the three space axes seen from the
    body, which are the rows of the attitude A, from the body to space. The algebra is so(3) acting on three copies of
    R^3, with sign -1: ``L' = L cross Omega``, ``X' = X cross Omega``, and so on, ``Omega = I^-1 L``.

    Parameters
    ----------
    inertia : (3,) or (3, 3)
        Principal moments of inertia, or the inertia tensor in the body frame (mass times length squared). The moment
        along a rod is zero, and the other two are equal.
    attitude : bool
        Whether the attitude is part of the state; without it the state is L, as that of `rigid_body`.

    Returns
    -------
    BodySystem
        State: 12 numbers; ``state(attitude=, angular_velocity=)`` makes it, and ``attitudes(x)``,
        ``angular_velocity(x, frame=)``, ``angular_momentum(x, frame=)`` read it. Solutions have ``rotation``,
        ``angular_velocity`` and ``angular_momentum``. Casimirs: the products of the axes, ``"X.X"``, ..., ``"Y.Z"``.
        Integrals of the free body: ``"total L1"``, ``"total L2"``, ``"total L3"``, its momentum in space.
        ``exact(x0, t)`` in closed form. With ``Splitting(parts="free_body")`` the free motion is one exact part, which
        turns the axes.

    Raises
    ------
    TypeError, ValueError
        `inertia` has another shape, or is not finite, symmetric and positive, but for the moment along a rod.

    Warns
    -----
    UserWarning
        A principal moment exceeds the sum of the other two, which is impossible for a body.

    Examples
    --------
    >>> import coadjoint as co
    >>> sat = co.systems.body((1.0, 2.0, 2.5))
    >>> x0 = sat.state(angular_velocity=(0.0, 0.0, 0.5))
    >>> sol = co.integrate(sat, x0, (0, 2), 0.1, co.Splitting(parts="free_body"))
    >>> sol.rotation[-1].as_rotvec().round(12)
    array([0., 0., 1.])
    """
    found = read_body_inertia(inertia)
    if not found.tensor.any():
        raise ValueError("inertia is zero: a point does not rotate; use co.systems.bodies for points with positions")
    M, named = found.inverse, {"sign": -1, "name": "body"}
    parameters = {"inertia": found.given, "attitude": read_bool(attitude, "attitude")}
    if not parameters["attitude"]:
        exact: Any = partial(exact_solution, M, -1)
        return BodySystem(found, rotations(), Quadratic(M), parameters=parameters, exact=exact, **named)
    return BodySystem(
        found,
        attitude_algebra(),
        Quadratic(_in_state(M, attitude=True)),
        casimirs=axis_products(1, PER_BODY),
        integrals=momentum_in_space(1, PER_BODY),
        parameters=parameters,
        exact=partial(_free_motion, M),
        **named,
    )


def _free_motion(M: Floats, x0: Any, t: Any, attitude: Any = False) -> Floats:
    """Return the state of the free body: its momentum in closed form, and the axes turned by its attitude."""
    reject_attitude(attitude, "body")
    start, times = start_and_times(x0, t, PER_BODY)
    L, turned = exact_solution(M, -1, start[:3], times, attitude=True)
    axes = np.einsum("ai,...ij->...aj", start[3:].reshape(3, 3), turned)
    return np.concatenate([L, axes.reshape(*times.shape, 9)], axis=-1)
