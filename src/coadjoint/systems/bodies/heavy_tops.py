"""Heavy tops, rigid bodies with a fixed point under gravity, and the integrable ones among them."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.bodies.inertia import (
    axis_of_symmetry,
    inverse_of,
    momentum_along,
    principal,
    read_inertia,
    read_moment,
    read_vector,
    warn_unphysical_inertia,
)
from coadjoint.systems.bodies.rigid_body import ClassicalBody
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples, read_number

Floats = npt.NDArray[np.float64]

AXIS_IN_SPACE = Picture("body axis", axis=2, up=(3, 4, 5), vertical="vertical")
VERTICAL_IN_BODY = Picture(
    "directions", vectors={r"vertical $\gamma$": (3, 4, 5)}, title="the vertical, seen from the body"
)

TOP = {"m": ("momentum", "mass length^2/time"), "gamma": ("direction", "1")}
"""Kinds and units of the coordinates of a top."""


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
    coordinates=TOP,
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
    moments, w = read_inertia(inertia, centred=False), read_vector(lever, "lever")
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


rigid_motions = cache(catalogue.e)  # one object for all tops and bodies in fluids, also if none is in use


def _lagrange_energy(equatorial: Any, axial: Any, lever: Any) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    moments = np.array([equatorial, equatorial, axial])
    return energy_under_gravity(1.0 / moments, np.array([0.0, 0.0, lever]))


@ready_made(
    energy=_lagrange_energy,
    coordinates=TOP,
    gallery_entry=entry_of_top(
        x0=(0.0, 0.0, 3.0, 0.8660254037844386, 0.0, 0.5),
        t_span=(0.0, 24.0),
        caption="Released with its axis at rest, inclined by 60 degrees: the axis nutates between cusps, in which "
        "it is at rest, and precesses about the vertical.",
        pictures=(Picture("nutation", axis=2, up=(3, 4, 5)), AXIS_IN_SPACE),
    ),
)
def lagrange_top(equatorial: float = 1.0, axial: float = 0.5, lever: float = 1.0) -> ClassicalBody:
    """Return Lagrange's top: a heavy top with ``I1 = I2`` and the centre of mass on the third axis.

    State, sign -1, Casimirs and group element are those of `heavy_top`. The momentum along the axis, m3, is an
    integral, so the motion is integrable. The upright position is stable (a sleeping top) if
    ``m3^2 > 4 equatorial lever``. For other axes use `heavy_top`.

    Parameters
    ----------
    equatorial, axial : float
        Moments of inertia about the fixed point (mass times length squared): across the axis and about it. Positive.
    lever : float
        Weight times the distance of the centre of mass along the axis (an energy); negative if the centre of mass is
        below the fixed point when the axis points up.

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        With the integral ``"m3"``.

    Raises
    ------
    ValueError
        A moment is not positive, or a number not finite.

    Warns
    -----
    UserWarning
        The axial moment exceeds twice the equatorial one, which is impossible for a body.

    Notes
    -----
    Lagrange, "Mechanique analitique" (1788); Audin, "Spinning Tops" (1996), chapter II.

    Examples
    --------
    >>> top = lagrange_top(equatorial=1.0, axial=0.5, lever=2.0)
    >>> top.energy([1.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    3.5
    >>> top.integrals
    {'m3': m3}
    """
    parameters = {
        "equatorial": read_moment(equatorial, "equatorial"),
        "axial": read_moment(axial, "axial"),
        "lever": read_number(lever, "lever"),
    }
    across, along = parameters["equatorial"], parameters["axial"]
    warn_unphysical_inertia((across, across, along), "e(3)", "axial")
    return top_under_gravity(_lagrange_energy(**parameters), "lagrange_top", parameters)


def _energy_off_axis(ratio: float, equatorial: Any, lever: Any) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the energy of a top with ``I1 = I2`` and I3 = `ratio` I1, the centre of mass in the equatorial plane."""
    return energy_under_gravity(1.0 / equatorial / np.array((1.0, 1.0, ratio)), np.array([lever[0], lever[1], 0.0]))


def _read_off_axis(ratio: float, equatorial: Any, lever: Any) -> dict[str, Any]:
    moment = read_moment(equatorial, "equatorial", ratio)
    u, v = read_vector(lever, "lever", 2).tolist()
    return {"equatorial": moment, "lever": (u, v)}


@ready_made(
    energy=partial(_energy_off_axis, 0.5),
    coordinates=TOP,
    gallery_entry=entry_of_top(
        x0=(1.0, 0.5, 1.5, 0.6, 0.0, 0.8),
        t_span=(0.0, 60.0),
        caption="An integrable top: the motion is quasi-periodic on a torus of two dimensions, which the "
        "paths of the third axis in space (middle) and of the vertical, seen from the body (right), begin to fill.",
    ),
)
def kovalevskaya_top(equatorial: float = 2.0, lever: npt.ArrayLike = (1.0, 0.0)) -> ClassicalBody:
    """Return Kovalevskaya's top: a heavy top with ``I1 = I2 = 2 I3``, the centre of mass in the plane of axes 1, 2.

    State, sign -1, Casimirs and group element are those of `heavy_top`. It is the third and last integrable heavy top,
    with the integral ``K = |(m1 + i m2)^2 / (2 I1) - (l1 + i l2)(gamma1 + i gamma2)|^2``. For other axes use
    `heavy_top`.

    Parameters
    ----------
    equatorial : float
        Moment of inertia I1 = I2 about the fixed point (mass times length squared), positive; I3 is half of it.
    lever : (2,)
        Weight times the position of the centre of mass along the axes 1 and 2 (an energy).

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        With the integral ``"K"`` (energy squared).

    Raises
    ------
    ValueError
        The moment is not positive, or `lever` is not two finite numbers.

    Notes
    -----
    Kowalevski, "Sur le probleme de la rotation d'un corps solide autour d'un point fixe", Acta Mathematica 12 (1889).

    Examples
    --------
    >>> top = kovalevskaya_top(equatorial=2.0, lever=(1.0, 0.0))
    >>> top.vector_field([2.0, 4.0, 3.0, 1.0, 3.0, 4.0])
    array([ 6.,  1., -3.,  1.,  1., -1.])
    >>> top.integrals["K"]([2.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    1.0
    """
    parameters = _read_off_axis(0.5, equatorial, lever)
    return top_under_gravity(_energy_off_axis(0.5, **parameters), "kovalevskaya_top", parameters)


@ready_made(
    energy=partial(_energy_off_axis, 0.25),
    coordinates=TOP,
    gallery_entry=entry_of_top(
        x0=(0.0, 4.0, 3.0, 0.6, -0.48, 0.64),
        t_span=(0.0, 60.0),
        caption="Without angular momentum about the vertical the top is integrable: the vertical, seen from the body "
        "(right), moves within a band of its sphere.",
    ),
)
def goryachev_chaplygin_top(equatorial: float = 4.0, lever: npt.ArrayLike = (1.0, 0.0)) -> ClassicalBody:
    """Return the Goryachev-Chaplygin top: ``I1 = I2 = 4 I3``, the centre of mass in the plane of axes 1 and 2.

    State, sign -1, Casimirs and group element are those of `heavy_top`. It is integrable only if the vertical momentum
    m . gamma is zero. Its additional integral is therefore not in ``integrals``, which hold for all states:
    `coadjoint.systems.bodies.heavy_tops.goryachev_chaplygin_integral` returns it, for ``observe``.

    Parameters
    ----------
    equatorial : float
        Moment of inertia I1 = I2 about the fixed point (mass times length squared), positive; I3 is a quarter of it.
    lever : (2,)
        Weight times the position of the centre of mass along the axes 1 and 2 (an energy).

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.

    Raises
    ------
    ValueError
        The moment is not positive, or `lever` is not two finite numbers.

    Notes
    -----
    Goryachev, Mat. Sbornik 21 (1900); Chaplygin, Trudy Otd. Fiz. Nauk 12 (1904); Audin, "Spinning Tops" (1996).

    Examples
    --------
    >>> top = goryachev_chaplygin_top(equatorial=4.0, lever=(1.0, 0.0))
    >>> top.vector_field([4.0, 8.0, 3.0, 1.0, 3.0, 4.0])
    array([18., -5., -3.,  1.,  1., -1.])
    """
    parameters = _read_off_axis(0.25, equatorial, lever)
    return top_under_gravity(_energy_off_axis(0.25, **parameters), "goryachev_chaplygin_top", parameters)


def goryachev_chaplygin_integral(equatorial: float = 4.0, lever: npt.ArrayLike = (1.0, 0.0)) -> Polynomial:
    """Return ``m3 (m1^2 + m2^2) / I1 - gamma3 (l1 m1 + l2 m2)``, an integral of the top if m . gamma is zero.

    Otherwise it changes at the rate ``(l2 m1 - l1 m2)(m . gamma) / I1``.

    Parameters
    ----------
    equatorial : float
        As for `goryachev_chaplygin_top`.
    lever : (2,)
        As for `goryachev_chaplygin_top`.

    Returns
    -------
    Polynomial
        In six coordinates.

    Raises
    ------
    ValueError
        As for `goryachev_chaplygin_top`.

    Examples
    --------
    >>> goryachev_chaplygin_integral()
    -x1*x6 + 0.25*x1^2*x3 + 0.25*x2^2*x3
    """
    parameters = _read_off_axis(0.25, equatorial, lever)
    size, (u, v) = parameters["equatorial"], parameters["lever"]
    m1, m2, m3, gamma3 = (Polynomial.variable(i, 6) for i in (0, 1, 2, 5))
    return 1.0 / size * (m3 * (m1**2 + m2**2)) - gamma3 * (u * m1 + v * m2)
