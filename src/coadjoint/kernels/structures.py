"""Tables as C structures for the kernels, with the layout that the library describes."""

from __future__ import annotations

import ctypes
import functools
import struct
from collections.abc import Callable
from operator import itemgetter
from typing import Any

import numpy as np

from coadjoint.kernels.interface import check_fields, kernel_interface

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


@functools.cache
def structures() -> dict[str, Any]:
    """Return the C structures of the tables by name."""
    found: dict[str, Any] = {}
    for name, fields in kernel_interface().tables.items():
        members = [
            (label, SCALARS.get(kind) or (ctypes.c_void_p if kind in ARRAYS else found[kind])) for kind, label in fields
        ]
        found[name] = type(name, (ctypes.Structure,), {"_fields_": members, "kinds": [kind for kind, _ in fields]})
    return found


@functools.cache
def structure_of_table(kind: Any) -> Any:
    """Return the C structure with the name and fields of a class of named tuples; raise ImportError if they differ."""
    check_fields(kind.__name__, getattr(kind, "_fields", ()))
    return structures()[kind.__name__]


@functools.cache
def per_member_fields(kind: Any) -> frozenset[str]:
    """Return the arrays of a table class with one column per member if constants of members differ.

    Examples
    --------
    >>> from coadjoint.kernels.field import GroupField
    >>> sorted(per_member_fields(GroupField))
    ['value']
    """
    structure = structure_of_table(kind)
    return frozenset(
        name for (name, _), token in zip(structure._fields_, structure.kinds, strict=True) if token in PER_MEMBER_TYPES
    )


def as_structure(table: Any) -> Any:
    """Return a named tuple as the C structure of its name, which keeps the arrays alive; return a structure unchanged.

    Raise TypeError if an array is not C-contiguous or has another type than the kernels read, ImportError if the
    library has no such table or one with other fields.
    """
    if isinstance(table, ctypes.Structure):
        return table
    own: Any = type(table)
    kind = structure_of_table(own)
    filled = kind()
    for field, token in zip((field for field, _ in kind._fields_), kind.kinds, strict=True):
        value = getattr(table, field)
        if token in SCALARS:
            setattr(filled, field, value)
        elif token in ARRAYS:
            if value.dtype != ARRAYS[token] or not value.flags.c_contiguous:
                raise TypeError(f"{kind.__name__}.{field} is {value.dtype}, not a contiguous {ARRAYS[token]}")
            setattr(filled, field, value.ctypes.data)
        else:
            setattr(filled, field, as_structure(value))
    filled.source = table
    return filled


@functools.cache
def packer(kind: Any) -> Callable[..., bytes]:
    """Return a function from the fields of a table, in the order of the class, to its bytes; ten times faster than
    `as_structure`.

    The table has plain numbers and addresses only; arrays are given by address.
    """
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
