"""The quadratic Hamiltonian, ``H(x) = x . M x / 2 + linear . x + constant``."""

from __future__ import annotations

import copy
from fractions import Fraction
from typing import Any, Self, cast

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.monomials import Coefficient, joined_names, special_names
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.caching import cached_if_small
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import MAX_SHOWN_LENGTH, plain, short
from coadjoint.systems.evaluation import ProductSums, ignore_overflow, lossless_coefficients, read_point, scatter
from coadjoint.systems.hamiltonians.repeated_rows import (
    Entries,
    RepeatedRows,
    check_symmetric,
    entries_of_polynomial,
    polynomial_of_entries,
    real_array,
    repeated_rows,
    rows_of,
    sparse_entries,
    starts_of_rows,
)
from coadjoint.systems.hamiltonians.summable import Summable
from coadjoint.systems.hamiltonians.terms import QuadraticTerm, RepeatedTerm
from coadjoint.validation import read_finite, read_integer, read_number

UNBOUND = "Quadratic of a number has no dimension yet; call bind(n) first"


@suggest_keywords
class Quadratic(Summable):
    """The quadratic Hamiltonian ``x . M x / 2 + linear . x + constant``.

    Use it whenever H is quadratic. Every scheme of the library supports it, and `Taylor`, `GaussLegendre` and
    ``freeze="structure"`` preserve its energy to round-off. M need not be positive definite.

    Parameters
    ----------
    M : number, (n,), symmetric (n, n), or SciPy sparse matrix (n, n)
        The matrix (for a rigid body the *inverse* inertia). A number is a multiple of the unit matrix, a vector a
        diagonal; a sparse matrix is never made dense, except by `hessian`. An asymmetry of up to 64 u of the largest
        entry (u = 2^-53, the round-off of a computed matrix) is removed by taking the upper triangle.
    linear : (n,), optional
        Coefficients of the linear part.
    constant : float, optional
        Added to the value; it has no effect on the motion.

    Attributes
    ----------
    dim : int or None
        n; None for a number M without `linear`, until `bind`.
    timed : bool
        False.

    Raises
    ------
    ValueError
        M is not symmetric (the message gives the entry), not square or not finite, or `linear` has another length.
    TypeError
        M or `linear` does not consist of real numbers.

    Notes
    -----
    The T of equation (2) of Reich, "Numerical integration of the generalized Euler equations" (1993).

    Examples
    --------
    >>> H = Quadratic([1.0, 0.5, 0.25], linear=[0.0, 0.0, 1.0])
    >>> H([1.0, 2.0, 2.0])
    4.0
    >>> H.gradient([1.0, 2.0, 2.0])
    array([1. , 1. , 1.5])
    """

    timed = False
    has_linear = True
    place_in_sum = 0
    _terms: tuple[QuadraticTerm, ...] | None = None
    _written_names: tuple[str, ...] | None = None
    """Names of the coordinates in the text of the polynomial that it was made of."""

    def __init__(self, M: Any, linear: npt.ArrayLike | None = None, constant: Any = 0.0) -> None:
        self._linear: npt.NDArray[Any] | None = None if linear is None else real_array(linear, "linear")
        if self._linear is not None and self._linear.ndim != 1:
            raise ValueError(f"linear has shape {self._linear.shape}; give one coefficient for each coordinate, (n,)")
        size = read_number(constant, "constant")
        self._constant = constant if isinstance(constant, Fraction) else size
        self.scalar: Any = None  # the number M of a Hamiltonian without a dimension, as given
        self.dim: int | None = None
        # Sparse rows, or the shapes of rows of which few differ.
        self._sparse: tuple[npt.NDArray[Any], ...] | None = None
        self._repeated: RepeatedRows | None = None
        if hasattr(M, "tocsr"):
            self._store(*sparse_entries(M))
            return
        array = real_array(M, "M")
        if array.ndim == 0 and self._linear is None:
            self.scalar = array.item()
        elif array.ndim == 0:
            n = len(self._linear) if self._linear is not None else 0
            self._store(n, np.arange(n), np.arange(n), np.full(n, array.item(), dtype=array.dtype))
        elif array.ndim == 1:
            nonzero = np.flatnonzero(array)
            self._store(array.size, nonzero, nonzero, array[nonzero], mirrored=True)
        elif array.ndim == 2 and array.shape[0] == array.shape[1]:
            rows, columns = np.nonzero(array)
            self._store(array.shape[0], rows, columns, array[rows, columns])
        else:
            raise ValueError(f"M has shape {array.shape}; give a number, (n,) or a symmetric (n, n)")

    def _store(
        self,
        n: int,
        rows: npt.NDArray[Any],
        columns: npt.NDArray[Any],
        entries: npt.NDArray[Any],
        mirrored: bool = False,
    ) -> None:
        """Store the upper triangle and its mirror image as sparse rows; `mirrored` entries, sorted, as given."""
        if n == 0:
            raise ValueError("M has no entries; give at least one coordinate")
        if self._linear is None:
            self._linear = np.broadcast_to(0.0, n)
        if self._linear.size != n:
            size = f"M has {n} entries" if mirrored else f"M is {n} x {n}"
            raise ValueError(
                f"{size} and linear has {self._linear.size}; give both one for each coordinate of the system"
            )
        if not mirrored:
            rows, columns = rows.astype(np.int64), columns.astype(np.int64)
            check_symmetric(n, rows, columns, entries.astype(np.float64))
            upper = (rows <= columns) & (entries != 0)
            above = upper & (rows < columns)
            rows, columns = np.r_[rows[upper], columns[above]], np.r_[columns[upper], rows[above]]
            entries = np.r_[entries[upper], entries[above]]
            order = np.lexsort((columns, rows))
            rows, columns, entries = rows[order], columns[order], entries[order]
        self.dim = n
        starts, columns = starts_of_rows(rows, n), columns.astype(np.uint32)
        self._repeated = repeated_rows(starts, columns, entries)
        if self._repeated is None:
            self._sparse = starts, columns, entries
        for array in (starts, columns, entries, self._linear):
            array.flags.writeable = False

    @classmethod
    def _of_rows(cls, rows: RepeatedRows | tuple[npt.NDArray[Any], ...], linear: Any) -> Self:
        """Return the Hamiltonian of a symmetric matrix without zeros: repeated rows, or starts, columns and values."""
        quadratic = cls(np.zeros(1))
        repeated = rows if isinstance(rows, RepeatedRows) else repeated_rows(*rows)
        quadratic._repeated, quadratic._sparse = repeated, None if repeated is not None else cast(Any, rows)
        quadratic.dim = n = len(repeated.shape) if repeated is not None else len(cast(Any, rows)[0]) - 1
        quadratic._linear = np.broadcast_to(0.0, n) if linear is None else real_array(linear, "linear")
        for array in (*(quadratic._sparse or ()), quadratic._linear):
            array.flags.writeable = False
        return quadratic

    @property
    def _columns(self) -> tuple[npt.NDArray[Any], ...]:
        """Starts of the sparse rows, and the columns and values of their entries."""
        if self._repeated is None:
            return cast(Any, self._sparse)
        columns = self._repeated.start, self._repeated.coordinate, self._repeated.value
        for array in columns:
            array.flags.writeable = False
        return columns

    @cached_if_small
    def _rows(self) -> npt.NDArray[np.int64]:
        return rows_of(self._columns[0])

    @classmethod
    def from_polynomial(cls, polynomial: Polynomial) -> Self:
        """Convert a polynomial of degree at most two to a quadratic Hamiltonian, with its coefficients unchanged."""
        if not isinstance(polynomial, Polynomial):
            raise TypeError(f"the polynomial is {short(polynomial)}; give a Polynomial")
        if polynomial.degree > 2:
            raise ValueError(f"the polynomial has degree {polynomial.degree}; a quadratic Hamiltonian has at most 2")
        entries, constant = entries_of_polynomial(polynomial)
        return cls.from_entries(polynomial.dim, *entries, constant)._written_as(polynomial)

    def _written_as(self, *functions: Any) -> Self:
        self._written_names = joined_names(functions)
        return self

    @classmethod
    def from_entries(
        cls,
        n: int,
        rows: npt.NDArray[np.int64],
        columns: npt.NDArray[np.int64],
        entries: npt.NDArray[Any],
        linear: npt.NDArray[Any],
        constant: Any,
    ) -> Self:
        """Return the Hamiltonian whose M has the given entries, in both triangles and without duplicates."""
        read_finite(entries, "the entries of M")
        quadratic = cls(np.zeros(1), constant=constant)
        quadratic._linear = real_array(linear, "linear")
        quadratic._store(n, rows, columns, entries)
        return quadratic

    @property
    def constant(self) -> Any:
        """The constant as given: a float or a Fraction."""
        return self._constant

    @property
    def exact(self) -> bool:
        """Whether M, `linear` or `constant` contain exact numbers such as fractions."""
        if self.dim is None:
            return not isinstance(self.scalar, float) or isinstance(self._constant, Fraction)
        entries = np.zeros(0) if self._sparse is None else self._sparse[2]
        kinds = {entries.dtype, np.zeros(0).dtype if self._linear is None else self._linear.dtype}
        return kinds != {np.dtype(np.float64)} or isinstance(self._constant, Fraction)

    def to_polynomial(self) -> Polynomial:
        """Convert this bound Hamiltonian to a polynomial; inverse of `from_polynomial`.

        Returns
        -------
        Polynomial

        Examples
        --------
        >>> Quadratic([[1.0, -1.0], [-1.0, 0.0]], linear=[0.0, 3.0]).to_polynomial()
        3.0*x2 + 0.5*x1^2 - x1*x2
        """
        polynomial, written = polynomial_of_entries(*self.as_given(), self._constant), self._written_names
        polynomial._written_names, polynomial._names = written, None if written is None else special_names(written)
        return polynomial

    def bind(self, n: int) -> Quadratic:
        """Return this Hamiltonian for dimension `n`; a number M becomes a multiple of the unit matrix."""
        n = read_integer(n, "the dimension")
        if self.scalar is not None:
            kind = object if not isinstance(self.scalar, float) else np.float64
            return Quadratic(np.full(n, self.scalar, dtype=kind), constant=self._constant)
        self.check_dimension(n)
        return self

    def check_dimension(self, n: int, owner: str = "the system") -> None:
        """Raise ValueError if the dimension of M is not n, that of `owner`; a number as M has any dimension."""
        if self.dim not in (None, read_integer(n, "the dimension")):
            # The size of M in the form in which it was probably given.
            diagonal = np.array_equal(self._rows, self._columns[1])
            size = f"has {self.dim} entries" if diagonal else f"is {self.dim} x {self.dim}"
            raise ValueError(f"M {size}; {owner} has dimension {n}; give {n}")

    def as_given(self) -> Entries:
        """Return M, both triangles sorted by rows, and the linear part, bound, with fractions unchanged."""
        if self.dim is None or self._linear is None:
            raise TypeError(UNBOUND)
        _, columns, entries = self._columns
        return Entries(self._rows, columns.astype(np.int64), entries, self._linear)

    @ignore_overflow
    def times(self, factor: Coefficient) -> Self:
        if self.dim is None:
            return type(self)(self.scalar * factor, constant=self._constant * factor)
        return self.from_entries(self.dim, *self.as_given().times(factor), self._constant * factor)._written_as(self)

    @ignore_overflow
    def joined(self, other: Any) -> Any:
        """Return the sum with another one, as one, or with a polynomial, as that."""
        if not isinstance(other, Quadratic):
            return other.joined(self)
        dim, constant = self.dim if self.dim is not None else other.dim, self._constant + other._constant
        if dim is None:
            return Quadratic(self.scalar + other.scalar, constant=constant)
        if other.dim not in (None, dim):
            raise ValueError(f"Hamiltonians of {dim} and {other.dim} coordinates cannot be added")
        entries = self.bind(dim).as_given().plus(other.bind(dim).as_given())
        return self.from_entries(dim, *entries, constant)._written_as(self, other)

    def linear_part(self) -> npt.NDArray[np.float64]:
        """Return the coefficients of the linear term, (n,)."""
        (term,) = self.terms()
        return np.array(term.linear)

    def with_linear(self, linear: npt.ArrayLike) -> Quadratic:
        """Return the same bound Hamiltonian with another linear part; M is shared."""
        n = self.as_given().linear.size
        coefficients = real_array(linear, "linear")
        if coefficients.shape != (n,):
            raise ValueError(
                f"linear has the shape {coefficients.shape}; give one coefficient for each of {n} coordinates"
            )
        coefficients.flags.writeable = False
        changed = copy.copy(self)
        changed.__dict__.pop("_terms", None)
        changed._linear = coefficients
        return changed

    def _at(self, x: npt.ArrayLike) -> tuple[Quadratic, npt.NDArray[Any]]:
        y = read_point(x, self.dim)
        return (self if self.dim is not None else self.bind(y.size)), y

    @ignore_overflow
    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        """Return ``x . M x / 2 + linear . x + constant``."""
        bound, y = self._at(x)
        linear, half = bound._linear_part(y), bound._product(y)
        if y.dtype != object:
            return (0.5 * (half @ y) + linear @ y + float(bound._constant)).item()
        constant = lossless_coefficients(np.array([bound._constant], dtype=object), y)[0]
        return (half @ y) / 2 + linear @ y + constant

    @ignore_overflow
    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return ``M x + linear``, shape (n,)."""
        bound, y = self._at(x)
        return bound._product(y) + bound._linear_part(y)

    def gradient_and_size(self, x: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any], int]:
        """Return the gradient, the sums of its absolute products in each component, and a bound of their number."""
        (form,), n = self.terms(), x.size
        size = scatter(form.rows, np.abs(form.values * x[form.indices]), n) + np.abs(form.linear)
        return self.gradient(x), size, 64 + 2 * n + len(form.values)

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return M as a dense array, shape (n, n)."""
        bound, y = self._at(x)
        _, columns, values = bound._columns
        entries = lossless_coefficients(values, y)
        dense = np.zeros((y.size, y.size), dtype=entries.dtype)
        dense[bound._rows, columns] = entries
        return dense

    def _linear_part(self, x: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return lossless_coefficients(self._linear if self._linear is not None else np.zeros(x.size), x)

    @cached_if_small
    def _sums(self) -> ProductSums:
        start, _, entries = self._columns
        return ProductSums(self._rows, entries, len(start) - 1)

    def _product(self, x: npt.NDArray[Any]) -> npt.NDArray[Any]:
        if x.dtype == object:
            return self._sums((x, self._columns[1]))
        if self._repeated is not None:
            matrix, product = self._repeated, np.zeros(x.size, dtype=x.dtype)
            for first, row, column, entry in matrix.pieces():
                sums = scatter(row, matrix.number[entry] * x[column], int(row.max(initial=-1)) + 1)
                product[first : first + len(sums)] = sums
            return product
        _, columns, entries = self._columns
        return scatter(self._rows, lossless_coefficients(entries, x) * x[columns], x.size)

    def terms(self) -> tuple[QuadraticTerm, ...]:
        """Return the single `QuadraticTerm`; the Hamiltonian must be bound."""
        if self._terms is not None:  # a `cached_property` takes a lock, once for each member of a batch
            return self._terms
        if self._linear is None:
            raise TypeError(UNBOUND)
        linear, constant = self._linear.astype(np.float64, copy=False), float(self._constant)
        if self._repeated is not None:
            self._terms = (RepeatedTerm(self._repeated, linear, constant),)
        else:
            starts, columns, entries = self._columns
            self._terms = (QuadraticTerm(starts, columns, entries.astype(np.float64, copy=False), linear, constant),)
        return self._terms

    def __repr__(self) -> str:
        if self.scalar is not None:
            return f"Quadratic({self.scalar!r})"
        shown = ""
        if self.dim is not None and self.dim <= 4:
            dense = self.hessian(np.zeros(self.dim))
            diagonal = np.array_equal(dense, np.diag(np.diag(dense)))
            shown = str((np.diag(dense) if diagonal else dense).tolist())
        if len(shown) > MAX_SHOWN_LENGTH or not shown:
            count = len(self._columns[1]) if self._repeated is None else int(self._repeated.lengths.sum())
            shown = f"<{self.dim} x {self.dim}, {count} nonzero>"
        linear = self._linear_part(np.zeros(self.dim or 0))
        entries = str(linear.tolist()) if linear.size <= 4 else ""
        tail = f", linear={entries if 0 < len(entries) <= MAX_SHOWN_LENGTH else '...'}" if linear.any() else ""
        return f"Quadratic({shown}{tail})"


@plain.register(Quadratic)
def _(value: Quadratic) -> Any:
    return plain(value.to_polynomial())
