"""Rigid bodies that move in an ideal fluid: Kirchhoff's equations, and the integrable case of Clebsch."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.bodies.heavy_tops import rigid_motions
from coadjoint.systems.bodies.inertia import inverse_of, positive_moments, principal, read_inertia, read_vector
from coadjoint.systems.bodies.rigid_body import ClassicalBody
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples, read_finite

Floats = npt.NDArray[np.float64]


def _kirchhoff_energy(
    inertia: npt.NDArray[Any], mass: npt.NDArray[Any], coupling: npt.NDArray[Any]
) -> tuple[npt.NDArray[Any]]:
    matrix = np.zeros((6, 6), dtype=np.result_type(inertia, mass, coupling))
    coupled = coupling.any()
    for block, values, what in ((slice(0, 3), inertia, "inertia"), (slice(3, 6), mass, "mass")):
        values = values if coupled else inverse_of(values, what)
        matrix[block, block] = np.diag(values) if values.ndim == 1 else values
    if coupled:
        matrix[:3, 3:], matrix[3:, :3] = coupling, coupling.T
        matrix = inverse_of(matrix, "the matrix of inertia, coupling and mass")
    return (matrix,)


@ready_made(
    energy=_kirchhoff_energy,
    symmetric=("inertia", "mass"),
    gallery_entry=GalleryEntry(
        x0=(0.5, 1.5, 1.0, 0.8, 0.1, 0.1),
        t_span=(0.0, 40.0),
        step=0.02,
        caption="A body pushed through a fluid along its light axis turns broadside on: it flutters and tumbles about "
        "the direction of its impulse. Middle, its path, with its first axis; right, that axis in space, the "
        "impulse upward.",
        pictures=(
            Picture("path in space", axis=0),
            Picture("body axis", axis=0, up=(3, 4, 5), vertical="impulse"),
        ),
        components=Picture("components", chosen=(0, 1, 2), quantity="angular impulse"),
        attitude=True,
        coordinates=("m1", "m2", "m3", "p1", "p2", "p3"),
        quantity="impulses",
    ),
)
def kirchhoff_body(
    inertia: npt.ArrayLike = (1.0, 2.0, 3.0),
    mass: npt.ArrayLike = (1.5, 2.5, 2.0),
    coupling: npt.ArrayLike = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
) -> ClassicalBody:
    """Return a body in a fluid at rest at infinity, ``m' = m cross Omega + p cross v``, ``p' = p cross Omega``.

    The first three coordinates are the angular impulse m of body and fluid together, the last three the linear impulse
    p, both in the body frame. They are related to the velocities Omega (angular) and v (linear) by
    ``m = inertia Omega + coupling v`` and ``p = coupling^T Omega + mass v``. The algebra is e(3) with the body sign,
    -1, and ``H = (m . Omega + p . v) / 2``. A full 6 x 6 matrix K of inertia is given by its blocks:
    ``inertia=K[:3, :3]``, ``coupling=K[:3, 3:]``, ``mass=K[3:, 3:]``.

    The group element g is a matrix of SE(3), ``g' = g rho(Omega, v)``. Its block ``A = g[:3, :3]`` is the attitude,
    from the body to space. Its column ``r = g[:3, 3]`` is the position of the origin of the body, ``r' = A v``. The
    impulses ``A p`` and ``A m + r cross A p`` are constant.

    Parameters
    ----------
    inertia : (3,) or (3, 3)
        Moments of inertia including added inertia of the fluid, a diagonal or a symmetric matrix (mass times length
        squared). One may exceed the sum of the other two, as for a long thin plate.
    mass : (3,) or (3, 3)
        Mass including added mass of the fluid, which depends on the direction: a diagonal or a symmetric matrix.
    coupling : (3, 3), optional
        Coupling of rotation and translation (mass times length); zero for a body with three planes of symmetry.

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        Casimirs ``"|p|^2"`` and ``"m.p"``. A body of revolution about a coordinate axis, without coupling, also
        preserves the angular impulse along the axis, such as ``"m3"``.

    Raises
    ------
    ValueError
        A block has the wrong shape or is not finite, `inertia` or `mass` is not symmetric, or the full matrix is not
        positive definite.

    Notes
    -----
    Kirchhoff, Crelle 71 (1870); Lamb, "Hydrodynamics" (1932), chapter VI; Leonard, Automatica 33, 331 (1997).

    Examples
    --------
    >>> body = kirchhoff_body(inertia=(1.0, 2.0, 4.0), mass=(1.0, 2.0, 4.0))
    >>> body.vector_field([1.0, 2.0, 4.0, 2.0, 4.0, 8.0])
    array([-10.,  15.,  -5.,  -4.,   6.,  -2.])
    >>> kirchhoff_body(inertia=(1, 1, 2), mass=(2, 2, 1)).integrals
    {'m3': m3}
    """
    moments, masses = read_inertia(inertia, centred=False), read_inertia(mass, "mass")
    B = read_finite(coupling, "coupling")
    if B.shape != (3, 3):
        raise ValueError(f"coupling has shape {B.shape}; give a finite (3, 3)")
    if B.any():
        inverse_of(moments, "inertia"), inverse_of(masses, "mass")  # raise an error that names the block
    (matrix,) = _kirchhoff_energy(moments, masses, B)
    return ClassicalBody(
        rigid_motions(),
        Quadratic(matrix),
        sign=-1,
        name="kirchhoff_body",
        parameters={"inertia": as_tuples(moments), "mass": as_tuples(masses), "coupling": as_tuples(B)},
        integrals={} if B.any() else _of_revolution(matrix[:3, :3], matrix[3:, 3:]),
    )


def _of_revolution(A: Floats, C: Floats) -> dict[str, Polynomial]:
    """Return the angular impulse along each coordinate axis that is an axis of revolution."""
    a, c = principal(A), principal(C)
    if a is None or c is None:
        return {}
    pairs = ((k, (k + 1) % 3, (k + 2) % 3) for k in range(3))
    return {f"m{k + 1}": Polynomial.variable(k, 6) for k, i, j in pairs if a[i] == a[j] and c[i] == c[j]}


def _clebsch_energy(inverse_mass: npt.NDArray[Any], *, inertia: npt.ArrayLike) -> tuple[npt.NDArray[Any]]:
    if len(set(np.asarray(inertia).tolist())) > 1:
        raise ValueError("moments that are not equal tie the coefficients to each other")
    return (_diagonal_of(inertia, inverse_mass),)


def _diagonal_of(inertia: npt.ArrayLike, inverse_mass: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.concatenate([1.0 / np.asarray(inertia), inverse_mass])


@ready_made(
    energy=_clebsch_energy,
    gallery_entry=GalleryEntry(
        x0=(0.6, 0.4, 1.0, 0.5, 0.3, 0.2),
        t_span=(0.0, 60.0),
        step=0.05,
        caption="An integrable body in a fluid: its path winds regularly about the direction of its impulse. Middle, "
        "the path, with the first axis of the body; right, the impulse, seen from the body.",
        pictures=(
            Picture("path in space", axis=0),
            Picture("directions", vectors={"impulse $p$": (3, 4, 5)}, title="the impulse, seen from the body"),
        ),
        components=Picture("components", chosen=(0, 1, 2), quantity="angular impulse"),
        attitude=True,
        coordinates=("m1", "m2", "m3", "p1", "p2", "p3"),
        quantity="impulses",
    ),
)
def clebsch_body(
    inertia: npt.ArrayLike = (1.0, 1.0, 1.0), inverse_mass: npt.ArrayLike = (1.0, 1.5, 3.0)
) -> ClassicalBody:
    """Return the Clebsch case of Kirchhoff's equations, ``H = sum(m_i^2 / I_i + c_i p_i^2) / 2``, on e(3) with sign -1.

    State, Casimirs and group element are those of `kirchhoff_body`. The system is integrable if
    ``(c2 - c3) I1 + (c3 - c1) I2 + (c1 - c2) I3 = 0``: for any c if all moments are equal, otherwise for
    ``c_i = alpha + beta I_i``. The same equations describe a body with a fixed point in a quadratic potential
    (Brun): p is then the direction of the field, c may have any sign, and the translation in the group element is not
    a position.

    Parameters
    ----------
    inertia : (3,)
        Principal moments (mass times length squared), positive.
    inverse_mass : (3,)
        The coefficients c (1/mass), of any sign.

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        With the integral ``"F"``: ``sum(c_i m_i^2 - I c_j c_k p_i^2)`` if all moments are equal, otherwise
        ``sum(m_i^2 - beta I_j I_k p_i^2)``, (i, j, k) cyclic.

    Raises
    ------
    ValueError
        Not three finite numbers each, a moment that is not positive, or coefficients that do not satisfy the Clebsch
        condition; the message gives the nearest that do.

    Notes
    -----
    Clebsch, Math. Annalen 3, 238 (1870); Perelomov, "Integrable Systems of Classical Mechanics" (1990), section 3.2.

    Examples
    --------
    >>> body = clebsch_body(inertia=(1.0, 2.0, 4.0), inverse_mass=(1.0, 2.0, 4.0))
    >>> body.vector_field([1.0, 2.0, 4.0, 2.0, 1.0, 3.0])
    array([  4., -15.,   1.,  -2.,   1.,   1.])
    >>> clebsch_body(inertia=(1, 2, 3), inverse_mass=(1, 1, 2))
    Traceback (most recent call last):
    ValueError: inverse_mass is not a Clebsch case: ... the nearest valid values are 0.833333, 1.33333, 1.83333; ...
    """
    moments = tuple(positive_moments(read_vector(inertia, "inertia"), "inertia").tolist())
    c = read_vector(inverse_mass, "inverse_mass")
    try:
        integral = _integral([Fraction(v) for v in moments], [Fraction(v) for v in c.tolist()])
    except OverflowError:
        raise ValueError("products of inertia and inverse_mass leave the range of float64; take other units") from None
    return ClassicalBody(
        rigid_motions(),
        Quadratic(_diagonal_of(moments, c)),
        sign=-1,
        name="clebsch_body",
        parameters={"inertia": moments, "inverse_mass": tuple(c.tolist())},
        integrals={"F": integral},
    )


def _integral(I: list[Fraction], c: list[Fraction]) -> Quadratic:
    """Return the additional integral; raise ValueError if the moments and coefficients are not a Clebsch case."""
    pairs = ((1, 2), (2, 0), (0, 1))
    if I[0] == I[1] == I[2]:
        return _diagonal([2 * v for v in c], [-2 * I[0] * c[j] * c[k] for j, k in pairs])
    terms = [(c[j] - c[k]) * I[i] for i, (j, k) in enumerate(pairs)]
    mean = sum(I, Fraction(0)) / 3
    beta = sum((v * (w - mean) for v, w in zip(c, I, strict=True)), Fraction(0)) / sum((w - mean) ** 2 for w in I)
    alpha = sum(c, Fraction(0)) / 3 - beta * mean
    size = sum(abs(v * (abs(I[j]) + abs(I[k]))) for v, (j, k) in zip(c, pairs, strict=True))
    defect = sum(terms, Fraction(0))
    if abs(defect) > 8 * UNIT_ROUNDOFF * size:
        nearest = ", ".join(f"{float(alpha + beta * w):.6g}" for w in I)
        raise ValueError(
            f"inverse_mass is not a Clebsch case: (c2 - c3) I1 + (c3 - c1) I2 + (c1 - c2) I3 is {float(defect):.3g} "
            f"and must vanish; the nearest valid values are {nearest}; otherwise use kirchhoff_body"
        )
    return _diagonal([Fraction(2)] * 3, [-2 * beta * I[j] * I[k] for j, k in pairs])


def _diagonal(of_m: list[Fraction], of_p: list[Fraction]) -> Quadratic:
    return Quadratic([float(v) for v in (*of_m, *of_p)])
