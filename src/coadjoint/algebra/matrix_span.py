"""Structure constants of the algebra that matrices span: exact over square roots, else by least squares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from numbers import Rational
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.elimination import Span, Vector, add_multiple
from coadjoint.algebra.exact.numbers import (
    Roots,
    ball,
    exact_number,
    is_finite,
    midpoint,
    product_of_roots,
    recognized_roots,
    rounded,
    rounded_sum,
)
from coadjoint.algebra.exact.sparse_sums import DEFECT_FACTOR, Floats
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.validation import read_list, to_array

DISTANCE = 2.0**-40  # from a span, relative to the products in a commutator, below which a matrix belongs to it
EXACT_INTEGERS = 2.0**53  # floats from here on are integers whatever was rounded
PRECISION = 1024  # bits of the least squares
MAX_DIM = 256  # of a closure

Entries = dict[tuple[int, int], Roots]
Constants = list[tuple[int, int, int, float]]


class Matrices(NamedTuple):
    """Matrices as exact numbers, sums of rational multiples of square roots, and the rounded real representation."""

    entries: list[Entries]
    floats: Floats
    size: int
    complex: bool
    hermitian: bool
    recognized: bool
    certain: bool


def read_matrices(argument: Any) -> Matrices:
    """Validate matrices (n, d, d); complex ones become real matrices (A, -B; B, A) of twice the size."""
    rule = "give n square matrices of one size, such as [A1, A2, A3]"
    matrices = read_list(argument, "matrices", rule)
    arrays: list[NDArray[Any]] = []
    for number, matrix in enumerate(matrices, 1):
        dense = matrix.toarray() if hasattr(matrix, "toarray") else matrix
        array = to_array(dense, f"matrix A{number}", "iufc")
        if array.ndim != 2 or array.shape[0] != array.shape[1] or 0 in array.shape:
            raise ValueError(f"matrix A{number} has shape {array.shape}; {rule}")
        if arrays and array.shape != arrays[0].shape:
            raise ValueError(f"matrix A{number} has shape {array.shape}, and A1 has {arrays[0].shape}; {rule}")
        arrays.append(array)
    if not arrays:
        raise ValueError(f"there are no matrices; {rule}")
    d = len(arrays[0])
    numbers = [[_parts(value, f"matrix A{n}") for value in array.flat] for n, array in enumerate(arrays, 1)]
    is_complex = any(imaginary for row in numbers for _, imaginary in row)
    most = (1 + is_complex) * d * d
    if len(arrays) > most:
        raise ValueError(
            f"there are {len(arrays)} matrices of {d} x {d}, of which at most {most} are independent; leave out those "
            "that depend on others"
        )
    size = d * (1 + is_complex)
    parts = [part for row in numbers for pair in row for part in pair]
    certain = all(
        isinstance(part, int | Fraction) or (part.is_integer() and abs(part) < EXACT_INTEGERS) for part in parts
    )
    roots = recognized_roots(parts)
    recognized = roots is not None
    entries, floats = [], np.zeros((len(arrays), size, size))
    for n, row in enumerate(numbers):
        entry: Entries = {}
        for position, pair in enumerate(row):
            a, b = divmod(position, d)
            for imaginary, value in enumerate(pair):
                if value == 0:
                    continue
                exact = {1: exact_number(value)} if roots is None else roots[value]
                places = ((a, b, 1), (a + d, b + d, 1)) if not imaginary else ((a, b + d, -1), (a + d, b, 1))
                for r, c, sign in places[: 1 + is_complex]:
                    entry[r, c] = {root: sign * factor for root, factor in exact.items()}
                    floats[n, r, c] = sign * rounded(value)
        entries.append(entry)
    hermitian = is_complex and all(np.array_equal(rho, rho.T) for rho in floats)
    return Matrices(entries, floats, size, is_complex, hermitian, recognized, certain)


def _parts(value: Any, what: str) -> tuple[Any, Any]:
    """Return the real and the imaginary part of a number, each an int, a Fraction or a float."""
    if isinstance(value, Rational):
        parts: tuple[Any, Any] = exact_number(value), 0
    else:
        try:
            number = complex(value)
        except (TypeError, ValueError, OverflowError):
            raise TypeError(f"{what} contains {short(value)}; give real or complex numbers") from None
        parts = number.real, number.imag
    if not all(map(is_finite, parts)):
        raise ValueError(f"{what} contains {short(value)}; its numbers must be finite in float64")
    return parts


def _add_product(total: Entries, left: Entries, right: Entries, sign: int) -> None:
    by_row: dict[int, list[tuple[int, Roots]]] = {}
    for (row, column), value in right.items():
        by_row.setdefault(row, []).append((column, value))
    for (row, middle), a in left.items():
        for column, b in by_row.get(middle, ()):
            entry = total.setdefault((row, column), {})
            for p, u in a.items():
                for q, v in b.items():
                    root, factor = product_of_roots(p, q)
                    add_multiple(entry, sign * factor * u, {root: v})


def commutator(left: Entries, right: Entries) -> Entries:
    """Return the commutator of two matrices, exactly."""
    total: Entries = {}
    _add_product(total, left, right, 1)
    _add_product(total, right, left, -1)
    return {position: value for position, value in total.items() if value}


class ExactSpan:
    """The span of matrices over a field of square roots, exactly, of those before the first that depends on others."""

    def __init__(self, matrices: Sequence[Entries], size: int) -> None:
        self._size, found = size, {1}
        for entries in matrices:
            for value in entries.values():
                for root in value.keys() - found:
                    found |= {product_of_roots(root, other)[0] for other in found}
        self.roots = sorted(found)
        self._index = {root: number for number, root in enumerate(self.roots)}
        vectors = [self._vector(entries, root) for entries in matrices for root in self.roots]
        self._span = Span()
        refused = next((number for number, vector in enumerate(vectors) if not self._span.add(vector)), None)
        self.first_dependent: tuple[int, dict[int, float]] | None = None
        if refused is not None:
            k = refused // len(self.roots)
            self.first_dependent = k, self.coordinates(matrices[k])[0] or {}

    def _vector(self, entries: Entries, root: int = 1) -> Vector:
        vector: Vector = {}
        for (row, column), value in entries.items():
            for other, factor in value.items():
                product, scale = product_of_roots(root, other)
                add_multiple(
                    vector, scale * factor, {(row * self._size + column) * len(self.roots) + self._index[product]: 1}
                )
        return vector

    def coordinates(self, entries: Entries, i: int = 0, j: int = 0) -> tuple[dict[int, float] | None, float]:
        """Return the coordinates of a matrix, None outside of the span, and 0."""
        combination = self._span.combination(self._vector(entries))
        if combination is None:
            return None, 0.0
        found: dict[int, Roots] = {}
        for number, value in combination.items():
            if value:
                k, root = divmod(number, len(self.roots))
                found.setdefault(k, {})[self.roots[root]] = value
        return {k: rounded_sum(value) for k, value in found.items()}, 0.0


class NearestSpan:
    """The span of matrices of floats: coordinates by least squares in 1024 bits, the same on every machine."""

    def __init__(self, matrices: Sequence[Entries], size: int) -> None:
        self._size = size
        self._exponents = [_exponent(entries) for entries in matrices]
        self._rows = [_flat(entries, size, e) for entries, e in zip(matrices, self._exponents, strict=True)]
        self._norms = [math.hypot(*map(float, row)) for row in self._rows]
        self._projections: dict[int, tuple[Any, Any]] = {}

    def coordinates(self, entries: Entries, i: int, j: int) -> tuple[dict[int, float] | None, float]:
        """Return the coordinates of the commutator of matrices i and j, None outside of the span, and its distance."""
        exponent, scale = self._exponents[i] + self._exponents[j], self._norms[i] * self._norms[j]
        found, distance = self.distance(_flat(entries, self._size, exponent), scale, len(self._rows))
        if distance > DISTANCE:
            return None, distance
        # Components below the rounding of the given numbers are zero.
        smallest = DEFECT_FACTOR * UNIT_ROUNDOFF * scale
        return {
            k: rounded(value * Fraction(2) ** (exponent - self._exponents[k]))
            for k, value in enumerate(found)
            if abs(value) * Fraction(self._norms[k]) > smallest
        }, distance

    @property
    def first_dependent(self) -> tuple[int, dict[int, float]] | None:
        """Return the first matrix that depends on those before it, and its coordinates in them."""
        from flint import arb, ctx

        with ctx.workprec(PRECISION):
            known = self._known(len(self._rows))
            gram = (known * known.transpose()).mid().tolist()
            lower: list[list[Any]] = []  # L of L D L^T; D has the squared distances
            squares: list[Any] = []
            for k, norm in enumerate(self._norms):
                row: list[Any] = []
                for j in range(k):
                    total = gram[k][j] - sum((row[m] * lower[j][m] * squares[m] for m in range(j)), start=arb(0))
                    row.append((total / squares[j]).mid())
                square = gram[k][k] - sum((v * v * d for v, d in zip(row, squares, strict=True)), start=arb(0))
                if not square.mid() > (arb(DISTANCE) * arb(norm)) ** 2:
                    found, _ = self.distance(self._rows[k], norm, k) if norm else ([], 0.0)
                    powers = (Fraction(2) ** (self._exponents[k] - e) for e in self._exponents)
                    return k, {i: rounded(v * q) for i, (v, q) in enumerate(zip(found, powers, strict=False)) if v}
                lower.append(row)
                squares.append(square.mid())
        return None

    def _known(self, count: int) -> Any:
        """Return the first `count` matrices as the rows of a matrix."""
        from flint import arb_mat

        return arb_mat([[ball(value) for value in row] for row in self._rows[:count]])

    def _projection(self, count: int) -> tuple[Any, Any]:
        """Return the transposed matrices, and the map from a matrix to its coordinates."""
        if count not in self._projections:
            known = self._known(count)
            self._projections[count] = known.transpose(), ((known * known.transpose()).mid().inv() * known).mid()
        return self._projections[count]

    def distance(self, row: list[Fraction], scale: float, count: int) -> tuple[list[Fraction], float]:
        """Return the coordinates in the first `count` matrices of the nearest one, and its distance over `scale`."""
        from flint import arb, arb_mat, ctx

        if not count:
            return [], math.hypot(*map(float, row)) / scale
        with ctx.workprec(PRECISION):
            transposed, projection = self._projection(count)
            target = arb_mat([[ball(value)] for value in row])
            found = (projection * target).mid()
            rest = (target - transposed * found).mid()
            square = sum((value * value for value in rest.entries()), start=arb(0))
            return [midpoint(value) for value in found.entries()], float(square.mid().sqrt()) / scale


def _exponent(entries: Entries) -> int:
    """Return about the binary logarithm of the largest entry."""
    values = [Fraction(value[1]) for value in entries.values()]
    return max((abs(v.numerator).bit_length() - v.denominator.bit_length() for v in values), default=0)


def _flat(entries: Entries, size: int, exponent: int) -> list[Fraction]:
    row = [Fraction(0)] * (size * size)
    for (a, b), value in entries.items():
        row[a * size + b] = Fraction(value[1]) / Fraction(2) ** exponent
    return row


@long_operation("from_matrices")
def spanned(given: Matrices, names: Sequence[str]) -> tuple[Constants, Floats]:
    """Return constants and representation of the algebra that matrices span; ValueError if dependent or not closed."""
    missing: tuple[int, int, Entries, float] | None = None
    for exact in [True] * given.recognized + [False] * (not given.certain):
        matrices = given.entries if exact else _as_floats(given)
        constants, missing = _constants(matrices, _span_of_independent(matrices, names, given.size, exact))
        if missing is None:
            return constants, given.floats
    assert missing is not None
    i, j, matrix, distance = missing
    text = short(_shown(matrix, given).tolist(), 300)
    by = f" by {distance:.1e} of the size of its products" if distance else ""
    hint = "add this matrix, or complete the set by LieAlgebra.closure"
    if given.hermitian:
        hint = "for Hermitian matrices give -1j or 1j times them, which are closed where these are not"
    raise ValueError(
        f"[{names[i]}, {names[j]}] is not in the span of the {len(given.entries)} matrices{by}: it is {text}; {hint}"
    )


def _as_floats(given: Matrices) -> list[Entries]:
    """Return the rounded matrices, as exact numbers."""
    return [
        {(int(a), int(b)): {1: exact_number(float(rho[a, b]))} for a, b in zip(*np.nonzero(rho), strict=True)}
        for rho in given.floats
    ]


def _shown(entries: Entries, given: Matrices) -> Any:
    """Return a matrix for messages: complex if the given ones are."""
    dense = np.zeros((given.size, given.size))
    for position, value in entries.items():
        dense[position] = rounded_sum(value)
    if not given.complex:
        return dense
    d = given.size // 2
    return dense[:d, :d] + 1j * dense[d:, :d]


def _constants(
    matrices: Sequence[Entries], span: ExactSpan | NearestSpan
) -> tuple[Constants, tuple[int, int, Entries, float] | None]:
    """Return the constants, and the first pair whose commutator is outside of the span, with it and its distance."""
    constants: Constants = []
    for i, left in enumerate(matrices):
        note_progress(f"the commutators of {len(matrices)} matrices", i / len(matrices))
        for j in range(i + 1, len(matrices)):
            bracket = commutator(left, matrices[j])
            if not bracket:
                continue
            found, distance = span.coordinates(bracket, i, j)
            if found is None:
                return [], (i, j, bracket, distance)
            constants += [(i, j, k, value) for k, value in found.items()]
    return constants, None


def _span_of_independent(
    matrices: Sequence[Entries], names: Sequence[str], size: int, exact: bool
) -> ExactSpan | NearestSpan:
    """Return the span of matrices; ValueError with the first one that depends on others, and its coordinates."""
    span = ExactSpan(matrices, size) if exact else NearestSpan(matrices, size)
    if span.first_dependent is not None:
        k, combination = span.first_dependent
        terms = " + ".join(f"{value:.6g} {names[i]}" for i, value in list(combination.items())[:6])
        more = " + ..." if len(combination) > 6 else ""
        raise ValueError(f"the matrices are dependent: {names[k]} = {terms or '0'}{more}; leave {names[k]} out")
    return span


@long_operation("closure")
def closed(given: Matrices, names: list[str]) -> tuple[Constants, Floats, list[tuple[int, int]]]:
    """Return the algebra generated by matrices, as from `spanned`, and the pair of each commutator that was added."""
    # By the Jacobi identity, commutators with the generators suffice. `names` receives the names of added matrices.
    exact = given.recognized
    matrices = list(given.entries) if exact else _as_floats(given)
    span = _span_of_independent(matrices, names, given.size, exact)
    generators, added = len(matrices), list[tuple[int, int]]()
    i = 1
    while i < len(matrices):
        note_progress(f"the commutators of {len(matrices)} matrices")
        for g in range(min(i, generators)):
            bracket = commutator(matrices[g], matrices[i])
            if not bracket or span.coordinates(bracket, g, i)[0] is not None:
                continue
            if len(matrices) == MAX_DIM:
                raise ValueError(
                    f"{generators} matrices generate an algebra of dimension above {MAX_DIM}; give fewer, or a "
                    "basis to LieAlgebra.from_matrices"
                )
            matrices.append(bracket if exact else _rounded_entries(bracket))
            added.append((g, i))
            names.append(f"A{len(matrices)}")
            span = ExactSpan(matrices, given.size) if exact else NearestSpan(matrices, given.size)
        i += 1
    floats = np.zeros((len(matrices), given.size, given.size))
    floats[:generators] = given.floats
    for k in range(generators, len(matrices)):
        for position, value in matrices[k].items():
            floats[(k, *position)] = rounded_sum(value)
    return *spanned(given._replace(entries=matrices, floats=floats), names), added


def _rounded_entries(entries: Entries) -> Entries:
    values = {position: rounded_sum(value) for position, value in entries.items()}
    return {position: {1: exact_number(value)} for position, value in values.items() if value}
