"""Folders from which code is loaded: no other user can change what is in them."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def check_private(folder: Path) -> None:
    """Refuse a folder, given by its real path, of which another user can change or replace the contents.

    Raises
    ------
    PermissionError
        With the reason as a clause.
    OSError
        The folder cannot be examined.
    """
    # From the root downward: once a folder is known to be safe, the entries in it stay what they are.
    trusted = {0, os.geteuid(), os.lstat("/").st_uid}
    for place in (*reversed(folder.parents), folder):
        found = os.lstat(place)
        if not stat.S_ISDIR(found.st_mode):
            raise PermissionError(f"{place} is not a folder")
        if found.st_uid not in trusted or (place == folder and found.st_uid != os.geteuid()):
            raise PermissionError(f"{place} belongs to another user")
        # Others can add entries to a sticky folder such as /tmp, but not replace the entries of this user.
        sticky = place != folder and found.st_mode & stat.S_ISVTX
        if found.st_mode & OTHERS_WRITE and not sticky:
            raise PermissionError(f"{place} can be changed by other users, mode {stat.S_IMODE(found.st_mode):o}")


@contextmanager
def private_folder() -> Iterator[Path]:
    """Make a temporary folder that only this user can change, and remove it at the end.

    Raises
    ------
    RuntimeError
        There is no such place for temporary files.

    Examples
    --------
    >>> with private_folder() as folder:
    ...     oct(folder.stat().st_mode & 0o777)
    '0o700'
    """
    try:
        own = tempfile.TemporaryDirectory(prefix="coadjoint-", ignore_cleanup_errors=True)
    except OSError as reason:
        raise RuntimeError(f"no temporary folder can be made ({reason}); set TMPDIR to a folder of your own") from None
    with own as name:
        folder = Path(os.path.realpath(name))
        try:
            check_private(folder)
        except OSError as reason:
            raise RuntimeError(
                f"temporary files in {folder.parent} are not safe ({reason}); set TMPDIR to a folder of your own"
            ) from None
        yield folder
