"""Lazily read xarray variables for arrays of an archive, with all checks of the archive."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from coadjoint.files.archives.reading import read_array
from coadjoint.files.archives.stored_arrays import StoredArray
from coadjoint.files.datasets.named_axes import MEMBER
from coadjoint.memory import check_available_memory
from coadjoint.systems.batch import Axis


class ArchivedArray(BackendArray):
    """An array of an archive that is read when indexed; parameters as for `read_array`.

    With `axes`, these are dimensions in place of the members. `check_last_point` is called when the last of the growing
    rows has been read, and raises an error if it was replaced since.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        array: StoredArray,
        may_be_missing: Callable[[tuple[int, ...]], bool] | None,
        axes: Mapping[str, Axis] | None = None,
        check_last_point: Callable[[], None] | None = None,
    ) -> None:
        self.path, self.name, self.array, self.may_be_missing = path, name, array, may_be_missing
        self.check_last_point = check_last_point if array.grows else None
        self.shape, self.dims, self.dtype = array.shape, array.dims, np.dtype(array.kind)
        self._lengths: tuple[int, ...] = ()
        if axes and MEMBER in array.dims:
            k, self._lengths = array.dims.index(MEMBER), tuple(axis.length for axis in axes.values())
            self.shape = (*array.shape[:k], *self._lengths, *array.shape[k + 1 :])
            self.dims = (*array.dims[:k], *axes, *array.dims[k + 1 :])

    def __getitem__(self, key: Any) -> Any:
        part = self._part_of_axes if self._lengths else self._part
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, part)

    def _part_of_axes(self, key: tuple[Any, ...]) -> NDArray[Any]:
        """Read a part along the axes: for each combination of all axes but the last a range of members."""
        k, count = self.array.dims.index(MEMBER), len(self._lengths)
        axes = [range(size)[index] for index, size in zip(key[k : k + count], self._lengths, strict=True)]
        lengths = [len(chosen) for chosen in axes if isinstance(chosen, range)]
        outer = [chosen if isinstance(chosen, range) else (chosen,) for chosen in axes[:-1]]
        last, pieces = axes[-1], []
        for combination in product(*outer):
            first = int(np.ravel_multi_index((*combination, 0), self._lengths))
            inner = range(last, last + 1) if isinstance(last, int) else last
            stop = first + inner.stop
            members = slice(first + inner.start, stop if stop >= 0 else None, inner.step)
            pieces.append(self._part((*key[:k], members, *key[k + count :])))
        # The members follow the dimensions before them that have not been reduced by an integer.
        position = sum(isinstance(index, slice) for index in key[:k])
        values = np.concatenate(pieces, axis=position)
        return values.reshape(*values.shape[:position], *lengths, *values.shape[position + 1 :])

    def _part(self, key: tuple[Any, ...]) -> NDArray[Any]:
        """Read a part given by integers and slices."""
        ranges = [
            range(size)[index] if isinstance(index, slice) else range(index, index + 1)
            for index, size in zip(key, self.array.shape, strict=True)
        ]
        ascending = [index if index.step > 0 else index[::-1] for index in ranges]
        check_available_memory(
            16 * prod(map(len, ranges)), f"{self.name} of the archive {self.path}", "read a part of it"
        )
        values = read_array(self.path, self.name, self.array, ascending, self.may_be_missing)
        if self.check_last_point is not None and self.array.shape[0] - 1 in ascending[0]:
            self.check_last_point()
        restored = (
            (slice(None) if chosen_range.step > 0 else slice(None, None, -1)) if isinstance(index, slice) else 0
            for index, chosen_range in zip(key, ranges, strict=True)
        )
        return np.asarray(values[tuple(restored)])


def variable(array: ArchivedArray) -> xarray.Variable:
    """Return a variable whose values are read lazily; modified values stay in memory."""
    lazy: Any = indexing  # its annotations are inconsistent
    values = lazy.MemoryCachedArray(lazy.CopyOnWriteArray(lazy.LazilyIndexedArray(array)))
    return xarray.Variable(array.dims, values, dict(array.array.attributes))
