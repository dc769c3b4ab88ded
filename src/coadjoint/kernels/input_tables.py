"""Tables with inputs: numbers that each call brings, written into a copy of the few arrays that hold them.

Where they stand is not written down by any scheme. It is seen in the tables of two systems that differ in the inputs
alone, each input a number with random digits: what is not equal in the two must be an input in both, to the bit, or an
exact sum of inputs that the scheme has told.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import number_at
from coadjoint.kernels.description import limit
from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.structures import ARRAYS, SCALARS, VARIED, pointed
from coadjoint.memory import check_room
from coadjoint.program.offsets_of_squares import ExactSum, offsets_of_squares

Floats = NDArray[np.float64]

# The place of the address of an inner table among the whole numbers of a step: see `tables_around`.
ADDRESS_OF_INNER = 1


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
    """One C structure, and the same of another system."""

    def __init__(self, one: Any, other: Any, inner: bool = False) -> None:
        self.filled = pointed(one)
        self.kind = type(self.filled)
        self.fields = list(fields_of(one, self.kind))
        others = list(fields_of(other, self.kind))
        self.changed: list[tuple[Field, NDArray[np.int64], Floats]] = []
        for mine, theirs in zip(self.fields, others, strict=True):
            if inner and mine.name == "tables.whole":
                continue
            if mine.token == "constants" and mine.value.shape == theirs.value.shape:
                places = np.flatnonzero(mine.value.view(np.int64) != theirs.value.view(np.int64))
                if len(places):
                    self.changed.append((mine, places, theirs.value))
            elif mine.token == "addresses" and mine.value.shape == theirs.value.shape:
                continue  # of the same functions, compiled twice
            elif not np.array_equal(mine.value, theirs.value):
                raise NotPlaced(f"its table has {mine.name} that depend on them")


class _Block:
    """Constants of several tables one after the other, with what is to be written there and into the structures."""

    def __init__(self, tables: Sequence[_Table], chosen: Sequence[Sequence[Field]], sizes: Sequence[int]) -> None:
        words = list(accumulate((size // 8 for size in sizes), initial=0))
        self.words, pieces, pointers, starts = words, [], [], []
        self.start: dict[tuple[int, str], int] = {}
        count = 0
        for number, fields in enumerate(chosen):
            for field in fields:
                self.start[number, field.name] = count
                pieces.append(np.ascontiguousarray(field.value).view(np.float64))
                pointers.append(words[number] + field.offset // 8)
                starts.append(count)
                count += len(field.value)
        self.template = np.concatenate([np.zeros(0), *pieces])
        self.pointers = [(place, 8 * start) for place, start in zip(pointers, starts, strict=True)]
        self.raw = np.concatenate([np.frombuffer(bytes(table.filled), dtype=np.int64) for table in tables])
        self.kinds = [table.kind for table in tables]

    def structures(self, block: Floats, columns: int, inner: Sequence[int] = ()) -> list[Any]:
        """Return copies of the structures that read the block, whose rows have so many columns."""
        raw, here = self.raw.copy(), ctypes.addressof(number_at(block))
        for place, start in self.pointers:
            raw[place] = here + columns * start
        found = [kind.from_buffer(raw, 8 * first) for kind, first in zip(self.kinds, self.words, strict=False)]
        for place, table in zip(inner, found[2:], strict=True):
            block.view(np.int64)[place] = ctypes.addressof(table)
        # A structure keeps the memory alive that it stands in, and now also what it points to.
        found[0].source = found[1].source = block
        return found


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
    nested : bool
        Whether a step takes steps of another loop inside; members then need tables of their own.

    Raises
    ------
    NotPlaced
        The tables differ in something else than constants that are inputs, or exact sums of inputs.
    """

    def __init__(
        self,
        loops: tuple[CompiledLoop, CompiledLoop],
        watches: tuple[Any, Any],
        inputs: tuple[Floats, Floats],
    ) -> None:
        inner = list(_inside(*loops))
        self.nested = bool(inner)
        around = [own.inner is not None for own in (loops[0], *(pair[0] for pair in inner))]
        tables = [_Table(loops[0].tables, loops[1].tables, around[0]), _Table(*watches)]
        tables += [_Table(one.tables, other.tables, own) for (one, other), own in zip(inner, around[1:], strict=True)]
        sizes = [ctypes.sizeof(table.kind) for table in tables]
        held = [n for n, own in enumerate([around[0], False, *around[1:]]) if own]
        chosen = []
        for number, table in enumerate(tables):
            names = {field.name for field, _, _ in table.changed} | ({"tables.whole"} if number in held else set())
            chosen.append([field for field in table.fields if field.name in names])
        self._shared = _Block(tables, chosen, sizes)
        self._inner = [self._shared.start[number, "tables.whole"] + ADDRESS_OF_INNER for number in held]
        varied = [[field for field in table.fields if field.token in VARIED] for table in tables]
        self._each = None if self.nested else _Block(tables, varied, sizes)
        parts = [loops[0].parts, None, *(pair[0].parts for pair in inner)]
        rules = [{} if own is None else offsets_of_squares(own) for own in parts]
        self._keep = tables
        self._found = [
            (number, field.name, int(place), _source(field, int(place), values, inputs, rules[number]))
            for number, table in enumerate(tables)
            for field, places, values in table.changed
            for place in places
        ]
        self._copies = self._written(self._shared)
        self._copies_of_each = None if self._each is None else self._written(self._each)

    def _written(self, block: _Block) -> tuple[NDArray[np.int64], NDArray[np.int64], list[tuple[int, ExactSum]]]:
        """Return at which places of a block which inputs stand, and the places with their rules."""
        places = [(block.start[number, name] + place, source) for number, name, place, source in self._found]
        plain = [(place, source) for place, source in places if isinstance(source, int)]
        at, of = np.array(plain, dtype=np.int64).reshape(-1, 2).T
        return at.copy(), of.copy(), [(place, rule) for place, rule in places if not isinstance(rule, int)]

    def shared(self, inputs: Floats) -> tuple[Any, Any]:
        """Return the structures of the scheme and of the invariants for inputs (m,) that all members have."""
        block, (at, of, rules) = self._shared.template.copy(), self._copies
        if not len(block):
            block = np.zeros(1)
        block[at] = inputs[of]
        for place, rule in rules:
            block[place] = rule.at(inputs)
        found = self._shared.structures(block, 1, self._inner)
        return found[0], found[1]

    def each(self, inputs: Floats) -> tuple[Any, Any, int]:
        """Return them for inputs (members, m), and how many columns the constants have; not where it is `nested`."""
        assert self._each is not None and self._copies_of_each is not None
        members, crowd = len(inputs), limit("LARGEST_CROWD")
        columns = -(-members // crowd) * crowd
        template, (at, of, rules) = self._each.template, self._copies_of_each
        check_room(8 * columns * len(template), f"the tables of {members} members with inputs of their own")
        block = np.repeat(template if len(template) else np.zeros(1), columns).reshape(-1, columns)
        # Lanes may read beyond the last member: the last one again.
        block[at, :members], block[at, members:] = inputs[:, of].T, inputs[-1, of][:, None]
        for place, rule in rules:
            block[place, :members] = [rule.at(own) for own in inputs]
            block[place, members:] = block[place, members - 1]
        found = self._each.structures(block.reshape(-1), columns)
        return found[0], found[1], columns


def _inside(one: CompiledLoop, other: CompiledLoop) -> Iterator[tuple[CompiledLoop, CompiledLoop]]:
    """Yield the loops that are inside of others, from the outermost on."""
    while one.inner is not None and other.inner is not None:
        one, other = one.inner, other.inner
        yield one, other


def _source(
    field: Field,
    place: int,
    theirs: Floats,
    inputs: tuple[Floats, Floats],
    rules: Mapping[int, ExactSum],
) -> int | ExactSum:
    """Return which input a constant is, or the rule that it follows."""
    here, there = field.value[place], theirs[place]
    same = np.flatnonzero((inputs[0] == here) & (inputs[1] == there))
    if len(same):
        return int(same[0])
    # Row after row of its terms stand the angles of the parts.
    rule = rules.get(place) if field.name == "terms.offset" else None
    if rule is not None and rule.at(inputs[0]) == here and rule.at(inputs[1]) == there:
        return rule
    raise NotPlaced(f"its table has {field.name} that are neither an input nor an exact sum of inputs")
