"""Tables of members that differ in their constants only: one shared set of tables, with the member index last."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any, TypeVar

import numpy as np

from coadjoint.kernels.interface import limit
from coadjoint.kernels.structures import per_member_fields

Tables = TypeVar("Tables", bound=tuple[Any, ...])


def _varies(tables: Any, name: str) -> bool:
    kind: Any = type(tables)
    return hasattr(kind, "_fields") and name in per_member_fields(kind)


def _fields(tables: Any) -> Sequence[str]:
    return getattr(tables, "_fields", ("",) * len(tables))


def structure_of(tables: Any) -> Hashable:
    """Return everything in tables except their constants: members of equal structure can share one set of tables.

    Constants are the arrays that the kernels call `constants`, and the `addresses` of functions; only the shape of
    constants, and which addresses are zero, belong to the structure.
    """
    if isinstance(tables, np.ndarray):
        return tables.dtype.char, tables.shape, tables.tobytes()
    if isinstance(tables, tuple):
        items = zip(_fields(tables), tables, strict=True)
        return type(tables), *(_shape_of(item) if _varies(tables, name) else structure_of(item) for name, item in items)
    found: Hashable = tables
    return found


def _shape_of(item: Any) -> Hashable:
    return item.shape if item.dtype == np.float64 else (item.shape, (item == 0).tobytes())


def stacked(members: Sequence[Tables]) -> Tables:
    """Return one set of tables for a nonempty sequence of members of equal `structure_of`.

    Integers and functions are those of the first member. Each array of constants (count,) becomes (count, columns),
    C-contiguous, one column per member; the last column is repeated up to a multiple of the limit LARGEST_CROWD, since
    lanes may read beyond the last member.
    """
    first = members[0]
    columns = zip(_fields(first), first, zip(*members, strict=True), strict=True)
    return _rebuilt(first, [_stacked_column(first, name, item, column) for name, item, column in columns])


def _stacked_column(tables: Any, name: str, item: Any, column: Sequence[Any]) -> Any:
    if isinstance(item, tuple):
        return stacked(column)
    if _varies(tables, name):
        beyond = -len(column) % limit("LARGEST_CROWD")
        return np.ascontiguousarray(np.pad(np.array(column), ((0, beyond), (0, 0)), mode="edge").T)
    return item


def _rebuilt(tables: Tables, items: list[Any]) -> Tables:
    kind: Any = type(tables)
    made: Tables = kind._make(items) if hasattr(kind, "_make") else kind(items)
    return made
