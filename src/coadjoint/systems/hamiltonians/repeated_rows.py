"""Sparse rows of matrices: read from arrays and polynomials; rows of a lattice are stored once for each shape."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.exact.numbers import quotient
from coadjoint.algebra.exact.sparse_sums import distinct
from coadjoint.algebra.polynomials.monomials import Coefficient, exponents_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.validation import REAL_KINDS, read_finite, to_array

Integers = npt.NDArray[np.int64]

MIN_ROWS = 1 << 12  # smallest number of rows that are compared
MIN_REPEATS = 8  # smallest mean number of rows of a shape
SAMPLE = 1 << 12  # rows of which the number of shapes is counted first
BLOCK = 1 << 15  # rows whose entries are held in memory at once
HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)


def values_at(values: npt.NDArray[Any], index: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return values[index]; without memory if all of them are one number, broadcast."""
    return np.broadcast_to(values[:1], len(index)) if values.strides == (0,) and len(values) else values[index]


def starts_of_rows(rows: npt.NDArray[Any], n: int) -> npt.NDArray[np.int64]:
    """Return the starts of n compressed sparse rows whose entries have these rows."""
    starts = np.zeros(n + 1, dtype=np.int64)
    if len(rows):
        np.cumsum(np.bincount(rows, minlength=n), out=starts[1:])
    return starts


