"""Memory estimates and checks before large allocations."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar
from weakref import WeakValueDictionary

UNCHECKED_BYTES = 2**26
"""Allocations below this size (bytes) are not checked."""

RELEASED_SIZE = 2**18
"""Dimension above which memory freed in the preparation of a system and of its runs is returned to the system."""

NO_LIMIT = 2**62  # bytes: more than any machine has, and still a number of 64 bits
MAX_CACHED_SIZE = 2**16  # entries: half a megabyte of an array is kept, larger ones are computed again

Arrays = TypeVar("Arrays")
Arguments = ParamSpec("Arguments")
Built = TypeVar("Built")


class cached_if_small(Generic[Arrays]):
    """A cached property of one array, or a tuple of arrays, that is computed again each time if it is large."""

    def __init__(self, build: Callable[[Any], Arrays]) -> None:
        self.build, self.__doc__ = build, build.__doc__

    def __get__(self, instance: Any, owner: type) -> Arrays:
        if instance is None:
            return self  # type: ignore[return-value]
        value = self.build(instance)
        if _count(value) <= MAX_CACHED_SIZE:
            instance.__dict__[self.build.__name__] = value
        return value


def shared(build: Callable[Arguments, Built]) -> Callable[Arguments, Built]:
    """Return a function that builds an immutable object, one for the same arguments as long as it is in use."""
    in_use: WeakValueDictionary[Any, Built] = WeakValueDictionary()

    @wraps(build)
    def shared_or_built(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Built:
        # Types belong to the key, since 3.0 and True are equal to integers and are refused.
        try:
            key = tuple((type(v), v) for v in args), frozenset((k, type(v), v) for k, v in kwargs.items())
            built = in_use.get(key)
        except TypeError:  # arguments without a hash
            return build(*args, **kwargs)
        return in_use.setdefault(key, build(*args, **kwargs)) if built is None else built

    return shared_or_built


def _count(arrays: Any) -> int:
    return sum(map(_count, arrays)) if isinstance(arrays, tuple) else int(arrays.size)


class InsufficientMemoryError(ValueError, MemoryError):
    """An allocation exceeds the memory that is available."""


def available() -> int:
    """Return the memory available to this process in bytes; a large number if the system does not report it."""
    return max(0, min(_free(), _available_in_cgroups(), _available_address_space()))


def release_freed_memory() -> None:
    """Return freed memory to the system, where the allocator (of glibc) would keep it for smaller arrays."""
    if sys.platform == "linux":
        import ctypes

        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(ctypes.c_size_t(0))


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
        return NO_LIMIT


def _free_on_windows() -> int:
    import ctypes

    status = (ctypes.c_uint64 * 8)(64)  # the length of the structure and the load; then the total and the free bytes
    success = getattr(ctypes, "windll").kernel32.GlobalMemoryStatusEx(ctypes.byref(status))  # noqa: B009
    return int(status[2]) if success else NO_LIMIT


def _available_in_cgroups(root: str = "/sys/fs/cgroup", membership: str = "/proc/self/cgroup") -> int:
    """Return the memory left in the Linux control groups of this process: a container, a batch job."""
    left = NO_LIMIT
    try:
        lines = Path(membership).read_text(encoding="ascii").splitlines()
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
            left = min(left, _available_in_cgroup(base.joinpath(*inside[:depth]), *names))
    return left


def _available_in_cgroup(group: Path, limit: str, used: str, cache: str) -> int:
    """Return the memory left in one control group, not counting its file cache."""
    try:
        maximum, usage = (int(Path(group, name).read_text(encoding="ascii")) for name in (limit, used))
        statistics = dict(line.split() for line in Path(group, "memory.stat").read_text(encoding="ascii").splitlines())
        return maximum - usage + int(statistics.get(cache, 0))
    except (OSError, ValueError):  # no limit of this kind
        return NO_LIMIT


def _available_address_space() -> int:
    """Return the address space left by ``ulimit -v``."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit == resource.RLIM_INFINITY:
            return NO_LIMIT
        return limit - int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    except (ImportError, OSError, ValueError):
        return NO_LIMIT


def format_bytes(count: float) -> str:
    """Format a number of bytes.

    >>> format_bytes(5.62e9), format_bytes(2e8), format_bytes(3e16), format_bytes(10**400)
    ('5.6 GB', '200 MB', '3e+07 GB', '1e+291 GB')
    """
    count = min(count, 10**300)  # integers may exceed the range of float
    if count < 1e9:
        return f"{count / 1e6:.0f} MB"
    return f"{count / 1e9:.1f} GB" if count < 1e14 else f"{count / 1e9:.0e} GB"


def check_available_memory(count: float, what: str, instead: str = "") -> None:
    """Raise `InsufficientMemoryError`, from `what` to `instead`, if `count` bytes are not available."""
    if count > UNCHECKED_BYTES:
        free = available()
        if count > free:
            ending = f"; {instead}" if instead else ""
            raise InsufficientMemoryError(
                f"{what} needs about {format_bytes(count)}; this machine has {format_bytes(free)} free{ending}"
            )
