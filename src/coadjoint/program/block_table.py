"""Table of the blocks of many generators: connected sets of coordinates, classified by kind; translates only once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.program.blocks import Block, BlockKind, larger_block, wide_series
from coadjoint.program.generators import BasisMatrices, Components, Generators, components_of
from coadjoint.program.numbers import roundoff
from coadjoint.program.sparse_rows import SparseRows, joined_starts, starts_of

MIN_REPEATED = 1 << 12  # smallest number of forms that are compared
MAX_ENTRIES = 64  # largest sum of the different numbers of entries of a matrix
MIN_TRANSLATES = 8  # smallest mean number of forms of a shape
HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)


class BlockTable(NamedTuple):
    """Blocks by angle and first coordinate: block b has `width` coordinates from indices[begin[b]] (CUBIC, SERIES: then
    starts of rows and columns), constants from constant_begin[b], then values of entries.
    """

    angle: Integers
    kind: NDArray[np.uint8]
    width: NDArray[np.uint32]
    entries: NDArray[np.uint32]
    degree: NDArray[np.uint32]
    begin: Integers
    indices: NDArray[np.uint32]
    constant_begin: Integers
    constants: NDArray[Any]

    def take(self, chosen: NDArray[Any]) -> BlockTable:
        index = expand(self.begin[chosen], self.begin[chosen + 1])[1]
        constant = expand(self.constant_begin[chosen], self.constant_begin[chosen + 1])[1]
        return self._replace(
            **{name: getattr(self, name)[chosen] for name in PER_BLOCK_COLUMNS},
            begin=starts_of(np.diff(self.begin)[chosen]),
            indices=self.indices[index],
            constant_begin=starts_of(np.diff(self.constant_begin)[chosen]),
            constants=self.constants[constant],
        )


# Columns with one entry per block.
PER_BLOCK_COLUMNS = ("angle", "kind", "width", "entries", "degree")


def joined_tables(tables: Sequence[BlockTable]) -> BlockTable:
    """Concatenate tables of blocks."""
    if len(tables) == 1:
        return tables[0]
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(table, name) for table in tables])
        for name in (*PER_BLOCK_COLUMNS, "indices", "constants")
    }
    for name in ("begin", "constant_begin"):
        joined[name] = joined_starts([getattr(table, name) for table in tables])
    return BlockTable(**joined)


def block_table(generators: Generators, u: Any) -> BlockTable:
    """Decompose generators, by sorted entries, into blocks in the order of their angles; `u` is the round-off."""
    sets, sheared, depth = components_of(generators)
    width = sets.width
    larger = ~sheared & (width > 2)
    nilpotent, cyclic = larger & (depth >= 0), larger & (depth < 0)
    classes = [
        (np.flatnonzero(mask), build)
        for mask, build in (
            (sheared, _shear_blocks),
            (~sheared & (width == 1), _scale_blocks),
            (~sheared & (width == 2), _plane_blocks),
            (nilpotent, lambda subset: _series_blocks(subset, depth[nilpotent])),
            (cyclic, lambda subset: _cyclic_blocks(subset, u)),
        )
    ]
    tables, owners = [], []
    for chosen, build in classes:
        if len(chosen):
            subset = sets.take(chosen) if len(chosen) < len(width) else sets
            tables.append(build(subset))
            owners.append(np.repeat(chosen, subset.lengths) if build is _shear_blocks else chosen)
    if not tables:
        return _empty_table(generators.value)
    table = joined_tables(tables)
    return table if len(tables) == 1 else table.take(np.argsort(np.concatenate(owners), kind="stable"))


def _empty_table(value: NDArray[Any]) -> BlockTable:
    empty, start = np.zeros(0, dtype=np.int64), np.zeros(1, dtype=np.int64)
    return _build_table(empty, np.zeros(0, dtype=np.uint8), empty, empty, start, empty, start, value[:0])


def _build_table(
    angle: Integers,
    kind: Any,
    width: Any,
    degree: Any,
    begin: Integers,
    index: Any,
    constant_begin: Any,
    constants: Any,
) -> BlockTable:
    """Build a table; index entries beyond the coordinates of a block are its row starts and columns."""
    size = len(angle)
    widths = np.broadcast_to(width, size).astype(np.uint32)
    lengths = np.diff(begin) - widths
    return BlockTable(
        angle,
        np.broadcast_to(kind, size).astype(np.uint8),
        widths,
        np.where(lengths > 0, lengths - widths - 1, 0).astype(np.uint32),
        np.broadcast_to(degree, size).astype(np.uint32),
        begin,
        index.astype(np.uint32),
        constant_begin,
        constants,
    )


def _shear_blocks(sets: Components) -> BlockTable:
    ends = np.arange(len(sets.value) + 1)
    low = sets.low[:-1][sets.owner]
    index = np.stack([sets.member[low + sets.row], sets.member[low + sets.column]], axis=1).ravel()
    return _build_table(sets.angle[sets.owner], BlockKind.SHEAR, 2, 0, 2 * ends, index, ends, sets.value)


def _scale_blocks(sets: Components) -> BlockTable:
    return _build_table(sets.angle, BlockKind.SCALE, 1, 0, sets.low, sets.member, sets.first, sets.value)


def _plane_blocks(sets: Components) -> BlockTable:
    """Build the ROTATE and PLANE blocks, of two coordinates."""
    matrix = np.repeat(0 * sets.value[sets.first[:-1]], 4).reshape(-1, 2, 2)
    matrix[sets.owner, sets.row, sets.column] = sets.value
    (a, b), (c, d) = matrix[:, 0].T, matrix[:, 1].T
    is_rotation = np.asarray((a == 0) & (d == 0) & (b == -c), dtype=bool)
    members = sets.member.reshape(-1, 2)
    reversed_ = is_rotation & np.asarray(c < 0, dtype=bool)
    members = np.where(reversed_[:, None], members[:, ::-1], members)
    constants = np.stack([(a + d) / 2, (a - d) / 2, b, c], axis=1)
    constants[is_rotation, 0] = abs(c[is_rotation])
    used = np.ones(constants.shape, dtype=bool)
    used[is_rotation, 1:] = False
    kinds = np.where(is_rotation, BlockKind.ROTATE, BlockKind.PLANE)
    return _build_table(
        sets.angle, kinds, 2, 0, sets.low, members.ravel(), starts_of(np.where(is_rotation, 1, 4)), constants[used]
    )


def _series_blocks(sets: Components, depth: Integers) -> BlockTable:
    """Build the SERIES blocks of nilpotent patterns, whose exponentials are finite sums."""
    width, count, size = sets.width, sets.lengths, len(sets.angle)
    begin = starts_of(2 * width + 1 + count)
    index = np.empty(begin[-1], dtype=np.int64)
    starts = begin[:-1]
    member_index = np.arange(len(sets.member)) + np.repeat(starts - sets.low[:-1], width)
    index[member_index] = sets.member
    in_row = np.bincount(sets.low[sets.owner] + sets.row, minlength=len(sets.member))
    index[member_index + np.repeat(width, width)] = np.cumsum(in_row) - in_row - np.repeat(sets.first[:-1], width)
    index[starts + 2 * width] = count
    entry_index = np.arange(len(sets.column)) + np.repeat(starts + 2 * width + 1 - sets.first[:-1], count)
    index[entry_index] = sets.column
    constant_begin = starts_of(count + 1)
    constants = np.empty(constant_begin[-1], dtype=sets.value.dtype)
    constants[constant_begin[:-1]] = 0 * sets.value[sets.first[:-1]]
    constants[np.arange(len(sets.value)) + sets.owner + 1] = sets.value
    return _build_table(
        sets.angle, np.full(size, BlockKind.SERIES), width, depth, begin, index, constant_begin, constants
    )


def _cyclic_blocks(sets: Components, u: Any) -> BlockTable:
    """Build the blocks of patterns with cycles; equal blocks, as at the sites of a lattice, are classified once."""
    model_numbers: dict[Any, int] = {}
    models: list[Block] = []
    tails: list[Integers] = []
    model_constants: list[NDArray[Any]] = []
    model_of_set = np.empty(len(sets.angle), dtype=np.int64)
    width = sets.width.tolist()
    for s, (first, last) in enumerate(zip(sets.first[:-1].tolist(), sets.first[1:].tolist(), strict=True)):
        row, column, value = sets.row[first:last], sets.column[first:last], sets.value[first:last]
        value_key = tuple(value) if value.dtype == object else value.tobytes()
        key = (width[s], row.tobytes(), column.tobytes(), value_key)
        if key not in model_numbers:
            model = wide_series(width[s], row, column, value)
            if model is None:
                local = tuple(zip(row.tolist(), column.tolist(), value.tolist(), strict=True))
                model = larger_block(width[s], local, u)
            model_numbers[key] = len(models)
            models.append(model)
            is_series = model.kind == BlockKind.SERIES  # its entries, possibly very many, are those of D
            tails.append(_sparse_tail(width[s], row, column) if is_series else _sparse_tail_of(model))
            model_constants.append(
                np.append(np.array(model.constants, dtype=value.dtype), value)
                if is_series
                else np.array(_flat_constants(model), dtype=value.dtype)
            )
        model_of_set[s] = model_numbers[key]
    begin = starts_of(sets.width + np.array([len(tail) for tail in tails])[model_of_set])
    constant_begin = starts_of(np.array([len(constants) for constants in model_constants])[model_of_set])
    index = np.empty(begin[-1], dtype=np.int64)
    constants = np.empty(constant_begin[-1], dtype=sets.value.dtype)
    for number, model in enumerate(models):
        selected = np.flatnonzero(model_of_set == number)
        start, size = begin[selected][:, None], len(model.coordinates)
        index[start + np.arange(size)] = sets.member[sets.low[selected][:, None] + np.arange(size)]
        index[start + size + np.arange(len(tails[number]))] = tails[number]
        constants[constant_begin[selected][:, None] + np.arange(len(model_constants[number]))] = model_constants[number]
    kinds, degrees = (np.array([getattr(model, name) for model in models])[model_of_set] for name in ("kind", "degree"))
    return _build_table(sets.angle, kinds, sets.width, degrees, begin, index, constant_begin, constants)


def _sparse_tail(width: int, row: Integers, column: Integers) -> Integers:
    """Return the sparse rows that follow the coordinates of a block: row starts, then columns."""
    return np.concatenate([starts_of(np.bincount(row, minlength=width)), column])


def _sparse_tail_of(block: Block) -> Integers:
    row, column = np.array([entry[:2] for entry in block.entries], dtype=np.int64).T
    return _sparse_tail(len(block.coordinates), row, column)


def _flat_constants(block: Block) -> list[Any]:
    columns = zip(*(entry[2:] for entry in block.entries), strict=True)
    return [*block.constants, *(value for column in columns for value in column)]


def repeated_block_table(matrices: BasisMatrices, forms: SparseRows) -> BlockTable | None:
    """Return the table of forms that are basis elements, bitwise that of all; None if few are translates."""
    count = len(forms.start) - 1
    units = len(forms.value) == count and bool(np.all(np.diff(forms.start) == 1)) and bool(np.all(forms.value == 1.0))
    if count < MIN_REPEATED or not units:
        return None
    element = forms.coordinate.astype(np.int64)
    found = _shapes(matrices, element)
    if found is None or len(found[1]) * MIN_TRANSLATES > count:
        return None
    shape, leaders = found
    leading = matrices.combinations(SparseRows.units(element[leaders]), float)
    table = joined_tables([block_table(generators, roundoff(float)) for generators in leading])
    first = np.searchsorted(table.angle, np.arange(len(leaders) + 1))
    angle, chosen = expand(first[shape], first[shape + 1])
    blocks = table.take(chosen)
    index = expand(blocks.begin[:-1], blocks.begin[:-1] + blocks.width)[1]
    shift = np.repeat((element - element[leaders][shape])[angle], blocks.width)
    blocks.indices[index] = blocks.indices[index] + shift
    return blocks._replace(angle=angle)


def _shapes(matrices: BasisMatrices, element: Integers) -> tuple[Integers, Integers] | None:
    """Return the shape of each element's matrix, relative to the element, and the first element of each shape."""
    start = matrices.entries[0]
    lengths = np.diff(start)[element]
    shape, leaders = np.zeros(len(element), dtype=np.int64), [np.zeros(0, dtype=np.int64)]
    known = 0
    different = np.flatnonzero(np.bincount(lengths))
    if different.sum() > MAX_ENTRIES:
        return None
    for length in different.tolist():
        members = np.flatnonzero(lengths == length)
        hashed = np.zeros(len(members), dtype=np.uint64)
        for number in _numbers(matrices, element[members], length):
            hashed = (hashed ^ number.view(np.uint64)) * HASH_FACTOR
            hashed ^= hashed >> np.uint64(32)
        _, leader, inverse = np.unique(hashed, return_index=True, return_inverse=True)
        same = (np.array_equal(n, n[leader][inverse]) for n in _numbers(matrices, element[members], length))
        if not all(same):  # different shapes with one hash
            return None
        shape[members] = known + inverse
        leaders.append(members[leader])
        known += len(leader)
    return shape, np.concatenate(leaders)


def _numbers(matrices: BasisMatrices, element: Integers, length: int) -> Iterator[NDArray[Any]]:
    """Yield the rows and columns relative to the element, and the bits of the values, entry after entry."""
    start, rows, columns, values = matrices.entries
    for index in (start[element] + k for k in range(length)):
        yield rows[index] - element
        yield columns[index] - element
        yield values[index].view(np.int64)
