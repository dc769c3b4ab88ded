"""Of which terms does a Hamiltonian consist? The form that the tables of a scheme are built from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.logarithmic import Forms
from coadjoint.algebra.polynomial import Polynomial


@dataclass(frozen=True, eq=False)
class QuadraticTerm:
    """The term ``constant + linear . x + x . M x / 2``, M symmetric and sparse.

    Parameters
    ----------
    indptr, indices : ndarray of int64, shapes (n + 1,) and (nnz,)
        Compressed sparse rows of M (both triangles), columns sorted in each row, no stored zeros.
    values : ndarray of float64, shape (nnz,)
        The entries of M.
    linear : ndarray of float64, shape (n,)
        Coefficients of the linear part.
    constant : float
        Moves nothing; kept so that the energy is the one that was given.
    piece : int or None
        Number of the piece of a `SplitHamiltonian` that it belongs to.
    """

    indptr: npt.NDArray[np.int64]
    indices: npt.NDArray[np.int64]
    values: npt.NDArray[np.float64]
    linear: npt.NDArray[np.float64]
    constant: float = 0.0
    piece: int | None = None

    called: ClassVar[bool] = False

    @cached_property
    def rows(self) -> npt.NDArray[np.int64]:
        """Row number of every stored entry of M, shape (nnz,)."""
        return np.repeat(np.arange(self.linear.size, dtype=np.int64), np.diff(self.indptr))


@dataclass(frozen=True, eq=False)
class PolynomialTerm:
    """A polynomial in all n coordinates.

    Parameters
    ----------
    polynomial : Polynomial
        In n variables.
    piece : int or None
        Number of the piece of a `SplitHamiltonian` that it belongs to.
    """

    polynomial: Polynomial
    piece: int | None = None

    called: ClassVar[bool] = False
    constant: ClassVar[float] = 0.0


@dataclass(frozen=True, eq=False)
class FunctionTerm:
    """A Python function of some coordinates, ``y = x[coordinates]``.

    Parameters
    ----------
    coordinates : ndarray of int64, shape (m,)
        The coordinates that it depends on, 0-based.
    value, gradient : callable
        Functions of ``y``, or of ``(y, t)`` if `timed`; `gradient` returns shape (m,).
    hessian : callable or None
        Returns shape (m, m).
    scalar : bool
        The functions take the number ``y = x[coordinates[0]]`` and return numbers.
    timed : bool
        The functions take the time as a second argument.
    piece : int or None
        Number of the piece of a `SplitHamiltonian` that it belongs to.
    forms : Forms or None
        The value as a formula that the kernels know: then it needs no compiling.
    """

    coordinates: npt.NDArray[np.int64]
    value: Callable[..., Any]
    gradient: Callable[..., Any]
    hessian: Callable[..., Any] | None
    scalar: bool = False
    timed: bool = False
    piece: int | None = None
    forms: Forms | None = None

    called: ClassVar[bool] = True
    constant: ClassVar[float] = 0.0


Term = QuadraticTerm | PolynomialTerm | FunctionTerm
