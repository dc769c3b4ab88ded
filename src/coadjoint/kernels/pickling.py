"""Pickling of compiled loops: tables are sent, and function addresses are resolved again in the receiving process."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from coadjoint.kernels.functions import CalledFunction, CompiledFunction, TabledFunction
from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.matrix_tables import ROUTINES, blas_address
from coadjoint.kernels.stepping import STEPS, step_address
from coadjoint.kernels.structures import varied_fields
from coadjoint.kernels.tables import Compiled

OWNERS = (CompiledFunction, TabledFunction, CalledFunction)
STANDING = ("step", "whole")
"""Fields with addresses that exist in every process: steps of the library, and BLAS routines."""


class Standing(NamedTuple):
    """An object that every process has at its own address: a BLAS routine by name if `blas`, else a step for
    `step_address`.
    """

    what: Any
    blas: bool

    @property
    def address(self) -> int:
        """Address in this process."""
        return blas_address(self.what) if self.blas else step_address(self.what)


class SentTables(NamedTuple):
    """Tables with the addresses of the sending process, and the objects they point to as pairs (address, owner)."""

    tables: Any
    owners: tuple[tuple[int, Any], ...]


def can_be_sent(keep: tuple[Any, ...]) -> bool:
    """Return whether tables can be pickled: the objects their addresses point to can be rebuilt in another process."""
    return all(isinstance(kept, OWNERS) for kept in keep)


def sent(tables: Any, keep: tuple[Any, ...]) -> SentTables:
    """Return tables in a form that can be pickled, with the owners of their addresses."""
    return SentTables(tables, (*((kept.address, kept) for kept in keep), *_standing(tables).items()))


def received(given: SentTables) -> Compiled:
    """Return tables with the addresses of this process; functions are compiled again, once.

    Examples
    --------
    >>> import pickle
    >>> from coadjoint.kernels.tables import watch_tables
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> watch = watch_tables(body, body.casimirs)
    >>> there = received(pickle.loads(pickle.dumps(sent(watch.tables, watch.keep))))
    >>> bool((there.tables.constant == watch.tables.constant).all())
    True
    """
    moved = {address: owner.address for address, owner in given.owners}
    keep = tuple(owner for _, owner in given.owners if isinstance(owner, OWNERS))
    return Compiled(_moved(given.tables, moved) if moved else given.tables, keep)


def _standing(tables: Any) -> dict[int, Standing]:
    """Return the addresses in tables that exist in every process, with their objects."""
    found: dict[int, Standing] = {}
    for name in getattr(type(tables), "_fields", ()):
        value = getattr(tables, name)
        if isinstance(value, tuple):
            found |= _standing(value)
        elif name in STANDING and isinstance(value, np.ndarray):
            numbers = value.ravel().tolist()
            found |= {number: Standing(STEPS[number], False) for number in numbers if number in STEPS}
            found |= {number: Standing(ROUTINES[number], True) for number in numbers if number in ROUTINES}
    return found


def _moved(tables: Any, moved: Mapping[int, int]) -> Any:
    """Return tables with addresses replaced."""
    kind: Any = type(tables)
    if not hasattr(kind, "_fields"):
        return tables
    own = {name: getattr(tables, name) for name in kind._fields}
    places = [name for name, value in own.items() if isinstance(value, np.ndarray) and value.dtype == np.int64]
    varied = varied_fields(kind) if places else frozenset()
    for name, value in own.items():
        if isinstance(value, tuple):
            own[name] = _moved(value, moved)
        elif name in places and (name in varied or name in STANDING):
            own[name] = np.array([moved.get(old, old) for old in value.ravel().tolist()], np.int64).reshape(value.shape)
    return kind(**own)


def sent_loop(loop: CompiledLoop) -> dict[str, Any]:
    """Return a compiled loop in a form that can be pickled, if `loop_can_be_sent`."""
    return {
        "name": loop.name,
        "shift": loop.shift,
        "memory": loop.memory,
        "accounts": loop.accounts,
        "parts": loop.parts,
        "given": sent(loop.tables, loop.keep),
    }


def received_loop(given: Mapping[str, Any]) -> CompiledLoop:
    """Return the compiled loop from the result of `sent_loop`."""
    tables, keep = received(given["given"])
    return CompiledLoop(tables=tables, keep=keep, **{name: given[name] for name in given if name != "given"})


def loop_can_be_sent(loop: CompiledLoop) -> bool:
    """Return whether a compiled loop can be pickled: its addresses point to functions only."""
    return not loop.held and can_be_sent(loop.keep)
