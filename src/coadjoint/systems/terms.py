"""Of which terms does a Hamiltonian consist? The form that the tables of a scheme are built from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomial import Polynomial


class TermReader(Protocol):
    """What is made from the terms of a Hamiltonian: tables, parts of a splitting."""

    def quadratic(self, term: QuadraticTerm) -> Any:
        """Take a quadratic term."""

    def polynomial(self, term: PolynomialTerm) -> Any:
        """Take a polynomial."""

    def function(self, term: FunctionTerm) -> Any:
        """Take a function of Python."""


class Term(Protocol):
    """What every kind of term says of itself. A `TermReader` makes tables and parts from it."""

    @property
    def piece(self) -> int | None:
        """Number of the piece of a `SplitHamiltonian` that it belongs to."""

    @property
    def constant(self) -> float:
        """The constant that is added to its value."""

    @property
    def degree(self) -> int | None:
        """The degree as a polynomial; None where it is no polynomial."""

    @property
    def called(self) -> bool:
        """Whether it calls functions of the user."""

    @property
    def differentiable(self) -> bool:
        """Whether its second derivatives are known."""

    @property
    def multiplications(self) -> int:
        """Multiplications that a gradient takes, functions not counted."""

    @property
    def form(self) -> QuadraticTerm | None:
        """The term as a quadratic one; None where it is not quadratic."""

    def couplings(self) -> Iterator[npt.NDArray[np.int64]]:
        """Yield sets of coordinates: second derivatives between two coordinates that share no set are zero."""

    def placed(self, where: npt.NDArray[np.int64], n: int, piece: int) -> Term:
        """Return the term of the coordinates `where` as one of all n coordinates, belonging to a piece."""

    def given_to(self, reader: TermReader) -> Any:
        """Give the term to a reader, in one or several of the kinds that it takes; return what the last one gave."""


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
    degree: ClassVar[int] = 2
    differentiable: ClassVar[bool] = True

    @property
    def multiplications(self) -> int:
        """One for each entry of M."""
        return len(self.values)

    @property
    def form(self) -> QuadraticTerm:
        """Itself."""
        return self

    def couplings(self) -> Iterator[npt.NDArray[np.int64]]:
        """Yield each pair of an entry of M."""
        yield from np.stack([self.rows, self.indices], axis=1)

    def placed(self, where: npt.NDArray[np.int64], n: int, piece: int) -> QuadraticTerm:
        """Return the entries in their new rows and columns."""
        rows, columns = where[self.rows], where[self.indices]
        order = np.lexsort((columns, rows))
        indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=n))]).astype(np.int64)
        linear = np.zeros(n)
        linear[where] = self.linear
        return QuadraticTerm(indptr, columns[order], self.values[order], linear, self.constant, piece)

    def given_to(self, reader: TermReader) -> Any:
        """Give it as it is."""
        return reader.quadratic(self)

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
    differentiable: ClassVar[bool] = True
    form: ClassVar[None] = None

    @property
    def degree(self) -> int:
        """Of the polynomial."""
        return self.polynomial.degree

    @property
    def multiplications(self) -> int:
        """Each factor of a monomial needs all of its powers."""
        exponents = [[e for e in monomial if e] for monomial in self.polynomial.monomials]
        return sum(len(e) * sum(e) for e in exponents)

    def couplings(self) -> Iterator[npt.NDArray[np.int64]]:
        """Yield the variables of each monomial."""
        yield from (np.flatnonzero(exponents) for exponents in self.polynomial.monomials)

    def placed(self, where: npt.NDArray[np.int64], n: int, piece: int) -> PolynomialTerm:
        """Return the polynomial in other variables."""
        monomials = {}
        for exponents, coefficient in self.polynomial.monomials.items():
            placed = [0] * n
            for i, power in zip(where.tolist(), exponents, strict=True):
                placed[i] = power
            monomials[tuple(placed)] = coefficient
        return PolynomialTerm(Polynomial(monomials, dim=n), piece)

    def given_to(self, reader: TermReader) -> Any:
        """Give it as it is."""
        return reader.polynomial(self)


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
    """

    coordinates: npt.NDArray[np.int64]
    value: Callable[..., Any]
    gradient: Callable[..., Any]
    hessian: Callable[..., Any] | None
    scalar: bool = False
    timed: bool = False
    piece: int | None = None

    called: ClassVar[bool] = True
    constant: ClassVar[float] = 0.0
    degree: ClassVar[None] = None
    form: ClassVar[None] = None
    multiplications: ClassVar[int] = 0

    @property
    def differentiable(self) -> bool:
        """Whether a Hessian was given."""
        return self.hessian is not None

    def couplings(self) -> Iterator[npt.NDArray[np.int64]]:
        """Yield all coordinates that the function depends on."""
        yield np.asarray(self.coordinates)

    def placed(self, where: npt.NDArray[np.int64], n: int, piece: int) -> FunctionTerm:
        """Return the function of other coordinates."""
        return replace(self, coordinates=where[self.coordinates], piece=piece)

    def given_to(self, reader: TermReader) -> Any:
        """Give it as it is."""
        return reader.function(self)
