"""Tables of members that differ in their constants alone: one set of tables for all of them, the member index last."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any, TypeVar

import numpy as np

Tables = TypeVar("Tables", bound=tuple[Any, ...])


def structure_of(tables: Any) -> Hashable:
    """Return everything in tables but their constants: two members with equal structure can share one set of tables.

    Constants are the arrays of float64; of those the shape is structure. Addresses of user functions are structure.

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
        kind = tables.dtype.char
        return (kind, tables.shape) if kind == "d" else (kind, tables.shape, tables.tobytes())
    if isinstance(tables, tuple):
        return (type(tables), *map(structure_of, tables))
    found: Hashable = tables
    return found


def stacked(members: Sequence[Tables]) -> Tables:
    """Return one set of tables for members of equal structure.

    Parameters
    ----------
    members : sequence of NamedTuple
        Of equal `structure_of`; not empty.

    Returns
    -------
    NamedTuple
        The integers and functions of the first member; every array of constants (count,) has become (count, members),
        C-contiguous.

    Examples
    --------
    >>> import numpy as np
    >>> from coadjoint.kernels.field import GroupField
    >>> index = np.zeros(1, dtype=np.uint32)
    >>> stacked([GroupField(1, 1, index, index, index, np.array([value])) for value in (1.0, 2.0)])[-1]
    array([[1., 2.]])
    """
    first = members[0]
    columns = zip(*members, strict=True)
    return _remade(first, [_stacked_column(item, column) for item, column in zip(first, columns, strict=True)])


def _stacked_column(item: Any, column: Sequence[Any]) -> Any:
    if isinstance(item, tuple):
        return stacked(column)
    if isinstance(item, np.ndarray) and item.dtype == np.float64:
        return np.ascontiguousarray(np.array(column).T)
    return item


def picked(varied: Tables, member: int) -> Tables:
    """Return the tables of one member of a stack: its own constants, in the type that it has alone.

    Parameters
    ----------
    varied : NamedTuple
        From `stacked`.
    member : int
        Its place in the stack.

    Returns
    -------
    NamedTuple

    Examples
    --------
    >>> import numpy as np
    >>> from coadjoint.kernels.field import GroupField
    >>> index = np.zeros(1, dtype=np.uint32)
    >>> both = stacked([GroupField(1, 1, index, index, index, np.array([value])) for value in (1.0, 2.0)])
    >>> picked(both, 1)[-1]
    array([2.])
    """
    return _remade(varied, [_picked_item(item, member) for item in varied])


def _picked_item(item: Any, member: int) -> Any:
    if isinstance(item, tuple):
        return picked(item, member)
    if isinstance(item, np.ndarray) and item.dtype == np.float64:
        return item[:, member].copy()
    return item


def _remade(tables: Tables, items: list[Any]) -> Tables:
    kind: Any = type(tables)
    made: Tables = kind._make(items) if hasattr(kind, "_make") else kind(items)
    return made
