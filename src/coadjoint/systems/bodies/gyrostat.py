"""The gyrostat: a rigid body with internal rotors."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.bodies.classical_body import ClassicalBody
from coadjoint.systems.bodies.inertia import (
    axis_of_symmetry,
    inverse_of,
    momentum_along,
    principal,
    read_inertia,
    read_vector,
    warn_unphysical_inertia,
)
from coadjoint.systems.bodies.rigid_body import rotations
from coadjoint.systems.closed_forms.closed_form import (
    check_finite_states,
    initial_group_element,
    start_and_times,
    with_group_element,
)
from coadjoint.systems.closed_forms.free_rigid_body import fixed_axis
from coadjoint.systems.gallery_entry import GalleryEntry, Picture, points_on_sphere
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples

Floats = npt.NDArray[np.float64]


def _energy(inertia: npt.NDArray[Any], rotors: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any], Any]:
    M = inverse_of(inertia, "inertia")
    rate = (M * rotors).sum(axis=1) if M.ndim == 2 else M * rotors
    return M, -rate, 0.5 * (rotors * rate).sum()


@ready_made(
    energy=_energy,
    symmetric=("inertia",),
    gallery_entry=GalleryEntry(
        x0=partial(points_on_sphere, 16),
        t_span=(0.0, 60.0),
        step=0.05,
        caption="Sixteen motions with the same length of the momentum. Without rotors their curves would be symmetric "
        "about the planes of the principal axes. The rotors shift the equilibria, and there are fewer of them.",
        pictures=(
            Picture(
                "directions",
                vectors={"x": (0, 1, 2)},
                axes_named=("$x_1$", "$x_2$", "$x_3$"),
                title="motions on the sphere of one momentum",
                view=(35.0, 22.0),
            ),
        ),
        components=Picture("components", chosen=(1,)),
        quantity="angular momentum",
    ),
)
def gyrostat(inertia: npt.ArrayLike = (1.0, 2.0, 3.0), rotors: npt.ArrayLike = (0.25, 0.5, 0.75)) -> ClassicalBody:
    """Return a body that carries rotors, ``x' = x cross Omega`` with ``Omega = I^-1 (x - k)``.

    x is the angular momentum of body and rotors together, in the body frame. That of the rotors relative to the
    body, k, is constant. The attitude A, from the body to space, satisfies ``A' = A hat(Omega)``, so that ``A x`` is
    constant. The algebra is so(3) with the body sign, -1, and ``H = (x - k) . I^-1 (x - k) / 2``. Without rotors use
    `rigid_body`.

    Parameters
    ----------
    inertia : (3,) or (3, 3)
        Principal moments, or the symmetric positive definite tensor (mass times length squared): with the rotors locked
        if motors keep their speed relative to the body; without the moments of the rotors about their own axes if they
        spin freely and so keep their own momentum.
    rotors : (3,)
        Angular momentum k of the rotors (mass times length squared over time).

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        Casimir ``|x|^2``. If two principal moments are equal and k lies along the third axis, or if all three are
        equal, the momentum along the axis of symmetry, such as ``"x3"``, is an integral, and
        ``exact(x0, t, attitude=False)`` is known in closed form.

    Raises
    ------
    ValueError
        `inertia` has another shape, or is not finite, symmetric and positive; `rotors` is not three finite numbers.

    Warns
    -----
    UserWarning
        A principal moment exceeds the sum of the other two, which is impossible for a body.

    Notes
    -----
    Volterra, "Sur la theorie des variations des latitudes", Acta Mathematica 22 (1899); Wittenburg, "Dynamics of
    Multibody Systems" (2008).

    Examples
    --------
    >>> s = gyrostat(inertia=(1.0, 2.0, 2.5), rotors=(0.0, 0.0, 2.5))
    >>> s.vector_field([1.0, 2.0, 5.0])
    array([-3.,  4., -1.])
    >>> s.energy([0.0, 0.0, 2.5])
    0.0
    """
    moments, k = read_inertia(inertia), read_vector(rotors, "rotors")
    with np.errstate(over="ignore", invalid="ignore"):
        M, linear, constant = _energy(moments, k)
    warn_unphysical_inertia(moments)
    if not math.isfinite(constant):
        raise ValueError(
            f"the energy of the rotors, {short(k.tolist())}, leaves the range of float64; take other units"
        )
    H = Quadratic(M, linear, float(constant))
    axis, m = axis_of_symmetry(M, k), principal(M)
    return ClassicalBody(
        rotations(),
        H,
        sign=-1,
        name="gyrostat",
        parameters={"inertia": as_tuples(moments), "rotors": tuple(k.tolist())},
        exact=None if axis is None or m is None else partial(_symmetric, m, k, axis),
        integrals=momentum_along(axis, "x", 3),
    )


def _symmetric(m: Floats, k: Floats, axis: Floats, x0: Any, t: Any, attitude: Any = False) -> Any:
    """Return the closed form of a symmetric gyrostat."""
    # ``Omega = n x + s axis`` with n the inverse moment across the axis and a constant s. So x rotates about the axis
    # by ``-s t``, and ``A(t) = A(0) exp(n t hat(x(0))) exp(s t hat(axis))``.
    start, times = start_and_times(x0, t, 3)
    first = initial_group_element(attitude, 3)
    n = float(m[np.argmin(np.abs(axis))])
    with np.errstate(over="ignore", invalid="ignore"):
        spin = float((axis * ((m - n) * start - m * k)).sum()) * axis
        time_array = np.atleast_1d(times)
        rotation = fixed_axis(spin, time_array)
        x, A = start @ rotation, first @ fixed_axis(n * start, time_array) @ rotation
    check_finite_states(np.concatenate([x.ravel(), A.ravel()]), start, times)
    if times.ndim == 0:
        x, A = x[0], A[0]
    return with_group_element(x, A, attitude)
