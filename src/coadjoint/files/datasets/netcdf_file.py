"""NetCDF output that survives a full disk: HDF5 would crash the interpreter."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import xarray

PAGE_BYTES = 2**16
MAX_CACHED_BYTES = 2**20


class DeferredErrorFile:
    """A file object whose writes never fail: the first failure is stored, and raised by `close`.

    HDF5 cannot close a file after a failed write, and crashes when the interpreter exits. Data written after a failure
    are kept in memory, since HDF5 may read them back; pieces above 2^20 bytes are dropped, since they are array data,
    which it does not read. `writing` returns a context for each write, as `Unfinished.writing`; its exceptions count as
    failures.

    Examples
    --------
    >>> import tempfile
    >>> from contextlib import nullcontext
    >>> with tempfile.TemporaryDirectory() as folder, DeferredErrorFile(Path(folder, "a"), nullcontext) as file:
    ...     _ = file.write(b"momentum"), file.seek(0)
    ...     file.read(3)
    b'mom'
    """

    def __init__(self, path: Path, writing: Callable[[], AbstractContextManager[None]]) -> None:
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0), 0o666)
        self._writing, self._at, self._size = writing, 0, 0
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
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        """Return the position."""
        return self._at

    def write(self, piece: Any) -> int:
        """Write bytes at the position, and advance it."""
        view = memoryview(piece).cast("B")
        if not self._attempt(lambda: self._write_all(view)):
            self._cache_pages(view)
        self._at += len(view)
        self._size = max(self._size, self._at)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file."""
        length = self._at if size is None else size
        self._attempt(lambda: os.ftruncate(self._descriptor, length))
        self._size = length
        return length

    def flush(self) -> None:
        """Do nothing; writes are not buffered."""

    def readinto(self, piece: Any) -> int:
        """Fill a buffer from the position, with zeros beyond the end, and return its length."""
        view = memoryview(piece).cast("B")
        view[:] = self._read_disk(self._at, len(view))
        for number in range(self._at // PAGE_BYTES, (self._at + len(view)) // PAGE_BYTES + 1):
            if number in self._pages:
                first, last = max(self._at, number * PAGE_BYTES), min(self._at + len(view), (number + 1) * PAGE_BYTES)
                if first < last:
                    within = self._pages[number][first - number * PAGE_BYTES : last - number * PAGE_BYTES]
                    view[first - self._at : last - self._at] = within
        self._at += len(view)
        return len(view)

    def read(self, length: int = -1) -> bytes:
        """Read bytes from the position."""
        rest = max(0, self._size - self._at)
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
            done += os.pwrite(self._descriptor, view[done:], self._at + done)

    def _read_disk(self, at: int, length: int) -> bytes:
        found = bytearray()
        while len(found) < length:
            try:
                piece = os.pread(self._descriptor, length - len(found), at + len(found))
            except OSError as error:
                self._failure = self._failure or error
                break
            if not piece:
                break
            found += piece
        return bytes(found.ljust(length, b"\0"))

    def _cache_pages(self, view: memoryview) -> None:
        if len(view) > MAX_CACHED_BYTES:
            return
        for number in range(self._at // PAGE_BYTES, (self._at + len(view)) // PAGE_BYTES + 1):
            page = self._pages.get(number)
            if page is None:
                page = self._pages[number] = bytearray(self._read_disk(number * PAGE_BYTES, PAGE_BYTES))
            first, last = max(self._at, number * PAGE_BYTES), min(self._at + len(view), (number + 1) * PAGE_BYTES)
            if first < last:
                page[first - number * PAGE_BYTES : last - number * PAGE_BYTES] = view[
                    first - self._at : last - self._at
                ]


def write_netcdf(dataset: xarray.Dataset, path: Path, writing: Callable[[], AbstractContextManager[None]]) -> None:
    """Write a dataset to a new NetCDF 4 file; `writing` as for `DeferredErrorFile`."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    with DeferredErrorFile(path, writing) as image, h5netcdf.File(image, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file))
