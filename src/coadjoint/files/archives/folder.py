"""File access within the folder of an archive, by plain names and never through symbolic links.

Folders elsewhere, in a file system of fsspec, can only be read. A failure to read is one of three answers: a file does
not exist (`FileNotFoundError`), is damaged (`ArchiveError`), or cannot be read now (`ArchiveUnreadable`).
"""

from __future__ import annotations

import errno
import os
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from coadjoint.errors import OneLineError, in_one_line
from coadjoint.files.output.atomic_output import (
    TEMPORARY_SUFFIX,
    open_locked,
    reject_link,
    write_atomically,
)
from coadjoint.memory import check_available_memory
from coadjoint.optional_packages import MissingPackageError, require_packages
from coadjoint.regular_files import open_regular
from coadjoint.short_repr import short
from coadjoint.validation import read_number

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
    """The folder of an archive on this machine; only its own path, from the user, may contain links."""

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()

    def __str__(self) -> str:
        return str(self.path)

    def file(self, folder: str, file: str = "") -> Path:
        """Return the path of a file in a subfolder ('': this one); OSError if the subfolder is a link."""
        if folder:
            reject_link(self.path / folder)
        return self.path / folder / file

    def read(self, folder: str, file: str, max_bytes: int | None = None, head: int | None = None) -> bytes:
        """Return a file of at most `max_bytes` bytes, or its first `head` bytes; ValueError if it is longer."""
        path = self.file(folder, file)
        reject_link(path)
        with open_regular(path) as content:
            return content.read(_length_to_read(os.fstat(content.fileno()).st_size, max_bytes, head))

    def write(self, folder: str, file: str, content: bytes) -> None:
        """Replace a file atomically."""
        write_atomically(self.file(folder, file), content)

    def names(self, folder: str) -> set[str]:
        """Return the names in a subfolder."""
        return set(os.listdir(self.file(folder)))

    def remove(self, folder: str, file: str) -> None:
        """Remove a file, if present; links are not followed."""
        with suppress(FileNotFoundError):
            os.unlink(self.file(folder, file))

    def remove_unfinished(self, folder: str) -> None:
        """Remove temporary files left by killed processes."""
        for name in self.names(folder):
            if name.startswith(".") and name.endswith(TEMPORARY_SUFFIX):
                self.remove(folder, name)

    def lock(self, folder: str, file: str) -> int | None:
        """Lock a file, created if missing; return its descriptor, or None if another process holds the lock."""
        return open_locked(self.file(folder, file), os.O_CREAT)


class RemoteFolder:
    """The folder of an archive in a file system of fsspec, such as a bucket; its text is its URL."""

    def __init__(self, filesystem: Any, root: str, url: str) -> None:
        self.filesystem, self.root, self.url = filesystem, root.rstrip("/"), url

    def __str__(self) -> str:
        return in_one_line(self.url, 200)

    @property
    def path(self) -> str:
        """The URL."""
        return self.url

    def read(self, folder: str, file: str, max_bytes: int | None = None, head: int | None = None) -> bytes:
        """Return a file, as `ArchiveFolder.read`."""
        path = "/".join(filter(None, (self.root, folder, file)))

        def status_and_link() -> tuple[Any, Any]:
            self.filesystem.invalidate_cache()  # another process may have committed
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


def remote_folder(value: Any) -> Folder | None:
    """Return the folder at a URL or of a mapping of fsspec; None for other values."""
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

    is_local = isinstance(filesystem, LocalFileSystem)
    return ArchiveFolder(Path(root)) if is_local else RemoteFolder(filesystem, root, url)


def request(work: Callable[[], Result]) -> Result:
    """Return the result of a request to a file system of fsspec; OSError with `strerror` for whatever it raises."""
    # In a thread: some file systems have longer limits of time, or none.
    results, errors, limit = list[Result](), list[BaseException](), timeout()

    def run() -> None:
        try:
            results.append(work())
        except BaseException as reason:
            errors.append(reason)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(limit)
    if results:
        return results[0]
    reason = (
        errors[0] if errors else TimeoutError(f"no answer within {limit:g} s, a limit that {TIMEOUT_VARIABLE} sets")
    )
    if isinstance(reason, ImportError | MemoryError | KeyboardInterrupt):
        raise reason
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


def read_location(value: Any) -> Folder:
    """Validate the place from which an archive is read: a path, which becomes absolute, a URL, or an fsspec mapping."""
    wanted = "a path, such as 'run.zarr', a URL, or a mapping of fsspec"
    return remote_folder(value) or ArchiveFolder(read_archive_path(value, wanted))


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
