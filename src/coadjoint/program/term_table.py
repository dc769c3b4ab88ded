"""Table of scalar functions: shares of a splitting, gradients of Runge-Kutta methods, watched invariants."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.numbers import Number, array_of
from coadjoint.program.sparse_rows import Rows, SparseRows, joined_starts, starts_of
from coadjoint.systems.hamiltonians.repeated_rows import RepeatedRows, values_at
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm, QuadraticTerm, Term

LINEAR, POLYNOMIAL, FUNCTION = 0, 1, 2
"""Kinds of terms, as in `boundary/codes.hpp`."""


class Terms(NamedTuple):
    """Table of terms, as in `docs/table.md`; a linear term is the sum of x[target] (offset + weight . x / 2). A
    FUNCTION in derivatives of the energy has coefficients, as monomials without factors. With `repeated`, row r has the
    entries of shape[r], with columns relative to target[r], modulo 2^32, and if it is 2 their offset too.
    """

    size: int
    kind: NDArray[np.uint8]
    row: NDArray[np.uint32]
    target: NDArray[np.uint32]
    offset: NDArray[Any]
    entry: NDArray[np.uint32]
    column: NDArray[np.uint32]
    weight: NDArray[Any]
    monomial: NDArray[np.uint32]
    coefficient: NDArray[Any]
    factor: NDArray[np.uint32]
    factor_row: NDArray[np.uint32]
    exponent: NDArray[np.uint32]
    repeated: int = 0
    shape: NDArray[np.uint32] = np.zeros(0, dtype=np.uint32)


class TermTable:
    """Builder of the table; `functions` maps the index of a FUNCTION term to its Python functions. With `used_rows`, as
    for values, quadratic terms have rows only for coordinates that they depend on.
    """

    def __init__(self, used_rows: bool = False) -> None:
        self._used_rows = used_rows
        self.functions: dict[int, FunctionTerm] = {}
        self._kind: list[NDArray[Any]] = []
        self._rows: list[NDArray[Any]] = [np.zeros(1, dtype=np.int64)]
        self._monomials: list[NDArray[Any]] = [np.zeros(1, dtype=np.int64)]
        self._target: list[NDArray[Any]] = []
        self._offset: list[NDArray[Any]] = []
        self._weights: list[Rows] = []
        self._coefficient: list[Any] = []
        self._factor: list[int] = [0]
        self._factor_row: list[int] = []
        self._exponent: list[int] = []

    def __len__(self) -> int:
        return sum(map(len, self._kind))

    def _add_rows(self, kind: int, target: NDArray[Any], offset: Any, weights: Rows) -> None:
        self._kind.append(np.array([kind]))
        self._rows.append(self._rows[-1][-1:] + len(target))
        self._target.append(np.asarray(target))
        self._offset.append(np.asarray(offset))
        self._weights.append(weights)
        self._monomials.append(np.array([len(self._coefficient)]))

    def add_linear_terms(self, row: Any, offset: NDArray[Any], weights: Rows) -> None:
        """Add several terms at once, term k with the rows row[k] to row[k + 1], all with the target 0."""
        count, last = len(row) - 1, self._rows[-1][-1]
        self._kind.append(np.full(count, LINEAR))
        self._rows.append(last + np.asarray(row[1:]) - row[0])
        self._monomials.append(np.full(count, len(self._coefficient)))
        self._target.append(np.broadcast_to(np.uint32(0), len(offset)))
        self._offset.append(offset)
        self._weights.append(weights)

    def add_linear(self, target: Any, offset: Any, indptr: Any, column: Any, weight: Any) -> None:
        self._add_rows(LINEAR, target, offset, SparseRows(np.asarray(indptr), np.asarray(column), np.asarray(weight)))

    def _add_empty_rows(self, kind: int, coordinates: Sequence[int]) -> None:
        size = len(coordinates)
        self._add_rows(kind, np.asarray(coordinates, dtype=np.int64), np.zeros(size), SparseRows.empty(size))

    def add_polynomial(self, coordinates: Sequence[int], polynomial: Polynomial) -> None:
        """Add a polynomial of the given coordinates (constant monomials have no gradient)."""
        row_of = {coordinate: int(self._rows[-1][-1]) + k for k, coordinate in enumerate(coordinates)}
        for _, coefficient, factors in polynomial._factors:
            self._coefficient.append(coefficient)
            self._factor_row.extend(row_of[k] for k in factors)
            self._exponent.extend(factors.values())
            self._factor.append(len(self._exponent))
        self._add_empty_rows(POLYNOMIAL, coordinates)

    def add_by_coefficients(self, coordinates: Sequence[int], count: int) -> None:
        """Add a FUNCTION term with `count` coefficients of zero, by which it is differentiated."""
        self._coefficient.extend([0.0] * count)
        self._factor.extend([len(self._exponent)] * count)
        self._add_empty_rows(FUNCTION, coordinates)

    def add(self, term: Term) -> None:
        term.describe_to(self)

    def quadratic(self, term: QuadraticTerm) -> None:
        offset, weights = term.linear, rows_of_form(term)
        target: NDArray[Any] = np.arange(len(offset), dtype=np.uint32)
        if self._used_rows and not (used := (offset != 0) | (np.diff(weights.start) > 0)).all():
            target = np.flatnonzero(used)
            offset, weights = values_at(offset, target), weights.take(target)
        self._add_rows(LINEAR, target, offset, weights)

    def polynomial(self, term: PolynomialTerm) -> None:
        self.add_polynomial(sorted({k for _, _, factors in term.polynomial._factors for k in factors}), term.polynomial)

    def function(self, term: FunctionTerm) -> None:
        self.functions[len(self)] = term
        self._add_empty_rows(FUNCTION, term.coordinates.tolist())

    def table(self, number: Number = float) -> Terms:
        """Return the table with its constants in the given number type."""
        lengths = _joined([np.diff(weights.start) for weights in self._weights], np.int64)
        return Terms(
            size=len(self),
            kind=_joined(self._kind, np.uint8),
            row=_joined(self._rows, np.uint32),
            target=_joined(self._target, np.uint32),
            offset=array_of(number, _joined(self._offset, None)),
            entry=starts_of(lengths).astype(np.uint32),
            column=_joined([weights.coordinate for weights in self._weights], np.uint32),
            weight=array_of(number, _joined([weights.value for weights in self._weights], None)),
            monomial=_joined(self._monomials, np.uint32),
            coefficient=array_of(number, self._coefficient),
            factor=np.array(self._factor, dtype=np.uint32),
            factor_row=np.array(self._factor_row, dtype=np.uint32),
            exponent=np.array(self._exponent, dtype=np.uint32),
        )

    def repeated_table(self) -> Terms | None:
        """Return the table with the entries of each shape of a row stored once; None if not all rows repeat."""
        matrices = [weights for weights in self._weights if isinstance(weights, RepeatedRows)]
        if not matrices or len(matrices) < len(self._weights):
            return None
        shared = all(offset.strides == (0,) for offset in self._offset)
        offsets = [
            np.repeat(offset[:1], len(matrix.begin) - 1) if shared else offset
            for offset, matrix in zip(self._offset, matrices, strict=True)
        ]
        first = np.cumsum([0] + [len(matrix.begin) - 1 for matrix in matrices]).tolist()
        shapes = [
            matrix.shape + np.uint32(shift) if shift else matrix.shape
            for shift, matrix in zip(first, matrices, strict=False)
        ]
        empty = np.zeros(0, dtype=np.uint32)
        return Terms(
            size=len(self),
            kind=_joined(self._kind, np.uint8),
            row=_joined(self._rows, np.uint32),
            target=_joined([matrix.targets for matrix in matrices], np.uint32),
            offset=_joined(offsets, np.float64),
            entry=joined_starts([matrix.begin for matrix in matrices]).astype(np.uint32),
            column=np.concatenate([matrix.relative for matrix in matrices]).astype(np.uint32),
            weight=_joined([matrix.number for matrix in matrices], np.float64),
            monomial=_joined(self._monomials, np.uint32),
            coefficient=np.zeros(0),
            factor=np.zeros(1, dtype=np.uint32),
            factor_row=empty,
            exponent=empty,
            repeated=2 if shared else 1,
            shape=_joined(shapes, np.uint32),
        )


def rows_of_form(term: QuadraticTerm) -> Rows:
    """Return the sparse rows of M of a quadratic term, as they are stored."""
    return term.repeated or SparseRows(term.indptr, term.indices.astype(np.uint32, copy=False), term.values)


def _joined(pieces: list[NDArray[Any]], dtype: Any) -> NDArray[Any]:
    joined = pieces[0] if len(pieces) == 1 else np.concatenate([np.zeros(0, dtype=dtype or np.float64), *pieces])
    return joined if dtype is None else np.ascontiguousarray(joined, dtype=dtype)


def derivative_of(term: FunctionTerm, order: int, y: NDArray[Any], t: Any) -> Any:
    """Return the gradient (order 1) or Hessian (order 2) of a function term at its own coordinates y."""
    function = term.gradient if order == 1 else term.hessian
    if function is None:
        raise TypeError("a function of the Hamiltonian was given without second derivatives; give its hessian")
    result = function(y[0] if term.scalar else y, *((t,) if term.timed else ()))
    return np.asarray(result).reshape((len(y),) * order)
