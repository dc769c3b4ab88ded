"""How is a Zarr store written so that it can be given up at any time, and told later from a folder of somebody else?"""

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

INDEX = ".zmetadata"
LISTED = "coadjoint_files"


def write_zarr(dataset: xarray.Dataset, path: Path, writing: Callable[[], AbstractContextManager[None]]) -> None:
    """Write a dataset as a Zarr store of format 2, with a list of its files in its index.

    Parameters
    ----------
    dataset : xarray.Dataset
        What is written.
    path : Path
        A new folder.
    writing : callable
        A context in which each file is written, `Unfinished.writing`.

    Raises
    ------
    OSError
        The disk is full, for instance.
    """
    # Format 2: format 3 has no agreed encoding of text, which the names of components are.
    dataset.to_zarr(_store(path, writing), mode="w", zarr_format=2, consolidated=True)
    index = json.loads((path / INDEX).read_text(encoding="utf-8"))
    with writing():
        (path / INDEX).write_text(json.dumps({**index, LISTED: sorted(_files(path))}), encoding="utf-8")


def written_by_coadjoint(path: Path) -> str:
    """Return what is in a folder that `write_zarr` did not write; empty where all of it is known.

    Parameters
    ----------
    path : Path
        A folder.

    Returns
    -------
    str
        The name of a file, or of the index that is missing.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "zarr.json").write_text("{}")
    ...     written_by_coadjoint(Path(folder))
    'zarr.json'
    """
    try:
        listed = json.loads((path / INDEX).read_text(encoding="utf-8"))[LISTED]
        known = set(listed) if isinstance(listed, list) else set()
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        known = set()
    return min((name for name in _files(path) if name not in known), default="" if known else INDEX)


def _files(path: Path) -> Iterator[str]:
    """Yield all files, and what is neither file nor folder, as paths from the folder on with slashes."""
    for entry in os.scandir(path):
        if entry.is_dir(follow_symlinks=False):
            inside = [f"{entry.name}/{name}" for name in _files(Path(entry.path))]
            yield from inside or [f"{entry.name}/"]
        else:
            yield entry.name


def _store(path: Path, writing: Callable[[], AbstractContextManager[None]]) -> LocalStore:
    """Return a store each of whose files is written at once: a store of Zarr goes on in threads of its own."""
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
