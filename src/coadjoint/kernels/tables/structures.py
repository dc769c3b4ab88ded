"""Tables as C structures with the layout that the library describes, and shared tables of members that differ."""

from __future__ import annotations

import ctypes
import functools
import struct
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple, TypeVar

import numpy as np

from coadjoint.kernels.interface import check_fields, kernel_interface, limit

# Types of fields in `source/boundary/tables.hpp`: numbers, or elements of arrays.
SCALARS: dict[str, Any] = {"integer": ctypes.c_int64, "number": ctypes.c_double, "flag": ctypes.c_int64}
ARRAYS: dict[str, Any] = {
    "bytes": np.dtype(np.uint8),
    "indices": np.dtype(np.uint32),
    "integers": np.dtype(np.int64),
    "addresses": np.dtype(np.int64),
    "numbers": np.dtype(np.float64),
    "constants": np.dtype(np.float64),
}
PER_MEMBER_TYPES = frozenset(("addresses", "constants"))
"""Types of arrays with one column per member if the constants of members differ."""

Tables = TypeVar("Tables", bound=tuple[Any, ...])


class NotWritable(ValueError):
    """The tables depend on numbers in a way that cannot be written into them; the message names the field."""


def unrecorded() -> Any:
    """Refuse to return the sources of tables."""
    raise NotWritable("its tables do not record where they are")


@functools.cache
def structures() -> dict[str, Any]:
    """Return the C structures of the tables by name."""
    by_name: dict[str, Any] = {}
    for name, fields in kernel_interface().tables.items():
        members = [
            (label, SCALARS.get(kind) or (ctypes.c_void_p if kind in ARRAYS else by_name[kind]))
            for kind, label in fields
        ]
        by_name[name] = type(name, (ctypes.Structure,), {"_fields_": members, "kinds": [kind for kind, _ in fields]})
    return by_name


@functools.cache
def structure_of_table(kind: Any) -> Any:
    """Return the C structure with the name and fields of a class of named tuples; raise ImportError if they differ."""
    check_fields(kind.__name__, getattr(kind, "_fields", ()))
    return structures()[kind.__name__]


class TableField(NamedTuple):
    """A number or an array of a table or of a nested one: its dotted name, its type, and its offset in bytes."""

    name: str
    token: str
    offset: int

    def of(self, tables: Any) -> Any:
        """Return the value in named tuples."""
        return attrgetter(self.name)(tables)


@functools.cache
def table_fields(structure: Any) -> tuple[TableField, ...]:
    """Return the fields of a C structure and of nested ones, in its order."""
    found: list[TableField] = []
    for (name, kind), token in zip(structure._fields_, structure.kinds, strict=True):
        offset = getattr(structure, name).offset
        if token in SCALARS or token in ARRAYS:
            found.append(TableField(name, token, offset))
        else:
            found += [TableField(f"{name}.{one.name}", one.token, offset + one.offset) for one in table_fields(kind)]
    return tuple(found)


def with_arrays(tables: Tables, arrays: Mapping[str, Any]) -> Tables:
    """Return tables with other arrays, by their dotted names."""
    named: Any = tables
    changed: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}
    for name, array in arrays.items():
        outer, _, inner = name.partition(".")
        if inner:
            nested.setdefault(outer, {})[inner] = array
        else:
            changed[outer] = array
    changed |= {outer: with_arrays(getattr(named, outer), inner) for outer, inner in nested.items()}
    replaced: Tables = named._replace(**changed)
    return replaced


def as_structure(table: Any) -> Any:
    """Return a named tuple as the C structure of its name, which keeps arrays alive; a structure unchanged."""
    if isinstance(table, ctypes.Structure):
        return table
    table_class: Any = type(table)
    return _filled(structure_of_table(table_class), partial(getattr, table), table)


def filled(name: str, **fields: Any) -> Any:
    """Return the C structure of a name with these fields, for a table that Python does not read."""
    check_fields(name, fields)
    return _filled(structures()[name], fields.__getitem__, fields)


def _filled(kind: Any, value_of: Callable[[str], Any], source: Any) -> Any:
    numbers = []
    for (field, _), token in zip(kind._fields_, kind.kinds, strict=True):
        value = value_of(field)
        if token in ARRAYS:
            if value.dtype != ARRAYS[token] or not value.flags.c_contiguous:
                raise TypeError(f"{kind.__name__}.{field} is {value.dtype}, not a contiguous {ARRAYS[token]}")
            value = value.__array_interface__["data"][0]
        elif token not in SCALARS:
            value = as_structure(value)
        numbers.append(value)
    structure = kind(*numbers)
    structure.source = source
    return structure


@functools.cache
def packer(kind: Any) -> Callable[..., bytes]:
    """Return a function from the fields of a table of numbers to its bytes, ten times faster than `as_structure`."""
    structure = structure_of_table(kind)
    names = tuple(name for name, _ in structure._fields_)
    pack = struct.Struct("=" + "".join("d" if token == "number" else "q" for token in structure.kinds)).pack
    if names == kind._fields:
        return pack
    in_order = itemgetter(*map(kind._fields.index, names))
    return lambda *numbers: pack(*in_order(numbers))


def address(array: Any) -> ctypes.c_void_p:
    """Return the address of the first element of a contiguous array."""
    return ctypes.c_void_p(array.ctypes.data)


def structure_of(tables: Any) -> Hashable:
    """Return everything in tables except their constants: members of equal structure can share one set of tables."""
    kind: Any = type(tables)
    return kind, *(_structure_of(one, one.of(tables)) for one in table_fields(structure_of_table(kind)))


def _structure_of(field: TableField, value: Any) -> Hashable:
    if field.token in SCALARS:
        scalar: Hashable = value
        return scalar
    if field.token not in PER_MEMBER_TYPES:
        return value.dtype.char, value.shape, value.tobytes()
    return value.shape if value.dtype == np.float64 else (value.shape, (value == 0).tobytes())


def stacked(members: Sequence[Tables]) -> Tables:
    """Return one set of tables for members of equal `structure_of`, with a column of constants for each; the last one
    is repeated up to a multiple of MOST_LANES, since lanes may read beyond it.
    """
    kind: Any = type(members[0])
    varying = [one for one in table_fields(structure_of_table(kind)) if one.token in PER_MEMBER_TYPES]
    return with_arrays(
        members[0], {one.name: _stacked_columns([one.of(member) for member in members]) for one in varying}
    )


def _stacked_columns(columns: Sequence[Any]) -> Any:
    padding = -len(columns) % limit("MOST_LANES")
    return np.ascontiguousarray(np.pad(np.array(columns), ((0, padding), (0, 0)), mode="edge").T)
