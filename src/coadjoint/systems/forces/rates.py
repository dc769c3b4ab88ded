"""Rates and metrics of forces (number, diagonal or matrix): validation, storage as plain numbers, application."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.user_functions import sample_points
from coadjoint.validation import as_tuples, read_finite, to_array

Plain = float | tuple[Any, ...]


def read_matrix(argument: Any, what: str, dimensions: tuple[int, ...] = (0, 1, 2)) -> Plain:
    """Validate a number, a vector or a square matrix, and return it as floats in nested tuples."""
    array = read_finite(argument, what)
    square = array.ndim < 2 or array.shape[0] == array.shape[1]
    if array.ndim not in dimensions or not square or not array.size:
        shapes = " or ".join(("a number", "(n,)", "(n, n)")[k] for k in dimensions)
        raise ValueError(f"{what} has the shape {array.shape}; it must be {shapes}")
    plain: Plain = as_tuples(array)
    return plain


def read_state(argument: Any, what: str, number: bool = False) -> Any:
    """Validate a vector or a matrix state (with `number` also a scalar), and return it as nested tuples."""
    if isinstance(argument, Mapping) and argument.keys() == {"real", "imaginary"}:  # the form used in records
        argument = read_finite(argument["real"], what) + 1j * read_finite(argument["imaginary"], what)
    matrix = to_array(argument, what, "iufc")
    if matrix.ndim not in (2, 3):
        return read_matrix(argument, what, (0, 1) if number else (1,))
    if matrix.shape[-2] != matrix.shape[-1] or not matrix.size or not np.isfinite(matrix).all():
        raise ValueError(f"{what} has the shape {matrix.shape}; a matrix must be (N, N), of finite numbers")
    return as_tuples(matrix.astype(complex if matrix.dtype.kind == "c" else float))


def check_state(argument: Any, what: str, system: Any) -> None:
    """Raise an error if a state does not belong to a system; a scalar must be zero for systems of matrices."""
    shape = np.shape(argument)
    if system.has_matrices:
        if shape or argument != 0.0:
            system.read(argument, what)
    elif len(shape) > 1:
        raise ValueError(f"{what} is a matrix; {system.name} needs ({system.dim},)")
    else:
        check_dimension(argument, what, system)


def state_vector(argument: Any, system: Any) -> NDArray[np.float64]:
    """Return a state as a vector of real numbers, (n,)."""
    if system.has_matrices and np.ndim(argument):
        return np.asarray(system.read(argument))
    return np.asarray(np.broadcast_to(np.asarray(argument, dtype=np.float64), (system.dim,)))


def sample_states(system: Any) -> list[NDArray[Any]]:
    """Return seeded sample states of different kinds, in the form in which user functions take them."""
    points = sample_points(system.dim)
    return [system.algebra.projected(system.from_vector(x)) for x in points] if system.has_matrices else points


def check_dimension(argument: Plain, what: str, system: Any) -> None:
    """Raise an error if a vector or matrix does not have the dimension of a system."""
    shape = np.shape(argument)
    if shape and shape[0] != system.dim:
        raise ValueError(f"{what} has the shape {shape}; {system.name} has dimension {system.dim}")


def apply_metric(matrix: Any, y: NDArray[Any]) -> NDArray[Any]:
    """Return the product of a number, a diagonal or a matrix with y."""
    array = np.asarray(matrix)
    return array @ y if array.ndim == 2 else array * y


def metric_root(metric: Plain, what: str) -> NDArray[np.float64]:
    """Return L with L L^T = P: square roots of a number or diagonal, or a Cholesky factor, summed in a fixed order."""
    P = np.array(metric, dtype=np.float64)
    size = np.max(np.abs(P))
    if P.ndim < 2:
        if np.any(P < 0.0):
            raise ValueError(f"{what} has the negative entry {P.min():g}; damping needs a positive semidefinite one")
        return np.sqrt(P)
    if not np.array_equal(P, P.T):
        raise ValueError(f"{what} is not symmetric; damping needs a symmetric positive semidefinite one")
    n = len(P)
    L, remainder, tolerance = np.zeros((n, n)), P.copy(), 64 * n * UNIT_ROUNDOFF * size
    for k in range(n):
        if remainder[k, k] > tolerance:
            L[k:, k] = remainder[k:, k] / np.sqrt(remainder[k, k])
            remainder -= np.multiply.outer(L[:, k], L[:, k])
        elif remainder[k, k] < -tolerance or np.max(np.abs(remainder[k:, k])) > np.sqrt(tolerance * size):
            raise ValueError(f"{what} is not positive semidefinite; damping would feed energy in")
    return L
