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
        values = self.archive.read(self.name, ascending)
        restored = (
            slice(None, None, 1 if chosen.step > 0 else -1) if isinstance(index, slice) else 0
            for index, chosen in zip(key, ranges, strict=True)
        )
        return np.asarray(values[tuple(restored)])


def variable(array: ArchivedArray) -> xarray.Variable:
    """Return a variable whose values are read lazily; modified values stay in memory."""
    lazy: Any = indexing  # its annotations are inconsistent
    values = lazy.MemoryCachedArray(lazy.CopyOnWriteArray(lazy.LazilyIndexedArray(array)))
    return xarray.Variable(array.dims, values, dict(array.array.attributes))
