"""Lazily read xarray variables for arrays of an archive, with all checks of the archive."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from coadjoint.files.archives.archive import Archive
from coadjoint.files.datasets.named_axes import MEMBER
from coadjoint.systems.batch import Axis


class ArchivedArray(BackendArray):
    """An array of an archive that is read when indexed; with `axes`, these are dimensions in place of the members."""

    def __init__(self, archive: Archive, name: str, axes: Mapping[str, Axis]) -> None:
        self.archive, self.name, self.array = archive, name, archive.arrays[name]
        self.shape, self.dims, self.dtype = self.array.shape, self.array.dims, np.dtype(self.array.kind)
        self._lengths: tuple[int, ...] = ()
        if axes and MEMBER in self.dims:
            k, self._lengths = self.dims.index(MEMBER), tuple(axis.length for axis in axes.values())
            self.shape = (*self.shape[:k], *self._lengths, *self.shape[k + 1 :])
            self.dims = (*self.dims[:k], *axes, *self.dims[k + 1 :])

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._part)

    def _part(self, key: tuple[Any, ...]) -> NDArray[Any]:
        """Read a part given by integers and slices."""
        is_slice = [isinstance(index, slice) for index in key]
        ranges = [
            range(size)[index] if several else range(index, index + 1)
            for index, size, several in zip(key, self.shape, is_slice, strict=True)
        ]
        if not all(ranges):
            lengths = [len(chosen) for chosen, several in zip(ranges, is_slice, strict=True) if several]
            return np.zeros(lengths, self.dtype)
        values = self._along_axes(ranges) if self._lengths else self._along_members(ranges)
        return np.asarray(values[tuple(slice(None) if several else 0 for several in is_slice)])

    def _along_axes(self, ranges: list[range]) -> NDArray[Any]:
        """Read ranges along the axes: for each combination of all axes but the last a range of members."""
        k, count = self.array.dims.index(MEMBER), len(self._lengths)
        before, (*outer, last), after = ranges[:k], ranges[k : k + count], ranges[k + count :]
        pieces = []
        for combination in product(*outer):
            first = int(np.ravel_multi_index((*combination, 0), self._lengths))
            members = range(first + last.start, first + last.stop, last.step)
            pieces.append(self._along_members([*before, members, *after]))
        return np.concatenate(pieces, axis=k).reshape(tuple(map(len, ranges)))

    def _along_members(self, ranges: list[range]) -> NDArray[Any]:
        ascending = [chosen if chosen.step > 0 else chosen[::-1] for chosen in ranges]
        values = self.archive.read(self.name, ascending)
        return values[tuple(slice(None, None, 1 if chosen.step > 0 else -1) for chosen in ranges)]


def variable(array: ArchivedArray) -> xarray.Variable:
    """Return a variable whose values are read lazily; modified values stay in memory."""
    lazy: Any = indexing  # its annotations are inconsistent
    values = lazy.MemoryCachedArray(lazy.CopyOnWriteArray(lazy.LazilyIndexedArray(array)))
    return xarray.Variable(array.dims, values, dict(array.array.attributes))
