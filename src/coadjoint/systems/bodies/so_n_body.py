"""The free rigid body of n dimensions, on so(n)."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import check_symmetric_matrix, warn_negative_mass, with_change
from coadjoint.systems.closed_forms.manakov_integrals import (
    halves_of_so4,
    inverse_of_form,
    manakov_integrals,
    planes,
    rotations,
    trace_form,
)
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples, check_finite, read_numbers

BYTES_PER_ENTRY = 500  # for a matrix of fractions with its inverse


def _energy(inertia: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    if inertia.ndim == 1:
        first, second = planes(len(inertia))
        return (1.0 / (inertia[first] + inertia[second]),)
    inverse = inverse_of_form(trace_form(_exact(inertia.real), 1))
    return (with_change(inverse, trace_form(inertia.imag, 1)) if inertia.dtype.kind == "c" else inverse,)


def _exact(matrix: npt.NDArray[np.float64]) -> npt.NDArray[Any]:
    return np.array([[Fraction(entry) for entry in row] for row in matrix.tolist()], dtype=object)


@ready_made(
    energy=_energy,
    symmetric=("inertia",),
    gallery_entry=GalleryEntry(
        x0=(1.0, 0.3, 0.2, 0.1, 0.6, 0.5),
        t_span=(0.0, 200.0),
        step=0.1,
        caption="A body of four dimensions: so(4) is two copies of so(3), so its momentum is two vectors of constant "
        "lengths, each on a sphere of its own (both drawn on one). Together they fill a torus: the motion is "
        "integrable.",
        pictures=(
            Picture(
                "directions",
                vectors={"self-dual part": halves_of_so4(1.0), "anti-self-dual part": halves_of_so4(-1.0)},
                title="so(4) as two spheres: the directions of both parts",
            ),
        ),
        coordinates=lambda dim: ("x12", "x13", "x14", "x23", "x24", "x34") if dim == 6 else (),
        quantity="angular momentum",
    ),
)
def so_n_body(inertia: npt.ArrayLike = (1.0, 2.0, 3.0, 4.0)) -> LiePoissonSystem:
    """Return the free rigid body of n dimensions, ``X' = [X, Omega]`` with ``X = Lambda Omega + Omega Lambda``.

    X is the angular momentum in the body frame, a skew n x n matrix, and Omega the angular velocity. The state consists
    of the coordinates of X in the basis of so(n), for the planes 12, 13, ..., 1n, 23, ...; for n = 3 it is the vector
    along the axes. Sign -1, the body equations, and ``H = sum of x_ij Omega_ij / 2`` over the planes. For principal
    axes ``Omega_ij = x_ij / (l_i + l_j)``, so for n = 3 it is `rigid_body` with the moments l2 + l3, l3 + l1, l1 + l2.

    The group element g is the attitude, a rotation of n-dimensional space from the body to space; ``g X g^T`` is
    constant.

    Parameters
    ----------
    inertia : (n,) or (n, n)
        Second moments of the mass along the principal axes, or the symmetric matrix of them, Lambda (mass times length
        squared), n >= 3. The sum of any two principal values must be positive. A full matrix is inverted in rational
        arithmetic, which takes minutes from about n = 20: give principal values then.

    Returns
    -------
    LiePoissonSystem
        Casimirs of so(n). Manakov's integrals with ``a = Lambda^2``, such as ``"X^2 a"``; see `manakov_top`. The energy
        is a linear combination of the quadratic ones and ``|x|^2``.

    Raises
    ------
    ValueError
        `inertia` has the wrong shape, is not finite or not symmetric, or a sum of two principal values is not positive.

    Warns
    -----
    UserWarning
        A principal value is negative, which is impossible for a distribution of mass.

    Notes
    -----
    Manakov, Funct. Anal. Appl. 10, 328 (1976); Ratiu, Indiana Univ. Math. J. 29, 609 (1980).

    Examples
    --------
    >>> body = so_n_body((1.0, 1.0, 3.0, 7.0))
    >>> body.energy([1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    0.3
    >>> list(body.integrals)
    ['X^2 a', 'X^2 a^2']
    """
    values = read_numbers(inertia, "inertia")
    if values.ndim not in (1, 2) or values.shape[0] < 3 or values.shape != values.shape[:1] * values.ndim:
        raise ValueError(f"inertia has shape {values.shape}; give n principal values, or a symmetric (n, n), n from 3")
    check_finite(values, "inertia")
    n = len(values)
    if values.ndim == 2:
        check_symmetric_matrix(values, "inertia")
        values = np.triu(values) + np.triu(values, 1).T
    smallest = np.sort(values if values.ndim == 1 else np.linalg.eigvalsh(values))[:2]
    with np.errstate(over="ignore"):
        least_sum = smallest.sum()
    if least_sum <= (0.0 if values.ndim == 1 else 4 * n * UNIT_ROUNDOFF * np.abs(values).max()):
        raise ValueError(f"inertia has the principal values {short(smallest.tolist())}; their sum must be positive")
    warn_negative_mass(values)
    algebra = rotations(n)
    if values.ndim == 1:
        first, second = planes(n)
        with np.errstate(over="ignore", divide="ignore"):
            sums = values[first] + values[second]
            (M,), a = _energy(values), values**2
        if not (np.isfinite(sums).all() and np.isfinite(M).all()):
            raise ValueError(
                "sums of two principal values of inertia or their inverses leave the range of float64; change units"
            )
    else:
        need = BYTES_PER_ENTRY * algebra.dim**2
        check_available_memory(need, f"the inverse of an inertia of dimension {n}", "give principal values")
        (M,), a = _energy(values), _exact(values) @ _exact(values)
    return LiePoissonSystem(
        algebra,
        Quadratic(M),
        sign=-1,
        name="so_n_body",
        parameters={"inertia": as_tuples(values)},
        integrals=manakov_integrals(a),
    )
