"""Pickling of compiled loops: tables are sent, and function addresses are resolved again in the receiving process."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from coadjoint.kernels.functions.compiled_functions import CompiledFunction, FormulaFunction, PythonCallback
from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.tables.compiled import CompiledTables
from coadjoint.kernels.tables.matrix_steps import ROUTINES, blas_address
from coadjoint.kernels.tables.steps import STEPS, step_address
from coadjoint.kernels.tables.structures import per_member_fields

OWNERS = (CompiledFunction, FormulaFunction, PythonCallback)
LIBRARY_ADDRESS_FIELDS = ("step", "whole")
"""Fields with addresses that exist in every process: steps of the library, and BLAS routines."""


class LibraryAddress(NamedTuple):
    """An object that every process has at its own address: a BLAS routine if `blas`, else a step, by name."""

    what: Any
    blas: bool

    @property
    def address(self) -> int:
        """Address in this process."""
        return blas_address(self.what) if self.blas else step_address(self.what)


class PicklableTables(NamedTuple):
    """Tables with the addresses of the sending process, and the objects they point to as pairs (address, owner)."""

    tables: Any
    owners: tuple[tuple[int, Any], ...]


def is_picklable(keepalive: tuple[Any, ...]) -> bool:
    """Return whether tables can be pickled: the objects their addresses point to can be rebuilt in another process."""
    return all(isinstance(owner, OWNERS) for owner in keepalive)


def picklable_tables(tables: Any, keepalive: tuple[Any, ...]) -> PicklableTables:
    """Return tables in a form that can be pickled, with the owners of their addresses."""
    return PicklableTables(
        tables, (*((owner.address, owner) for owner in keepalive), *_library_addresses(tables).items())
    )


def restored_tables(pickled: PicklableTables) -> CompiledTables:
    """Return tables with the addresses of this process; functions are compiled again, once."""
    relocations = {address: owner.address for address, owner in pickled.owners}
    keepalive = tuple(owner for _, owner in pickled.owners if isinstance(owner, OWNERS))
    return CompiledTables(_relocated(pickled.tables, relocations) if relocations else pickled.tables, keepalive)


def _library_addresses(tables: Any) -> dict[int, LibraryAddress]:
    """Return the addresses in tables that exist in every process, with their objects."""
    addresses: dict[int, LibraryAddress] = {}
    for name in getattr(type(tables), "_fields", ()):
        value = getattr(tables, name)
        if isinstance(value, tuple):
            addresses |= _library_addresses(value)
        elif name in LIBRARY_ADDRESS_FIELDS and isinstance(value, np.ndarray):
            numbers = value.ravel().tolist()
            addresses |= {number: LibraryAddress(STEPS[number], False) for number in numbers if number in STEPS}
            addresses |= {number: LibraryAddress(ROUTINES[number], True) for number in numbers if number in ROUTINES}
    return addresses


def _relocated(tables: Any, relocations: Mapping[int, int]) -> Any:
    """Return tables with addresses replaced."""
    kind: Any = type(tables)
    if not hasattr(kind, "_fields"):
        return tables
    values = {name: getattr(tables, name) for name in kind._fields}
    integer_fields = [
        name for name, value in values.items() if isinstance(value, np.ndarray) and value.dtype == np.int64
    ]
    per_member = per_member_fields(kind) if integer_fields else frozenset()
    for name, value in values.items():
        if isinstance(value, tuple):
            values[name] = _relocated(value, relocations)
        elif name in integer_fields and (name in per_member or name in LIBRARY_ADDRESS_FIELDS):
            values[name] = np.array(
                [relocations.get(address, address) for address in value.ravel().tolist()], np.int64
            ).reshape(value.shape)
    return kind(**values)


def picklable_loop(loop: CompiledLoop) -> dict[str, Any]:
    """Return a compiled loop in a form that can be pickled, if `loop_is_picklable`."""
    return {
        "name": loop.name,
        "shift": loop.shift,
        "memory": loop.memory,
        "accounts": loop.accounts,
        "tables": picklable_tables(loop.tables, loop.keepalive),
    }


def restored_loop(pickled: Mapping[str, Any]) -> CompiledLoop:
    """Return the compiled loop from the result of `picklable_loop`."""
    tables, keepalive, _ = restored_tables(pickled["tables"])
    return CompiledLoop(
        tables=tables, keepalive=keepalive, **{name: pickled[name] for name in pickled if name != "tables"}
    )


def loop_is_picklable(loop: CompiledLoop) -> bool:
    """Return whether a compiled loop can be pickled: its addresses point to functions only."""
    return not loop.referenced and is_picklable(loop.keepalive)
