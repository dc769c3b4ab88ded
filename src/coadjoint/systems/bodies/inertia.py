"""Moments of inertia: validation of principal moments or a tensor, and their correctly rounded inverse."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.validation import check_finite, read_finite, read_number, read_numbers

MIN_MOMENT = 2.0**-1022


def inverse_inertia(inertia: npt.ArrayLike, what: str = "inertia") -> tuple[npt.NDArray[np.float64], Any]:
    """Return the inverse inertia M, (3,) or (3, 3), and the inertia as a tuple, from principal moments or a tensor.

    `what` is the name in messages. Raises ValueError unless symmetric and positive definite with a finite inverse.

    Examples
    --------
    >>> inverse_inertia((1, 2, 4))
    (array([1.  , 0.5 , 0.25]), (1.0, 2.0, 4.0))
    """
    given = read_numbers(inertia, what)
    if given.shape not in ((3,), (3, 3)):
        raise ValueError(f"{what} has shape {given.shape}; give three principal moments, or a symmetric (3, 3)")
    check_finite(given, what)
    M = 1.0 / positive_moments(given, what) if given.ndim == 1 else inverse_of(given, what)
    return M, plain(given)


def plain(array: npt.NDArray[np.float64]) -> Any:
    """Return an array as nested tuples of numbers."""
    return tuple(map(plain, array)) if array.ndim > 1 else tuple(array.tolist())


def read_vector(values: npt.ArrayLike, what: str, n: int = 3) -> npt.NDArray[np.float64]:
    """Validate a vector of n finite numbers; `what` is its name in messages.

    Examples
    --------
    >>> read_vector((1, 2, 3), "lever")
    array([1., 2., 3.])
    """
    given = read_finite(values, what)
    if given.shape != (n,):
        raise ValueError(f"{what} has shape {given.shape}; give {n} finite numbers")
    return given


def principal(M: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    """Return the diagonal of an inverse inertia, or None if it is not diagonal.

    Examples
    --------
    >>> principal(np.diag([1.0, 2.0, 3.0]))
    array([1., 2., 3.])
    """
    if M.ndim == 1:
        return M
    return np.diag(M) if np.array_equal(M, np.diag(np.diag(M))) else None


def axis_of_symmetry(M: npt.NDArray[np.float64], vector: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    """Return the unit vector of the common axis of symmetry of an inverse inertia and a vector; None if there is none.

    Only coordinate axes are considered: other axes are rounded.

    Examples
    --------
    >>> axis_of_symmetry(np.array([1.0, 2.0, 1.0]), np.array([0.0, 5.0, 0.0]))
    array([0., 1., 0.])
    """
    m = principal(M)
    if m is None:
        return None
    for c in (2, 0, 1):
        a, b = (c + 1) % 3, (c + 2) % 3
        if m[a] == m[b] and vector[a] == vector[b] == 0.0:
            return np.eye(3)[c]
    if m[0] == m[1] == m[2]:
        scaled = np.ldexp(vector, -int(np.frexp(np.abs(vector).max())[1]))
        return scaled / np.sqrt((scaled**2).sum())
    return None


def momentum_along(axis: npt.NDArray[np.float64] | None, letter: str, n: int) -> dict[str, Polynomial]:
    """Return the momentum along an axis of symmetry by name, as an integral in n coordinates; empty without an axis.

    Examples
    --------
    >>> momentum_along(np.array([0.0, 1.0, 0.0]), "m", 6)
    {'m2': x2}
    """
    if axis is None:
        return {}
    along = axis.tolist()
    name = f"{letter}{along.index(1.0) + 1}" if 1.0 in along else f"{letter} along the axis"
    return {name: sum((v * Polynomial.variable(i, n) for i, v in enumerate(along) if v), 0 * Polynomial.variable(0, n))}


def positive_moments(moments: npt.NDArray[np.float64], what: str) -> npt.NDArray[np.float64]:
    """Return moments that are positive and have finite inverses; raise ValueError for the first that does not."""
    for i, moment in enumerate(moments.tolist()):
        place = f"[{i}]" if len(moments) > 1 else ""
        if moment <= 0.0:
            raise ValueError(f"{what}{place} is {moment:g}; every principal moment must be positive")
        if moment < MIN_MOMENT:
            raise ValueError(f"{what}{place} is {moment:g}, and its inverse overflows; take larger units")
    return moments


def moments_of(size: float, what: str, ratios: tuple[float, ...] = (1.0,)) -> tuple[npt.NDArray[np.float64], float]:
    """Return inverse moments with the given ratios (powers of two) to that of `size`, and the validated size."""
    given = read_number(size, what)
    for moment in (given, given * min(ratios)):
        positive_moments(np.array([moment]), what)
    return 1.0 / given / np.array(ratios), given


def check_symmetric_matrix(matrix: npt.NDArray[np.float64], what: str) -> None:
    """Raise ValueError if a matrix is asymmetric by more than 64 u of its largest entry, with the entry."""
    with np.errstate(over="ignore"):
        asymmetry = np.abs(matrix - matrix.T)
    if asymmetry.max() > 64 * UNIT_ROUNDOFF * np.abs(matrix).max():
        i, j = (int(q) for q in np.unravel_index(np.argmax(asymmetry), matrix.shape))
        raise ValueError(f"{what} is not symmetric: {matrix[i, j]:g} and {matrix[j, i]:g} at [{i}, {j}] and [{j}, {i}]")


def inverse_of(matrix: npt.NDArray[np.float64], what: str) -> npt.NDArray[np.float64]:
    """Return the inverse of a small positive definite matrix, correctly rounded from rational arithmetic.

    So it has the same bits on every machine, unlike LAPACK's. Raises ValueError if not symmetric positive definite,
    or on overflow.
    """
    check_symmetric_matrix(matrix, what)
    n = len(matrix)
    unit = [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]
    q = [[Fraction(float(matrix[min(i, j), max(i, j)])) for j in range(n)] + unit[i] for i in range(n)]
    for c in range(n):
        # Without pivoting the pivots are those of L D L^T, all positive if the matrix is positive definite.
        if q[c][c] <= 0:
            raise ValueError(
                f"{what} {short(matrix.tolist())} is not positive definite; every principal moment must be positive"
            )
        q[c] = [entry / q[c][c] for entry in q[c]]
        for i in range(n):
            if i != c and q[i][c]:
                q[i] = [entry - q[i][c] * above for entry, above in zip(q[i], q[c], strict=True)]
    try:
        return np.array([[float(entry) for entry in row[n:]] for row in q])
    except OverflowError:
        raise ValueError(f"{what} {short(matrix.tolist())} has an inverse that overflows; take larger units") from None
