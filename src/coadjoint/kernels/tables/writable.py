"""Tables whose constants are written for inputs or coefficients of members; only arrays that depend are copied."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import as_c_double
from coadjoint.kernels.tables.compiled import (
    PER_MEMBER_TYPES,
    SCALARS,
    NotWritable,
    TableField,
    as_structure,
    table_fields,
)
from coadjoint.memory import check_available_memory

if TYPE_CHECKING:
    from coadjoint.kernels.tables.compiled import CompiledTables
    from coadjoint.program.sources import Multiples, Rules, Sources

Floats = NDArray[np.float64]

WRITABLE_TYPES = ("constants", "numbers")
ADDRESS_FIELD = "tables.whole"
"""The field of integers that contains addresses."""
WATCH = 1
"""The number of the table of the invariants."""
NO_SUMS, DEPENDENT = "are neither inputs nor exact sums of inputs", "depend on them"


class _Table:
    """A table of a run. Its address is entry `index` of the integers of table number `parent`, -1 if there is none."""

    def __init__(self, table: Any, sources: Sources, parent: int = -1, index: int = -1) -> None:
        self.structure, self.parent, self.index = as_structure(table), parent, index
        kind: Any = type(self.structure)
        self.kind, self.fields = kind, {field.name: field for field in table_fields(kind)}
        self.sources = sources

    def value(self, name: str) -> Any:
        return self.fields[name].of(self.structure.source)


def _tables_of(loop: CompiledTables, watch: CompiledTables) -> list[_Table]:
    """Return the tables of a loop, of the invariants, and all tables that they refer to by address."""
    tables = [_Table(loop.tables, loop.sources()), _Table(watch.tables, watch.sources())]
    pending = [(0, loop)]
    while pending:
        number, outer = pending.pop()
        for index, referenced in outer.referenced.items():
            pending.append((len(tables), referenced))
            tables.append(_Table(referenced.tables, referenced.sources(), number, index))
    return tables


class _Block:
    """Arrays of several tables in one allocation, and copies of the tables that point into it."""

    def __init__(self, tables: Sequence[_Table], fields_of_tables: Sequence[Sequence[TableField]]) -> None:
        self.kinds = [table.kind for table in tables]
        parents = sorted({table.parent for table in tables if table.parent >= 0})
        # Arrays of addresses follow the structures.
        address_arrays = [tables[number].value(ADDRESS_FIELD) for number in parents]
        sizes = [ctypes.sizeof(kind) // 8 for kind in self.kinds] + [len(array) for array in address_arrays]
        self.word_offsets = list(accumulate(sizes, initial=0))
        arrays_at = dict(zip(parents, self.word_offsets[len(tables) :], strict=False))
        self.start: dict[tuple[int, str], int] = {}
        pieces, self.pointers, self.scalars, count = [np.zeros(1)], [], [], 1
        for number, fields in enumerate(fields_of_tables):
            for field in fields:
                self.start[number, field.name] = count
                position = self.word_offsets[number] + field.offset // 8
                if field.token in SCALARS:
                    self.scalars.append((position, count))
                else:
                    self.pointers.append((position, 8 * count))
                array = np.atleast_1d(field.of(tables[number].structure.source))
                pieces.append(np.ascontiguousarray(array).view(np.float64))
                count += len(array)
        self.template = np.concatenate(pieces)
        structures = [np.frombuffer(bytes(table.structure), dtype=np.int64) for table in tables]
        self.raw = np.concatenate([*structures, *address_arrays])
        # Words that hold the addresses of others, by their positions.
        self.addresses = [
            (self.word_offsets[number] + tables[number].fields[ADDRESS_FIELD].offset // 8, start)
            for number, start in arrays_at.items()
        ]
        self.addresses += [
            (arrays_at[table.parent] + table.index, self.word_offsets[number])
            for number, table in enumerate(tables)
            if table.parent >= 0
        ]

    def structures(self, block: Floats, columns: int) -> tuple[Any, Any]:
        """Return copies of the first two tables that point into a block with this number of columns per row."""
        raw, base_address = self.raw.copy(), ctypes.addressof(as_c_double(block))
        for position, start in self.pointers:
            raw[position] = base_address + columns * start
        for position, start in self.scalars:
            raw[position] = block.view(np.int64)[columns * start]
        for position, word in self.addresses:
            raw[position] = raw.ctypes.data + 8 * word
        scheme, watch = (
            kind.from_buffer(raw, 8 * first) for kind, first in zip(self.kinds[:2], self.word_offsets, strict=False)
        )
        # A structure keeps its own memory alive; this adds the memory that it points to.
        scheme.source = watch.source = block
        return scheme, watch


class WritableTables:
    """Tables of a scheme and of watched invariants for numbers (m,) given with each call, `values` as built.

    `indices`: coefficient -> input; `tangled`: coefficients that inputs change indirectly. With `separate_tables`
    members need tables of their own.
    """

    def __init__(
        self,
        loop: CompiledTables,
        watch: CompiledTables,
        indices: Mapping[int, int],
        values: Floats,
        tangled: Sequence[int] = (),
    ) -> None:
        tables = self._tables = _tables_of(loop, watch)
        wanted = np.array(sorted(indices), dtype=np.int64)
        given = np.array([indices[source] for source in wanted.tolist()], dtype=np.int64)
        others = np.array(tangled, dtype=np.int64)
        self._multiples: list[tuple[int, str, Multiples]] = []
        self._sums: list[tuple[int, str, Any]] = []  # with `Rules`
        for number, table in enumerate(tables):
            for path, computed in table.sources.computed.items():
                if np.any(np.isin(computed, np.concatenate([wanted, others]))):
                    is_constant = table.fields[path].token in WRITABLE_TYPES
                    raise NotWritable(f"its table has {path} that {NO_SUMS if is_constant else DEPENDENT}")
            for path, multiples in table.sources.multiples.items():
                own = multiples.among(wanted, given)
                template = np.atleast_1d(table.value(path))[own.position]
                if np.any(np.isin(multiples.number, others)) or template.tobytes() != own.of(values).tobytes():
                    raise NotWritable(f"its table has {path} that {NO_SUMS}")
                if len(own.number):
                    self._multiples.append((number, path, own))
            for path, sums in table.sources.sums.items():
                if sums.among(others, others).rules:
                    raise NotWritable(f"its table has {path} that {NO_SUMS}")
                if (chosen := sums.among(wanted, given)).rules:
                    self._sums.append((number, path, chosen))
        written = {(number, path) for number, path, _ in (*self._multiples, *self._sums)}
        tokens = {tables[number].fields[name].token for number, name in written}
        in_columns = all(one.in_columns for one in (loop, watch) if one.referenced)
        self.separate_tables = not (in_columns and tokens <= PER_MEMBER_TYPES)
        self._shared = _Block(
            tables,
            [[field for name, field in table.fields.items() if (k, name) in written] for k, table in enumerate(tables)],
        )
        self._in_shared = self._written(self._shared)

    @cached_property
    def _each(self) -> tuple[_Block, tuple[Any, ...]]:
        """The arrays that have a column for each member, and what is written into them."""
        block = _Block(
            self._tables,
            [[field for field in table.fields.values() if field.token in PER_MEMBER_TYPES] for table in self._tables],
        )
        return block, self._written(block)

    def _written(self, block: _Block) -> tuple[list[Multiples], list[tuple[Rules, list[Integers]]]]:
        """Return the multiples of given numbers with their rows in a block, and exact sums with those of each rule."""
        from coadjoint.program.sources import concatenated

        rows = [one._replace(position=block.start[table, path] + one.position) for table, path, one in self._multiples]
        multiples = concatenated(rows)
        plain = multiples.factor == 1.0  # copied bit by bit: some are addresses
        found = multiples.take(plain)._replace(factor=None), multiples.take(~plain)
        return [one for one in found if len(one.number)], [
            (sums, [block.start[table, path] + position for position, _ in sums.rules])
            for table, path, sums in self._sums
        ]

    def multiples(self) -> Iterator[tuple[Any, str, Multiples]]:
        """Yield the numbers of the scheme that are multiples of those given, by their table and field."""
        yield from (
            (self._tables[number].structure.source, path, one) for number, path, one in self._of(self._multiples)
        )

    @property
    def has_sums(self) -> bool:
        return bool(self._of(self._sums))

    @staticmethod
    def _of(found: list[tuple[int, str, Any]]) -> list[tuple[int, str, Any]]:
        """Return what belongs to the scheme, not to the watched invariants."""
        return [one for one in found if one[0] != WATCH]

    def derivatives(self, names: Sequence[str]) -> Multiples:
        """Return derivatives of fields by the numbers, one after the other; NotWritable if other fields depend."""
        from coadjoint.program.sources import Multiples, concatenated

        sizes = (len(self._tables[0].value(name)) for name in names)
        first = dict(zip(names, accumulate(sizes, initial=0), strict=False))
        for number, path, _ in (*self._multiples, *self._sums):
            if number == 0 and path not in first:
                raise NotWritable(f"its table has {path} that {DEPENDENT}")
        found = [one._replace(position=first[path] + one.position) for k, path, one in self._multiples if k == 0]
        rules = [(path, sums, rule) for k, path, sums in self._sums if k == 0 for rule in sums.rules]
        for path, of_rule, (position, rule) in rules:
            used = np.isin(of_rule.coordinate, rule.used)
            for coordinate, index in zip(of_rule.coordinate[used].tolist(), of_rule.number[used], strict=True):
                unit = np.zeros(len(of_rule.linear))
                unit[coordinate] = 1.0
                found.append(Multiples(first[path] + position, np.full(len(position), index), np.array(rule.at(unit))))
        return concatenated(found)

    def shared(self, numbers: Floats) -> tuple[Any, Any]:
        """Return the structures of the scheme and of the invariants for numbers (m,) common to all members."""
        block, (found, sums_of_rules) = self._shared.template.copy(), self._in_shared
        for multiples in found:
            block[multiples.position] = multiples.of(numbers)
        for sums, rows in sums_of_rules:
            for own, entries in zip(rows, sums.of(numbers), strict=True):
                block[own] = entries
        return self._shared.structures(block, 1)

    def each(self, numbers: Floats) -> tuple[Any, Any, int]:
        """Return the structures for (members, m), and the number of columns; not valid if `separate_tables`."""
        return side_by_side(len(numbers), [(self, slice(0, len(numbers)), numbers)])

    def _write_columns(self, block: Floats, own: slice | Integers, numbers: Floats) -> None:
        """Write the columns of members with these numbers into a block of all."""
        arrays, (found, sums_of_rules) = self._each
        columns = block[:, own]  # of a slice, a view
        columns[...] = arrays.template[:, None]
        for multiples in found:
            columns[multiples.position] = multiples.of(numbers).T
        for sums, rows in sums_of_rules:
            for entries, of_members in zip(rows, zip(*map(sums.of, numbers), strict=True), strict=True):
                columns[entries] = np.transpose(of_members)
        if columns.base is not block:
            block[:, own] = columns


def side_by_side(
    members: int, parts: Sequence[tuple[WritableTables, slice | Integers, Floats]]
) -> tuple[Any, Any, int]:
    """Return the structures for members whose tables differ in constants, and the number of columns.

    Each part has the tables of some members, their columns and their numbers (count, m).
    """
    lanes = limit("MOST_LANES")
    columns = -(-members // lanes) * lanes
    arrays, _ = parts[0][0]._each
    size = len(arrays.template)
    check_available_memory(8 * columns * size, f"the tables of {members} members with individual numbers")
    block = np.empty((size, columns))
    for tables, own, numbers in parts:
        tables._write_columns(block, own, numbers)
    # Lanes may read beyond the last member: it is repeated.
    block[:, members:] = block[:, members - 1 : members]
    return *arrays.structures(block.reshape(-1), columns), columns
