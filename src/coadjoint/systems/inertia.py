"""Which inertia does a body have? Principal moments or a tensor, read and inverted without rounding on the way."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.given import check_finite, read_numbers
from coadjoint.rounding import UNIT_ROUNDOFF

LEAST_MOMENT = 2.0**-1022


def inverse_inertia(inertia: npt.ArrayLike) -> tuple[npt.NDArray[np.float64], Any]:
    """Return the inverse inertia of a body, and the inertia as a plain tuple, which is its parameter.

    Parameters
    ----------
    inertia : (3,) or (3, 3)
        Principal moments, or the symmetric positive definite tensor.

    Returns
    -------
    M : (3,) or (3, 3) array
    kept : tuple

    Raises
    ------
    ValueError
        Another shape, or not finite, symmetric and positive; or the inverse overflows.

    Examples
    --------
    >>> inverse_inertia((1, 2, 4))
    (array([1.  , 0.5 , 0.25]), (1.0, 2.0, 4.0))
    """
    given = read_numbers(inertia, "inertia")
    if given.shape not in ((3,), (3, 3)):
        raise ValueError(f"inertia has shape {given.shape}; give three principal moments, or a symmetric (3, 3)")
    check_finite(given, "inertia")
    if given.ndim == 1:
        return 1.0 / _positive_moments(given), tuple(given.tolist())
    return _inverse(given), tuple(tuple(row) for row in given.tolist())


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
