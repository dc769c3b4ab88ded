"""Completed squares of a sparse symmetric matrix, bitwise as for a dense one, at the cost of its nonzero entries."""

from __future__ import annotations

from heapq import heapify, heappop, heappush
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.program.parts.squares import MAX_RATIONAL_SIZE, MIN_PIVOT_RATIO, complete_squares, split_linear
from coadjoint.program.sparse_rows import SparseRows
from coadjoint.rounding import UNIT_ROUNDOFF

# Mean number of entries per row below which rows are stored sparse.
DENSE_ROW = 16

Form = dict[int, float]


class SparseSquares(NamedTuple):
    """Forms l_r (sparse), factors d_r and beta_r, and pivots, as in `Squares`."""

    forms: SparseRows
    weights: NDArray[Any]
    linear: NDArray[Any]
    pivots: NDArray[np.int64]


def sparse_squares(matrix: SparseRows, linear: NDArray[np.float64]) -> SparseSquares:
    """Complete the square of linear.x + x.M.x/2 for sparse symmetric M, with the numbers of `complete_squares`."""
    size = len(linear)
    if size > MAX_RATIONAL_SIZE and len(matrix.value) < DENSE_ROW * size:
        return _Reduction(matrix, linear).squares()
    dense = np.zeros((size, size))
    dense[matrix.owner, matrix.coordinate] = matrix.value
    forms, weights, betas, pivots = complete_squares(dense, linear)
    row, column = np.nonzero(forms != 0)
    start = np.searchsorted(row, np.arange(len(forms) + 1)).astype(np.int64)
    return SparseSquares(SparseRows(start, column.astype(np.uint32), forms[row, column]), weights, betas, pivots)


class _Reduction:
    """Residual matrix of `complete_squares`, with the same operations in the same order.

    Rows are dictionaries; heaps give the largest entries.
    """

    def __init__(self, matrix: SparseRows, linear: NDArray[np.float64]) -> None:
        self.rows: list[Form] = [{} for _ in linear]
        owner: Integers = matrix.owner
        for i, j, value in zip(owner.tolist(), matrix.coordinate.tolist(), matrix.value.tolist(), strict=True):
            self.rows[i][j] = value
        self.linear: list[float] = linear.tolist()
        self.diagonal = [(-abs(row[i]), i) for i, row in enumerate(self.rows) if i in row]
        self.entries = [(-abs(v), i, j) for i, row in enumerate(self.rows) for j, v in row.items() if i <= j]
        heapify(self.diagonal)
        heapify(self.entries)
        # Each of n pivots rounds an entry three times.
        self.floor = 4.0 * len(linear) * UNIT_ROUNDOFF * float(np.max(np.abs(matrix.value), initial=0.0))

    def squares(self) -> SparseSquares:
        forms: list[Form] = []
        weights: list[float] = []
        betas: list[float] = []
        steps: list[tuple[int, int, int]] = []
        while (pivots := self._pivots()) is not None:
            completed = self._square(*pivots) if len(pivots) == 1 else self._pair(*pivots)
            self._eliminate(pivots, completed)
            new_betas = split_linear(
                [self.linear[p] for p in pivots], [[form.get(p, 0.0) for p in pivots] for form, _ in completed]
            )
            for (form, weight), beta in zip(completed, new_betas, strict=True):
                for k, value in form.items() if beta != 0 else ():
                    self.linear[k] -= beta * value
                forms.append(form)
                weights.append(weight)
                betas.append(beta)
            steps += [(len(steps), pivots[0], pivots[-1])] * len(completed)
            for p in pivots:
                self.linear[p] = 0.0
        for k, b in enumerate(self.linear):
            if b != 0:
                forms.append({k: 1.0})
                weights.append(0.0)
                betas.append(b)
                steps.append((len(steps), k, k))
        sparse = SparseRows.of_lists(
            [sorted(form) for form in forms], [[form[k] for k in sorted(form)] for form in forms]
        )
        pivoted = np.array(steps, dtype=np.int64).reshape(-1, 3)
        return SparseSquares(sparse, np.array(weights), np.array(betas), pivoted)

    def _pivots(self) -> tuple[int, ...] | None:
        """Return the coordinate of the next square, or two coupled ones; None if the residual vanishes."""
        while self.entries and not self._current(*self.entries[0]):
            heappop(self.entries)
        if not self.entries or -self.entries[0][0] <= self.floor:
            return None
        largest, i, j = self.entries[0]
        while self.diagonal and not self._current(*self.diagonal[0], self.diagonal[0][1]):
            heappop(self.diagonal)
        if self.diagonal:
            size, k = self.diagonal[0]
            if -size * MIN_PIVOT_RATIO.denominator >= -largest * MIN_PIVOT_RATIO.numerator:
                return (k,)
        return (i, j)

    def _current(self, size: float, i: int, j: int) -> bool:
        return -size == abs(self.rows[i].get(j, 0.0)) and size != 0

    def _square(self, i: int) -> list[tuple[Form, float]]:
        row = self.rows[i]
        return [({k: value / row[i] for k, value in row.items() if value != 0}, row[i])]

    def _pair(self, i: int, j: int) -> list[tuple[Form, float]]:
        row_i, row_j = self.rows[i], self.rows[j]
        sign = 1 if (row_i.get(i, 0.0) + row_j.get(j, 0.0)) * row_i[j] >= 0 else -1
        along = {k: row_i.get(k, 0.0) + sign * row_j.get(k, 0.0) for k in row_i.keys() | row_j.keys()}
        size = (along[i] + sign * along[j]) / 4
        first = {k: value / (2 * size) for k, value in along.items()}
        rest = {k: row_j.get(k, 0.0) - size * first[j] * first[k] for k in along}
        second = {k: value / rest[j] for k, value in rest.items()}
        forms = [(first, size), (second, rest[j])]
        return [({k: value for k, value in form.items() if value != 0}, weight) for form, weight in forms]

    def _eliminate(self, pivots: tuple[int, ...], completed: list[tuple[Form, float]]) -> None:
        touched = {k for form, _ in completed for k in form}.difference(pivots)
        for form, weight in completed:
            inner = [(k, value) for k, value in form.items() if k in touched]
            for a, u in inner:
                row = self.rows[a]
                for b, v in inner:
                    row[b] = row.get(b, 0.0) - weight * (u * v)
        for p in pivots:
            for k in self.rows[p]:
                if k != p:
                    self.rows[k].pop(p, None)
            self.rows[p] = {}
        for a in touched:
            row = self.rows[a]
            for b in touched:
                if a <= b and row.get(b):
                    heappush(self.entries, (-abs(row[b]), a, b))
            if row.get(a):
                heappush(self.diagonal, (-abs(row[a]), a))
