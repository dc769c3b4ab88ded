"""Where is a result while it is written? In a hidden folder beside its target, which a killed run may leave behind."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from types import TracebackType

from coadjoint import interruption

try:
    import fcntl
except ImportError:  # Windows: leftovers stay, since nothing tells whether their writer lives
    fcntl = None  # type: ignore[assignment]

LOCK = "lock"
REPLACED = "replaced"


class Stopped(Exception):
    """A write came after the whole was given up."""


class Unfinished:
    """A result that is being written: `place` inside of a hidden folder, until `finish` renames it to its target.

    The folder is gone after the ``with`` block, whatever happens in it. It holds a lock as long as its process lives,
    so that `remove_leftovers` knows which folders are those of killed runs.

    Parameters
    ----------
    target : Path
        Where the result goes.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Unfinished(Path(folder, "answer.txt")) as unfinished:
    ...         _ = unfinished.place.write_text("42")
    ...         unfinished.finish()
    ...     os.listdir(folder)
    ['answer.txt']
    """

    def __init__(self, target: Path) -> None:
        self._target, self._gate, self._stopped = target, threading.RLock(), False
        self._lock: int | None = None

    def __enter__(self) -> Unfinished:
        # The folder is known to what ends the process before it exists.
        interruption.begin(self.give_up)
        try:
            while self._lock is None:
                self._folder = self._target.parent / f"{_prefix(self._target)}{secrets.token_hex(4)}"
                self._folder.mkdir(mode=0o700)
                self._lock = locked(self._folder / LOCK, os.O_CREAT)
        except BaseException:
            self._leave()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leave()

    def _leave(self) -> None:
        self.give_up()
        interruption.end(self.give_up)
        if self._lock is not None:
            os.close(self._lock)

    @property
    def place(self) -> Path:
        """Where the result is written, a name in a new folder."""
        return self._folder / self._target.name

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Let nothing be given up while one piece is written; afterwards refuse by `Stopped` to write another."""
        with self._gate:
            if self._stopped:
                raise Stopped
            yield

    def finish(self) -> None:
        """Rename the result to its target."""
        if self._target.is_dir() and not self._target.is_symlink():
            # A folder cannot be renamed over one that is not empty: the old one steps aside, and is deleted with ours.
            os.replace(self._target, self._folder / REPLACED)
        os.replace(self.place, self._target)

    def give_up(self) -> None:
        """Write nothing more, and remove the hidden folder; once it is renamed, the result stays."""
        with self._gate:
            self._stopped = True
        _settle(self._folder, self._target)


def remove_leftovers(target: Path) -> None:
    """Remove the hidden folders that killed runs to this target have left; those of runs that live stay.

    Parameters
    ----------
    target : Path
        Where those runs wanted to write. It is put back where a run was killed while it replaced a folder.
    """
    prefix = _prefix(target)
    with os.scandir(target.parent) as entries:
        found = [entry for entry in entries if entry.name.startswith(prefix)]
    for entry in found:
        # Somebody else's, or gone meanwhile: no reason to refuse a run.
        with suppress(OSError):
            if _is_own(entry):
                _remove_if_left(Path(entry.path), target)


def _is_own(entry: os.DirEntry[str]) -> bool:
    """Return whether an entry is a folder of this user, and no symbolic link: only such folders are removed."""
    if not entry.is_dir(follow_symlinks=False):
        return False
    return not hasattr(os, "geteuid") or entry.stat(follow_symlinks=False).st_uid == os.geteuid()


def _remove_if_left(folder: Path, target: Path) -> None:
    try:
        lock = locked(folder / LOCK)
    except FileNotFoundError:
        folder.rmdir()  # Its run was killed before it locked it, or is about to: then it makes another.
        return
    if lock is not None:
        _settle(folder, target)
        os.close(lock)


def _prefix(target: Path) -> str:
    # A name may be as long as a file system allows, so that it is cut; its hash tells it from others.
    return f".{target.name[:24]}-{sha256(os.fsencode(target.name)).hexdigest()[:12]}-"


def locked(path: Path, create: int = 0, folder: int | None = None) -> int | None:
    """Return the descriptor of a locked file, or None where another process has locked or removed it.

    No symbolic link is followed to the file. `folder` is the descriptor of the folder from which `path` is reached.
    """
    if fcntl is None and not create:
        return None
    flags = os.O_RDWR | create | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        descriptor = os.open(path, flags, 0o600, dir_fd=folder)
    except FileNotFoundError:
        if create:
            return None
        raise
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "the lock is no regular file")
    if fcntl is None:
        return descriptor
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return None
    except OSError:
        if create:
            return descriptor  # a file system without locks: nobody will take this folder for a leftover
        os.close(descriptor)
        return None
    if os.fstat(descriptor).st_nlink == 0:
        os.close(descriptor)
        return None
    return descriptor


def _settle(folder: Path, target: Path) -> None:
    """Put back a folder that had stepped aside for a result that did not come, and remove the rest."""
    with suppress(OSError):
        if (folder / REPLACED).is_dir() and not os.path.lexists(target):
            os.replace(folder / REPLACED, target)
    _remove(folder)


def _remove(folder: Path) -> None:
    """Remove a hidden folder, its lock last: what an interrupt leaves of it can still be recognised."""
    with suppress(OSError):
        for entry in sorted(folder.iterdir(), key=lambda entry: entry.name == LOCK):
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry, ignore_errors=True)
            else:
                entry.unlink()
        folder.rmdir()
