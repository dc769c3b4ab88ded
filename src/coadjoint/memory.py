"""Memory that is available, and the check before runs, tables and contents of files are allocated."""

from __future__ import annotations

import os
from pathlib import Path

UNCHECKED_BYTES = 2**26  # allocations up to this size are not checked
NO_LIMIT = 2**62  # bytes: more than any machine has, and still a number of 64 bits


class InsufficientMemoryError(ValueError, MemoryError):
    """An allocation exceeds the memory that is available."""


def available() -> int:
    """Return the memory available to this process in bytes; a large number if the system does not report it."""
    return max(0, min(_free(), _free_in_control_groups(), _free_address_space()))


def _words(*path: str) -> list[list[str]]:
    """Return the words of each line of a file of the system; an empty list if it cannot be read."""
    try:
        return [line.split() for line in Path(*path).read_text(encoding="ascii").splitlines()]
    except (OSError, ValueError):
        return []


def _free() -> int:
    """Return the free memory of the machine, or the total if only that is reported."""
    for name, number, *_ in _words("/proc/meminfo"):
        if name == "MemAvailable:" and number.isdigit():
            return 1024 * int(number)
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # Windows, where an allocation beyond the memory fails by itself
        return NO_LIMIT


def _free_in_control_groups() -> int:
    """Return the memory left in the control groups of this process and those above, of which file caches are free."""
    left = NO_LIMIT
    for words in _words("/proc/self/cgroup"):
        number, kinds, path = " ".join(words).split(":", 2)
        base, names = "/sys/fs/cgroup", ("memory.max", "memory.current", "file")
        if "memory" in kinds.split(","):
            base, names = f"{base}/memory", ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_cache")
        elif number != "0":
            continue
        inside = [part for part in path.split("/") if part not in ("", "..")]
        for depth in range(len(inside) + 1):
            most, used, statistics = (_words(base, *inside[:depth], name) for name in (*names[:2], "memory.stat"))
            if most and used and most[0][0].isdigit():  # not "max"
                cached = int(dict(statistics).get(names[2], 0))
                left = min(left, int(most[0][0]) - int(used[0][0]) + cached)
    return left


def _free_address_space() -> int:
    """Return the address space left by ``ulimit -v``."""
    try:
        import resource
    except ImportError:
        return NO_LIMIT
    limit, taken = resource.getrlimit(resource.RLIMIT_AS)[0], _words("/proc/self/statm")
    return limit - int(taken[0][0]) * resource.getpagesize() if taken and limit != resource.RLIM_INFINITY else NO_LIMIT


def format_bytes(count: float) -> str:
    """Format a number of bytes: 5.6 GB, 200 MB."""
    count = min(count, 10**300)  # integers may exceed the range of float
    return f"{count / 1e6:.0f} MB" if count < 1e9 else f"{count / 1e9:{'.1f' if count < 1e14 else '.0e'}} GB"


def check_available_memory(count: float, what: str, instead: str = "") -> None:
    """Raise `InsufficientMemoryError`, from `what` to `instead`, if `count` bytes are not available."""
    if count > UNCHECKED_BYTES and count > (free := available()):
        ending = f"; {instead}" if instead else ""
        needed = f"{what} needs about {format_bytes(count)}"
        raise InsufficientMemoryError(f"{needed}; this machine has {format_bytes(free)} free{ending}")
