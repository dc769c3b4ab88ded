"""Lazily read xarray variables for arrays of an archive, with all checks of the archive."""

from __future__ import annotations

from collections.abc import Callable
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
from coadjoint.memory import check_available_memory


class ArchivedArray(BackendArray):
    """An array of an archive that is read when indexed; parameters as for `read_array`."""

    def __init__(
        self, path: Path, name: str, array: StoredArray, may_be_missing: Callable[[tuple[int, ...]], bool] | None
    ) -> None:
        self.path, self.name, self.array, self.may_be_missing = path, name, array, may_be_missing
        self.shape, self.dtype = array.shape, np.dtype(array.kind)

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._part)

    def _part(self, key: tuple[Any, ...]) -> NDArray[Any]:
        """Read a part given by integers and slices."""
        ranges = [
            range(size)[index] if isinstance(index, slice) else range(index, index + 1)
            for index, size in zip(key, self.shape, strict=True)
        ]
        ascending = [index if index.step > 0 else index[::-1] for index in ranges]
        check_available_memory(
            16 * prod(map(len, ranges)), f"{self.name} of the archive {self.path}", "read a part of it"
        )
        values = read_array(self.path, self.name, self.array, ascending, self.may_be_missing)
        restored = (
            (slice(None) if chosen_range.step > 0 else slice(None, None, -1)) if isinstance(index, slice) else 0
            for index, chosen_range in zip(key, ranges, strict=True)
        )
        return np.asarray(values[tuple(restored)])


def variable(array: ArchivedArray) -> xarray.Variable:
    """Return a variable whose values are read lazily; modified values stay in memory."""
    lazy: Any = indexing  # its annotations are inconsistent
    values = lazy.MemoryCachedArray(lazy.CopyOnWriteArray(lazy.LazilyIndexedArray(array)))
    return xarray.Variable(array.array.dims, values, dict(array.array.attributes))
