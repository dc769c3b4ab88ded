"""Atomic replacement of files: a reader finds the old or the new content, never a part."""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path

SYNC_UNSUPPORTED = (errno.EINVAL, errno.EBADF, errno.ENOTSUP, errno.ENOSYS)
"""Error numbers of file systems that cannot sync folders."""
TEMPORARY_SUFFIX = ".writing"
"""Suffix of incomplete files; those of killed processes are ignored."""


def write_atomically(path: Path, content: bytes, folder: int | None = None) -> None:
    """Write a temporary file, sync it to disk, and rename it to `path`, without following symbolic links.

    A missing folder is not created. `folder` is the descriptor that `path` is relative to. OSError: the disk is full,
    or the folder is gone; an existing file is then unchanged.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_atomically(Path(folder, "answer.txt"), b"42")
    ...     os.listdir(folder)
    ['answer.txt']
    """
    beside = path.with_name(f".{path.name}{TEMPORARY_SUFFIX}")

    def opened(name: str, flags: int) -> int:
        try:
            return os.open(name, flags, 0o666, dir_fd=folder)
        except FileExistsError:
            os.unlink(name, dir_fd=folder)  # from a killed process, or a link out of the folder
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


def sync_to_disk(folder: int) -> None:
    """Sync the directory entries of an open folder to disk, where supported."""
    try:
        os.fsync(folder)
    except OSError as reason:
        if reason.errno not in SYNC_UNSUPPORTED:
            raise
