"""File access within the folder of an archive, by plain names and never through symbolic links."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from coadjoint.files.output.atomic_output import (
    TEMPORARY_SUFFIX,
    open_locked,
    reject_link,
    sync_to_disk,
    write_atomically,
)
from coadjoint.memory import check_available_memory

USE_DIR_FD = os.open in os.supports_dir_fd and hasattr(os, "O_NOFOLLOW")
"""Whether files are opened relative to a descriptor of their folder. Windows has none, and locks folders in use."""
NOT_REGULAR_REASON = "no regular file"
READ_MEMORY_FACTOR = 2
"""Memory needed to read a file, per byte."""


class ArchiveFolder:
    """The open folder of an archive; it stays the same folder if its path is renamed.

    Only `path` itself, from the user, may contain links.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()
        self._descriptor: int | None = None
        if USE_DIR_FD:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        elif not path.is_dir():
            os.scandir(path).close()  # raises the specific OSError

    def __enter__(self) -> ArchiveFolder:
        return self

    def __exit__(self, *ended: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the folder."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    @contextmanager
    def _at(self, folder: str, file: str = "") -> Iterator[tuple[Path, int | None]]:
        """Yield the path of a file in a subfolder, or in this folder for '', and the descriptor it is relative to.

        On platforms without descriptors of folders this is None.
        """
        if not USE_DIR_FD:
            reject_link(self.path / folder, None)
            yield self.path / folder / file, None
            return
        assert self._descriptor is not None
        if not folder:
            yield Path(file), self._descriptor
            return
        try:
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=self._descriptor)
        except OSError:
            reject_link(Path(folder), self._descriptor)
            raise
        try:
            yield Path(file), descriptor
        finally:
            os.close(descriptor)

    def read(self, folder: str, file: str, max_bytes: int | None = None, head: int | None = None) -> bytes:
        """Return a file of at most `max_bytes` bytes, or its first `head` bytes.

        OSError: missing, unreadable or no regular file; ValueError: too long, or too little memory.
        """
        with self._at(folder, file) as (path, inside):

            def opened(name: str, flags: int) -> int:
                if not USE_DIR_FD:
                    reject_link(path, None)
                flags |= getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
                try:
                    return os.open(name, flags, dir_fd=inside)
                except OSError:
                    reject_link(path, inside)
                    raise

            with open(path, "rb", opener=opened) as content:
                status = os.fstat(content.fileno())
                if not stat.S_ISREG(status.st_mode):
                    raise OSError(errno.EINVAL, NOT_REGULAR_REASON)
                if max_bytes is not None and status.st_size > max_bytes:
                    raise ValueError(f"it has {status.st_size} bytes; the limit is {max_bytes}")
                length = status.st_size if head is None else min(head, status.st_size)
                check_available_memory(READ_MEMORY_FACTOR * length, "it")
                return content.read(length)

    def write(self, folder: str, file: str, content: bytes) -> None:
        """Replace a file atomically."""
        with self._at(folder, file) as (path, inside):
            write_atomically(path, content, inside)

    def make(self, folder: str) -> None:
        """Create a subfolder."""
        with self._at("", folder) as (path, inside):
            os.mkdir(path, dir_fd=inside)

    def names(self, folder: str) -> set[str]:
        """Return the names in a subfolder."""
        with self._at(folder) as (path, inside):
            return set(os.listdir(path if inside is None else inside))

    def status(self, folder: str, file: str) -> os.stat_result:
        """Return the status of a file; links are not followed."""
        with self._at(folder, file) as (path, inside):
            return os.stat(path, dir_fd=inside, follow_symlinks=False)

    def remove(self, folder: str, file: str) -> None:
        """Remove a file, if present; links are not followed."""
        with self._at(folder, file) as (path, inside), suppress(FileNotFoundError):
            os.unlink(path, dir_fd=inside)

    def remove_unfinished(self, folder: str) -> None:
        """Remove temporary files left by killed processes."""
        for name in self.names(folder):
            if name.startswith(".") and name.endswith(TEMPORARY_SUFFIX):
                self.remove(folder, name)

    def sync_to_disk(self, folders: Iterable[str]) -> None:
        """Sync the directory entries of some subfolders to disk."""
        for folder in folders:
            with self._at(folder) as (_, inside):
                if inside is not None:
                    sync_to_disk(inside)

    def lock(self, folder: str, file: str) -> int | None:
        """Lock a file, created if missing; return its descriptor, or None if another process holds the lock."""
        with self._at(folder, file) as (path, inside):
            try:
                return open_locked(path, os.O_CREAT, inside)
            except OSError:
                reject_link(path, inside)
                raise
