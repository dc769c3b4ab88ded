"""Machine code in the cache folder of the user, which is loaded only if no other user can have written it."""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path

from coadjoint.private_folders import WRITABLE_BY_OTHERS, check_private

MOST_FILES = 2000
"""Files of a kind that are kept; half of them, the oldest, are removed for the next one."""


class CodeCache:
    """Files of a suffix in the folder ``coadjoint`` of the user's cache, created if missing; OSError if unsafe."""

    def __init__(self, suffix: str) -> None:
        self._suffix, self._folder = suffix, _folder_of_user()

    def find(self, name: str) -> Path | None:
        """Return the undamaged file of this name, or None; remove damaged ones. PermissionError: of another user."""
        for path in self._files():
            if path.name.startswith(f"{name}-"):
                if path.name == self._name(name, _trusted_content(path)):
                    # Loading by name is safe: in a private folder nobody else can replace the file.
                    return path
                path.unlink(missing_ok=True)
        return None

    def add(self, name: str, build: Callable[[Path], object]) -> Path:
        """Return a new file of this name, which `build` writes."""
        files = self._files()
        if len(files) >= MOST_FILES:
            for path in sorted(files, key=_age)[: MOST_FILES // 2]:
                path.unlink(missing_ok=True)
        with tempfile.TemporaryDirectory(dir=self._folder) as build_folder:
            new_file = Path(build_folder, name)
            build(new_file)
            path = self._folder / self._name(name, _flushed_content(new_file))
            os.replace(new_file, path)
        return path

    def _files(self) -> list[Path]:
        return sorted(path for path in self._folder.iterdir() if path.name.endswith(self._suffix))

    def _name(self, name: str, content: bytes) -> str:
        """Return a file name with a digest of the content, since loading damaged code would crash the process."""
        return f"{name}-{hashlib.sha256(content).hexdigest()[:32]}{self._suffix}"


def _age(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:  # removed by another process
        return 0.0


def _folder_of_user() -> Path:
    configured = os.environ.get("XDG_CACHE_HOME", "")
    # A relative path is ignored, as the XDG Base Directory Specification requires.
    base = Path(configured) if os.path.isabs(configured) else _home() / ".cache"
    folder = Path(os.path.realpath(base / "coadjoint"))
    for level in (*reversed(folder.parents), folder):
        if not level.exists():
            level.mkdir(mode=0o700, exist_ok=True)
    check_private(folder)
    return folder


def _home() -> Path:
    try:
        home = Path.home()
    except RuntimeError:
        raise FileNotFoundError("the user has no home folder") from None
    if not home.is_absolute() or not home.is_dir():
        raise FileNotFoundError(f"the home folder {home} does not exist")
    return home


def _trusted_content(path: Path) -> bytes:
    """Return the content of a file; PermissionError unless this user owns it and nobody else can write it."""
    with open(path, "rb", opener=_without_links) as file:
        status = os.fstat(file.fileno())
        # Windows shows neither owners nor modes; `check_private` has admitted the folder.
        shown = hasattr(os, "geteuid")
        foreign = shown and (status.st_uid != os.geteuid() or bool(status.st_mode & WRITABLE_BY_OTHERS))
        if not stat.S_ISREG(status.st_mode) or foreign:
            raise PermissionError(
                f"{path} is not a file that only this user can write: owner {status.st_uid}, mode {status.st_mode:o}"
            )
        return file.read()


def _without_links(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))


def _flushed_content(path: Path) -> bytes:
    """Restrict a new file to its owner, flush it to disk, and return its content."""
    path.chmod(0o600)
    with open(path, "r+b") as file:  # Windows flushes no file that is only read
        os.fsync(file.fileno())
        return file.read()
