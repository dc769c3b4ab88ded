"""Completed squares: a symmetric matrix, dense or sparse, as a sum of d_r l_r l_r^T; rational up to a moderate size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from heapq import heapify, heappop, heappush
from math import isfinite, lcm
from operator import mul
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import rational
from coadjoint.algebra.exact.sparse_sums import Integers, connected
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.parts.part import GradientShare, Parts
from coadjoint.program.sparse_rows import SparseRows, sparse_row
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.coefficients import PLACEHOLDER_COEFFICIENT

# Single pivots need a diagonal entry of at least this fraction of the largest entry, which bounds the coefficients of
# the forms (Bunch and Parlett 1971, (1 + sqrt 17)/8).
MIN_PIVOT_RATIO = Fraction(41, 64)
# Above this size numerators become too large, and the reduction runs in the number type of its input.
MAX_RATIONAL_SIZE = 16
# Mean number of entries per row below which rows are stored sparse.
DENSE_ROW = 16

Form = dict[int, float]
Mask = NDArray[np.bool_]


class Squares(NamedTuple):
    """Completed squares: x.M.x/2 + b.x = sum_r d_r (l_r.x)^2 / 2 + beta_r l_r.x, at most n of them. `forms` has the
    l_r, dense (r, n) or as sparse rows, `weights` the d_r (zero for a form that only carries a piece of b), `linear`
    the beta_r. `pivots` (r, 3) has the step of the reduction and its pivots, repeated if there is only one.
    """

    forms: Any
    weights: NDArray[Any]
    linear: NDArray[Any]
    pivots: NDArray[np.int64]


def complete_squares(matrix: NDArray[Any], linear: NDArray[Any], central: NDArray[np.bool_] | None = None) -> Squares:
    """Complete the square for any symmetric matrix (Lagrange's reduction), rational as eigenvectors are not.

    Those of `central` coordinates, which generate no flow, come last, so that no flow is a difference of larger ones.
    """
    size = len(linear)
    exact = matrix.dtype == np.float64 and size <= MAX_RATIONAL_SIZE
    lift = np.vectorize(Fraction, otypes=[object]) if exact else np.copy
    residual, b = lift(matrix), lift(linear)
    chosen = np.ones(size, dtype=bool) if central is None else ~central
    # Each of n pivots rounds an entry three times.
    rounding = 0 if exact or matrix.dtype == object else 4.0 * size * UNIT_ROUNDOFF
    floor = rounding and rounding * np.max(np.abs(matrix[np.ix_(chosen, chosen)]), initial=0.0)
    forms: list[NDArray[Any]] = []
    weights: list[Any] = []
    betas: list[Any] = []
    steps: list[tuple[int, int, int]] = []
    # The rows and columns of pivots are zero; they are removed once they are many.
    active, remaining = np.arange(size), size
    while remaining:
        if 4 * remaining <= 3 * len(active):
            rest = np.flatnonzero(~np.isin(active, [p for _, *pair in steps for p in pair]))
            active, residual = active[rest], residual[np.ix_(rest, rest)]
        within = chosen[active]
        pivotal = residual if within.all() else np.where(np.multiply.outer(within, within), residual, 0 * residual)
        best = int(np.argmax(np.abs(np.diagonal(pivotal))))
        row, column = divmod(int(np.argmax(np.abs(pivotal))), len(active))
        largest = abs(pivotal[row, column])
        if largest <= floor:
            if chosen.all():
                break
            if exact:  # drop what the rounding of the entries leaves of squares without a flow
                least = 4.0 * size * UNIT_ROUNDOFF * float(np.max(np.abs(matrix)))
                rounded = np.multiply.outer(~within, ~within) & np.asarray(np.abs(residual) <= least, dtype=bool)
                residual = np.where(rounded, 0 * residual, residual)
            chosen[:], floor = True, rounding and rounding * np.max(np.abs(matrix))
            continue
        is_single = abs(residual[best, best]) * MIN_PIVOT_RATIO.denominator >= largest * MIN_PIVOT_RATIO.numerator
        local_pivots = [best] if is_single else [row, column]
        completed = _square(residual, best) if is_single else _pair(residual, row, column)
        new_betas = _split_linear(b[active[local_pivots]], [form[local_pivots] for form, _ in completed])
        for (form, weight), beta in zip(completed, new_betas, strict=True):
            residual = residual - weight * np.multiply.outer(form, form)
            b[active] = b[active] - beta * form
            full_form = np.zeros(size, dtype=b.dtype)
            full_form[active] = form
            forms.append(full_form)
            weights.append(weight)
        betas.extend(new_betas)
        pivots = active[local_pivots].tolist()
        steps += [(len(steps), pivots[0], pivots[-1])] * len(completed)
        residual[local_pivots, :] = residual[:, local_pivots] = 0 * residual[0, 0]
        b[pivots] = 0 * b[0]
        remaining -= len(local_pivots)
    for k in np.flatnonzero(b != 0):
        form = 0 * b
        form[k] = form[k] + 1
        forms.append(form)
        weights.append(0 * b[k])
        betas.append(b[k])
        steps.append((len(steps), int(k), int(k)))
    stacked = np.array(forms, dtype=b.dtype).reshape(len(forms), size)
    pivoted = np.array(steps, dtype=np.int64).reshape(-1, 3)
    return Squares(stacked, np.array(weights, dtype=b.dtype), np.array(betas, dtype=b.dtype), pivoted)


def _square(residual: NDArray[Any], i: int) -> list[tuple[NDArray[Any], Any]]:
    return [(residual[i] / residual[i, i], residual[i, i])]


def _pair(residual: NDArray[Any], i: int, j: int) -> list[tuple[NDArray[Any], Any]]:
    """Return squares along e_i +- e_j, then e_j, for a diagonal small against m = M_ij.

    With a zero diagonal, ((u + v)(u + v)^T - (u - v)(u - v)^T) m/2 with the rows m u and m v.
    """
    sign = 1 if (residual[i, i] + residual[j, j]) * residual[i, j] >= 0 else -1
    along = residual[i] + sign * residual[j]
    size = (along[i] + sign * along[j]) / 4
    first = along / (2 * size)
    rest = residual[j] - size * first[j] * first
    return [(first, size), (rest / rest[j], rest[j])]


def _split_linear(b: Any, forms: Sequence[Any]) -> list[Any]:
    """Return beta with sum beta_r l_r = b, from the entries of b and the forms at the one or two pivots."""
    if len(forms) == 1:
        return [b[0] / forms[0][0]]
    (p0, p1), (m0, m1), (b0, b1) = *forms, b
    determinant = p0 * m1 - p1 * m0
    return [(b0 * m1 - b1 * m0) / determinant, (p0 * b1 - p1 * b0) / determinant]


def sparse_squares(matrix: SparseRows, linear: NDArray[np.float64], central: Mask | None = None) -> Squares:
    """Complete the square of linear.x + x.M.x/2 for sparse symmetric M, with the numbers of `complete_squares`."""
    size = len(linear)
    if size > MAX_RATIONAL_SIZE and len(matrix.value) < DENSE_ROW * size:
        return _Reduction(matrix, linear, central).squares()
    dense = np.zeros((size, size))
    dense[matrix.owner, matrix.coordinate] = matrix.value
    squares = complete_squares(dense, linear, central)
    row, column = np.nonzero(squares.forms != 0)
    start = np.searchsorted(row, np.arange(len(squares.forms) + 1)).astype(np.int64)
    return squares._replace(forms=SparseRows(start, column.astype(np.uint32), squares.forms[row, column]))


class _Reduction:
    """Residual matrix of `complete_squares`, with the same operations in the same order."""

    def __init__(self, matrix: SparseRows, linear: NDArray[np.float64], central: Mask | None = None) -> None:
        self.rows: list[Form] = [{} for _ in linear]
        owner: Integers = matrix.owner
        for i, j, value in zip(owner.tolist(), matrix.coordinate.tolist(), matrix.value.tolist(), strict=True):
            self.rows[i][j] = value
        self.linear: list[float] = linear.tolist()
        self.matrix = matrix
        self._choose(np.ones(len(linear), dtype=bool) if central is None else ~central)

    def _choose(self, chosen: Mask) -> None:
        self.chosen, rows = chosen, [(i, self.rows[i]) for i in np.flatnonzero(chosen).tolist()]
        self.diagonal = [(-abs(row[i]), i) for i, row in rows if i in row]
        self.entries = [(-abs(v), i, j) for i, row in rows for j, v in row.items() if i <= j and chosen[j]]
        heapify(self.diagonal)
        heapify(self.entries)
        # Each of n pivots rounds an entry three times.
        values = self.matrix.value[chosen[self.matrix.owner] & chosen[self.matrix.coordinate]]
        self.floor = 4.0 * len(chosen) * UNIT_ROUNDOFF * float(np.max(np.abs(values), initial=0.0))

    def squares(self) -> Squares:
        forms: list[Form] = []
        weights: list[float] = []
        betas: list[float] = []
        steps: list[tuple[int, int, int]] = []
        while (pivots := self._pivots()) is not None:
            completed = self._square(*pivots) if len(pivots) == 1 else self._pair(*pivots)
            self._eliminate(pivots, completed)
            new_betas = _split_linear(
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
        return Squares(sparse, np.array(weights), np.array(betas), pivoted)

    def _pivots(self) -> tuple[int, ...] | None:
        """Return the coordinate of the next square, or two coupled ones; None if the residual vanishes."""
        while self.entries and not self._current(*self.entries[0]):
            heappop(self.entries)
        if not self.entries or -self.entries[0][0] <= self.floor:
            if self.chosen.all():
                return None
            self._choose(np.ones_like(self.chosen))
            return self._pivots()
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
            for b in touched if self.chosen[a] else ():
                if a <= b and row.get(b) and self.chosen[b]:
                    heappush(self.entries, (-abs(row[b]), a, b))
            if row.get(a) and self.chosen[a]:
                heappush(self.diagonal, (-abs(row[a]), a))


# A new linear term b needs no new squares: the forms l_r do not depend on it, and sum_r beta_r l_r = b.
class ExactSums(NamedTuple):
    """Sums over k of factors[r][k] b[coordinates[k]], divided by denominators[r], rounded once."""

    coordinates: tuple[int, ...]
    factors: tuple[tuple[int, ...], ...]
    denominators: tuple[int, ...]

    @property
    def used(self) -> Integers:
        return np.array(self.coordinates)

    def at(self, b: NDArray[np.float64]) -> list[float]:
        """Evaluate the sums for finite floats b, correctly rounded; raise OverflowError beyond float64.

        >>> ExactSums((0, 1), ((1, -2), (1, 0)), (3, 4)).at(np.array([1.0, 0.25]))
        [0.16666666666666666, 0.25]
        """
        exact = [value.as_integer_ratio() for value in b.take(self.coordinates).tolist()]
        # Denominators of floats are powers of two, so the largest is a common denominator.
        common = max([denominator for _, denominator in exact])
        scaled = [numerator * (common // denominator) for numerator, denominator in exact]
        return [
            sum(map(mul, factors, scaled)) / (denominator * common)
            for factors, denominator in zip(self.factors, self.denominators, strict=True)
        ]


class ReductionSteps(NamedTuple):
    """Linear terms of squares with forms in floats, by the operations of the reduction in their order."""

    steps: tuple[tuple[tuple[int, ...], tuple[dict[int, float], ...]], ...]
    order: tuple[int, ...]

    @property
    def used(self) -> Integers:
        return np.array(sorted({k for _, forms in self.steps for form in forms for k in form}))

    def at(self, b: NDArray[np.float64]) -> list[float]:
        """Evaluate the linear terms bitwise as for newly completed squares; raise OverflowError beyond float64."""
        residual, offsets = b.tolist(), []
        for pivots, forms in self.steps:
            betas = _split_linear([residual[p] for p in pivots], [[form.get(p, 0.0) for p in pivots] for form in forms])
            for beta, form in zip(betas, forms, strict=True):
                for k, value in form.items():
                    residual[k] -= beta * value
            offsets += betas
        if not all(map(isfinite, offsets)):
            raise OverflowError("a completed square is too large for float64")
        return [offsets[position] for position in self.order]


def offsets_of_squares(parts: Parts) -> list[tuple[list[int], ExactSums | ReductionSteps]]:
    """Return (angles, offsets of the linear term) by set of coupled coordinates; uncoupled ones are omitted.

    Up to 16 coupled coordinates have exact forms (`ExactSums`), others floats (`ReductionSteps`).
    """
    forms = parts.forms
    linear = np.ones(len(parts.offset), dtype=bool)
    for s in parts.nonlinear:
        linear[parts.row[s] : parts.row[s + 1]] = False
    owner = forms.owner
    # The angle of a coordinate that depends on others is no square, but a derivative of products.
    alone, weights = np.diff(forms.start) == 1, parts.weights
    own = np.zeros(len(alone), dtype=np.uint32)
    own[alone] = forms.coordinate[forms.start[:-1][alone]]
    linear[weights.owner[alone[weights.owner] & (weights.coordinate != own[weights.owner])]] = False
    angles = np.flatnonzero(linear)
    entries = np.flatnonzero(linear[owner])
    # Nodes are the angles, then the coordinates.
    count, coordinate = len(parts.offset), forms.coordinate[entries].astype(np.int64)
    label = connected(count + int(coordinate.max(initial=-1)) + 1, owner[entries], count + coordinate)
    clusters: dict[int, list[int]] = {}
    for angle in angles.tolist():
        clusters.setdefault(int(label[angle]), []).append(angle)
    result: list[tuple[list[int], ExactSums | ReductionSteps]] = []
    for cluster in clusters.values():
        rows = [dict(zip(*sparse_row(parts.forms, angle), strict=True)) for angle in cluster]
        coordinates = sorted({k for row in rows for k in row})
        if len(coordinates) > MAX_RATIONAL_SIZE and parts.pivots is not None:
            result.append((cluster, _reduced(rows, parts.pivots[cluster])))
        elif 1 < len(coordinates) <= MAX_RATIONAL_SIZE and len(cluster) <= len(coordinates):
            result.append((cluster, _inverse(rows, coordinates)))
    return result


def _reduced(rows: list[dict[int, Any]], pivots: NDArray[np.int64]) -> ReductionSteps:
    """Recover the steps of the reduction from its forms."""
    steps: dict[int, tuple[tuple[int, ...], list[dict[int, float]]]] = {}
    inverse = np.argsort(pivots[:, 0], kind="stable")
    for position in inverse.tolist():
        step, first, last = pivots[position].tolist()
        pivot_pair = (first,) if first == last else (first, last)
        steps.setdefault(step, (pivot_pair, []))[1].append(rows[position])
    order = np.argsort(inverse).tolist()
    return ReductionSteps(tuple((pivot_pair, tuple(forms)) for pivot_pair, forms in steps.values()), tuple(order))


def with_linear_offsets(parts: Parts, linear: NDArray[np.float64]) -> Parts:
    """Replace `PLACEHOLDER_COEFFICIENT`, zeros kept as structure, by the linear term, shape (n,), in parts."""
    offset = parts.offset.copy()
    for angles, sums in offsets_of_squares(parts):
        offset[angles] = sums.at(linear)
    offset[parts.offset == PLACEHOLDER_COEFFICIENT] = 0.0
    gradients = {s: _without_placeholders(share) for s, share in parts.gradients.items()}
    return replace(parts, offset=offset, gradients=gradients, pivots=None)


def _without_placeholders(share: GradientShare) -> GradientShare:
    if share.polynomial is None:
        return share
    monomials = {e: c for e, c in share.polynomial.monomials.items() if c != PLACEHOLDER_COEFFICIENT}
    return GradientShare(share.coordinates, Polynomial(monomials, dim=share.polynomial.dim))


def _inverse(rows: list[dict[int, Any]], coordinates: list[int]) -> ExactSums:
    """Return beta of sum_r beta_r l_r = b, for linearly independent forms."""
    from flint import fmpq_mat

    r, m = len(rows), len(coordinates)
    # [L^T | 1], reduced, is [1 | B] in its first rows, with B L^T = 1.
    augmented = [
        [rational(row.get(k, 0)) for row in rows] + [rational(int(i == j)) for j in range(m)]
        for i, k in enumerate(coordinates)
    ]
    reduced, _ = fmpq_mat(m, r + m, [entry for line in augmented for entry in line]).rref()
    factors, denominators = [], []
    for a in range(r):
        exact = [reduced[a, r + j] for j in range(m)]
        denominators.append(lcm(*(int(value.denominator) for value in exact)))
        factors.append(tuple(int(value.numerator) * (denominators[-1] // int(value.denominator)) for value in exact))
    return ExactSums(tuple(coordinates), tuple(factors), tuple(denominators))
