"""Files replaced whole: a reader finds the old one or the new one, and never a part of either."""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path

UNHEARD = (errno.EINVAL, errno.EBADF, errno.ENOTSUP, errno.ENOSYS)
"""Error numbers of file systems that do not sync folders."""
WRITING = ".writing"
"""Ends the name of a file that is not whole yet; what a killed process leaves of it means nothing."""


def write_whole(path: Path, content: bytes, folder: int | None = None) -> None:
    """Write a file beside its place, sync it to disk, and rename it; no symbolic link is followed to either.

    Its folder must exist: one that somebody has removed is not made again.

    Parameters
    ----------
    path : Path
        The file, replaced if it exists.
    content : bytes
        All of it.
    folder : int, optional
        Descriptor of the folder from which `path` is reached.

    Raises
    ------
    OSError
        The disk is full, or the folder is gone; the file is then as it was.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_whole(Path(folder, "answer.txt"), b"42")
    ...     os.listdir(folder)
    ['answer.txt']
    """
    beside = path.with_name(f".{path.name}{WRITING}")

    def opened(name: str, flags: int) -> int:
        try:
            return os.open(name, flags, 0o666, dir_fd=folder)
        except FileExistsError:
            os.unlink(name, dir_fd=folder)  # left by a killed process, or a link out of the folder
            return os.open(name, flags, 0o666, dir_fd=folder)

    try:
        with open(beside, "xb", opener=opened) as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path, src_dir_fd=folder, dst_dir_fd=folder)
    except BaseException:
        with suppress(OSError):
            os.unlink(beside, dir_fd=folder)
        raise


def settle(folder: int) -> None:
    """Sync the names in an open folder to disk, where the system can sync folders.

    Raises
    ------
    OSError
        The disk is full or broken.
    """
    try:
        os.fsync(folder)
    except OSError as reason:
        if reason.errno not in UNHEARD:
            raise
