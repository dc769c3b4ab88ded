"""Cache keys for results that depend on sparsity patterns alone, such as for ensembles with different constants."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from numpy.typing import NDArray

SourceT = TypeVar("SourceT")

MAX_PATTERN_SIZE = 64  # coordinates, forms or parts; larger patterns are not cached


class Pattern(Generic[SourceT]):
    """Hashable set of arrays that determine a cached result; equal if the arrays are equal.

    `source` is the object from which the result is computed; the first one is used for all equal patterns.

    Examples
    --------
    >>> import numpy as np
    >>> Pattern("one", np.array([1, 2])) == Pattern("other", np.array([1, 2]))
    True
    >>> Pattern("one", np.array([1, 2])) == Pattern("one", np.array([1, 3]))
    False
    """

    def __init__(self, source: SourceT, *columns: NDArray[Any]) -> None:
        self.source = source
        self._key = tuple(_content(column) for column in columns)
        self._hash = hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Pattern) and self._key == other._key

    def __hash__(self) -> int:
        return self._hash


def _content(column: NDArray[Any]) -> tuple[Any, ...]:
    # The bytes of object arrays (fractions) are addresses, so their values are compared.
    values = tuple(column.tolist()) if column.dtype == object else column.tobytes()
    return column.dtype.char, column.shape, values
