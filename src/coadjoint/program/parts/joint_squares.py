"""Completed squares of many systems at once: those for which `complete_squares` takes the same pivots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.bounded import SMALLEST_FACTOR, Bounded, determinant_terms, sum_of
from coadjoint.program.commutation import BRACKET_ROUNDOFF, Commutation
from coadjoint.program.parts.agreement import Agreement, Undecided
from coadjoint.program.parts.part import COMPUTED, Parts
from coadjoint.program.parts.quadratic_atoms import sets_of
from coadjoint.program.parts.squares import MAX_RATIONAL_SIZE, MIN_PIVOT_RATIO
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.hamiltonians.terms import QuadraticTerm, Term
from coadjoint.systems.system_stacks import counts_of

Floats = NDArray[np.float64]

PRIME = 2**61 - 1
MAX_ERROR = 2.0**-80  # relative error of entries after which they are computed anew


class Square(NamedTuple):
    """A completed square of all systems: a form on `coordinates`, the row of weights d l, its linear term, and d.

    Without weights the form only carries a piece of the linear term.
    """

    coordinates: Integers
    form: Bounded
    weights: Bounded | None
    linear: Bounded
    factor: Bounded


class RoundedSquare(NamedTuple):
    """A square in floats: form and weights (coordinates, members), none without weights, and linear term (members,)."""

    coordinates: Integers
    form: Floats
    weights: Floats
    linear: Floats


class _Generic:
    """The matrix and linear term of one energy with other entries, in integers modulo a prime.

    What vanishes there vanishes for all entries. Numbers of systems, which are known to a bound, are then set to zero.
    """

    def __init__(self, matrix: Floats, linear: Floats) -> None:
        drawn = np.random.default_rng(PRIME % 1993).integers(1, PRIME, (*matrix.shape[:1], matrix.shape[0] + 1))
        values = np.triu(drawn[:, :-1]) + np.triu(drawn[:, :-1], 1).T
        used = np.any(matrix != 0.0, axis=-1), np.any(linear != 0.0, axis=-1)
        self.matrix, self.linear = (
            np.where(mask, numbers, 0).astype(object)
            for mask, numbers in zip(used, (values, drawn[:, -1]), strict=True)
        )

    def completed(self, pivots: Sequence[int], sign: int) -> list[tuple[NDArray[Any], NDArray[Any], Any]]:
        """Return forms, weights and linear terms of the squares at one or two pivots, as `squares_of_members`."""
        M, b = self.matrix, self.linear
        if len(pivots) == 1:
            (p,) = pivots
            return [(M[p] * _inverse(M[p, p]) % PRIME, M[p].copy(), b[p])]
        p, q = pivots
        half = (M[p] + sign * M[q]) * _inverse(2) % PRIME
        first = 2 * half * _inverse(half[p] + sign * half[q]) % PRIME
        row = (M[q] - half * first[q]) % PRIME
        second = row * _inverse(row[q]) % PRIME
        inverse = _inverse(first[p] * second[q] - first[q] * second[p])
        betas = (b[p] * second[q] - b[q] * second[p]) * inverse, (first[p] * b[q] - first[q] * b[p]) * inverse
        return [(first, half, betas[0] % PRIME), (second, row, betas[1] % PRIME)]

    def eliminate(self, pivots: Sequence[int], completed: Sequence[tuple[Any, Any, Any]]) -> None:
        """Subtract squares, and what concerns their pivots."""
        for form, weights, beta in completed:
            self.matrix = (self.matrix - np.multiply.outer(weights, form)) % PRIME
            self.linear = (self.linear - beta * form) % PRIME
        pivoted = list(pivots)
        self.matrix[pivoted, :] = self.matrix[:, pivoted] = self.linear[pivoted] = 0


def _inverse(number: Any) -> int:
    if not number % PRIME:
        raise Undecided
    return pow(int(number), -1, PRIME)


def squares_of_members(matrix: Floats, linear: Floats, agreement: Agreement) -> list[Square]:
    """Complete the squares of b.x + x.M.x/2 for all M (n, n, members), b (n, members), in exact pivots."""
    M, b, generic = Bounded.of(matrix).copy(), Bounded.of(linear).copy(), _Generic(matrix, linear)
    remaining, pivoted, squares = list(range(len(linear))), list[int](), list[Square]()
    zero, one = (Bounded.of(np.full(linear.shape[1], value)) for value in (0.0, 1.0))
    sharp = bool(np.all((matrix == 0.0) | (np.abs(matrix) > SMALLEST_FACTOR)))
    while remaining:
        rest = np.array(remaining)
        first, second = (rest[index] for index in np.triu_indices(len(rest)))
        sizes = abs(M[first, second])
        if not agreement.present(sizes).any():
            break
        largest, best = agreement.largest(sizes), agreement.largest(abs(M[rest, rest]))
        signs, certain = _signs_of_single(abs(M[rest[best], rest[best]]), sizes[largest])
        sign = 1
        if agreement.decide(signs >= 0.0, certain):
            pivots = [int(rest[best])]
            row, factor = M[pivots[0], rest], M[pivots[0], pivots[0]].copy()
            form = row / factor
            form[best] = one
            # In exact numbers d l is the row of the pivot.
            completed = [Square(rest, form, row, b[pivots[0]].copy(), factor)]
        else:
            pivots = [int(first[largest]), int(second[largest])]
            sign, completed = _pair(M, b, rest, pivots, agreement)
        model = generic.completed(pivots, sign)
        remaining = [k for k in remaining if k not in pivots]
        for square, (form_model, _, beta_model) in zip(completed, model, strict=True):
            if not beta_model:
                square.linear[...] = zero
            at = np.flatnonzero(form_model[rest] != 0)
            at = at[agreement.present(square.form[at])]
            assert square.weights is not None
            squares.append(Square(rest[at], square.form[at], square.weights[at], square.linear, square.factor))
            _eliminate(M, b, squares[-1], np.array(remaining, dtype=np.int64), agreement)
        generic.eliminate(pivots, model)
        M[generic.matrix == 0] = zero
        b[generic.linear == 0] = zero
        pivoted += pivots
        if sharp and len(pivoted) <= 2:
            _sharpen(M, matrix, pivoted, remaining)
    return squares + [Square(np.array([k]), one[None], None, b[k], zero) for k in remaining if agreement.present(b[k])]


def _signs_of_single(diagonal: Bounded, largest: Bounded) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return the signs of what decides for a single pivot, and whether they are certain."""
    first, second = (float(part) for part in (MIN_PIVOT_RATIO.denominator, MIN_PIVOT_RATIO.numerator))
    difference = diagonal.high * first - largest.high * second
    size = diagonal.high * first + largest.high * second
    certain = np.abs(difference) > 16.0 * UNIT_ROUNDOFF * size + 2.0 * first * (diagonal.error + largest.error)
    if certain.all():
        return np.sign(difference), certain
    return (diagonal * Bounded.of(first) - largest * Bounded.of(second)).signs()


