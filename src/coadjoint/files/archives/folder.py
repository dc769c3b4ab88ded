"""File access within the folder of an archive, by plain names and never through symbolic links.

Folders elsewhere, in a file system of fsspec, can only be read. A failure to read is one of three answers: a file does
not exist (`FileNotFoundError`), is damaged (`ArchiveError`), or cannot be read now (`ArchiveUnreadable`).
"""

from __future__ import annotations

import errno
import os
import re
import stat
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from coadjoint.errors import OneLineError, in_one_line
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
from coadjoint.validation import read_number

USE_DIR_FD = os.open in os.supports_dir_fd and hasattr(os, "O_NOFOLLOW")
"""Whether files are opened relative to a descriptor of their folder. Windows has none, and locks folders in use."""
NOT_REGULAR_REASON = "no regular file"
UNWRITTEN_KINDS = (errno.ELOOP, errno.EINVAL, errno.EISDIR, errno.ENOTDIR)
"""Errors of entries that are no files of an archive: links, folders, pipes."""
READ_MEMORY_FACTOR = 2
"""Memory needed to read a file, per byte."""
MAX_NAME_LENGTH = 255  # bytes, of file systems
TIMEOUT_VARIABLE, DEFAULT_TIMEOUT = "COADJOINT_TIMEOUT", 60.0
"""Environment variable with the time (s) that a server or a worker may take to answer, and its default."""
ABSENT = (404, 410)  # HTTP: not found, gone
FAILURES = (OSError, MemoryError, RecursionError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError)
"""Errors while an archive is read."""
URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+(?:::[A-Za-z0-9+.-]+)*://")
"""The beginning of a URL, also of a chained one of fsspec; a single letter is a drive of Windows."""


Result = TypeVar("Result")


class ArchiveError(OneLineError):
    """An archive is missing, damaged, in use, or cannot be created; raised before anything runs."""


class ArchiveUnreadable(ArchiveError):
    """An archive or a file of it cannot be read now, which says nothing about its content; try again."""


@contextmanager
def reading(path: Any, what: str) -> Iterator[None]:
    """Convert failures to `ArchiveUnreadable`, or to `ArchiveError` for damage; a missing file remains one."""
    try:
        yield
    except (OneLineError, FileNotFoundError):
        raise
    except FAILURES as reason:
        problem = getattr(reason, "strerror", None) or in_one_line(str(reason), 300) or type(reason).__name__
        failed = isinstance(reason, OSError) and reason.errno not in UNWRITTEN_KINDS
        if failed or isinstance(reason, MemoryError | RecursionError):
            raise ArchiveUnreadable(f"{path}: {what} cannot be read now ({problem})") from reason
        raise ArchiveError(f"{path}: {what} is damaged ({problem})") from reason


def timeout() -> float:
    """Return the time (s) that a server or a worker may take to answer."""
    text = os.environ.get(TIMEOUT_VARIABLE)
    try:
        seconds = read_number(DEFAULT_TIMEOUT if text is None else float(text), TIMEOUT_VARIABLE)
    except ValueError:
        seconds = 0.0
    if seconds <= 0.0:
        raise ValueError(f"the environment variable {TIMEOUT_VARIABLE} is {short(text)}; it must be a positive number")
    return seconds


class ArchiveFolder:
    """The open folder of an archive, also if its path is renamed; only `path`, from the user, may contain links."""

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()
        self._descriptor: int | None = None
        try:
            if USE_DIR_FD:
                self._descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
            elif not path.is_dir():
                os.scandir(path).close()  # raises the specific OSError
        except NotADirectoryError:
            raise ArchiveError(f"{path}: is a file; an archive is a folder, which a run with archive= writes") from None

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

        def status_and_link() -> tuple[Any, Any]:
            status = self.filesystem.info(path)
            linked = status.get("islink")
            if folder and linked is False:  # a folder of this machine, within another file system
                linked = self.filesystem.info(f"{self.root}/{folder}").get("islink")
            return status, linked

        status, linked = request(status_and_link)
        size = status.get("size")
        if status.get("type") != "file" or linked:
            raise OSError(errno.EINVAL, NOT_REGULAR_REASON)
        if size is None or size < 0:
            raise OSError(errno.EIO, "its length is unknown")
        length = _length_to_read(size, max_bytes, head)

        def content() -> bytes:
            with self.filesystem.open(path, "rb") as opened:
                return bytes(opened.read(length))

        return request(content)

    def names(self, folder: str) -> set[str]:
        """Return the names in a subfolder."""
        path = "/".join(filter(None, (self.root, folder)))
        paths = request(lambda: self.filesystem.ls(path, detail=False))
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

        before, chained, last = value.rpartition("::")
        url = f"{before}::{Path(last).absolute()}" if chained and not is_url(last) else value
        try:
            filesystem, root = request(lambda: url_to_fs(url))
        except ImportError as reason:
            problem = in_one_line(str(reason), 200)
            raise MissingPackageError(f"{short(value)} needs a package that is not installed ({problem})") from None
        except Exception as reason:  # file systems raise errors of any type
            raise ValueError(f"{short(value)} is no URL that fsspec opens ({in_one_line(str(reason), 200)})") from None
    else:
        return None
    from fsspec.implementations.local import LocalFileSystem

    return Path(root) if isinstance(filesystem, LocalFileSystem) else RemoteFolder(filesystem, root, url)