def rows_of(starts: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the row of every entry of compressed sparse rows."""
    return np.repeat(np.arange(len(starts) - 1, dtype=np.int64), np.diff(starts))


class RepeatedRows:
    """Compressed sparse rows of few shapes, with the attributes of `SparseRows`, which are expanded when read."""

    # Row r has the entries begin[s] to begin[s + 1] of its shape s = shape[r], in the columns target[r] + `relative`,
    # with the values `number`. In a matrix, whose `target` is None, this is column r + `relative`.

    def __init__(
        self,
        shape: npt.NDArray[np.uint32],
        target: npt.NDArray[np.uint32] | None,
        begin: Integers,
        relative: Integers,
        number: npt.NDArray[Any],
    ) -> None:
        self.shape, self.target = shape, target
        self.begin, self.relative, self.number = begin, relative, number

    @classmethod
    def of_table(cls, shape: npt.NDArray[Any], table: list[list[tuple[int, float]]]) -> RepeatedRows:
        """Construct the rows of a matrix, row r at coordinate r, from the entries of each shape as pairs."""
        known: dict[tuple[tuple[int, float], ...], int] = {}
        number = np.array([known.setdefault(tuple(entries), len(known)) for entries in table], dtype=np.uint32)
        entries = [entry for one in known for entry in one]
        begin = np.zeros(len(known) + 1, dtype=np.int64)
        np.cumsum([len(one) for one in known], out=begin[1:])
        relative = np.array([column for column, _ in entries], dtype=np.int64)
        values = np.array([value for _, value in entries], dtype=np.float64)
        shapes = number[shape] if len(known) > 1 else np.broadcast_to(np.uint32(0), len(shape))
        return cls(shapes, None, begin, relative, values)

    @property
    def targets(self) -> npt.NDArray[np.uint32]:
        """The coordinate of each row."""
        return np.arange(len(self.shape), dtype=np.uint32) if self.target is None else self.target

    @property
    def lengths(self) -> Integers:
        """The number of entries of each row."""
        return np.asarray(np.diff(self.begin)[self.shape])

    @property
    def start(self) -> Integers:
        """The first entry of each row, and the end of the last one."""
        start = np.zeros(len(self.shape) + 1, dtype=np.int64)
        np.cumsum(self.lengths, out=start[1:])
        return start

    @property
    def owner(self) -> Integers:
        """The row of each entry."""
        return np.repeat(np.arange(len(self.shape)), self.lengths)

    @property
    def coordinate(self) -> npt.NDArray[np.uint32]:
        """The column of each entry."""
        pieces = [columns for _, _, columns, _ in self.pieces()]
        return np.concatenate([np.zeros(0, dtype=np.uint32), *pieces])

    @property
    def value(self) -> npt.NDArray[Any]:
        """The value of each entry."""
        return np.concatenate([self.number[:0], *(self.number[entry] for _, _, _, entry in self.pieces())])

    def pieces(self) -> Iterator[tuple[int, Integers, npt.NDArray[np.uint32], Integers]]:
        """Yield entries of a few rows: the first row, and for each entry its row, column and index in `number`."""
        for first in range(0, len(self.shape), BLOCK):
            shape = self.shape[first : first + BLOCK]
            lengths = np.diff(self.begin)[shape]
            row = np.repeat(np.arange(len(shape)), lengths)
            entry = np.arange(len(row)) + (self.begin[shape] - (np.cumsum(lengths) - lengths))[row]
            target = first + row if self.target is None else self.target[first + row]
            yield first, row, (target + self.relative[entry]).astype(np.uint32), entry

    def edges(self) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        """Return the rows and columns of all entries above the diagonal of a matrix."""
        lengths = np.diff(self.begin)
        rows, columns = [np.zeros(0, dtype=np.int32)], [np.zeros(0, dtype=np.int32)]
        for k in range(int(lengths.max(initial=0))):
            here = lengths > k
            relative = np.zeros(len(lengths), dtype=np.int32)
            relative[here] = self.relative[self.begin[:-1][here] + k]
            shift = relative[self.shape]
            above = np.flatnonzero(shift > 0).astype(np.int32)
            rows.append(above)
            columns.append(above + shift[above])
        return np.concatenate(rows), np.concatenate(columns)

    def with_target(self, target: npt.NDArray[np.uint32]) -> RepeatedRows:
        """Return the same rows with another array of equal targets."""
        return RepeatedRows(self.shape, target, self.begin, self.relative, self.number)

    def take(self, rows: npt.NDArray[Any]) -> RepeatedRows:
        """Select rows, in the order given."""
        target = rows.astype(np.uint32) if self.target is None else self.target[rows]
        return RepeatedRows(values_at(self.shape, rows), target, self.begin, self.relative, self.number)


def repeated_rows(start: Integers, columns: npt.NDArray[Any], values: npt.NDArray[Any]) -> RepeatedRows | None:
    """Return the rows of a square matrix with sorted columns by their shapes; None if few repeat."""
    count = len(start) - 1
    if count < MIN_ROWS or values.dtype != np.float64:
        return None
    if len(values) == count and np.array_equal(columns, np.arange(count)) and np.all(values == values[0]):
        return RepeatedRows.of_table(np.zeros(count, dtype=np.uint32), [[(0, float(values[0]))]])
    found = shapes_of(start, columns, values.view(np.int64))
    if found is None:
        return None
    shape, leaders = found
    lengths = np.diff(start)[leaders]
    begin = np.zeros(len(leaders) + 1, dtype=np.int64)
    np.cumsum(lengths, out=begin[1:])
    owner = np.repeat(np.arange(len(leaders)), lengths)
    entry = np.arange(begin[-1]) + (start[leaders] - begin[:-1])[owner]
    relative = columns[entry].astype(np.int64) - leaders[owner]
    return RepeatedRows(shape, None, begin, relative, values[entry])


def shapes_of(
    start: Integers, columns: npt.NDArray[Any], codes: npt.NDArray[Any]
) -> tuple[npt.NDArray[np.uint32], Integers] | None:
    """Return the shape of each sparse row, and the first row of each shape; None if few rows repeat."""
    # Rows of one shape have equal codes, in columns that are equal relative to the row. Columns ascend in each row.
    count = len(start) - 1
    sample = np.unique(np.linspace(0, count - 1, min(count, SAMPLE)).astype(np.int64))
    if len(np.unique(_hashes(start, columns, codes, sample))) * MIN_REPEATS > len(sample):
        return None
    blocks = [np.arange(first, min(first + BLOCK, count)) for first in range(0, count, BLOCK)]
    _, leaders, shape = np.unique(
        np.concatenate([_hashes(start, columns, codes, rows) for rows in blocks]),
        return_index=True,
        return_inverse=True,
    )
    if len(leaders) * MIN_REPEATS > count:
        return None
    lengths = np.diff(start)
    for rows in blocks:
        models = leaders[shape[rows]]
        if not np.array_equal(lengths[rows], lengths[models]):
            return None
        for k in range(int(lengths[rows].max(initial=0))):
            long = lengths[rows] > k
            some, model = (rows, models) if long.all() else (rows[long], models[long])
            here, there = start[some] + k, start[model] + k
            shift = some - model
            if np.any(columns[here] != columns[there] + shift) or np.any(codes[here] != codes[there]):
                return None  # different shapes with one hash
    return shape.astype(np.uint32), leaders


def _hashes(start: Integers, columns: npt.NDArray[Any], codes: npt.NDArray[Any], rows: Integers) -> npt.NDArray[Any]:
    """Return a hash of the shape of each of the given rows."""
    first, lengths = start[rows], start[rows + 1] - start[rows]
    before = np.cumsum(lengths) - lengths
    entry: Any = slice(first[0], first[0] + lengths.sum())
    if rows[-1] - rows[0] >= len(rows):  # not consecutive
        entry = np.arange(lengths.sum()) + np.repeat(first - before, lengths)
    mixed = _mixed((columns[entry] - np.repeat(rows, lengths)).view(np.uint64))
    mixed = _mixed(mixed ^ codes[entry].astype(np.int64).view(np.uint64))
    result = np.zeros(len(rows), dtype=np.uint64)
    filled = np.flatnonzero(lengths)
    if len(filled):
        result[filled] = np.add.reduceat(mixed, before[filled])
    return result


def _mixed(bits: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    mixed = (bits ^ (bits >> np.uint64(32))) * HASH_FACTOR
    return mixed ^ (mixed >> np.uint64(29))


class Entries(NamedTuple):
    """The entries of a quadratic Hamiltonian: rows, columns and values of M, and the linear part."""

    rows: npt.NDArray[np.int64]
    columns: npt.NDArray[np.int64]
    entries: npt.NDArray[Any]
    linear: npt.NDArray[Any]

    def plus(self, other: Entries) -> Entries:
        """Return the entries of the sum; the order of both is that of rows and columns."""
        rows, columns = np.r_[self.rows, other.rows], np.r_[self.columns, other.columns]
        entries = np.concatenate([self.entries, other.entries])
        order = np.lexsort((columns, rows))
        rows, columns, entries = rows[order], columns[order], entries[order]
        starts = np.flatnonzero(np.r_[True, (np.diff(rows) != 0) | (np.diff(columns) != 0)][: len(rows)])
        if len(starts):
            rows, columns, entries = rows[starts], columns[starts], np.add.reduceat(entries, starts)
        return Entries(rows, columns, _as_floats(entries), _as_floats(self.linear + other.linear))

    def times(self, factor: Coefficient) -> Entries:
        """Return the entries of a multiple."""
        entries, linear = (
            _as_floats(numbers * (factor if numbers.dtype == object else float(factor)))
            for numbers in (self.entries, self.linear)
        )
        return self._replace(entries=entries, linear=linear)


def _as_floats(numbers: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return an array of objects as float64 if all are floats."""
    if numbers.dtype == object and all(isinstance(number, float) for number in numbers):
        return numbers.astype(np.float64)
    return numbers


def polynomial_of_entries(
    rows: npt.NDArray[Any],
    columns: npt.NDArray[Any],
    entries: npt.NDArray[Any],
    coefficients: npt.NDArray[Any],
    constant: Coefficient,
) -> Polynomial:
    """Return ``x . M x / 2 + coefficients . x + constant`` for entries of both triangles of M; exact if they are."""
    n = len(coefficients)
    monomials: dict[tuple[int, ...], Any] = {(0,) * n: constant}
    for i, c in enumerate(coefficients.tolist()):
        monomials[exponents_of((i,), n)] = c
    for i, j, c in zip(rows.tolist(), columns.tolist(), entries.tolist(), strict=True):
        if i <= j:
            monomials[exponents_of((i, j), n)] = c if i < j else quotient(c, 2)
    return Polynomial(monomials, dim=n)


def entries_of_polynomial(polynomial: Polynomial) -> tuple[Entries, Any]:
    """Return the entries of a polynomial of degree at most two, with its coefficients unchanged, and the constant."""
    n = polynomial.dim
    exact = not all(isinstance(c, float) for _, c, _ in polynomial._factors)
    kind: Any = object if exact else np.float64
    linear: npt.NDArray[Any] = np.broadcast_to(0.0, n)
    if any(sum(powers.values()) == 1 for _, _, powers in polynomial._factors):
        linear = np.full(n, 0, dtype=kind)
    constant: Any = 0.0
    rows: list[int] = []
    columns: list[int] = []
    entries: list[Any] = []
    for _, coefficient, powers in polynomial._factors:
        factors = [k for k, e in powers.items() for _ in range(e)]
        if len(factors) == 2:
            i, j = factors
            rows += [i] if i == j else [i, j]
            columns += [i] if i == j else [j, i]
            entries += [2 * coefficient] if i == j else [coefficient, coefficient]
        elif len(factors) == 1:
            linear[factors[0]] = coefficient
        else:
            constant = coefficient
    packed = np.empty(len(entries), dtype=kind)
    packed[:] = entries
    return Entries(np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64), packed, linear), constant


