"""Writers of datasets as NetCDF and Zarr, which can be abandoned and survive a full disk; checksums of contents."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.regular_files import open_regular

if TYPE_CHECKING:
    import xarray
    from zarr.core.buffer import Buffer
    from zarr.storage import LocalStore

CHECKSUM = "content_sha256"
"""Attribute with the checksum."""
EXCLUDED_ATTRIBUTES = (CHECKSUM, "coordinates", "_FillValue")
"""Attributes that are not content, since readers remove them."""
BUFFER_BYTES = 2**20  # of each piece of an array, for its copy in a fixed byte order


def with_checksum(dataset: xarray.Dataset) -> xarray.Dataset:
    """Add the checksum of a dataset to its attributes."""
    return dataset.assign_attrs({CHECKSUM: checksum_of(dataset)})


def checksum_of(dataset: xarray.Dataset) -> str:
    """Return SHA-256 of the names, dimensions, types (integers as int64), values and attributes of a dataset."""
    digest = hashlib.sha256(_attributes(dataset.attrs))
    for name in sorted(map(str, dataset.variables)):
        variable = dataset.variables[name]
        values = np.asarray(variable.values)
        kind = {"i": "int64", "u": "int64", "b": "bool"}.get(values.dtype.kind, values.dtype.name)
        text = values.dtype.kind not in "iubf"
        head = [name, list(map(str, variable.dims)), list(values.shape), "text" if text else kind]
        digest.update(json.dumps(head).encode() + _attributes(variable.attrs))
        flat = values.reshape(-1)
        for first in range(0, flat.size, BUFFER_BYTES):
            piece = flat[first : first + BUFFER_BYTES]
            if text:
                digest.update(json.dumps(list(map(_text, piece.tolist()))).encode())
            else:
                digest.update(np.ascontiguousarray(piece, dtype=np.dtype(kind).newbyteorder("<")).tobytes())
    return digest.hexdigest()


def _attributes(attributes: Mapping[Any, Any]) -> bytes:
    content = {str(name): _to_json(value) for name, value in attributes.items() if name not in EXCLUDED_ATTRIBUTES}
    return json.dumps(content, sort_keys=True).encode()


def _to_json(value: Any) -> Any:
    """Convert an attribute to JSON; arrays of one number become scalars, since files do not distinguish them."""
    if isinstance(value, str | bytes):
        return _text(value)
    array = np.asarray(value)
    if array.dtype.kind not in "iubf":
        return list(map(_text, array.reshape(-1).tolist()))
    numbers = (array.astype(np.int64) if array.dtype.kind == "b" else array).reshape(-1).tolist()
    return numbers[0] if len(numbers) == 1 else numbers


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


PAGE_BYTES = 2**16  # unit of that cache
MAX_CACHED_BYTES = 2**20  # kept of a file that cannot be written; enough for the metadata that HDF5 reads back


class DeferredErrorFile:
    """A file object that raises the first failure of a write only in `close`."""

    # HDF5 cannot close a file after a failed write, and crashes at exit; small pieces stay in memory, to be read back.

    def __init__(self, path: Path, writing: Callable[[], AbstractContextManager[None]]) -> None:
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0), 0o666)
        self._writing, self._position, self._size = writing, 0, 0
        self._failure: BaseException | None = None
        self._pages: dict[int, bytearray] = {}

    def __enter__(self) -> DeferredErrorFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file, and raise the first failure."""
        try:
            os.close(self._descriptor)
        finally:
            if self._failure is not None:
                raise self._failure

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Set and return the position."""
        self._position = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence]
        return self._position

    def tell(self) -> int:
        """Return the position."""
        return self._position

    def write(self, piece: Any) -> int:
        """Write bytes at the current position."""
        view = memoryview(piece).cast("B")
        if not self._attempt(lambda: self._write_all(view)):
            self._cache_pages(view)
        self._position += len(view)
        self._size = max(self._size, self._position)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file."""
        length = self._position if size is None else size
        self._attempt(lambda: os.ftruncate(self._descriptor, length))
        self._size = length
        return length

    def flush(self) -> None:
        """Do nothing; writes are not buffered."""

    def readinto(self, piece: Any) -> int:
        """Fill a buffer from the position, with zeros beyond the end, and return its length."""
        view = memoryview(piece).cast("B")
        view[:] = self._read_disk(self._position, len(view))
        for number in range(self._position // PAGE_BYTES, (self._position + len(view)) // PAGE_BYTES + 1):
            if number in self._pages:
                first, last = (
                    max(self._position, number * PAGE_BYTES),
                    min(self._position + len(view), (number + 1) * PAGE_BYTES),
                )
                if first < last:
                    within = self._pages[number][first - number * PAGE_BYTES : last - number * PAGE_BYTES]
                    view[first - self._position : last - self._position] = within
        self._position += len(view)
        return len(view)

    def read(self, length: int = -1) -> bytes:
        """Read bytes from the position."""
        rest = max(0, self._size - self._position)
        piece = bytearray(rest if length < 0 else min(length, rest))
        self.readinto(piece)
        return bytes(piece)

    def _attempt(self, work: Callable[[], object]) -> bool:
        """Run a disk operation and return whether it succeeded; after a failure, none is attempted."""
        if self._failure is None:
            try:
                with self._writing():
                    work()
                return True
            except BaseException as error:
                self._failure = error
        return False

    def _write_all(self, view: memoryview) -> None:
        done = 0
        while done < len(view):
            done += os.pwrite(self._descriptor, view[done:], self._position + done)

    def _read_disk(self, position: int, length: int) -> bytes:
        content = bytearray()
        while len(content) < length:
            try:
                piece = os.pread(self._descriptor, length - len(content), position + len(content))
            except OSError as error:
                self._failure = self._failure or error
                break
            if not piece:
                break
            content += piece
        return bytes(content.ljust(length, b"\0"))

    def _cache_pages(self, view: memoryview) -> None:
        if len(view) > MAX_CACHED_BYTES:
            return
        for number in range(self._position // PAGE_BYTES, (self._position + len(view)) // PAGE_BYTES + 1):
            page = self._pages.get(number)
            if page is None:
                page = self._pages[number] = bytearray(self._read_disk(number * PAGE_BYTES, PAGE_BYTES))
            first, last = (
                max(self._position, number * PAGE_BYTES),
                min(self._position + len(view), (number + 1) * PAGE_BYTES),
            )
            if first < last:
                page[first - number * PAGE_BYTES : last - number * PAGE_BYTES] = view[
                    first - self._position : last - self._position
                ]


def write_netcdf(dataset: xarray.Dataset, path: Path, writing: Callable[[], AbstractContextManager[None]]) -> None:
    """Write a dataset to a new NetCDF 4 file; `writing` as for `DeferredErrorFile`."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    with DeferredErrorFile(path, writing) as buffer, h5netcdf.File(buffer, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file))


INDEX_FILE = ".zmetadata"
FILE_LIST = "coadjoint_files"


def write_zarr(dataset: xarray.Dataset, path: Path, writing: Callable[[], AbstractContextManager[None]]) -> None:
    """Write a dataset to a new folder as Zarr format 2, with a list of its files in its index."""
    # Format 3 has no standard encoding of text, which component names need.
    dataset.to_zarr(_store(path, writing), mode="w", zarr_format=2, consolidated=True)
    index = json.loads((path / INDEX_FILE).read_text(encoding="utf-8"))
    with writing():
        (path / INDEX_FILE).write_text(json.dumps({**index, FILE_LIST: sorted(_files(path))}), encoding="utf-8")


def foreign_file(path: Path) -> str:
    """Return the name of a file that `write_zarr` did not write (or of the missing index); empty if there is none."""
    try:
        with open_regular(path / INDEX_FILE) as index:
            listed = json.load(index)[FILE_LIST]
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
    """Return a store that writes each file synchronously; the default store of Zarr writes in threads."""
    from zarr.storage import LocalStore

    class Store(LocalStore):
        def set_sync(self, key: str, value: Buffer) -> None:
            with writing():
                path = self.root / key
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(value.to_bytes())

        async def set(self, key: str, value: Any, *args: Any, **kwargs: Any) -> None:
            self.set_sync(key, value)

        async def set_if_not_exists(self, key: str, value: Any) -> None:
            if not (self.root / key).exists():
                self.set_sync(key, value)

    return Store(path)
