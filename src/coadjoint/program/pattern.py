"""What depends on a pattern alone is made once, since members of an ensemble differ in their constants alone."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from numpy.typing import NDArray

Given = TypeVar("Given")

LARGEST_PATTERN = 64  # coordinates, forms or parts: what is made of larger patterns is not kept


class Pattern(Generic[Given]):
    """The arrays that alone decide on what is made of them. Two patterns are equal where their arrays are.

    Parameters
    ----------
    given : object
        What it is made of; the first one given stands for all that are equal.
    *columns : ndarray
        The arrays.

    Examples
    --------
    >>> import numpy as np
    >>> Pattern("one", np.array([1, 2])) == Pattern("other", np.array([1, 2]))
    True
    >>> Pattern("one", np.array([1, 2])) == Pattern("one", np.array([1, 3]))
    False
    """

    def __init__(self, given: Given, *columns: NDArray[Any]) -> None:
        self.given = given
        self._key = tuple(_content(column) for column in columns)
        self._hash = hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Pattern) and self._key == other._key

    def __hash__(self) -> int:
        return self._hash


def _content(column: NDArray[Any]) -> tuple[Any, ...]:
    # The bytes of an array of objects, such as fractions, are addresses.
    held = tuple(column.tolist()) if column.dtype == object else column.tobytes()
    return column.dtype.char, column.shape, held