def real_array(argument: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
    """Return a copy as float64, or as objects if it contains fractions; raise an error unless real and finite."""
    array = to_array(argument, name)
    floats = read_finite(array, name)
    if array.dtype != object:
        return floats
    exact = np.empty(array.shape, dtype=object)
    # NumPy integers in an array of objects would overflow silently.
    for index, entry in np.ndenumerate(array):
        exact[index] = entry.item() if isinstance(entry, np.generic) else entry
    return exact


def sparse_entries(M: Any) -> tuple[int, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], bool]:
    """Return n, rows, columns and values of a SciPy sparse matrix, sorted by rows, and whether it is symmetric."""
    if M.ndim != 2 or M.shape[0] != M.shape[1]:
        raise ValueError(f"M has shape {M.shape}; give a symmetric (n, n)")
    csr = M.tocsr().copy()
    csr.sum_duplicates()
    csr.eliminate_zeros()
    if csr.dtype.kind not in REAL_KINDS:
        raise TypeError(f"M has numbers of type {csr.dtype}; give real numbers")
    n, entries = int(M.shape[0]), csr.data.astype(np.float64)
    rows = np.repeat(np.arange(n, dtype=np.int64), np.diff(csr.indptr))
    bad = np.flatnonzero(~np.isfinite(entries))
    if bad.size:
        raise ValueError(f"M[{rows[bad[0]]}, {csr.indices[bad[0]]}] is {entries[bad[0]]}; give finite numbers")
    transposed = csr.transpose().tocsr()
    pairs = ((transposed.indptr, csr.indptr), (transposed.indices, csr.indices), (transposed.data, csr.data))
    return n, rows, csr.indices, entries, all(np.array_equal(a, b) for a, b in pairs)


def check_symmetric(n: int, rows: npt.NDArray[Any], columns: npt.NDArray[Any], values: npt.NDArray[Any]) -> None:
    """Raise ValueError for asymmetry beyond 64 u of the largest entry, the round-off of a computed symmetric matrix."""
    above, below = rows < columns, rows > columns
    upper, lower = rows[above] * n + columns[above], columns[below] * n + rows[below]
    positions = distinct(np.concatenate([upper, lower]))
    first, second = np.zeros(positions.size), np.zeros(positions.size)
    first[np.searchsorted(positions, upper)] = values[above]
    second[np.searchsorted(positions, lower)] = values[below]
    bad = np.flatnonzero(np.abs(first - second) > 64 * UNIT_ROUNDOFF * np.abs(values).max(initial=0.0))
    if bad.size:
        i, j = divmod(int(positions[bad[0]]), n)
        raise ValueError(
            f"M is not symmetric: M[{i}, {j}] = {first[bad[0]]:g} but M[{j}, {i}] = {second[bad[0]]:g}; "
            "give both the same value"
        )
