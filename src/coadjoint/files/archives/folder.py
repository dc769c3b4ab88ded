"""File access within the folder of an archive, by plain names and never through symbolic links.

Folders elsewhere, in a file system of fsspec, can only be read.
"""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from coadjoint.errors import in_one_line
from coadjoint.files.output.atomic_output import (
    TEMPORARY_SUFFIX,
    open_locked,
    reject_link,
    sync_to_disk,
    write_atomically,
)
from coadjoint.memory import check_available_memory
from coadjoint.optional_packages import MissingPackageError, require_packages
from coadjoint.short_repr import short

USE_DIR_FD = os.open in os.supports_dir_fd and hasattr(os, "O_NOFOLLOW")
"""Whether files are opened relative to a descriptor of their folder. Windows has none, and locks folders in use."""
NOT_REGULAR_REASON = "no regular file"
READ_MEMORY_FACTOR = 2
"""Memory needed to read a file, per byte."""
URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+(?:::[A-Za-z0-9+.-]+)*://")
"""The beginning of a URL, also of a chained one of fsspec; a single letter is a drive of Windows."""


class ArchiveFolder:
    """The open folder of an archive, also if its path is renamed; only `path`, from the user, may contain links."""

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
        """Yield the path of a file in a subfolder ('': this one) and the descriptor it is relative to, if any."""
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
        """Return a file of at most `max_bytes` bytes, or its first `head` bytes; ValueError if it is longer."""
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
                return content.read(_length_to_read(status.st_size, max_bytes, head))

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


class RemoteFolder:
    """The folder of an archive in a file system of fsspec, such as a bucket; its text is its URL."""

    def __init__(self, filesystem: Any, root: str, url: str) -> None:
        self.filesystem, self.root, self.url = filesystem, root.rstrip("/"), url

    def __str__(self) -> str:
        return in_one_line(self.url, 200)

    def __enter__(self) -> RemoteFolder:
        # Listings are cached by some file systems, also while another process commits.
        self.filesystem.invalidate_cache()
        return self

    def __exit__(self, *ended: object) -> None:
        pass

    def read(self, folder: str, file: str, max_bytes: int | None = None, head: int | None = None) -> bytes:
        """Return a file, as `ArchiveFolder.read`."""
        path = "/".join(filter(None, (self.root, folder, file)))
        with _as_os_errors():
            status = self.filesystem.info(path)
            linked = status.get("islink")
            if folder and linked is False:  # a folder of this machine, within another file system
                linked = self.filesystem.info(f"{self.root}/{folder}").get("islink")
        size = status.get("size")
        if status.get("type") != "file" or linked:
            raise OSError(errno.EINVAL, NOT_REGULAR_REASON)
        if size is None or size < 0:
            raise OSError(errno.EINVAL, "its length is unknown")
        length = _length_to_read(size, max_bytes, head)
        with _as_os_errors(), self.filesystem.open(path, "rb") as content:
            return bytes(content.read(length))

    def names(self, folder: str) -> set[str]:
        """Return the names in a subfolder."""
        with _as_os_errors():
            paths = self.filesystem.ls("/".join(filter(None, (self.root, folder))), detail=False)
            return {path.rstrip("/").rpartition("/")[2] for path in paths}


def is_url(value: Any) -> bool:
    """Whether a value is the text of a URL."""
    return isinstance(value, str) and URL.match(value) is not None


def remote_folder(value: Any) -> RemoteFolder | Path | None:
    """Return the folder at a URL or of a mapping of fsspec, a path if it is on this machine; None for other values."""
    if hasattr(value, "fs") and hasattr(value, "root"):
        filesystem, root, url = value.fs, value.root, value.fs.unstrip_protocol(value.root)
    elif is_url(value):
        require_packages(f"reading {short(value)}", "fsspec")
        from fsspec.core import url_to_fs

        try:
            (filesystem, root), url = url_to_fs(value), value
        except ImportError as reason:
            problem = in_one_line(str(reason), 200)
            raise MissingPackageError(f"{short(value)} needs a package that is not installed ({problem})") from None
        except Exception as reason:  # file systems raise errors of any type
            raise ValueError(f"{short(value)} is no URL that fsspec opens ({in_one_line(str(reason), 200)})") from None
    else:
        return None
    from fsspec.implementations.local import LocalFileSystem

    return Path(root) if isinstance(filesystem, LocalFileSystem) else RemoteFolder(filesystem, root, url)


@contextmanager
def _as_os_errors() -> Iterator[None]:
    """Convert the errors of a file system of fsspec, which may be of any type, to OSError with `strerror`."""
    try:
        yield
    except FileNotFoundError:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT)) from None
    except MemoryError:
        raise
    except Exception as reason:
        problem = getattr(reason, "strerror", None) or in_one_line(str(reason), 200) or type(reason).__name__
        raise OSError(getattr(reason, "errno", None) or errno.EIO, problem) from reason


def _length_to_read(size: int, max_bytes: int | None, head: int | None) -> int:
    """Return how much of a file to read; ValueError: too long, or too little memory."""
    if max_bytes is not None and size > max_bytes:
        raise ValueError(f"it has {size} bytes; the limit is {max_bytes}")
    length = size if head is None else min(head, size)
    check_available_memory(READ_MEMORY_FACTOR * length, "it")
    return length
