"""How the kernels are compiled and where the results are kept."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

# No fastmath: the bits of a run must not depend on how LLVM regroups a sum.
OPTIONS = {"nogil": True, "error_model": "numpy", "boundscheck": False}


@functools.cache
def _kernel_stamp() -> str:
    """Return a digest of every source that a loop is made of: what it inlines, and the tables that it reads."""
    digest = hashlib.sha256()
    package = Path(__file__).parents[1]
    for source in sorted([*package.glob("kernels/*.py"), *package.glob("program/*.py")]):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls, and keep it on disk for the next process."""
    dispatcher = numba.njit(cache=True, **OPTIONS)(function)
    stamp(dispatcher)
    return dispatcher


def stamp(cached: Any) -> None:
    """Mark what is kept on disk of a compiled function with all kernel sources.

    Numba stamps an entry with the function's own file alone; it depends on all that is inlined into it.
    """
    kept = cached._cache._cache_file
    kept._source_stamp = f"{kept._source_stamp!r} {_kernel_stamp()}"


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function that only other kernels call: it disappears into its caller."""
    return numba.njit(forceinline=True, **OPTIONS)(function)
