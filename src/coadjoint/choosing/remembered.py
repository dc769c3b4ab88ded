"""What a choice finds out that depends on the system and not on the state: kept for the next choices."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import lru_cache
from typing import Any, TypeVar

from coadjoint.methods.base import Method
from coadjoint.runs.loops import SystemLoops
from coadjoint.systems.kinds import System

Found = TypeVar("Found")

# Of larger systems nothing is kept: their tables take room, and beside their steps it takes no time to make them.
LARGEST = 64
# Of one system so much is kept; then all of it is forgotten. Of the systems it is those that were asked for last.
MOST = 256
SYSTEMS = 16


@lru_cache(maxsize=SYSTEMS)
def _known_of(system: System) -> dict[Hashable, Any]:
    return {}


def remembered(system: System, key: Hashable, make: Callable[[], Found]) -> Found:
    """Return what was made for a system under a key, or make it.

    Parameters
    ----------
    system : System
        What moves. It does not change, and neither does what is made for it.
    key : hashable
        Of one kind of things; what cannot be hashed is made each time.
    make : callable
        It makes what is wanted. What it raises is not kept.

    Returns
    -------
    object
        The same for several calls, which must not change it.
    """
    if system.dim > LARGEST:
        return make()
    try:
        known = _known_of(system)
        found: Found = known[key]
    except KeyError:
        found = make()
        if len(known) >= MOST:
            known.clear()
        known[key] = found
    except TypeError:
        return make()
    return found


def loops_of(system: System, method: Method, h: float) -> SystemLoops:
    """Return the loops of a scheme that follow the energy alone.

    They are cached where they depend neither on the step nor on functions of the user, which may read something else.
    """

    def made() -> SystemLoops:
        return SystemLoops(system, method, h, None, casimirs={})

    return (
        remembered(system, ("loops", method), made)
        if method.tables_of_any_step and not _has_functions(system)
        else made()
    )


def _has_functions(system: System) -> bool:
    return system.algebra is None or any(term.called for term in system.hamiltonian.terms())
