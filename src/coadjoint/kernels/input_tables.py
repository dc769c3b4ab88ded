"""Tables with inputs: numbers that each call brings, written into a copy of the few arrays that hold them.

Where they stand is not written down by any scheme. It is seen in the tables of two systems that differ in the inputs
alone, each input a number with random digits: what is not equal in the two must be an input in both, to the bit, or an
exact sum of inputs that the scheme has told.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import number_at
from coadjoint.kernels.description import limit
from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.structures import ARRAYS, SCALARS, VARIED, pointed
from coadjoint.memory import check_room
from coadjoint.program.offsets_of_squares import ExactSums, Reduced, offsets_of_squares
from coadjoint.program.parts import Parts

Floats = NDArray[np.float64]

# The numbers that can be written into a copy, the whole numbers that addresses stand among, and the offsets of angles:
# row after row of its terms stand the angles of the parts.
WRITTEN = ("constants", "numbers")
WHOLE, OFFSETS = "tables.whole", "terms.offset"


class NotPlaced(ValueError):
    """The tables depend on the inputs in a way that cannot be written into them; the message says which."""


class Field(NamedTuple):
    """A field of a table: its name, its type, where it stands in bytes, and its value."""

    name: str
    token: str
    offset: int
    value: Any


def fields_of(table: Any, kind: Any, base: int = 0, path: str = "") -> Iterator[Field]:
    """Yield the fields of a table and of the tables in it, as they stand in its C structure."""
    for (label, inner), token in zip(kind._fields_, kind.kinds, strict=True):
        offset, value = base + getattr(kind, label).offset, getattr(table, label)
        if token in SCALARS or token in ARRAYS:
            yield Field(path + label, token, offset, value)
        else:
            yield from fields_of(value, inner, offset, f"{path}{label}.")


class _Table:
    """One table of a run, beside the same of another system.

    It stands at the address that the table number `holder` has at a place of its whole numbers; or nothing holds it.
    """

    def __init__(self, one: Any, other: Any, parts: Parts | None = None, holder: int = -1, place: int = -1) -> None:
        self.filled, self.parts, self.holder, self.place = pointed(one), parts, holder, place
        self.kind = type(self.filled)
        self.pairs = list(zip(fields_of(one, self.kind), fields_of(other, self.kind), strict=True))

    def changed(self, holding: bool) -> Iterator[tuple[Field, NDArray[np.int64], Floats]]:
        """Yield the fields that are not the same in both, where they are not, and what the other table has."""
        for mine, theirs in self.pairs:
            if mine.token == "addresses" or (holding and mine.name == WHOLE):
                continue  # functions that were compiled twice, and tables that are compared themselves
            if mine.token in WRITTEN and mine.value.shape == theirs.value.shape:
                places = np.flatnonzero(mine.value.view(np.int64) != theirs.value.view(np.int64))
                if len(places):
                    yield mine, places, theirs.value
            elif not np.array_equal(mine.value, theirs.value):
                raise NotPlaced(f"its table has {mine.name} that depend on them")


def _tables_of(one: CompiledLoop, other: CompiledLoop, watches: tuple[Any, Any]) -> list[_Table]:
    """Return the tables of a loop, of the invariants, and those at addresses in them."""
    tables = [_Table(one.tables, other.tables, one.parts), _Table(*watches)]
    waiting = [(0, one, other)]
    while waiting:
        number, mine, theirs = waiting.pop()
        for place, held in mine.held.items():
            beside = theirs.held[place]
            if isinstance(held, CompiledLoop):
                waiting.append((len(tables), held, beside))
                tables.append(_Table(held.tables, beside.tables, held.parts, number, place))
            else:
                tables.append(_Table(held, beside, None, number, place))
    return tables


class _Block:
    """Arrays of several tables one after the other, and copies of the tables that read them there."""

    def __init__(self, tables: Sequence[_Table], chosen: Sequence[Sequence[Field]]) -> None:
        self.kinds = [table.kind for table in tables]
        self.words = list(accumulate((ctypes.sizeof(kind) // 8 for kind in self.kinds), initial=0))
        self.start: dict[tuple[int, str], int] = {}
        pieces, self.pointers, count = [np.zeros(1)], [], 1
        for number, fields in enumerate(chosen):
            for field in fields:
                self.start[number, field.name] = count
                self.pointers.append((self.words[number] + field.offset // 8, 8 * count))
                pieces.append(np.ascontiguousarray(field.value).view(np.float64))
                count += len(field.value)
        self.template = np.concatenate(pieces)
        self.raw = np.concatenate([np.frombuffer(bytes(table.filled), dtype=np.int64) for table in tables])
        self.held = [
            (number, self.start[table.holder, WHOLE] + table.place)
            for number, table in enumerate(tables)
            if table.holder >= 0
        ]

    def structures(self, block: Floats, columns: int) -> tuple[Any, Any]:
        """Return copies of the first two tables, which read the block; each of its rows has so many columns."""
        raw, here = self.raw.copy(), ctypes.addressof(number_at(block))
        for place, start in self.pointers:
            raw[place] = here + columns * start
        for number, place in self.held:
            block.view(np.int64)[place] = raw.ctypes.data + 8 * self.words[number]
        scheme, watch = (
            kind.from_buffer(raw, 8 * first) for kind, first in zip(self.kinds[:2], self.words, strict=False)
        )
        # A structure keeps the memory alive that it stands in, and now also what it points to.
        scheme.source = watch.source = block
        return scheme, watch


class _Written(NamedTuple):
    """Which rows of a block are which inputs, and which are sums of inputs."""

    rows: NDArray[np.int64]
    inputs: NDArray[np.int64]
    rules: list[tuple[NDArray[np.int64], ExactSums | Reduced]]


class InputTables:
    """The tables of a scheme and of the invariants that are followed, for inputs that each call brings.

    Parameters
    ----------
    loops : pair of CompiledLoop
        The scheme on two systems that differ in the inputs alone.
    watches : pair of Watch
        Their invariants.
    inputs : pair of ndarray, shape (m,)
        The inputs of the two, the linear term first. Those that differ have random digits, so that none is met by
        chance.

    Attributes
    ----------
    apart : bool
        Whether members with inputs of their own need tables of their own: other tables stand at addresses in them, or
        an input stands where the kernels read one number for all members.

    Raises
    ------
    NotPlaced
        The tables differ in something else than numbers that are inputs, or exact sums of inputs.
    """

    def __init__(
        self,
        loops: tuple[CompiledLoop, CompiledLoop],
        watches: tuple[Any, Any],
        inputs: tuple[Floats, Floats],
    ) -> None:
        tables = self._tables = _tables_of(*loops, watches)
        holders = {table.holder for table in tables}
        known = {pair: k for k, pair in enumerate(zip(*(own.tolist() for own in inputs), strict=True))}
        copies: list[tuple[int, str, int, int]] = []
        sums: list[tuple[int, str, list[int], ExactSums | Reduced]] = []
        chosen: list[list[Field]] = []
        self.apart = len(tables) > 2
        for number, table in enumerate(tables):
            chosen.append([field for field, _ in table.pairs if number in holders and field.name == WHOLE])
            for field, places, theirs in table.changed(number in holders):
                chosen[-1].append(field)
                self.apart = self.apart or field.token not in VARIED
                summed: set[int] = set()
                if table.parts is not None and field.name == OFFSETS:
                    for angles, rule in offsets_of_squares(table.parts):
                        found = field.value[angles].tolist(), theirs[angles].tolist()
                        if found == tuple(map(rule.at, inputs)):
                            sums.append((number, field.name, angles, rule))
                            summed.update(angles)
                for place in [place for place in places.tolist() if place not in summed]:
                    pair = field.value[place].item(), theirs[place].item()
                    if pair not in known:
                        raise NotPlaced(f"its table has {field.name} that are neither inputs nor exact sums of inputs")
                    copies.append((number, field.name, place, known[pair]))
        self._shared = _Block(tables, chosen)
        self._in_shared = _written(self._shared, copies, sums)
        if not self.apart:
            varied = [[field for field, _ in table.pairs if field.token in VARIED] for table in tables]
            self._each = _Block(tables, varied)
            self._in_each = _written(self._each, copies, sums)

    def shared(self, inputs: Floats) -> tuple[Any, Any]:
        """Return the structures of the scheme and of the invariants for inputs (m,) that all members have."""
        block, written = self._shared.template.copy(), self._in_shared
        block[written.rows] = inputs[written.inputs]
        for rows, rule in written.rules:
            block[rows] = rule.at(inputs)
        return self._shared.structures(block, 1)

    def each(self, inputs: Floats) -> tuple[Any, Any, int]:
        """Return them for inputs (members, m), and how many columns the constants have; not where members are apart."""
        members, crowd = len(inputs), limit("LARGEST_CROWD")
        columns = -(-members // crowd) * crowd
        template, written = self._each.template, self._in_each
        check_room(8 * columns * len(template), f"the tables of {members} members with inputs of their own")
        block = np.repeat(template, columns).reshape(-1, columns)
        # Lanes may read beyond the last member: the last one again.
        padded = inputs.take(np.minimum(np.arange(columns), members - 1), axis=0)
        block[written.rows] = padded[:, written.inputs].T
        for rows, rule in written.rules:
            block[rows, :members] = np.transpose([rule.at(own) for own in inputs])
            block[rows, members:] = block[rows, members - 1 : members]
        return *self._each.structures(block.reshape(-1), columns), columns


def _written(
    block: _Block,
    copies: Sequence[tuple[int, str, int, int]],
    sums: Sequence[tuple[int, str, list[int], ExactSums | Reduced]],
) -> _Written:
    rows = np.array([block.start[number, name] + place for number, name, place, _ in copies], dtype=np.int64)
    inputs = np.array([source for *_, source in copies], dtype=np.int64)
    rules = [(block.start[number, name] + np.array(places), rule) for number, name, places, rule in sums]
    return _Written(rows, inputs, rules)
