"""Generators of all angles: linear combinations of the matrices of the basis elements, as sparse entries."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, chunks, expand
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.numbers import Number, array_of, roundoff
from coadjoint.program.sparse_rows import SparseRows, order_by, run_starts, run_sums, starts_of


class Generators(NamedTuple):
    """Nonzero entries of one matrix per angle, sorted by angle, row and column."""

    angle: Integers
    row: Integers
    column: Integers
    value: NDArray[Any]


class BasisMatrices:
    """One sparse matrix per basis element of the algebra, with lazy linear combinations."""

    def __init__(self, size: int, start: Integers, rows: Integers, columns: Integers, values: NDArray[Any]) -> None:
        self.size = size
        self._start, self._rows, self._columns, self._values = start, rows, columns, values

    @classmethod
    def coadjoint(cls, algebra: LieAlgebra) -> BasisMatrices:
        """Construct D_i with J(x) e_i = D_i x: the action on momenta, (D_i)_jk = c_ji^k."""
        start, every = algebra.actions
        return cls(algebra.dim, start, every.j, every.k, every.c)

    @classmethod
    def on_group(cls, algebra: LieAlgebra, representation: NDArray[Any] | None) -> BasisMatrices:
        """Construct -rho_i^T (-D_i^T for None): the action on rows of a group element, g' = -g rho."""
        if representation is None:
            start, every = algebra.actions
            size, basis, rows, columns, values = algebra.dim, every.i, every.k, every.j, -every.c
        else:
            basis, columns, rows = np.nonzero(representation)
            size, values = representation.shape[1], -representation[basis, columns, rows]
        order = order_by(basis, rows, columns)
        start = np.searchsorted(basis, np.arange(algebra.dim + 1))
        return cls(size, start, rows[order], columns[order], values[order])

    def products(self, forms: SparseRows) -> Integers:
        """Count the products summed in the generator of each form."""
        cost = starts_of(np.diff(self._start)[forms.coordinate])
        return np.diff(cost[forms.start])

    def combinations(self, forms: SparseRows, number: Number) -> Iterator[Generators]:
        """Yield sum_i form_i D_i of all forms, in chunks of angles.

        Entries that cancel up to rounding are dropped.
        """
        cost = np.diff(self._start)[forms.coordinate]
        owner = forms.owner
        for part in chunks(owner, cost):
            first = self._start[forms.coordinate[part]]
            entry, at = expand(first, first + cost[part])
            factor, value = array_of(number, forms.value[part]), array_of(number, self._values[at])
            angle, row, column, term = owner[part][entry], self._rows[at], self._columns[at], factor[entry] * value
            order = order_by(angle, row, column)
            angle, row, column, term = angle[order], row[order], column[order], term[order]
            new = run_starts(angle, row, column)
            total, bound = run_sums(term, new), run_sums(abs(term), new)
            kept = np.asarray(abs(total) > 4 * roundoff(number) * bound, dtype=bool)
            place = np.flatnonzero(new)[kept]
            yield Generators(angle[place], row[place], column[place], total[kept])
