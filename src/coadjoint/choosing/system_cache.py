"""Cache of results that depend on the system and not on the state, across choices."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import lru_cache
from typing import Any, TypeVar

from coadjoint.methods.protocol.method import Method
from coadjoint.runs.loops.loops import Loops, loops_of_system
from coadjoint.systems.system import System

ResultT = TypeVar("ResultT")

# Largest dimension that is cached: larger tables take much memory, and building them is cheap relative to the steps.
MAX_CACHED_DIMENSION = 64
# Entries per system, after which its cache is cleared, and number of systems (least recently used first out).
MAX_ENTRIES = 256
MAX_SYSTEMS = 16


@lru_cache(maxsize=MAX_SYSTEMS)
def _cache_of(system: System) -> dict[Hashable, Any]:
    return {}


def cached_for_system(system: System, key: Hashable, compute: Callable[[], ResultT]) -> ResultT:
    """Return the cached result of `make` for an immutable system and a key, computing it on first use.

    Unhashable keys are not cached, nor are exceptions. Callers must not modify the result.
    """
    if system.dim > MAX_CACHED_DIMENSION:
        return compute()
    try:
        cache = _cache_of(system)
        result: ResultT = cache[key]
    except KeyError:
        result = compute()
        if len(cache) >= MAX_ENTRIES:
            cache.clear()
        cache[key] = result
    except TypeError:
        return compute()
    return result


def loops_of(system: System, method: Method, h: float) -> Loops:
    """Return the loops of a scheme that record the energy alone.

    They are cached if they depend neither on the step nor on user functions, which may have state.
    """

    def build() -> Loops:
        return loops_of_system(system, method, h, casimirs={})

    return (
        cached_for_system(system, ("loops", method), build)
        if method.tables_of_any_step and not _has_functions(system)
        else build()
    )


def _has_functions(system: System) -> bool:
    return system.algebra is None or any(term.called for term in system.hamiltonian.terms())
