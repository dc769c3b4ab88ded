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
from coadjoint.kernels.structures import ARRAYS, PER_MEMBER_TYPES, SCALARS, as_structure
from coadjoint.memory import check_available_memory
from coadjoint.program.parts.offsets_of_squares import ExactSums, ReductionSteps, offsets_of_squares
from coadjoint.program.parts.part import Parts

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

    Its address is entry `place` of the integers of table number `parent`; -1 if no table refers to it.
    """

    def __init__(self, one: Any, other: Any, parts: Parts | None = None, parent: int = -1, place: int = -1) -> None:
        self.structure, self.parts, self.parent, self.place = as_structure(one), parts, parent, place
        self.kind = type(self.structure)
        self.pairs = list(zip(fields_of(one, self.kind), fields_of(other, self.kind), strict=True))

    def changed(self, skip_addresses: bool) -> Iterator[tuple[Field, NDArray[np.int64], Floats]]:
        """Yield the fields that differ between the two tables, the positions that differ, and the values of the other
        table.
        """
        for mine, theirs in self.pairs:
            if mine.token == "addresses" or (skip_addresses and mine.name == ADDRESS_FIELD):
                continue  # functions compiled twice, and tables that are compared separately
            if mine.token in WRITABLE_TYPES and mine.value.shape == theirs.value.shape:
                places = np.flatnonzero(mine.value.view(np.int64) != theirs.value.view(np.int64))
                if len(places):
                    yield mine, places, theirs.value
            elif not np.array_equal(mine.value, theirs.value):
                raise InputsNotLocated(f"its table has {mine.name} that depend on them")


def _tables_of(one: CompiledLoop, other: CompiledLoop, watches: tuple[Any, Any]) -> list[_Table]:
    """Return the tables of a loop, of the invariants, and all tables that they refer to by address."""
    tables = [_Table(one.tables, other.tables, one.parts), _Table(*watches)]
    waiting = [(0, one, other)]
    while waiting:
        number, mine, theirs = waiting.pop()
        for place, referenced in mine.referenced.items():
            beside = theirs.referenced[place]
            if isinstance(referenced, CompiledLoop):
                waiting.append((len(tables), referenced, beside))
                tables.append(_Table(referenced.tables, beside.tables, referenced.parts, number, place))
            else:
                tables.append(_Table(referenced, beside, None, number, place))
    return tables


class _Block:
    """Arrays of several tables in one allocation, and copies of the tables that point into it."""

    def __init__(self, tables: Sequence[_Table], chosen: Sequence[Sequence[Field]]) -> None:
        self.kinds = [table.kind for table in tables]
        self.word_offsets = list(accumulate((ctypes.sizeof(kind) // 8 for kind in self.kinds), initial=0))
        self.start: dict[tuple[int, str], int] = {}
        pieces, self.pointers, count = [np.zeros(1)], [], 1
        for number, fields in enumerate(chosen):
            for field in fields:
                self.start[number, field.name] = count
                self.pointers.append((self.word_offsets[number] + field.offset // 8, 8 * count))
                pieces.append(np.ascontiguousarray(field.value).view(np.float64))
                count += len(field.value)
        self.template = np.concatenate(pieces)
        self.raw = np.concatenate([np.frombuffer(bytes(table.structure), dtype=np.int64) for table in tables])
        self.referenced = [
            (number, self.start[table.parent, ADDRESS_FIELD] + table.place)
            for number, table in enumerate(tables)
            if table.parent >= 0
        ]

    def structures(self, block: Floats, columns: int) -> tuple[Any, Any]:
        """Return copies of the first two tables that point into a block with this number of columns per row."""
        raw, here = self.raw.copy(), ctypes.addressof(as_c_double(block))
        for place, start in self.pointers:
            raw[place] = here + columns * start
        for number, place in self.referenced:
            block.view(np.int64)[place] = raw.ctypes.data + 8 * self.word_offsets[number]
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
        holders = {table.parent for table in tables}
        known = {pair: k for k, pair in enumerate(zip(*(own.tolist() for own in inputs), strict=True))}
        copies: list[tuple[int, str, int, int]] = []
        sums: list[tuple[int, str, list[int], ExactSums | ReductionSteps]] = []
        chosen: list[list[Field]] = []
        self.separate_tables = len(tables) > 2
        for number, table in enumerate(tables):
            chosen.append([field for field, _ in table.pairs if number in holders and field.name == ADDRESS_FIELD])
            for field, places, theirs in table.changed(number in holders):
                chosen[-1].append(field)
                self.separate_tables = self.separate_tables or field.token not in PER_MEMBER_TYPES
                summed: set[int] = set()
                if table.parts is not None and field.name == ANGLE_OFFSET_FIELD:
                    for angles, rule in offsets_of_squares(table.parts):
                        found = field.value[angles].tolist(), theirs[angles].tolist()
                        if found == tuple(map(rule.at, inputs)):
                            sums.append((number, field.name, angles, rule))
                            summed.update(angles)
                for place in [place for place in places.tolist() if place not in summed]:
                    pair = field.value[place].item(), theirs[place].item()
                    if pair not in known:
                        raise InputsNotLocated(
                            f"its table has {field.name} that are neither inputs nor exact sums of inputs"
                        )
                    copies.append((number, field.name, place, known[pair]))
        self._shared = _Block(tables, chosen)
        self._in_shared = _written(self._shared, copies, sums)
        if not self.separate_tables:
            varied = [[field for field, _ in table.pairs if field.token in PER_MEMBER_TYPES] for table in tables]
            self._each = _Block(tables, varied)
            self._in_each = _written(self._each, copies, sums)

    def shared(self, inputs: Floats) -> tuple[Any, Any]:
        """Return the structures of the scheme and of the invariants for inputs (m,) common to all members."""
        block, written = self._shared.template.copy(), self._in_shared
        block[written.rows] = inputs[written.inputs]
        for rows, rule in written.rules:
            block[rows] = rule.at(inputs)
        return self._shared.structures(block, 1)

    def each(self, inputs: Floats) -> tuple[Any, Any, int]:
        """Return the structures for inputs (members, m), and the number of columns of the constants; not valid if
        `separate_tables`.
        """
        members, crowd = len(inputs), limit("LARGEST_CROWD")
        columns = -(-members // crowd) * crowd
        template, written = self._each.template, self._in_each
        check_available_memory(8 * columns * len(template), f"the tables of {members} members with inputs of their own")
        block = np.repeat(template, columns).reshape(-1, columns)
        # Lanes may read beyond the last member: it is repeated.
        padded = inputs.take(np.minimum(np.arange(columns), members - 1), axis=0)
        block[written.rows] = padded[:, written.inputs].T
        for rows, rule in written.rules:
            block[rows, :members] = np.transpose([rule.at(own) for own in inputs])
            block[rows, members:] = block[rows, members - 1 : members]
        return *self._each.structures(block.reshape(-1), columns), columns


def _written(
    block: _Block,
    copies: Sequence[tuple[int, str, int, int]],
    sums: Sequence[tuple[int, str, list[int], ExactSums | ReductionSteps]],
) -> _InputRows:
    rows = np.array([block.start[number, name] + place for number, name, place, _ in copies], dtype=np.int64)
    inputs = np.array([source for *_, source in copies], dtype=np.int64)
    rules = [(block.start[number, name] + np.array(places), rule) for number, name, places, rule in sums]
    return _InputRows(rows, inputs, rules)
