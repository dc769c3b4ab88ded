"""Tables with inputs: numbers given with each call, written into a copy of the few arrays that contain them.

The positions of inputs are found by comparison of the tables of two systems that differ in the inputs only, each input
a number with random digits: each entry that differs must be equal, bit for bit, to an input in both tables, or to an
exact sum of inputs that the scheme declares.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import as_c_double
from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.tables.structures import ARRAYS, PER_MEMBER_TYPES, SCALARS, as_structure
from coadjoint.memory import check_available_memory
from coadjoint.program.parts.part import Parts
from coadjoint.program.parts.squares import ExactSums, ReductionSteps, offsets_of_squares

Floats = NDArray[np.float64]

# Types of fields that can be written into a copy, the field of integers that contains addresses, and the offsets of
# angles: the angles of the parts, in the order of the rows of their terms.
WRITABLE_TYPES = ("constants", "numbers")
ADDRESS_FIELD, ANGLE_OFFSET_FIELD = "tables.whole", "terms.offset"


class InputsNotLocated(ValueError):
    """The tables depend on the inputs in a way that cannot be written into them; the message names the field."""


class Field(NamedTuple):
    """A field of a table: name, type, offset in bytes, and value."""

    name: str
    token: str
    offset: int
    value: Any


def fields_of(table: Any, kind: Any, base: int = 0, path: str = "") -> Iterator[Field]:
    """Yield the fields of a table and of nested tables, in the order of the C structure."""
    for (label, inner), token in zip(kind._fields_, kind.kinds, strict=True):
        offset, value = base + getattr(kind, label).offset, getattr(table, label)
        if token in SCALARS or token in ARRAYS:
            yield Field(path + label, token, offset, value)
        else:
            yield from fields_of(value, inner, offset, f"{path}{label}.")


class _Table:
    """A table of a run, paired with the same table of another system.

    Its address is entry `index` of the integers of table number `parent`; -1 if no table refers to it.
    """

    def __init__(self, first: Any, second: Any, parts: Parts | None = None, parent: int = -1, index: int = -1) -> None:
        self.structure, self.parts, self.parent, self.index = as_structure(first), parts, parent, index
        self.kind = type(self.structure)
        self.pairs = list(zip(fields_of(first, self.kind), fields_of(second, self.kind), strict=True))

    def changed(self, skip_addresses: bool) -> Iterator[tuple[Field, NDArray[np.int64], Floats]]:
        """Yield the fields that differ, the positions that differ, and the values in the other table."""
        for field, other in self.pairs:
            if field.token == "addresses" or (skip_addresses and field.name == ADDRESS_FIELD):
                continue  # functions compiled twice, and tables that are compared separately
            if field.token in WRITABLE_TYPES and field.value.shape == other.value.shape:
                positions = np.flatnonzero(field.value.view(np.int64) != other.value.view(np.int64))
                if len(positions):
                    yield field, positions, other.value
            elif not np.array_equal(field.value, other.value):
                raise InputsNotLocated(f"its table has {field.name} that depend on them")


def _tables_of(first: CompiledLoop, second: CompiledLoop, watches: tuple[Any, Any]) -> list[_Table]:
    """Return the tables of a loop, of the invariants, and all tables that they refer to by address."""
    tables = [_Table(first.tables, second.tables, first.parts), _Table(*watches)]
    pending = [(0, first, second)]
    while pending:
        number, loop, other_loop = pending.pop()
        for index, referenced in loop.referenced.items():
            other_referenced = other_loop.referenced[index]
            if isinstance(referenced, CompiledLoop):
                pending.append((len(tables), referenced, other_referenced))
                tables.append(_Table(referenced.tables, other_referenced.tables, referenced.parts, number, index))
            else:
                tables.append(_Table(referenced, other_referenced, None, number, index))
    return tables


class _Block:
    """Arrays of several tables in one allocation, and copies of the tables that point into it."""

    def __init__(self, tables: Sequence[_Table], fields_of_tables: Sequence[Sequence[Field]]) -> None:
        self.kinds = [table.kind for table in tables]
        self.word_offsets = list(accumulate((ctypes.sizeof(kind) // 8 for kind in self.kinds), initial=0))
        self.start: dict[tuple[int, str], int] = {}
        pieces, self.pointers, count = [np.zeros(1)], [], 1
        for number, fields in enumerate(fields_of_tables):
            for field in fields:
                self.start[number, field.name] = count
                self.pointers.append((self.word_offsets[number] + field.offset // 8, 8 * count))
                pieces.append(np.ascontiguousarray(field.value).view(np.float64))
                count += len(field.value)
        self.template = np.concatenate(pieces)
        self.raw = np.concatenate([np.frombuffer(bytes(table.structure), dtype=np.int64) for table in tables])
        self.referenced = [
            (number, self.start[table.parent, ADDRESS_FIELD] + table.index)
            for number, table in enumerate(tables)
            if table.parent >= 0
        ]

    def structures(self, block: Floats, columns: int) -> tuple[Any, Any]:
        """Return copies of the first two tables that point into a block with this number of columns per row."""
        raw, base_address = self.raw.copy(), ctypes.addressof(as_c_double(block))
        for position, start in self.pointers:
            raw[position] = base_address + columns * start
        for number, position in self.referenced:
            block.view(np.int64)[position] = raw.ctypes.data + 8 * self.word_offsets[number]
        scheme, watch = (
            kind.from_buffer(raw, 8 * first) for kind, first in zip(self.kinds[:2], self.word_offsets, strict=False)
        )
        # A structure keeps its own memory alive; this adds the memory that it points to.
        scheme.source = watch.source = block
        return scheme, watch


class _InputRows(NamedTuple):
    """Rows of a block that are inputs, the indices of these inputs, and rows that are sums of inputs."""

    rows: NDArray[np.int64]
    inputs: NDArray[np.int64]
    rules: list[tuple[NDArray[np.int64], ExactSums | ReductionSteps]]


class InputTables:
    """The tables of a scheme and of the watched invariants, for inputs given with each call.

    `loops` and `watches` are those of two systems that differ in `inputs` (m,) only, the linear term first; inputs that
    differ have random digits, so that no other number equals them by chance. `separate_tables` is set if members with
    different inputs need separate tables: tables refer to other tables, or an input is a number that the kernels read
    once for all members. Raise `InputsNotLocated` if the tables differ in anything but inputs and exact sums of inputs.
    """

    def __init__(
        self,
        loops: tuple[CompiledLoop, CompiledLoop],
        watches: tuple[Any, Any],
        inputs: tuple[Floats, Floats],
    ) -> None:
        tables = self._tables = _tables_of(*loops, watches)
        parents = {table.parent for table in tables}
        index_of_input = {pair: k for k, pair in enumerate(zip(*(values.tolist() for values in inputs), strict=True))}
        copied_entries: list[tuple[int, str, int, int]] = []
        sums: list[tuple[int, str, list[int], ExactSums | ReductionSteps]] = []
        written_fields: list[list[Field]] = []
        self.separate_tables = len(tables) > 2
        for number, table in enumerate(tables):
            written_fields.append(
                [field for field, _ in table.pairs if number in parents and field.name == ADDRESS_FIELD]
            )
            for field, positions, other_values in table.changed(number in parents):
                written_fields[-1].append(field)
                self.separate_tables = self.separate_tables or field.token not in PER_MEMBER_TYPES
                handled: set[int] = set()
                if table.parts is not None and f".{field.name}".endswith(f".{ANGLE_OFFSET_FIELD}"):
                    for angles, rule in offsets_of_squares(table.parts):
                        numbers = field.value[angles].tolist(), other_values[angles].tolist()
                        if numbers == tuple(map(rule.at, inputs)):
                            sums.append((number, field.name, angles, rule))
                            handled.update(angles)
                for position in [position for position in positions.tolist() if position not in handled]:
                    pair = field.value[position].item(), other_values[position].item()
                    if pair not in index_of_input:
                        raise InputsNotLocated(
                            f"its table has {field.name} that are neither inputs nor exact sums of inputs"
                        )
                    copied_entries.append((number, field.name, position, index_of_input[pair]))
        self._copied_entries, self._sums = copied_entries, sums
        self._shared = _Block(tables, written_fields)
        self._in_shared = _written(self._shared, copied_entries, sums)
        if not self.separate_tables:
            per_member = [[field for field, _ in table.pairs if field.token in PER_MEMBER_TYPES] for table in tables]
            self._each = _Block(tables, per_member)
            self._in_each = _written(self._each, copied_entries, sums)

    def derivatives(self, names: Sequence[str], count: int) -> Iterator[tuple[int, int, float]]:
        """Yield the entries of these fields of the scheme, numbered one after the other, that depend on `count` inputs.

        Each with the index of an input, and the derivative by it. Raise `InputsNotLocated` if others depend on them.
        """
        fields = {field.name: len(field.value) for field, _ in self._tables[0].pairs if field.name in names}
        first = dict(zip(names, accumulate((fields[name] for name in names), initial=0), strict=False))
        for number, name, *_ in (*self._copied_entries, *self._sums):
            if number == 0 and name not in first:
                raise InputsNotLocated(f"its table has {name} that depend on them")
        for number, name, position, source in self._copied_entries:
            if number == 0:
                yield first[name] + position, source, 1.0
        for number, name, angles, rule in self._sums:
            if number == 0:
                for source, unit in enumerate(np.eye(count)):
                    for angle, factor in zip(angles, rule.at(unit), strict=True):
                        yield first[name] + angle, source, factor

    def shared(self, inputs: Floats) -> tuple[Any, Any]:
        """Return the structures of the scheme and of the invariants for inputs (m,) common to all members."""
        block, written = self._shared.template.copy(), self._in_shared
        block[written.rows] = inputs[written.inputs]
        for rows, rule in written.rules:
            block[rows] = rule.at(inputs)
        return self._shared.structures(block, 1)

    def each(self, inputs: Floats) -> tuple[Any, Any, int]:
        """Return the structures for inputs (members, m), and the number of columns; not valid if `separate_tables`."""
        members, lanes = len(inputs), limit("MOST_LANES")
        columns = -(-members // lanes) * lanes
        template, written = self._each.template, self._in_each
        check_available_memory(8 * columns * len(template), f"the tables of {members} members with individual inputs")
        block = np.repeat(template, columns).reshape(-1, columns)
        # Lanes may read beyond the last member: it is repeated.
        padded = inputs.take(np.minimum(np.arange(columns), members - 1), axis=0)
        block[written.rows] = padded[:, written.inputs].T
        for rows, rule in written.rules:
            block[rows, :members] = np.transpose([rule.at(inputs_of_member) for inputs_of_member in inputs])
            block[rows, members:] = block[rows, members - 1 : members]
        return *self._each.structures(block.reshape(-1), columns), columns


def _written(
    block: _Block,
    copies: Sequence[tuple[int, str, int, int]],
    sums: Sequence[tuple[int, str, list[int], ExactSums | ReductionSteps]],
) -> _InputRows:
    rows = np.array([block.start[number, name] + position for number, name, position, _ in copies], dtype=np.int64)
    inputs = np.array([source for *_, source in copies], dtype=np.int64)
    rules = [(block.start[number, name] + np.array(angles), rule) for number, name, angles, rule in sums]
    return _InputRows(rows, inputs, rules)
