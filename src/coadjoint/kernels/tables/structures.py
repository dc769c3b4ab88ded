"""Tables as C structures with the layout that the library describes, and shared tables of members that differ."""

from __future__ import annotations

import ctypes
import functools
import struct
from collections.abc import Callable, Hashable, Sequence
from operator import itemgetter
from typing import Any, TypeVar

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


@functools.cache
def per_member_fields(kind: Any) -> frozenset[str]:
    """Return the arrays of a table class with one column per member if constants of members differ."""
    structure = structure_of_table(kind)
    return frozenset(
        name for (name, _), token in zip(structure._fields_, structure.kinds, strict=True) if token in PER_MEMBER_TYPES
    )


def as_structure(table: Any) -> Any:
    """Return a named tuple as the C structure of its name, which keeps arrays alive; a structure unchanged."""
    if isinstance(table, ctypes.Structure):
        return table
    table_class: Any = type(table)
    kind = structure_of_table(table_class)
    values = []
    for (field, _), token in zip(kind._fields_, kind.kinds, strict=True):
        value = getattr(table, field)
        if token in ARRAYS:
            if value.dtype != ARRAYS[token] or not value.flags.c_contiguous:
                raise TypeError(f"{kind.__name__}.{field} is {value.dtype}, not a contiguous {ARRAYS[token]}")
            value = value.__array_interface__["data"][0]
        elif token not in SCALARS:
            value = as_structure(value)
        values.append(value)
    filled = kind(*values)
    filled.source = table
    return filled


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


Tables = TypeVar("Tables", bound=tuple[Any, ...])


def _varies(tables: Any, name: str) -> bool:
    kind: Any = type(tables)
    return hasattr(kind, "_fields") and name in per_member_fields(kind)


def _fields(tables: Any) -> Sequence[str]:
    return getattr(tables, "_fields", ("",) * len(tables))


def structure_of(tables: Any) -> Hashable:
    """Return everything in tables except their constants: members of equal structure can share one set of tables."""
    if isinstance(tables, np.ndarray):
        return tables.dtype.char, tables.shape, tables.tobytes()
    if isinstance(tables, tuple):
        items = zip(_fields(tables), tables, strict=True)
        return type(tables), *(_shape_of(item) if _varies(tables, name) else structure_of(item) for name, item in items)
    hashable: Hashable = tables
    return hashable


def _shape_of(item: Any) -> Hashable:
    return item.shape if item.dtype == np.float64 else (item.shape, (item == 0).tobytes())


def stacked(members: Sequence[Tables]) -> Tables:
    """Return one set of tables for members of equal `structure_of`, with a column of constants for each; the last one
    is repeated up to a multiple of MOST_LANES, since lanes may read beyond it.
    """
    first = members[0]
    columns = zip(_fields(first), first, zip(*members, strict=True), strict=True)
    return _rebuilt(first, [_stacked_column(first, name, item, column) for name, item, column in columns])


def _stacked_column(tables: Any, name: str, item: Any, column: Sequence[Any]) -> Any:
    if isinstance(item, tuple):
        return stacked(column)
    if _varies(tables, name):
        padding = -len(column) % limit("MOST_LANES")
        return np.ascontiguousarray(np.pad(np.array(column), ((0, padding), (0, 0)), mode="edge").T)
    return item


def _rebuilt(tables: Tables, items: list[Any]) -> Tables:
    kind: Any = type(tables)
    rebuilt: Tables = kind._make(items) if hasattr(kind, "_make") else kind(items)
    return rebuilt
