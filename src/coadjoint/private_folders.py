"""Folders from which code is loaded, protected against changes by other users."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def check_private(folder: Path) -> None:
    """Raise a PermissionError, with the reason as a clause, if another user can change the contents of a folder."""
    if not hasattr(os, "geteuid"):
        # Windows has access lists, which modes do not show; those of a user's own folder admit no other user.
        if not folder.is_relative_to(os.path.realpath(Path.home())):
            raise PermissionError(f"{folder} is not in the folder of this user, {Path.home()}")
        return
    # From the root downward: the entries of a folder found safe cannot change afterwards.
    trusted = {0, os.geteuid(), os.lstat("/").st_uid}
    for path in (*reversed(folder.parents), folder):
        status = os.lstat(path)
        if not stat.S_ISDIR(status.st_mode):
            raise PermissionError(f"{path} is not a folder")
        if status.st_uid not in trusted or (path == folder and status.st_uid != os.geteuid()):
            raise PermissionError(f"{path} belongs to another user")
        # In a sticky folder such as /tmp others can add entries, but not replace those of this user.
        sticky = path != folder and status.st_mode & stat.S_ISVTX
        if status.st_mode & WRITABLE_BY_OTHERS and not sticky:
            raise PermissionError(f"{path} can be changed by other users, mode {stat.S_IMODE(status.st_mode):o}")


@contextmanager
def private_folder() -> Iterator[Path]:
    """Context with a temporary folder that only this user can change; RuntimeError if none can be created."""
    try:
        temporary = tempfile.TemporaryDirectory(prefix="coadjoint-", ignore_cleanup_errors=True)
    except OSError as reason:
        raise RuntimeError(f"no temporary folder can be made ({reason}); set TMPDIR to a folder of your own") from None
    with temporary as name:
        folder = Path(os.path.realpath(name))
        try:
            check_private(folder)
        except OSError as reason:
            raise RuntimeError(
                f"temporary files in {folder.parent} are not safe ({reason}); set TMPDIR to a folder of your own"
            ) from None
        yield folder
