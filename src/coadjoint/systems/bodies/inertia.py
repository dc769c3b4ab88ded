"""Moments of inertia and other parameters of bodies: validation, correctly rounded inverses, and warnings."""

from __future__ import annotations

import sys
import warnings
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.validation import check_finite, read_finite, read_number, read_numbers, read_positive

MIN_MOMENT = 2.0**-1022  # smallest normal number: below it the inverse overflows


def read_inertia(inertia: npt.ArrayLike, what: str = "inertia") -> npt.NDArray[np.float64]:
    """Return positive principal moments, (3,), or a tensor, (3, 3), which `inverse_of` finds positive definite."""
    array = read_numbers(inertia, what)
    if array.shape not in ((3,), (3, 3)):
        raise ValueError(f"{what} has shape {array.shape}; give three principal moments, or a symmetric (3, 3)")
    check_finite(array, what)
    return positive_moments(array, what) if array.ndim == 1 else array


def read_vector(values: npt.ArrayLike, what: str, n: int = 3) -> npt.NDArray[np.float64]:
    """Validate a vector of n finite numbers; `what` is its name in messages."""
    vector = read_finite(values, what)
    if vector.shape != (n,):
        raise ValueError(f"{what} has shape {vector.shape}; give {n} finite numbers")
    return vector


def principal(M: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    """Return the diagonal of an inertia or its inverse, or None if it is not diagonal."""
    if M.ndim == 1:
        return M
    return np.diag(M) if np.array_equal(M, np.diag(np.diag(M))) else None


def axis_of_symmetry(M: npt.NDArray[np.float64], vector: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    """Return the coordinate axis of symmetry, a unit vector, of an inverse inertia and a vector, or None."""
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
    """Return the momentum along an axis of symmetry by name, as an integral in n coordinates; empty without an axis."""
    if axis is None:
        return {}
    components = axis.tolist()
    name = f"{letter}{components.index(1.0) + 1}" if 1.0 in components else f"{letter} along the axis"
    return {
        name: sum((v * Polynomial.variable(i, n) for i, v in enumerate(components) if v), 0 * Polynomial.variable(0, n))
    }


def positive_moments(moments: npt.NDArray[np.float64], what: str) -> npt.NDArray[np.float64]:
    """Return moments that are positive and have finite inverses; raise ValueError for the first that does not."""
    for i, moment in enumerate(moments.tolist()):
        index = f"[{i}]" if len(moments) > 1 else ""
        if moment <= 0.0:
            raise ValueError(f"{what}{index} is {moment:g}; every principal moment must be positive")
        if moment < MIN_MOMENT:
            raise ValueError(f"{what}{index} is {moment:g}, and its inverse overflows; take larger units")
    return moments


def read_moment(size: float, what: str, least_ratio: float = 1.0) -> float:
    """Return a positive moment; `least_ratio` is that of the smallest moment to it."""
    value = read_number(size, what)
    for moment in (value, value * least_ratio):
        positive_moments(np.array([moment]), what)
    return value


def check_symmetric_matrix(matrix: npt.NDArray[np.float64], what: str) -> None:
    """Raise ValueError if a matrix is asymmetric by more than 64 u of its largest entry, with the entry."""
    with np.errstate(over="ignore"):
        asymmetry = np.abs(matrix - matrix.T)
    if asymmetry.max() > 64 * UNIT_ROUNDOFF * np.abs(matrix).max():
        i, j = (int(q) for q in np.unravel_index(np.argmax(asymmetry), matrix.shape))
        raise ValueError(f"{what} is not symmetric: {matrix[i, j]:g} and {matrix[j, i]:g} at [{i}, {j}] and [{j}, {i}]")


def inverse_of(matrix: npt.NDArray[Any], what: str) -> npt.NDArray[Any]:
    """Return the inverse of moments, or of a small positive definite matrix, correctly rounded by exact arithmetic."""
    # So it has the same bits on every machine, unlike LAPACK's. An imaginary part is a change to first order.
    if matrix.ndim == 1:
        return 1.0 / matrix
    if matrix.dtype.kind == "c":
        return with_change(inverse_of(matrix.real, what), matrix.imag)
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
                q[i] = [entry - q[i][c] * pivot for entry, pivot in zip(q[i], q[c], strict=True)]
    try:
        return np.array([[float(entry) for entry in row[n:]] for row in q])
    except OverflowError:
        raise ValueError(f"{what} {short(matrix.tolist())} has an inverse that overflows; take larger units") from None


def with_change(inverse: npt.NDArray[np.float64], change: npt.NDArray[np.float64]) -> npt.NDArray[np.complex128]:
    """Return the inverse of a matrix plus i times a small change, to first order, from the inverse of the matrix."""
    return np.asarray(inverse - 1j * np.einsum("ij,jk,kl->il", inverse, change, inverse))


MAX_MAGNITUDE = 1e30


def read_in_range(value: Any, what: str, zero: bool = False) -> float:
    """Return a positive number between 1e-30 and 1e30, or zero if that is allowed; `what` is its name in messages."""
    if zero and read_number(value, what) == 0.0:
        return 0.0
    number = read_positive(value, what)
    if not 1 / MAX_MAGNITUDE <= number <= MAX_MAGNITUDE:
        raise ValueError(
            f"{what} is {number:g}; take units in which it is between {1 / MAX_MAGNITUDE:g} and {MAX_MAGNITUDE:g}"
        )
    return number


ROUNDING_TOLERANCE = 64 * UNIT_ROUNDOFF  # relative tolerance for rounded input
_QUADRATIC_FORM_HINT = "for another quadratic form use co.LiePoissonSystem(co.algebras.{}, co.Quadratic(...), sign=-1)"


def warn_unphysical_inertia(inertia: npt.ArrayLike, algebra: str | None = "so(3)", what: str = "inertia") -> None:
    """Warn if a principal moment exceeds the sum of the other two by more than round-off (equal in a flat body)."""
    # `algebra` is the one suggested for a quadratic form, None for bodies only.
    array = np.asarray(inertia, dtype=np.float64)
    tensor = np.diag(array) if array.ndim == 1 else array
    # Scaling keeps the ratios of the moments, and their sum does not overflow.
    scaled = tensor / np.abs(tensor).max()
    moments = np.diag(scaled) if array.ndim == 1 else np.linalg.eigvalsh(scaled)
    if 2.0 * moments.max() - moments.sum() > ROUNDING_TOLERANCE * moments.sum():
        text = f"{what}: a principal moment exceeds the sum of the other two, which no body has"
        _warn(text if algebra is None else f"{text}; {_QUADRATIC_FORM_HINT.format(algebra)}")


def warn_negative_mass(second_moments: npt.NDArray[np.float64]) -> None:
    """Warn if a second moment of the mass, (n,) principal or (n, n), is negative by more than round-off."""
    principal = second_moments if second_moments.ndim == 1 else np.linalg.eigvalsh(second_moments)
    if principal.min() < -ROUNDING_TOLERANCE * np.abs(principal).max():
        _warn(
            "inertia: a second moment of the mass is negative, which no body has; "
            f"{_QUADRATIC_FORM_HINT.format(f'so({len(principal)})')}"
        )


def _warn(text: str) -> None:
    """Warn at the innermost calling line outside the package, so that Python's filter shows it once per line."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_back.f_globals.get("__name__", "").partition(".")[0] == "coadjoint":
        level, frame = level + 1, frame.f_back
    warnings.warn(text, UserWarning, stacklevel=level + 1)
