"""Terms of Hamiltonians, the form from which the tables of schemes are built."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.caching import cached_if_small
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.hamiltonians.repeated_rows import RepeatedRows, polynomial_of_entries, rows_of, starts_of_rows
from coadjoint.systems.hamiltonians.traced_function import picklable_state, restore_state
from coadjoint.systems.user_functions import of_constants

MAX_COORDINATES = 2**32 - 1  # the largest unsigned number of 32 bits, the type of indices in compiled loops


class Term(Protocol):
    """Interface of all terms of Hamiltonians."""

    @property
    def piece(self) -> int | None:
        """Number of its piece of a `SplitHamiltonian`, or None."""

    @property
    def constant(self) -> float:
        """Constant part of the value."""

    @property
    def degree(self) -> int | None:
        """Degree as a polynomial; None if it is not one."""

    @property
    def called(self) -> bool:
        """Whether it calls user functions."""

    @property
    def differentiable(self) -> bool:
        """Whether its second derivatives are known."""

    @property
    def multiplications(self) -> int:
        """Number of multiplications of a gradient, without those of user functions."""

    @property
    def form(self) -> QuadraticTerm | None:
        """The term as a `QuadraticTerm`; None if it is not quadratic."""

    def couplings(self) -> Iterator[npt.NDArray[np.int64]]:
        """Yield sets of coordinates; second derivatives between coordinates that share no set are zero."""

    def placed(self, where: npt.NDArray[np.int64], n: int, piece: int) -> Term:
        """Return the term of the coordinates `where` as a term of all n coordinates that belongs to a piece."""

    @property
    def used(self) -> npt.NDArray[Any]:
        """Coordinates that the gradient depends on."""

    def gradient_entry(self, entry: int, x: npt.NDArray[Any], t: Any) -> Any:
        """Return an entry of the gradient at a state; of a function, an entry among its own coordinates."""

    def add_gradients(self, total: npt.NDArray[np.float64], x: npt.NDArray[np.float64], times: Sequence[float]) -> None:
        """Add the gradients at states (points, members, n) and at the time of each point to `total`."""

    def describe_to(self, reader: Any) -> Any:
        """Pass the term to `quadratic`, `polynomial` or `function` of a reader, in one or several of its forms."""


BuiltIn: TypeAlias = "QuadraticTerm | PolynomialTerm | FunctionTerm"


def built_in(terms: Iterable[Term]) -> list[BuiltIn]:
    """Return the forms in which terms, which may be of a user-defined type, describe themselves."""
    found: list[BuiltIn] = []
    reader = SimpleNamespace(quadratic=found.append, polynomial=found.append, function=found.append)
    for term in terms:
        term.describe_to(reader)
    return found


@suggest_keywords
@dataclass(frozen=True, eq=False)
class QuadraticTerm:
    """The term ``constant + linear . x + x . M x / 2``, M symmetric and sparse.

    Parameters
    ----------
    indptr, indices : ndarray of int64 and uint32, shapes (n + 1,) and (nnz,)
        Compressed sparse rows of M (both triangles), columns sorted in each row, no stored zeros.
    values : ndarray of float64, shape (nnz,)
        The entries of M.
    linear : ndarray of float64, shape (n,)
        Coefficients of the linear part.
    constant : float
        Has no effect on the motion; part of the energy.
    piece : int or None
        Number of its piece of a `SplitHamiltonian`.
    """

    indptr: npt.NDArray[np.int64]
    indices: npt.NDArray[np.uint32]
    values: npt.NDArray[np.float64]
    linear: npt.NDArray[np.float64]
    constant: float = 0.0
    piece: int | None = None

    called: ClassVar[bool] = False
    degree: ClassVar[int] = 2
    differentiable: ClassVar[bool] = True

    @property
    def multiplications(self) -> int:
        """Number of entries of M."""
        return len(self.values)

    @property
    def form(self) -> QuadraticTerm:
        """The term itself."""
        return self

    @property
    def repeated(self) -> RepeatedRows | None:
        """The rows of M if they are stored once for each shape."""
        return None

    def couplings(self) -> Iterator[npt.NDArray[np.int64]]:
        """Yield the pair of coordinates of each entry of M."""
        yield from np.stack([self.rows, self.indices], axis=1)

    def placed(self, where: npt.NDArray[np.int64], n: int, piece: int) -> QuadraticTerm:
        """Return the term with its entries in new rows and columns."""
        rows, columns = where[self.rows], where[self.indices].astype(np.uint32)
        order = np.lexsort((columns, rows))
        indptr = starts_of_rows(rows, n)
        linear = np.zeros(n)
        linear[where] = self.linear
        return QuadraticTerm(indptr, columns[order], self.values[order], linear, self.constant, piece)

    @property
    def used(self) -> npt.NDArray[Any]:
        """Coordinates with entries of M."""
        return np.flatnonzero(np.diff(self.indptr) > 0)

    def gradient_entry(self, entry: int, x: npt.NDArray[Any], t: Any) -> Any:
        """Return an entry of ``M x + linear``."""
        row = slice(int(self.indptr[entry]), int(self.indptr[entry + 1]))
        return self.linear[entry] + np.sum(self.values[row] * x[self.indices[row]])

    def add_gradients(self, total: npt.NDArray[np.float64], x: npt.NDArray[np.float64], times: Sequence[float]) -> None:
        """Add ``M x + linear``, by products of the sparse matrix."""
        from scipy.sparse import csr_array

        n = x.shape[-1]
        M = csr_array((self.values, self.indices, self.indptr), shape=(n, n))
        total += (M @ x.reshape(-1, n).T).T.reshape(x.shape) + self.linear

    def to_polynomial(self) -> Polynomial:
        """Return the term as a polynomial."""
        return polynomial_of_entries(self.rows, self.indices, self.values, self.linear, self.constant)

    def structure(self) -> tuple[Hashable, list[Any]]:
        """Return what tables depend on apart from coefficients, and the coefficients: linear ones and the entries."""
        return (self.piece, self.indptr.tobytes(), self.indices.tobytes()), [self.linear, self.values]

    def sum_of_absolute_values(self, size: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the sums of the absolute values of the monomials where coordinates have the absolute values `size`."""
        # Contiguous rows are summed in the same order for one state and for many.
        products = np.ascontiguousarray(size[..., self.rows] * np.abs(self.values) * size[..., self.indices])
        first = np.ascontiguousarray(np.abs(self.linear) * size)
        return np.asarray(abs(self.constant) + np.sum(first, axis=-1) + np.sum(products, axis=-1) / 2)

    def describe_to(self, reader: Any) -> Any:
        """Pass the term to `reader.quadratic`."""
        return reader.quadratic(self)

    @cached_if_small
    def rows(self) -> npt.NDArray[np.int64]:
        """Row number of every stored entry of M, shape (nnz,)."""
        return rows_of(self.indptr)