def within_limit(work: Callable[[], Result]) -> Result:
    """Return the result of a call, or raise what it raises; TimeoutError after the time limit."""
    # In a thread: file systems and clusters have limits of their own, or none.
    results, errors, limit = list[Result](), list[BaseException](), timeout()

    def run() -> None:
        try:
            results.append(work())
        except BaseException as reason:
            errors.append(reason)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(limit)
    for reason in errors:
        raise reason
    if not results:
        raise TimeoutError(f"no answer within {limit:g} s, a limit that {TIMEOUT_VARIABLE} sets")
    return results[0]


def request(work: Callable[[], Result]) -> Result:
    """Return the result of a request to a file system of fsspec; OSError with `strerror` for whatever it raises."""
    try:
        return within_limit(work)
    except (ImportError, MemoryError, KeyboardInterrupt):
        raise
    except BaseException as error:
        reason: BaseException = error
    if _is_absent(reason):
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
    while isinstance(reason, FileNotFoundError) and reason.__cause__ is not None:
        reason = reason.__cause__
    problem = getattr(reason, "strerror", None) or in_one_line(str(reason), 200) or type(reason).__name__
    number = getattr(reason, "errno", None)
    raise OSError(number if isinstance(number, int) else errno.EIO, problem) from reason


def _is_absent(reason: BaseException) -> bool:
    """Whether a file does not exist; file systems raise FileNotFoundError also where a server fails."""
    first = reason
    while first.__cause__ is not None:
        first = first.__cause__
    response = getattr(first, "response", None)  # of botocore
    answer = response.get("ResponseMetadata", {}).get("HTTPStatusCode") if isinstance(response, dict) else None
    status = next((n for n in (answer, *(getattr(first, k, None) for k in ("status", "status_code", "code"))) if n), 0)
    if isinstance(status, int) and status:
        return status in ABSENT
    return isinstance(reason, FileNotFoundError) and isinstance(first, FileNotFoundError | LookupError)


def _length_to_read(size: int, max_bytes: int | None, head: int | None) -> int:
    """Return how much of a file to read; ValueError: too long, or too little memory."""
    if max_bytes is not None and size > max_bytes:
        raise ValueError(f"it has {size} bytes; the limit is {max_bytes}")
    length = size if head is None else min(head, size)
    check_available_memory(READ_MEMORY_FACTOR * length, "it")
    return length


Folder = ArchiveFolder | RemoteFolder
Location = Path | RemoteFolder


def read_location(value: Any) -> Location:
    """Validate the place from which an archive is read: a path, which becomes absolute, a URL, or an fsspec mapping."""
    return remote_folder(value) or read_archive_path(value, "a path, such as 'run.zarr', a URL, or a mapping of fsspec")


def read_archive_path(value: Any, wanted: str = "the path of a folder, such as 'run.zarr'") -> Path:
    """Validate the path of an archive, and make it absolute: the working directory may change."""
    hint = f"archive is {short(value)}; it must be {wanted}"
    if not isinstance(value, str | os.PathLike):
        raise TypeError(hint)
    if is_url(value):
        raise ValueError(
            f"archive is {short(value)}; runs are written and resumed in folders of this machine, since a URL has no "
            "locks: give a path and copy the folder, and open_archive reads it from the URL"
        )
    path = os.fspath(value)
    if not isinstance(path, str) or not path or "\0" in path:
        raise ValueError(hint)
    if max(map(len, Path(path).parts), default=0) > MAX_NAME_LENGTH:
        raise ValueError(f"archive is {short(value)}; its name is too long")
    return Path(path).absolute()


def no_archive(path: Location) -> ArchiveError:
    """Return the error for a place without an archive."""
    return ArchiveError(f"{path}: there is no archive of a run; give the folder that archive= named")


def open_location(location: Location) -> Folder:
    """Open the folder of an archive to read it; ArchiveError if there is none."""
    return open_folder(location) if isinstance(location, Path) else location


def open_folder(path: Path) -> ArchiveFolder:
    """Open the folder of an archive on this machine; ArchiveError if there is none."""
    try:
        with reading(path, "the folder"):
            return ArchiveFolder(path)
    except FileNotFoundError:
        raise no_archive(path) from None
