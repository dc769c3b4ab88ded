"""Memory estimates and checks before large allocations."""

from __future__ import annotations

import os
import sys
from pathlib import Path

SMALL = 2**26
"""Allocations below this size (bytes) are not checked."""

UNKNOWN = 2**62


def available() -> int:
    """Return the memory available to this process in bytes; a large number if the system does not report it."""
    return max(0, min(_free(), _left_in_groups(), _left_of_address_space()))


def _free() -> int:
    """Return the free memory of the machine in bytes, or the total if only that is reported."""
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    except (OSError, ValueError):
        pass
    if sys.platform == "win32":
        return _free_on_windows()
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return UNKNOWN


def _free_on_windows() -> int:
    import ctypes

    class Status(ctypes.Structure):
        _fields_ = (("length", ctypes.c_uint32), ("load", ctypes.c_uint32), ("bytes", ctypes.c_uint64 * 7))

    status = Status(length=ctypes.sizeof(Status))
    found = getattr(ctypes, "windll").kernel32.GlobalMemoryStatusEx(ctypes.byref(status))  # noqa: B009
    return int(status.bytes[1]) if found else UNKNOWN


def _left_in_groups(root: str = "/sys/fs/cgroup", own: str = "/proc/self/cgroup") -> int:
    """Return the memory left in the Linux control groups of this process: a container, a batch job."""
    left = UNKNOWN
    try:
        lines = Path(own).read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):
        return left
    for line in lines:
        number, kinds, path = line.split(":", 2)
        if number == "0":
            base, names = Path(root), ("memory.max", "memory.current", "file")
        elif "memory" in kinds.split(","):
            base, names = Path(root, "memory"), ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_cache")
        else:
            continue
        inside = [part for part in path.split("/") if part not in ("", "..")]
        for depth in range(len(inside) + 1):
            left = min(left, _left_in(base.joinpath(*inside[:depth]), *names))
    return left


def _left_in(group: Path, limit: str, used: str, cache: str) -> int:
    """Return the memory left in one control group, not counting its file cache."""
    try:
        most, held = (int(Path(group, name).read_text(encoding="ascii")) for name in (limit, used))
        stated = dict(line.split() for line in Path(group, "memory.stat").read_text(encoding="ascii").splitlines())
        return most - held + int(stated.get(cache, 0))
    except (OSError, ValueError):  # no limit of this kind
        return UNKNOWN


def _left_of_address_space() -> int:
    """Return the address space left by ``ulimit -v``."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit == resource.RLIM_INFINITY:
            return UNKNOWN
        return limit - int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    except (ImportError, OSError, ValueError):
        return UNKNOWN


def in_words(count: float) -> str:
    """Format a number of bytes.

    Examples
    --------
    >>> in_words(5.62e9), in_words(2e8), in_words(3e16), in_words(10**400)
    ('5.6 GB', '200 MB', '3e+07 GB', '1e+291 GB')
    """
    count = min(count, 10**300)  # integers may exceed the range of float
    if count < 1e9:
        return f"{count / 1e6:.0f} MB"
    return f"{count / 1e9:.1f} GB" if count < 1e14 else f"{count / 1e9:.0e} GB"


def check_room(count: float, what: str, instead: str = "") -> None:
    """Raise a ValueError, with the estimate and the free memory, if `count` bytes are not available.

    `what` is the subject of the message; `instead` names an alternative that would fit.
    """
    if count > SMALL:
        free = available()
        if count > free:
            ending = f"; {instead}" if instead else ""
            raise ValueError(f"{what} needs about {in_words(count)}; this machine has {in_words(free)} free{ending}")
