"""The heavy top: a rigid body with a fixed point, under gravity."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
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
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples

Floats = npt.NDArray[np.float64]

AXIS_IN_SPACE = Picture("body axis", axis=2, up=(3, 4, 5), vertical="vertical")
VERTICAL_IN_BODY = Picture(
    "directions", vectors={r"vertical $\gamma$": (3, 4, 5)}, title="the vertical, seen from the body"
)


def entry_of_top(
    x0: tuple[float, ...],
    t_span: tuple[float, float],
    caption: str,
    pictures: tuple[Picture, ...] = (AXIS_IN_SPACE, VERTICAL_IN_BODY),
) -> GalleryEntry:
    """Return the gallery entry of a top, whose state is its momentum and the vertical."""
    return GalleryEntry(
        x0=x0,
        t_span=t_span,
        step=0.02,
        caption=caption,
        pictures=pictures,
        components=Picture("components", chosen=(0, 1, 2), quantity="angular momentum"),
        attitude=True,
        coordinates=("m1", "m2", "m3", "gamma1", "gamma2", "gamma3"),
        quantity="momentum and vertical",
    )


def energy_under_gravity(M: npt.NDArray[Any], lever: Any) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the matrix and the linear part of the energy of a top, from the inverse inertia, (3,) or (3, 3)."""
    matrix = np.zeros((6, 6), dtype=M.dtype)
    matrix[:3, :3] = M if M.ndim == 2 else np.diag(M)
    return matrix, np.concatenate([np.zeros(3), lever])


def _energy(inertia: npt.NDArray[Any], lever: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    return energy_under_gravity(inverse_of(inertia, "inertia"), lever)


@ready_made(
    energy=_energy,
    symmetric=("inertia",),
    gallery_entry=entry_of_top(
        x0=(0.3, 0.2, 3.0, 0.6, 0.0, 0.8),
        t_span=(0.0, 40.0),
        caption="A top without symmetry, with its centre of mass off every axis: the path of its third axis has no "
        "repeating pattern. Middle, the axis in space; right, the vertical, seen from the body.",
    ),
)
def heavy_top(inertia: npt.ArrayLike = (1.0, 2.0, 2.5), lever: npt.ArrayLike = (0.75, 0.5, 1.0)) -> ClassicalBody:
    """Return a heavy top, ``m' = m cross Omega + gamma cross lever``, ``gamma' = gamma cross Omega``.

    The first three coordinates are the angular momentum m about the fixed point, in the body frame, with
    ``Omega = I^-1 m``; the last three are gamma, the upward vertical in that frame, of length 1. The algebra is e(3)
    with the body sign, -1, and ``H = m . I^-1 m / 2 + lever . gamma``.

    The group element g is a matrix of SE(3), ``g' = g rho(Omega, lever)``. Its block ``A = g[:3, :3]`` is the attitude,
    from the body to space, so that ``A gamma`` is constant. Its column ``r = g[:3, 3]`` is not a position: the fixed
    point does not move. It is the integral of ``A lever`` over time, so ``r cross A gamma`` is minus the angular
    impulse of gravity, and ``A m + r cross A gamma`` is constant.

    A top with reaction wheels or sampled controllers is `body` with gravity as a ``co.forces.Torque`` of (x, A), the
    cross product of A[2] and the lever.

    Parameters
    ----------
    inertia : (3,) or (3, 3)
        Principal moments about the fixed point, or the symmetric positive definite tensor (mass times length squared).
    lever : (3,)
        Weight times the position of the centre of mass from the fixed point, in the body frame (an energy).

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        Casimirs: ``"|p|^2"``, the squared length of gamma, and ``"m.p"``, the vertical angular momentum m . gamma.
        Integrals for the parameters of Lagrange's top about any axis (the momentum along it, such as ``"m3"``), or of
        Kovalevskaya's top in any order of the axes (``"K"``).

    Raises
    ------
    ValueError
        `inertia` has another shape, or is not finite, symmetric and positive; `lever` is not three finite numbers.

    Warns
    -----
    UserWarning
        A principal moment exceeds the sum of the other two, which is impossible for a body.

    Notes
    -----
    If gravity is weak, ``Splitting(parts="free_body")`` has the free body as one part and gravity as the other: its
    error is proportional to gravity. At equal cost it is more accurate up to potential energies comparable to the
    rotational energy.

    Marsden and Ratiu, "Introduction to Mechanics and Symmetry" (1999), section 15.10; Audin, "Spinning Tops" (1996).

    Examples
    --------
    >>> top = heavy_top(inertia=(1.0, 2.0, 2.5), lever=(0.0, 0.0, 1.0))
    >>> top.vector_field([1.0, 2.0, 5.0, 2.0, 3.0, 1.0])
    array([ 2.,  1., -1.,  5., -3., -1.])
    >>> heavy_top(inertia=(2.0, 1.0, 1.0), lever=(3.0, 0.0, 0.0)).integrals
    {'m1': m1}
    """
    moments, w = read_inertia(inertia), read_vector(lever, "lever")
    energy = _energy(moments, w)
    warn_unphysical_inertia(moments, "e(3)")
    return top_under_gravity(energy, "heavy_top", {"inertia": as_tuples(moments), "lever": tuple(w.tolist())})


def top_under_gravity(energy: tuple[Floats, Floats], name: str, parameters: dict[str, Any]) -> ClassicalBody:
    """Return the top on e(3) with an energy of `energy_under_gravity`, with its integrals."""
    H, M, lever = Quadratic(*energy), energy[0][:3, :3], energy[1][3:]
    integrals = momentum_along(axis_of_symmetry(M, lever), "m", 6)
    K = kovalevskaya_integral(M, lever)
    if K is not None:
        integrals["K"] = K
    return ClassicalBody(rigid_motions(), H, sign=-1, name=name, parameters=parameters, integrals=integrals)


def kovalevskaya_integral(M: npt.NDArray[np.float64], lever: npt.NDArray[np.float64]) -> Polynomial | None:
    """Return ``|(m_a + i m_b)^2 / (2 A) - (l_a + i l_b)(gamma_a + i gamma_b)|^2`` in six coordinates, or None."""
    # The top has it if M is 1/A, 1/A and 2/A along coordinates a, b, c, and the lever is orthogonal to c.
    m = principal(M)
    if m is None:
        return None
    for c in range(3):
        a, b = (c + 1) % 3, (c + 2) % 3
        if m[a] == m[b] and m[c] == 2.0 * m[a] and lever[c] == 0.0:
            half, u, v = 0.5 * float(m[a]), float(lever[a]), float(lever[b])
            ma, mb, ga, gb = (Polynomial.variable(i, 6) for i in (a, b, a + 3, b + 3))
            real = half * (ma**2 - mb**2) - (u * ga - v * gb)
            imaginary = 2.0 * half * ma * mb - (u * gb + v * ga)
            return real**2 + imaginary**2
    return None


@cache
def rigid_motions() -> LieAlgebra:
    """Return e(3), cached: one object for all tops and bodies in fluids."""
    return catalogue.e(3)
