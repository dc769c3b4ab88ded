"""Tables of members that differ in their constants alone: one set of tables for all of them, the member index last."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any, TypeVar

import numpy as np

from coadjoint.kernels.description import limit
from coadjoint.kernels.structures import varied_fields

Tables = TypeVar("Tables", bound=tuple[Any, ...])


def _varies(tables: Any, name: str) -> bool:
    kind: Any = type(tables)
    return hasattr(kind, "_fields") and name in varied_fields(kind)


def _fields(tables: Any) -> Sequence[str]:
    return getattr(tables, "_fields", ("",) * len(tables))


def structure_of(tables: Any) -> Hashable:
    """Return everything in tables but their constants: two members with equal structure can share one set of tables.

    Constants are the arrays that the kernels call `constants`, and the `addresses` of functions; of those the shape and
    which addresses are zero is structure.

    Parameters
    ----------
    tables : NamedTuple
        Of arrays, numbers, compiled functions, and further such tuples.

    Returns
    -------
    hashable

    Examples
    --------
    >>> import numpy as np
    >>> from coadjoint.kernels.field import GroupField
    >>> index = np.zeros(1, dtype=np.uint32)
    >>> one, other = (GroupField(1, 1, index, index, index, np.array([value])) for value in (1.0, 2.0))
    >>> structure_of(one) == structure_of(other)
    True
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
    """Return one set of tables for members of equal structure.

    Parameters
    ----------
    members : sequence of NamedTuple
        Of equal `structure_of`; not empty.

    Returns
    -------
    NamedTuple
        The integers and functions of the first member; every array of constants (count,) has become (count, columns),
        C-contiguous, a column for each member and the last one repeated up to a multiple of the limit
        LARGEST_CROWD: lanes may read beyond the last member.

    Examples
    --------
    >>> import numpy as np
    >>> from coadjoint.kernels.field import GroupField
    >>> index = np.zeros(1, dtype=np.uint32)
    >>> stacked([GroupField(1, 1, index, index, index, np.array([value])) for value in (1.0, 2.0)])[-1][:, :3]
    array([[1., 2., 2.]])
    """
    first = members[0]
    columns = zip(_fields(first), first, zip(*members, strict=True), strict=True)
    return _remade(first, [_stacked_column(first, name, item, column) for name, item, column in columns])


def _stacked_column(tables: Any, name: str, item: Any, column: Sequence[Any]) -> Any:
    if isinstance(item, tuple):
        return stacked(column)
    if _varies(tables, name):
        beyond = -len(column) % limit("LARGEST_CROWD")
        return np.ascontiguousarray(np.pad(np.array(column), ((0, beyond), (0, 0)), mode="edge").T)
    return item


def _remade(tables: Tables, items: list[Any]) -> Tables:
    kind: Any = type(tables)
    made: Tables = kind._make(items) if hasattr(kind, "_make") else kind(items)
    return made
