"""Atomic output of files and folders; leftovers of killed runs are removed."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from types import TracebackType

from filelock import lock_descriptor

from coadjoint import interruption

SYNC_UNSUPPORTED = (errno.EINVAL, errno.EBADF, errno.ENOTSUP, errno.ENOSYS)
"""Error numbers of file systems that cannot sync folders."""
TEMPORARY_SUFFIX = ".writing"
"""Suffix of incomplete files; those of killed processes are ignored."""
SYMLINK_REASON = "a symbolic link, which an archive never contains"
IN_USE_WAITS = tuple(2.0**-k for k in range(10, 0, -1))
"""Waits (seconds) before a refused rename is tried again, a second in all: readers hold a file for less."""


def write_atomically(path: Path, content: bytes) -> None:
    """Write a temporary file, sync it to disk, and rename it to `path`, without following symbolic links."""
    temporary = path.with_name(f".{path.name}{TEMPORARY_SUFFIX}")

    def opened(name: str, flags: int) -> int:
        try:
            return os.open(name, flags, 0o666)
        except FileExistsError:
            os.unlink(name)  # from a killed process, or a link out of the folder
            return os.open(name, flags, 0o666)

    try:
        with open(temporary, "xb", opener=opened) as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        rename_when_free(lambda: os.replace(temporary, path))
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)
        raise


def rename_when_free(rename: Callable[[], None]) -> None:
    """Rename, and try again while it is refused: Windows renames nothing that another process has open."""
    for wait in IN_USE_WAITS:
        try:
            return rename()
        except PermissionError:
            time.sleep(wait)
    return rename()


def sync_to_disk(folder: Path) -> None:
    """Sync the directory entries of a folder to disk, where supported."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as reason:
        if reason.errno not in SYNC_UNSUPPORTED:
            raise
    finally:
        os.close(descriptor)


LOCK_FILE = "lock"
REPLACED_FOLDER = "replaced"


class PendingOutput:
    """A result being written in a hidden folder, until `finish` renames it; the folder is removed in any case."""

    # It is locked while its process lives, so that `remove_leftovers` recognizes the folders of killed runs.

    def __init__(self, target: Path) -> None:
        self._target, self._mutex, self._stopped = target, threading.RLock(), False
        self._lock: int | None = None

    def __enter__(self) -> PendingOutput:
        # Register the cleanup before the folder exists.
        interruption.cleanups.append(self.abandon)
        try:
            while self._lock is None:
                self._folder = self._target.parent / f"{_prefix(self._target)}{secrets.token_hex(4)}"
                self._folder.mkdir(mode=0o700)
                self._lock = open_locked(self._folder / LOCK_FILE, os.O_CREAT)
        except BaseException:
            self._cleanup()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cleanup()

    def _cleanup(self) -> None:
        self.abandon()
        interruption.cleanups.remove(self.abandon)
        self._release()

    def _release(self) -> None:
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)

    @property
    def path(self) -> Path:
        """Path to write to, in a new folder."""
        return self._folder / self._target.name

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Context for one write, which is not interrupted by `abandon`; RuntimeError after it."""
        with self._mutex:
            if self._stopped:
                raise RuntimeError("the output was abandoned")
            yield

    def finish(self) -> None:
        """Rename the result to its target."""
        if self._target.is_dir() and not self._target.is_symlink():
            # A folder cannot replace a non-empty one: move the old one into the hidden folder, to be deleted with it.
            rename_when_free(lambda: os.replace(self._target, self._folder / REPLACED_FOLDER))
        rename_when_free(lambda: os.replace(self.path, self._target))

    def abandon(self) -> None:
        """Stop writing and remove the hidden folder; a result already renamed is unaffected."""
        with self._mutex:
            self._stopped = True
        if _restore_target(self._folder, self._target):
            self._release()
            _remove_emptied(self._folder)


def remove_leftovers(target: Path) -> None:
    """Remove the hidden folders of killed runs to this target, and restore a target that was being replaced."""
    prefix = _prefix(target)
    with os.scandir(target.parent) as entries:
        leftovers = [entry for entry in entries if entry.name.startswith(prefix)]
    for entry in leftovers:
        # Of another user, or already gone: ignore.
        with suppress(OSError):
            if _is_own(entry):
                _remove_if_unlocked(Path(entry.path), target)


def _is_own(entry: os.DirEntry[str]) -> bool:
    """Whether an entry is a folder of this user and no symbolic link; only such folders are removed."""
    if not entry.is_dir(follow_symlinks=False):
        return False
    return not hasattr(os, "geteuid") or entry.stat(follow_symlinks=False).st_uid == os.geteuid()


def _remove_if_unlocked(folder: Path, target: Path) -> None:
    try:
        lock = open_locked(folder / LOCK_FILE)
    except FileNotFoundError:
        folder.rmdir()  # Its run was killed before locking it, or is about to lock it, and then makes another.
        return
    if lock is not None:
        emptied = _restore_target(folder, target)
        os.close(lock)
        if emptied:
            _remove_emptied(folder)


def _prefix(target: Path) -> str:
    # Truncated, since the name may have the maximal length; the hash keeps it unique.
    return f".{target.name[:24]}-{sha256(os.fsencode(target.name)).hexdigest()[:12]}-"


def open_locked(path: Path, create: int = 0) -> int | None:
    """Open and lock a file, not a link; return its descriptor, or None if another process has locked or removed it."""
    flags = os.O_RDWR | create | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    reject_link(path)
    try:
        descriptor = os.open(path, flags, 0o600)
    except FileNotFoundError:
        if create:
            return None
        raise
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "the lock is no regular file")
    try:
        # A lock of the operating system, which it releases when the process ends, however that happens.
        locked = lock_descriptor(descriptor, blocking=False)
    except OSError:
        locked = bool(create)  # a file system without locks: no process will treat this folder as a leftover
    if locked and os.fstat(descriptor).st_nlink > 0:
        return descriptor
    os.close(descriptor)
    return None


def reject_link(path: Path) -> None:
    """Raise OSError if the path is a symbolic link, or a junction of Windows."""
    try:
        status = os.stat(path, follow_symlinks=False)
    except OSError:
        return
    junction = getattr(status, "st_reparse_tag", 0) == getattr(stat, "IO_REPARSE_TAG_MOUNT_POINT", None)
    if stat.S_ISLNK(status.st_mode) or junction:
        raise OSError(errno.ELOOP, SYMLINK_REASON) from None


def _restore_target(folder: Path, target: Path) -> bool:
    """Restore a replaced folder if the result is not complete; return whether the lock alone is left."""
    with suppress(OSError):
        if (folder / REPLACED_FOLDER).is_dir() and not os.path.lexists(target):
            os.replace(folder / REPLACED_FOLDER, target)
        return _remove_content(folder)
    return False


def _remove_content(folder: Path) -> bool:
    """Remove the content of a hidden folder but its lock, so that a partial removal remains recognizable."""
    for entry in folder.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
            if entry.exists():
                return False
        elif entry.name != LOCK_FILE:
            entry.unlink()
    return True


def _remove_emptied(folder: Path) -> None:
    """Remove a hidden folder with its lock, which is no longer held: Windows removes no open file."""
    with suppress(OSError):  # another process may be removing it as well
        (folder / LOCK_FILE).unlink(missing_ok=True)
        folder.rmdir()
