"""Sparse rows, operations on sorted columns, layers of directed graphs, and cache keys of sparsity patterns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, distinct, expand
from coadjoint.systems.hamiltonians.repeated_rows import RepeatedRows, values_at

SourceT = TypeVar("SourceT")

# Number of unit rows whose starts are stored in 32 bits.
MANY_ROWS = 1 << 16
MAX_PATTERN_SIZE = 64  # coordinates, forms or parts; larger patterns are not cached


class SparseRows(NamedTuple):
    """Sparse rows, as linear forms or weights of angles: row r has the entries start[r] to start[r + 1]."""

    start: Integers
    coordinate: NDArray[np.uint32]
    value: NDArray[Any]

    @property
    def target(self) -> None:
        """Rows with entries of their own store no targets."""

    def with_target(self, target: NDArray[Any]) -> SparseRows:
        """Return the rows themselves, see `RepeatedRows`."""
        return self

    @classmethod
    def of_lists(cls, coordinates: Sequence[Sequence[int]], values: Sequence[Sequence[Any]]) -> SparseRows:
        start = starts_of([len(row) for row in coordinates])
        flat = [value for row in values for value in row]
        flat_values = np.array(flat, dtype=np.float64 if all(isinstance(value, float) for value in flat) else object)
        return cls(start, np.array([i for row in coordinates for i in row], dtype=np.uint32), flat_values)

    @classmethod
    def units(cls, coordinates: NDArray[Any]) -> SparseRows:
        size = len(coordinates)
        start: Any = np.arange(size + 1, dtype=np.int32 if MANY_ROWS < size < 2**31 - 1 else np.int64)
        return cls(start, coordinates.astype(np.uint32, copy=False), np.broadcast_to(1.0, size))

    @classmethod
    def empty(cls, count: int) -> SparseRows:
        return cls(np.zeros(count + 1, dtype=np.int64), np.zeros(0, dtype=np.uint32), np.zeros(0))

    @classmethod
    def concatenate(cls, pieces: Sequence[Any]) -> Any:
        """Concatenate `Rows`; a single piece is returned unchanged."""
        if len(pieces) == 1:
            return pieces[0]
        return cls(
            joined_starts([piece.start for piece in pieces]),
            np.concatenate([piece.coordinate for piece in pieces]),
            np.concatenate([piece.value for piece in pieces]),
        )

    @property
    def owner(self) -> Integers:
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))

    def take(self, rows: NDArray[Any]) -> SparseRows:
        if len(self.coordinate) == len(self.start) - 1 == self.start[-1] and np.all(np.diff(self.start) == 1):
            units = SparseRows.units(self.coordinate[rows])
            return units._replace(value=values_at(self.value, rows))
        first, last = self.start[rows], self.start[rows + 1]
        _, entries = expand(first, last)
        return SparseRows(starts_of(last - first), self.coordinate[entries], values_at(self.value, entries))


Rows = SparseRows | RepeatedRows


def sparse_row(rows: Any, r: int) -> tuple[list[int], list[Any]]:
    """Return the coordinates and values of a sparse row."""
    entries = slice(int(rows.start[r]), int(rows.start[r + 1]))
    return rows.coordinate[entries].tolist(), rows.value[entries].tolist()


def starts_of(counts: Any) -> Integers:
    """Return the starts of concatenated lists of these lengths, and the end of the last one."""
    start = np.zeros(len(counts) + 1, dtype=np.int64)
    np.cumsum(counts, out=start[1:])
    return start


def joined_starts(pieces: Sequence[NDArray[Any]]) -> Integers:
    """Return the starts of concatenated tables."""
    ends = starts_of([int(piece[-1]) for piece in pieces])
    rows = np.repeat(ends[:-1], [len(piece) - 1 for piece in pieces])
    return np.concatenate([np.zeros(1, dtype=np.int64), rows + np.concatenate([piece[1:] for piece in pieces])])


def is_ordered(*keys: NDArray[Any]) -> bool:
    """Test whether rows are sorted by several keys, the most significant first."""
    tied: Any = True
    for key in keys:
        if np.any(tied & (key[1:] < key[:-1])):
            return False
        tied = tied & (key[1:] == key[:-1])
    return True


def order_by(*keys: NDArray[Any]) -> Integers | slice:
    """Return the stable order by several keys; the full slice if they are sorted."""
    if is_ordered(*keys):
        return slice(None)
    (key,) = keys if len(keys) == 1 else (keys[0][:0],)
    if key.dtype.kind in "iu" and len(key) and key.min() >= 0 and key.max() < 2**16:
        return np.argsort(key.astype(np.uint16), kind="stable")  # by digits
    return np.lexsort(keys[::-1]).astype(np.int64)


def run_starts(*keys: NDArray[Any]) -> NDArray[np.bool_]:
    """Mark sorted rows that differ from the previous one; the first row does."""
    begins = np.zeros(len(keys[0]), dtype=bool)
    begins[:1] = True
    for key in keys:
        begins[1:] |= np.asarray(key[1:] != key[:-1], dtype=bool)
    return begins


def run_sums(values: NDArray[Any], first: NDArray[np.bool_]) -> NDArray[Any]:
    """Return sums of consecutive values, from left to right; `first` marks the start of each sum."""
    if values.dtype == object:
        return np.add.reduceat(values, np.flatnonzero(first)) if len(values) else values
    if np.all(first):
        return values
    # Unlike reduceat, bincount adds in order for sums of any length.
    return np.bincount(np.cumsum(first) - 1, weights=values)


def layers(count: int, source: Integers, target: Integers) -> Integers:
    """Return the length of the longest path to each node, (count,); -1 for nodes on or behind a cycle."""
    layer = np.full(count, -1, dtype=np.int64)
    open_edges = np.bincount(target, minlength=count)
    order = order_by(source)
    start, ends = starts_of(np.bincount(source, minlength=count)), target[order]
    current, depth = np.flatnonzero(open_edges == 0), 0
    while len(current):
        layer[current] = depth
        _, entries = expand(start[current], start[current + 1])
        reached = ends[entries]
        np.subtract.at(open_edges, reached, 1)
        current, depth = distinct(reached[open_edges[reached] == 0]), depth + 1
    return layer


class Pattern(Generic[SourceT]):
    """Hashable set of arrays that determine a result; of equal patterns the `source` of the first one is used."""

    def __init__(self, source: SourceT, *columns: NDArray[Any]) -> None:
        self.source = source
        self._key = tuple(_content(column) for column in columns)
        self._hash = hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Pattern) and self._key == other._key

    def __hash__(self) -> int:
        return self._hash


def _content(column: NDArray[Any]) -> tuple[Any, ...]:
    # The bytes of object arrays (fractions) are addresses, so their values are compared.
    values = tuple(column.tolist()) if column.dtype == object else column.tobytes()
    return column.dtype.char, column.shape, values
