"""Rigid bodies of n dimensions: on so(n), with Manakov's integrable energies, and as matrices for large n."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.matrix_algebra import MAX_MATRIX_SIZE, MatrixAlgebra
from coadjoint.memory import check_available_memory
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import check_symmetric_matrix, plain, read_vector, warn_negative_mass, with_change
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
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.streams import Weights
from coadjoint.systems.registry import ready_made
from coadjoint.validation import check_finite, read_finite, read_numbers

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
        parameters={"inertia": plain(values)},
        integrals=manakov_integrals(a),
    )


def _manakov_energy(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    first, second = planes(len(a))
    return ((b[first] - b[second]) / (a[first] - a[second]),)


@ready_made(
    energy=_manakov_energy,
    gallery_entry=GalleryEntry(
        x0=(1.0, 0.3, 0.2, 0.1, 0.6, 0.5),
        t_span=(0.0, 60.0),
        step=0.05,
        caption="An integrable energy on so(4), which is two copies of so(3): the momentum is two vectors of constant "
        "lengths, each on a sphere of its own (both drawn on one), and the paths fill bands with sharp edges.",
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
def manakov_top(a: npt.ArrayLike = (1.0, 2.0, 4.0, 7.0), b: npt.ArrayLike = (1.0, 3.0, 2.0, 5.0)) -> LiePoissonSystem:
    """Return Manakov's top on so(n), ``X' = [X, Omega]`` with ``Omega_ij = (b_i - b_j)/(a_i - a_j) x_ij``.

    State, sign -1 and group element are those of `so_n_body`, which is the case ``a = l^2``, ``b = l``. The energy
    ``sum of (b_i - b_j)/(a_i - a_j) x_ij^2 / 2`` need not be positive.

    The equations are equivalent to ``(X + mu a)' = [X + mu a, Omega + mu b]`` for every number mu, with a and b as
    diagonal matrices. So the coefficients of ``tr (X + mu a)^m`` are constant, and they are in involution.

    Parameters
    ----------
    a : (n,)
        Distinct numbers, n >= 3.
    b : (n,)
        Any numbers, in units such that (b_i - b_j)/(a_i - a_j) is an inverse moment of inertia.

    Returns
    -------
    LiePoissonSystem
        With the quadratic integrals ``"X^2 a"``, ``"X^2 a^2"``, ..., ``"X^2 a^(n-2)"``, ten at most, and those of
        higher degree, such as ``"X^4 a"``, up to n = 6: ``(-1)^j / m`` times the coefficient of mu^(m - 2j) of
        ``tr (X + mu a)^m`` is called X^2j a^(m - 2j). The energy is a combination of the quadratic ones and
        of ``|x|^2``.

    Raises
    ------
    ValueError
        a and b are not finite, differ in length or have fewer than three entries, two entries of a are equal, or a
        quotient or a power of a overflows.

    Notes
    -----
    Manakov, "Note on the integration of Euler's equations of the dynamics of an n-dimensional rigid body", Funct. Anal.
    Appl. 10, 328 (1976).

    Examples
    --------
    >>> top = manakov_top(a=(1.0, 2.0, 4.0, 7.0), b=(1.0, 3.0, 2.0, 5.0))
    >>> top.energy([1.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    3.0
    >>> top.integrals["X^2 a"].value([1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    14.0
    """
    a_values = read_finite(a, "a")
    if a_values.ndim != 1 or a_values.size < 3:
        raise ValueError(f"a has shape {a_values.shape}; give n numbers, n from 3")
    b_values = read_vector(b, "b", a_values.size)
    algebra = rotations(a_values.size)
    first, second = planes(a_values.size)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        (M,) = _manakov_energy(a_values, b_values)
    equal = a_values[first] == a_values[second]
    if equal.any():
        i, j = sorted((int(first[equal][0]), int(second[equal][0])))
        raise ValueError(f"a[{i}] and a[{j}] are both {a_values[i]:g}; give different numbers")
    if not np.isfinite(M).all():
        raise ValueError("a quotient (b_i - b_j)/(a_i - a_j) overflows; take smaller b, or a farther apart")
    return LiePoissonSystem(
        algebra,
        Quadratic(M),
        sign=-1,
        name="manakov_top",
        parameters={"a": tuple(a_values.tolist()), "b": tuple(b_values.tolist())},
        integrals=manakov_integrals(a_values),
    )


def _above_the_diagonal(dim: int) -> list[int]:
    n = math.isqrt(dim)
    return [n * i + j for i in range(n) for j in range(i + 1, n)][:8]


def _names(dim: int) -> tuple[str, ...]:
    n = math.isqrt(dim)
    return tuple(f"X{i},{j}" for i in range(1, n + 1) for j in range(1, n + 1))


def _in_all_planes() -> npt.NDArray[np.float64]:
    X = np.zeros((5, 5))
    X[np.triu_indices(5, 1)] = np.cos(np.arange(10.0))
    return X - X.T


@ready_made(
    gallery_entry=GalleryEntry(
        x0=_in_all_planes,
        t_span=(0.0, 60.0),
        step=0.05,
        caption="A body of five dimensions turns in all planes at once, with several frequencies. Its momentum is a "
        "matrix that turns, so its eigenvalues are constant.",
        pictures=(Picture("eigenvalues"),),
        components=Picture("components", chosen=_above_the_diagonal),
        coordinates=_names,
        quantity="angular momentum",
    )
)
def matrix_body(inertia: npt.ArrayLike = (1.0, 2.0, 3.0, 4.0, 5.0)) -> MatrixSystem:
    """Return the free rigid body of n dimensions, ``X' = [X, Omega]``, its momentum X a skew (n, n) matrix.

    ``Omega_ij = X_ij / (l_i + l_j)`` is the angular velocity in the body frame. Choose it instead of `so_n_body` if the
    structure constants of so(n), about n^3 of them, need too much memory, or to preserve the spectrum: steps use
    products of matrices.

    Parameters
    ----------
    inertia : (n,)
        Second moments l of the mass along the principal axes (mass times length squared), n >= 2. The sum of any two
        must be positive.

    Returns
    -------
    MatrixSystem
        On so(n). Energy ``tr(Omega^T X)/2``, the sum over planes of ``X_ij Omega_ij``: twice that of `so_n_body`.
        Casimirs tr X^2, tr X^4, ...

    Raises
    ------
    ValueError
        `inertia` has the wrong shape or is not finite, or the sum of two moments is not positive.

    Warns
    -----
    UserWarning
        A second moment is negative, which is impossible for a distribution of mass.

    Notes
    -----
    Manakov, Funct. Anal. Appl. 10, 328 (1976); Ratiu, Indiana Univ. Math. J. 29, 609 (1980).

    Examples
    --------
    >>> body = matrix_body((1.0, 1.0, 3.0, 7.0))
    >>> X = np.zeros((4, 4))
    >>> X[0, 1] = X[2, 3] = 1.0
    >>> body.energy(X - X.T)
    0.6
    """
    values = read_finite(inertia, "inertia")
    if values.ndim != 1 or not 2 <= len(values) <= MAX_MATRIX_SIZE:
        raise ValueError(f"inertia has shape {values.shape}; give n principal values, n from 2 to {MAX_MATRIX_SIZE}")
    if np.sort(values)[:2].sum() <= 0.0:
        raise ValueError(f"inertia is {short(values.tolist())}; the sum of any two moments must be positive")
    with np.errstate(over="ignore", divide="ignore"):
        sums = np.add.outer(values, values)
        # The diagonal has no effect: that of X is zero.
        np.fill_diagonal(sums, np.inf)
        inverse = -1.0 / sums
    if not (np.isfinite(sums) | np.eye(len(values), dtype=bool)).all() or not np.isfinite(inverse).all():
        raise ValueError("sums of two moments of inertia or their inverses leave the range of float64; change units")
    warn_negative_mass(values)
    parameters = {"inertia": tuple(values.tolist())}
    algebra = MatrixAlgebra("so", len(values))
    return MatrixSystem(algebra, Weights(inverse), energy_sign=-1, name="matrix_body", parameters=parameters)
