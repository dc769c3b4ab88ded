"""Does it fit? Memory is estimated before anything is made, and what does not fit is refused with the estimate."""

from __future__ import annotations

import os
import sys
from pathlib import Path

SMALL = 2**26
"""Bytes about which nobody is asked: asking takes longer than to see that there is no room for them."""

UNKNOWN = 2**62


def available() -> int:
    """Return how many bytes of memory this process can still have; a large number where the system does not say.

    Examples
    --------
    >>> available() > 0
    True
    """
    return max(0, min(_free(), _left_in_groups(), _left_of_address_space()))


def _free() -> int:
    """Return the bytes that the machine has free, or all that it has where it says no more."""
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
    """Return what Linux leaves to the groups that this process is in: a container, a batch job."""
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
    """Return what is left in one group; what it holds of files only to be quick does not count."""
    try:
        most, held = (int(Path(group, name).read_text(encoding="ascii")) for name in (limit, used))
        stated = dict(line.split() for line in Path(group, "memory.stat").read_text(encoding="ascii").splitlines())
        return most - held + int(stated.get(cache, 0))
    except (OSError, ValueError):  # no such limit
        return UNKNOWN


def _left_of_address_space() -> int:
    """Return what ``ulimit -v`` leaves."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit == resource.RLIM_INFINITY:
            return UNKNOWN
        return limit - int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    except (ImportError, OSError, ValueError):
        return UNKNOWN


def in_words(count: float) -> str:
    """Return a number of bytes as one would say it.

    Examples
    --------
    >>> in_words(5.62e9), in_words(2e8), in_words(3e16), in_words(10**400)
    ('5.6 GB', '200 MB', '3e+07 GB', '1e+291 GB')
    """
    count = min(count, 10**300)  # whole numbers may be larger than any float
    if count < 1e9:
        return f"{count / 1e6:.0f} MB"
    return f"{count / 1e9:.1f} GB" if count < 1e14 else f"{count / 1e9:.0e} GB"


def check_room(count: float, what: str, instead: str = "") -> None:
    """Refuse what needs more memory than there is.

    Parameters
    ----------
    count : number
        Bytes that it needs while it is made, estimated.
    what : str
        What it is, the subject of the message.
    instead : str, optional
        What would fit.

    Raises
    ------
    ValueError
        With the estimate, and with what is free.

    Examples
    --------
    >>> check_room(1000, "a small thing")
    """
    if count > SMALL:
        free = available()
        if count > free:
            ending = f"; {instead}" if instead else ""
            raise ValueError(f"{what} needs about {in_words(count)}; this machine has {in_words(free)} free{ending}")
