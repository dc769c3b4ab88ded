"""The user's cache of compiled steps: libraries are loaded only if no other user can have written them."""

from __future__ import annotations

import ctypes
import hashlib
import os
import stat
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

from coadjoint.private_folders import WRITABLE_BY_OTHERS, check_private, private_folder


def cached_library(name: str, build: Callable[[Path], None]) -> ctypes.CDLL:
    """Load a library from the cache, after `build` (which raises no OSError) has written it there if necessary."""
    try:
        folder = _cache_folder()
        path = _cached(folder, name)
        if path is None:
            with tempfile.TemporaryDirectory(dir=folder) as build_folder:
                new_file = Path(build_folder, name)
                build(new_file)
                path = folder / _cache_name(name, _flushed_content(new_file))
                os.replace(new_file, path)
    except OSError as reason:
        detail = f"{reason.strerror}: {reason.filename}" if reason.strerror else reason
        warnings.warn(
            f"the cache of compiled steps is not used ({detail}), so that each process compiles them again; correct "
            "this or name another folder by XDG_CACHE_HOME",
            RuntimeWarning,
            stacklevel=2,
        )
        with private_folder() as temporary_folder:
            build(temporary_folder / name)
            return ctypes.CDLL(str(temporary_folder / name))
    return ctypes.CDLL(str(path))


def _cache_name(name: str, content: bytes) -> str:
    """Return a file name with a digest of the content, since loading a damaged library would crash the process."""
    return f"{name}-{hashlib.sha256(content).hexdigest()[:32]}.so"


def _cache_folder() -> Path:
    """Return the cache folder, created if missing; no other user can change or replace its contents."""
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


def _cached(folder: Path, name: str) -> Path | None:
    """Return the undamaged library of this name, or None; remove damaged ones. PermissionError: of another user."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith(f"{name}-"):
            if path.name == _cache_name(name, _trusted_content(path)):
                # Loading by name is safe: in a private folder nobody else can replace the file.
                return path
            path.unlink(missing_ok=True)
    return None


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
