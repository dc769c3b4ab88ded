"""How is a file replaced so that a reader finds the old one or the new one, and never a part of either?"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

UNHEARD = (errno.EINVAL, errno.EBADF, errno.ENOTSUP, errno.ENOSYS)
"""What file systems answer that do not sync folders."""
WRITING = ".writing"
"""Ends the name of a file that is not whole yet; what a killed process leaves of it means nothing."""


def write_whole(path: Path, content: bytes) -> None:
    """Write a file beside its place, on to the disk, and rename it.

    Its folder must exist: one that somebody has removed is not made again.

    Parameters
    ----------
    path : Path
        The file, replaced if it exists.
    content : bytes
        All of it.

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
    try:
        with open(beside, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except BaseException:
        with suppress(OSError):
            beside.unlink()
        raise


def settle(folders: Iterable[Path]) -> None:
    """Let what was renamed in some folders be on the disk, where the system can say so of folders.

    Raises
    ------
    OSError
        The disk is full or broken, or a folder is gone.
    """
    if os.name == "nt":  # folders are no files there
        return
    for folder in folders:
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        except OSError as reason:
            if reason.errno not in UNHEARD:
                raise
        finally:
            os.close(descriptor)