class RepeatedTerm(QuadraticTerm):
    """A quadratic term whose M has few shapes of rows; its sparse rows are expanded when they are read."""

    def __init__(
        self,
        matrix: RepeatedRows,
        linear: npt.NDArray[np.float64],
        constant: float = 0.0,
        piece: int | None = None,
    ) -> None:
        self.__dict__.update(matrix=matrix, linear=linear, constant=constant, piece=piece)

    matrix: RepeatedRows

    @property
    def repeated(self) -> RepeatedRows:
        return self.matrix

    @property
    def indptr(self) -> npt.NDArray[np.int64]:  # type: ignore[override]
        return self.matrix.start

    @property
    def indices(self) -> npt.NDArray[np.uint32]:  # type: ignore[override]
        return self.matrix.coordinate

    @property
    def values(self) -> npt.NDArray[np.float64]:  # type: ignore[override]
        return self.matrix.value

    @property
    def multiplications(self) -> int:
        return int(self.matrix.lengths.sum())


@suggest_keywords
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
        """Degree of the polynomial."""
        return self.polynomial.degree

    @property
    def multiplications(self) -> int:
        """Sum over monomials: each factor needs all of its powers."""
        return sum(len(factors) * sum(factors.values()) for _, _, factors in self.polynomial._factors)

    def couplings(self) -> Iterator[npt.NDArray[np.int64]]:
        """Yield the variables of each monomial."""
        yield from (np.array([*factors], dtype=np.int64) for _, _, factors in self.polynomial._factors)

    def placed(self, where: npt.NDArray[np.int64], n: int, piece: int) -> PolynomialTerm:
        """Return the polynomial in other variables."""
        monomials = {}
        for exponents, coefficient in self.polynomial.monomials.items():
            placed = [0] * n
            for i, power in zip(where.tolist(), exponents, strict=True):
                placed[i] = power
            monomials[tuple(placed)] = coefficient
        return PolynomialTerm(Polynomial(monomials, dim=n), piece)

    @property
    def used(self) -> npt.NDArray[Any]:
        """Variables of the monomials."""
        return np.array(sorted({k for _, _, factors in self.polynomial._factors for k in factors}), dtype=np.int64)

    def gradient_entry(self, entry: int, x: npt.NDArray[Any], t: Any) -> Any:
        """Return an entry of the gradient of the polynomial."""
        return self.polynomial.gradient(x)[entry]

    def add_gradients(self, total: npt.NDArray[np.float64], x: npt.NDArray[np.float64], times: Sequence[float]) -> None:
        """Add the gradients of the polynomial."""
        total += self.polynomial.gradient(x)

    def to_polynomial(self) -> Polynomial:
        """Return the polynomial."""
        return self.polynomial

    def structure(self) -> tuple[Hashable, list[Any]]:
        """Return the piece and the exponents, and the coefficients."""
        monomials = self.polynomial.monomials
        return (self.piece, tuple(monomials)), [[float(value) for value in monomials.values()]]

    def sum_of_absolute_values(self, size: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the sums of the absolute values of the monomials where coordinates have the absolute values `size`."""
        total = np.zeros(size.shape[:-1])
        for exponents, coefficient in self.polynomial.monomials.items():
            # Products, since powers of the C library differ in their last bits.
            product = np.full(total.shape, abs(float(coefficient)))
            for k in np.repeat(np.arange(len(exponents)), exponents).tolist():
                product = product * size[..., k]
            total += product
        return total

    def describe_to(self, reader: Any) -> Any:
        """Pass the term to `reader.polynomial`."""
        return reader.polynomial(self)


@suggest_keywords
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

    __getstate__, __setstate__ = picklable_state, restore_state

    @property
    def differentiable(self) -> bool:
        """Whether second derivatives were given."""
        return self.hessian is not None

    def couplings(self) -> Iterator[npt.NDArray[np.int64]]:
        """Yield all coordinates that the function depends on."""
        yield np.asarray(self.coordinates)

    def placed(self, where: npt.NDArray[np.int64], n: int, piece: int) -> FunctionTerm:
        """Return the function of other coordinates."""
        return replace(self, coordinates=where[self.coordinates], piece=piece)

    @property
    def used(self) -> npt.NDArray[Any]:
        """All coordinates that the function depends on."""
        return self.coordinates

    def _gradient_at(self, x: npt.NDArray[Any], t: Any) -> Any:
        y = x[self.coordinates]
        return self.gradient(y[0] if self.scalar else y, *((t,) if self.timed else ()))

    def gradient_entry(self, entry: int, x: npt.NDArray[Any], t: Any) -> Any:
        """Return an entry of the gradient of the function."""
        return np.ravel(self._gradient_at(x, t))[entry]

    def add_gradients(self, total: npt.NDArray[np.float64], x: npt.NDArray[np.float64], times: Sequence[float]) -> None:
        """Add the gradients of the function, called for each state."""
        for k, t in enumerate(times):
            for m in range(x.shape[1]):
                total[k, m, self.coordinates] += self._gradient_at(x[k, m], t)

    def to_polynomial(self) -> None:
        """Return None: it is no polynomial."""

    @property
    def constants(self) -> npt.NDArray[np.float64] | None:
        """The constants from which its functions follow, or None."""
        found = of_constants(self.value)
        return None if found is None else found.constants

    def structure(self) -> tuple[Hashable, list[Any]]:
        """Return the piece, the coordinates, the functions and the pattern of their constants, and these."""
        found = of_constants(self.value)
        given = self.value, self.gradient, self.hessian
        functions = [one.key if (one := of_constants(function)) else function for function in given]
        common = self.piece, self.coordinates.tobytes(), *functions, self.scalar, self.timed
        return (common, []) if found is None else ((*common, found.pattern), [found.constants])

    def sum_of_absolute_values(self, size: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return zeros: absolute terms of functions are not known."""
        return np.zeros(size.shape[:-1])

    def describe_to(self, reader: Any) -> Any:
        """Pass the term to `reader.function`."""
        return reader.function(self)
