"""Zarr output that can be abandoned at any time, with an index by which foreign folders are recognized."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import xarray
    from zarr.core.buffer import Buffer
    from zarr.storage import LocalStore

INDEX_FILE = ".zmetadata"
FILE_LIST = "coadjoint_files"


def write_zarr(dataset: xarray.Dataset, path: Path, writing: Callable[[], AbstractContextManager[None]]) -> None:
    """Write a dataset to a new folder as Zarr format 2, with a list of its files in its index.

    `writing` is the context of each write, `Unfinished.writing`. OSError, for instance for a full disk.
    """
    # Format 3 has no standard encoding of text, which component names need.
    dataset.to_zarr(_store(path, writing), mode="w", zarr_format=2, consolidated=True)
    index = json.loads((path / INDEX_FILE).read_text(encoding="utf-8"))
    with writing():
        (path / INDEX_FILE).write_text(json.dumps({**index, FILE_LIST: sorted(_files(path))}), encoding="utf-8")


def foreign_file(path: Path) -> str:
    """Return the name of a file that `write_zarr` did not write (or of the missing index); empty if there is none.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "zarr.json").write_text("{}")
    ...     foreign_file(Path(folder))
    'zarr.json'
    """
    try:
        listed = json.loads((path / INDEX_FILE).read_text(encoding="utf-8"))[FILE_LIST]
        known = set(listed) if isinstance(listed, list) else set()
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        known = set()
    return min((name for name in _files(path) if name not in known), default="" if known else INDEX_FILE)


def _files(path: Path) -> Iterator[str]:
    """Yield the paths of all files and special entries relative to the folder, with slashes."""
    for entry in os.scandir(path):
        if entry.is_dir(follow_symlinks=False):
            inside = [f"{entry.name}/{name}" for name in _files(Path(entry.path))]
            yield from inside or [f"{entry.name}/"]
        else:
            yield entry.name


def _store(path: Path, writing: Callable[[], AbstractContextManager[None]]) -> LocalStore:
    """Return a store that writes each file synchronously; Zarr's own would write in threads."""
    from zarr.storage import LocalStore

    class Store(LocalStore):
        def set_sync(self, key: str, value: Buffer) -> None:
            with writing():
                place = self.root / key
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(value.to_bytes())

        async def set(self, key: str, value: Any, *given: Any, **more: Any) -> None:
            self.set_sync(key, value)

        async def set_if_not_exists(self, key: str, value: Any) -> None:
            if not (self.root / key).exists():
                self.set_sync(key, value)

    return Store(path)
