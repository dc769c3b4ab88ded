"""The free rigid body, in the standard body equations."""

from __future__ import annotations

from fractions import Fraction
from functools import cache, partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.given import check_finite, read_numbers
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.free_rigid_body import exact_solution
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.quadratic import Quadratic
from coadjoint.systems.ready_made import ready_made

LEAST_MOMENT = 2.0**-1022


@ready_made
def rigid_body(inertia: npt.ArrayLike = (1.0, 2.0, 3.0)) -> LiePoissonSystem:
    """Return the free rigid body, ``x' = x cross (I^-1 x)``, with its exact solution.

    The standard body equations: x is the angular momentum in the body frame, ``Omega = I^-1 x`` the angular velocity,
    and the attitude A, from the body to space, follows ``A' = A hat(Omega)``, so that ``A x`` is constant. Thus so(3)
    with sign -1 and ``H = x . I^-1 x / 2``. The convention of Reich (1993) is `paper_rigid_body`.

    Parameters
    ----------
    inertia : (3,) or (3, 3)
        Principal moments of inertia, or the symmetric positive definite inertia tensor (mass times length squared).
        Moments that violate the triangle inequality, which no distribution of mass has, are not refused: other
        systems have the same equations.

    Returns
    -------
    LiePoissonSystem
        With ``exact(x0, t, attitude=False)`` in closed form.

    Raises
    ------
    ValueError
        `inertia` has another shape, or is not finite, symmetric and positive.

    Examples
    --------
    >>> s = rigid_body(inertia=(1.0, 2.0, 4.0))
    >>> s.vector_field([1.0, 2.0, 4.0])
    array([-2.,  3., -1.])
    >>> s.exact([1.0, 2.0, 4.0], 0.0)
    array([1., 2., 4.])
    """
    given = read_numbers(inertia, "inertia")
    if given.shape not in ((3,), (3, 3)):
        raise ValueError(f"inertia has shape {given.shape}; give three principal moments, or a symmetric (3, 3)")
    check_finite(given, "inertia")
    M = 1.0 / _positive_moments(given) if given.ndim == 1 else _inverse(given)
    kept: Any = tuple(given.tolist()) if given.ndim == 1 else tuple(tuple(row) for row in given.tolist())
    return so3_body(M, sign=-1, name="rigid_body", parameters={"inertia": kept})


def so3_body(M: npt.NDArray[np.float64], *, sign: int, name: str, parameters: dict[str, Any]) -> LiePoissonSystem:
    """Return the system on so(3) with ``H = x . M x / 2`` and its closed form.

    Parameters
    ----------
    M : (3,) or symmetric (3, 3)
        Inverse inertia.
    sign : {+1, -1}
        -1: body equations; +1: the convention of Reich (1993).
    name : str
        Name of the system.
    parameters : dict
        What makes it again.

    Returns
    -------
    LiePoissonSystem

    Examples
    --------
    >>> so3_body(np.array([1.0, 0.5, 0.25]), sign=1, name="body", parameters={}).sign
    1
    """
    exact = partial(exact_solution, M, sign)
    return LiePoissonSystem(_rotations(), Quadratic(M), sign=sign, name=name, parameters=parameters, exact=exact)


@cache
def _rotations() -> LieAlgebra:
    """Return so(3), which does not change, to all bodies."""
    return catalogue.so(3)


def _positive_moments(moments: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    for i, moment in enumerate(moments.tolist()):
        if moment <= 0.0:
            raise ValueError(f"inertia[{i}] is {moment:g}; every principal moment must be positive")
        if moment < LEAST_MOMENT:
            raise ValueError(f"inertia[{i}] is {moment:g}, and its inverse overflows; take larger units")
    return moments


def _inverse(tensor: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the inverse, correctly rounded from rationals: the same bits on every machine, which LAPACK's are not."""
    with np.errstate(over="ignore"):
        asymmetry = np.abs(tensor - tensor.T)
    if asymmetry.max() > 64 * UNIT_ROUNDOFF * np.abs(tensor).max():
        i, j = (int(q) for q in np.unravel_index(np.argmax(asymmetry), (3, 3)))
        raise ValueError(
            f"inertia is not symmetric: {tensor[i, j]:g} and {tensor[j, i]:g} at [{i}, {j}] and [{j}, {i}]"
        )
    q = [[Fraction(float(tensor[min(i, j), max(i, j)])) for j in range(3)] for i in range(3)]

    def cofactor(i: int, j: int) -> Fraction:
        a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
        return q[a][c] * q[b][d] - q[a][d] * q[b][c]

    determinant = sum((q[0][j] * cofactor(0, j) for j in range(3)), Fraction(0))
    if q[0][0] <= 0 or cofactor(2, 2) <= 0 or determinant <= 0:
        raise ValueError(f"inertia {tensor.tolist()} is not positive definite; every principal moment must be positive")
    try:
        return np.array([[float(cofactor(i, j) / determinant) for j in range(3)] for i in range(3)])
    except OverflowError:
        raise ValueError(f"inertia {tensor.tolist()} has an inverse that overflows; take larger units") from None
