"""The free rigid body in the standard body equations."""

from __future__ import annotations

from functools import cache, partial
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.systems.bodies.classical_body import ClassicalBody
from coadjoint.systems.bodies.inertia import inverse_of, read_inertia, warn_unphysical_inertia
from coadjoint.systems.closed_forms.free_rigid_body import exact_solution
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples


def _energy(inertia: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    return (inverse_of(inertia, "inertia"),)


Kind = TypeVar("Kind", bound=LiePoissonSystem)


@ready_made(
    energy=_energy,
    symmetric=("inertia",),
    gallery_entry=GalleryEntry(
        x0=(0.01, 1.0, 0.01),
        t_span=(0.0, 90.0),
        step=0.05,
        caption="A body that spins about its middle axis flips periodically: left, the component along that axis "
        "changes its sign after equal times; middle, the momentum moves between the poles of its sphere along the "
        "separatrix; right, the axis itself in space.",
        pictures=(
            Picture("coadjoint orbit"),
            Picture("body axis", axis=1, up=(0, 1, 2), vertical="momentum"),
        ),
        components=Picture("components", flips=1),
        attitude=True,
        quantity="angular momentum",
    ),
)
def rigid_body(inertia: npt.ArrayLike = (1.0, 2.0, 3.0)) -> ClassicalBody:
    """Return the free rigid body, ``x' = x cross (I^-1 x)``, with its exact solution.

    The standard body equations: x is the angular momentum in the body frame, ``Omega = I^-1 x`` the angular velocity,
    and the attitude A, from the body to space, satisfies ``A' = A hat(Omega)``, so that ``A x`` is constant. The
    algebra is so(3) with sign -1, and ``H = x . I^-1 x / 2``. For the convention of Reich (1993) use
    `paper_rigid_body`.

    Parameters
    ----------
    inertia : (3,) or (3, 3)
        Principal moments of inertia, or the symmetric positive definite inertia tensor (mass times length squared).

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        With ``exact(x0, t, attitude=False)`` in closed form.

    Raises
    ------
    ValueError
        `inertia` has another shape, or is not finite, symmetric and positive.

    Warns
    -----
    UserWarning
        A principal moment exceeds the sum of the other two, which is impossible for a body. For another quadratic form
        on so(3) use ``LiePoissonSystem(algebras.so(3), Quadratic(M), sign=-1)``.

    Examples
    --------
    >>> s = rigid_body(inertia=(1.0, 2.0, 2.5))
    >>> s.vector_field([1.0, 2.0, 5.0])
    array([-1.,  3., -1.])
    >>> s.exact([1.0, 2.0, 4.0], 0.0)
    array([1., 2., 4.])
    """
    moments = read_inertia(inertia)
    energy = _energy(moments)
    warn_unphysical_inertia(moments)
    return so3_body(ClassicalBody, *energy, sign=-1, name="rigid_body", parameters={"inertia": as_tuples(moments)})


def so3_body(kind: type[Kind], M: npt.NDArray[np.float64], *, sign: int, name: str, parameters: dict[str, Any]) -> Kind:
    """Return the system on so(3) with ``H = x . M x / 2``, M (3,) or (3, 3), and its closed form."""
    # Sign -1 gives the body equations, +1 the convention of Reich (1993).
    exact = partial(exact_solution, M, sign)
    return kind(rotations(), Quadratic(M), sign=sign, name=name, parameters=parameters, exact=exact)


@cache
def rotations() -> LieAlgebra:
    """Return so(3), cached: one object for all bodies."""
    return catalogue.so(3)