def _sharpen(M: Bounded, matrix: Floats, pivoted: Sequence[int], remaining: Sequence[int]) -> None:
    """Replace entries that have cancelled by quotients of determinants, which are exact sums."""
    rows = np.array(remaining, dtype=np.int64)
    first, second = (rows[index] for index in np.triu_indices(len(rows)))
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        entry = M[i, j]
        if np.any(entry.error > MAX_ERROR * np.abs(entry.high)):
            minors = (
                [[[matrix[row, column]] for column in columns] for row in rows_of_minor]
                for rows_of_minor, columns in (([*pivoted, i], [*pivoted, j]), (pivoted, pivoted))
            )
            largest, smallest = (sum_of(determinant_terms(entries)) for entries in minors)
            M[i, j] = M[j, i] = largest / smallest


def _pair(
    M: Bounded, b: Bounded, rest: Integers, pivots: Sequence[int], agreement: Agreement
) -> tuple[int, list[Square]]:
    """Return the sign and the two squares of coupled pivots, as `_pair` in `squares.py`."""
    p, q = pivots
    (trace, certain), (entry, sure) = (M[p, p] + M[q, q]).signs(), M[p, q].signs()
    sign = 1 if agreement.decide(trace * entry >= 0.0, certain & sure) else -1
    at, to = (int(np.flatnonzero(rest == k)[0]) for k in (p, q))
    half = (M[p, rest] + M[q, rest].scaled(float(sign))).scaled(0.5)
    size = half[at] + half[to].scaled(float(sign))
    first = half.scaled(2.0) / size
    row = M[q, rest] - half * first[to]
    second, factor = row / row[to], row[to]
    second[to] = Bounded.of(np.ones_like(factor.high))
    betas = b[p].copy(), b[q].copy()
    if np.any(b.high[[p, q]]) or np.any(b.error[[p, q]]):
        determinant = first[at] * second[to] - first[to] * second[at]
        betas = (
            (b[p] * second[to] - b[q] * second[at]) / determinant,
            (first[at] * b[q] - first[to] * b[p]) / determinant,
        )
    return sign, [Square(rest, first, half, betas[0], size.scaled(0.5)), Square(rest, second, row, betas[1], factor)]


