"""The two examples of Reich (1993), in the convention of the paper."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.systems.bodies.rigid_body import so3_body
from coadjoint.systems.gallery_entry import GalleryEntry, Picture, points_on_sphere
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_finite, read_number


def _three(masses: npt.ArrayLike) -> tuple[float, ...]:
    values = read_finite(masses, "masses")
    if values.shape != (3,):
        raise ValueError(f"masses has shape {values.shape}; give three finite numbers, the diagonal of M")
    return tuple(values.tolist())


def _energy(masses: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    return (masses,)


@ready_made(
    energy=_energy,
    gallery_entry=GalleryEntry(
        x0=(1.0, 1.0, 1.0),
        t_span=(0.0, 20.0),
        step=0.01,
        caption="Every orbit spirals on the surface of its Casimir from one equilibrium on the third axis to the "
        "other: the third component decreases, and the other two grow and decay.",
        pictures=(Picture("coadjoint orbit"),),
        quantity="state",
    ),
)
def paper_a37(a: float = 2.0, masses: npt.ArrayLike = (1.0, 2.0, 0.01)) -> LiePoissonSystem:
    """Return example 5.1 of the paper: the algebra A3,7 with a diagonal quadratic Hamiltonian.

    ``[e1, e3] = a e1 - e2``, ``[e2, e3] = e1 + a e2`` and ``x' = J(x) M x``. Not unimodular; its Casimir,
    ``log(x1^2 + x2^2) - 2 a theta``, is multivalued. Every orbit goes from one equilibrium on the axis of x3 to the
    other, so long runs are not informative: [0, 20] from (1, 1, 1) shows the motion.

    Parameters
    ----------
    a : float
        Parameter of the algebra; any real number.
    masses : (3,)
        Diagonal of M.

    Returns
    -------
    LiePoissonSystem

    Raises
    ------
    ValueError
        Not three finite numbers.

    Notes
    -----
    Section 5.1 of Reich, "Numerical integration of the generalized Euler equations" (1993). The paper requires a > 1,
    which is not necessary, and states neither initial state nor time.

    Examples
    --------
    >>> paper_a37().vector_field([1.0, 1.0, 1.0])
    array([ 0.01,  0.03, -7.  ])
    """
    values, parameter = _three(masses), read_number(a, "a")
    return LiePoissonSystem(
        catalogue.get("A3,7", a=parameter),
        Quadratic(*_energy(np.array(values))),
        name="paper_a37",
        parameters={"a": parameter, "masses": values},
    )


@ready_made(
    energy=_energy,
    gallery_entry=GalleryEntry(
        x0=partial(points_on_sphere, 18),
        t_span=(0.0, 40.0),
        step=0.05,
        caption="Eighteen motions on the sphere of the momentum: closed curves around the axes of the largest and of "
        "the smallest moment of inertia, and between them the separatrix through the middle axis, which is "
        "unstable.",
        pictures=(
            Picture("error"),
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
def paper_rigid_body(masses: npt.ArrayLike = (1.0, 0.5, 1.0 / 3.0)) -> LiePoissonSystem:
    """Return example 5.2 of the paper: the rigid body, ``x' = (M x) cross x``, with its exact solution.

    The paper's convention (sign +1) is the body equations backward in time; the attitude satisfies
    ``A' = -A hat(M x)`` and ``A x`` is constant. For the standard body equations use `rigid_body`.

    Parameters
    ----------
    masses : (3,)
        Diagonal of M: the *inverse* moments of inertia, which the paper calls the inertia tensor.

    Returns
    -------
    LiePoissonSystem
        With ``exact(x0, t, attitude=False)`` in closed form.

    Raises
    ------
    ValueError
        Not three finite numbers.

    Notes
    -----
    Section 5.2 of Reich (1993); the paper starts from x = (1, 10, 1) and A the unit matrix, with step 0.1.

    Examples
    --------
    >>> paper_rigid_body((1.0, 0.5, 0.25)).vector_field([1.0, 2.0, 4.0])
    array([ 2., -3.,  1.])
    """
    values = _three(masses)
    return so3_body(
        LiePoissonSystem, *_energy(np.array(values)), sign=+1, name="paper_rigid_body", parameters={"masses": values}
    )