def _eliminate(M: Bounded, b: Bounded, square: Square, remaining: Integers, agreement: Agreement) -> None:
    """Subtract a square from the energy of the remaining coordinates."""
    inner = np.flatnonzero(np.isin(square.coordinates, remaining))
    first, second = (inner[index] for index in np.triu_indices(len(inner)))
    rows, columns = square.coordinates[first], square.coordinates[second]
    assert square.weights is not None
    if len(inner):
        M[rows, columns] = M[columns, rows] = M[rows, columns] - square.weights[first] * square.form[second]
        if agreement.present(square.linear):
            own = square.coordinates[inner]
            b[own] = b[own] - square.linear * square.form[inner]


def rounded_squares(matrix: Floats, linear: Floats, agreement: Agreement) -> list[RoundedSquare]:
    """Return the squares that are larger than the rounding of M, in floats."""
    floor = 8.0 * UNIT_ROUNDOFF * np.max(np.abs(matrix), axis=(0, 1))
    found = []
    for square in squares_of_members(matrix, linear, agreement):
        if not agreement.present(square.linear):
            form, bound = np.max(np.abs(square.form.high), axis=0), np.max(square.form.error, axis=0)
            size, error = np.abs(square.factor.high), square.factor.error
            most = (size + error) * (form + bound) ** 2 * (1.0 + 64 * UNIT_ROUNDOFF)
            least = np.maximum(size - error, 0.0) * np.maximum(form - bound, 0.0) ** 2 * (1.0 - 64 * UNIT_ROUNDOFF)
            if not agreement.decide(least > floor, (least > floor) | (most < floor)):
                continue
        form, beta = agreement.rounded(square.form), agreement.rounded(square.linear)
        weights = np.zeros((0, len(floor))) if square.weights is None else agreement.rounded(square.weights)
        found.append(RoundedSquare(square.coordinates, form, weights, beta))
    return found


def squares_of_term(
    term: QuadraticTerm, values: Floats, linear: Floats, algebra: LieAlgebra, separate: bool, agreement: Agreement
) -> list[RoundedSquare]:
    """Return the squares of a quadratic term of all systems, with M `values` (entries, members) and b (n, members)."""
    label, members, squared = sets_of(term, Commutation(algebra), separate)
    found = []
    for number in np.flatnonzero(squared).tolist():
        own = members[label[members] == number]
        if len(own) > MAX_RATIONAL_SIZE:
            raise Undecided
        entries = np.flatnonzero(label[term.rows] == number)
        matrix = np.zeros((len(own), len(own), values.shape[1]))
        rows, columns = (np.searchsorted(own, index[entries]) for index in (term.rows, term.indices))
        matrix[rows, columns] = values[entries]
        for square in rounded_squares(matrix, linear[own], agreement):
            found.append(square._replace(coordinates=own[square.coordinates]))
    return found


class Numbers(NamedTuple):
    """The numbers of parts of all systems: forms and weights (entries, members), offsets (angles, members)."""

    forms: Floats
    offset: Floats
    weights: Floats


def numbers_of_parts(
    parts: Parts, squares: Sequence[RoundedSquare], terms: Sequence[Term], coefficients: Floats
) -> Numbers:
    """Return the numbers of all systems for parts of the first one, from its squares and from copies of `terms`.

    Raises `Undecided` for other parts, or if an angle of the first system has other numbers.
    """
    count, forms, weights = coefficients.shape[1], parts.forms, parts.weights
    given = [np.asarray(one, dtype=np.float64) for one in (forms.value, parts.offset, weights.value)]
    numbers = Numbers(*(np.repeat(one[:, None], count, axis=1) for one in given))
    starts = np.cumsum([0, *counts_of(terms)]).tolist()
    share = np.repeat(np.arange(len(parts.source)), np.diff(parts.row))
    for a in range(len(parts.offset)):
        s = int(share[a])
        if s in parts.nonlinear_shares:
            continue
        of_form, of_weights = (slice(int(rows.start[a]), int(rows.start[a + 1])) for rows in (forms, weights))
        coordinates, columns = forms.coordinate[of_form].astype(np.int64), weights.coordinate[of_weights]
        if parts.source[s] == COMPUTED:
            square = next(
                (one for one in squares if _is_angle(one, numbers, coordinates, of_form, a, of_weights)), None
            )
            if square is None:
                raise Undecided
            numbers.forms[of_form], numbers.offset[a] = square.form, square.linear
            numbers.weights[of_weights] = square.weights
            continue
        term, start = terms[parts.source[s]].form, starts[parts.source[s]]
        if term is None or len(coordinates) != 1:
            raise Undecided
        n, (own,) = len(term.linear), coordinates.tolist()
        entries = np.searchsorted(term.rows * n + term.indices, own * n + columns.astype(np.int64))
        numbers.offset[a] = coefficients[start + own]
        numbers.weights[of_weights] = coefficients[start + n + entries]
    if any(one[:, 0].tobytes() != first.tobytes() for one, first in zip(numbers, given, strict=True)):
        raise Undecided
    return numbers


def _is_angle(
    square: RoundedSquare, numbers: Numbers, coordinates: Integers, form: slice, angle: int, weights: slice
) -> bool:
    """Return whether a square of the first system is the angle with these numbers."""
    return (
        np.array_equal(square.coordinates, coordinates)
        and len(square.weights) == weights.stop - weights.start
        and np.array_equal(square.form[:, 0], numbers.forms[form, 0])
        and np.array_equal(square.weights[:, 0], numbers.weights[weights, 0])
        and square.linear[0] == numbers.offset[angle, 0]
    )


def require_commutators(algebra: LieAlgebra, parts: Parts, forms: Floats, agreement: Agreement) -> None:
    """Keep the systems of which the same forms (entries, members) commute, up to rounding."""
    count, size, members = len(parts.offset), algebra.dim, forms.shape[1]
    dense, long = np.zeros((count, size, members)), np.diff(parts.forms.start) > 1
    dense[parts.forms.owner, parts.forms.coordinate] = forms
    used = np.zeros((count, size), dtype=bool)
    used[parts.forms.owner, parts.forms.coordinate] = True
    i, j, k, c = algebra.triples
    i, j, k, c = np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([k, k]), np.concatenate([c, -c])
    for f, g in zip(*np.triu_indices(count, 1), strict=True):
        if not (long[f] or long[g]):
            continue
        chosen = np.flatnonzero(used[f, i] & used[g, j])
        component, index = np.unique(k[chosen], return_inverse=True)
        total, bound = np.zeros((2, len(component), members))
        products = dense[f, i[chosen]] * c[chosen, None] * dense[g, j[chosen]]
        np.add.at(total, index, products)
        np.add.at(bound, index, np.abs(products))
        # Sums in another order may differ by a rounding for each product.
        rounding = (4 + np.bincount(index, minlength=len(component)))[:, None] * UNIT_ROUNDOFF
        clash = np.any(np.abs(total) > (BRACKET_ROUNDOFF + rounding) * bound, axis=0)
        clear = np.all((np.abs(total) < (BRACKET_ROUNDOFF - rounding) * bound) | (bound == 0.0), axis=0)
        agreement.decide(clash, clash | clear)
