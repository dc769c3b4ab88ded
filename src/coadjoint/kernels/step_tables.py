"""Construction of the arrays of the compiled loop from a system and a step method."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from coadjoint.kernels.field import GroupField
from coadjoint.kernels.field_tables import field_of, group_of, substeps
from coadjoint.kernels.library import kernels
from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.recording_tables import Watch
from coadjoint.kernels.stepping import Stepping, StepTables, step_address
from coadjoint.kernels.structures import as_structure
from coadjoint.kernels.tables import CompiledTables, addresses_of, invariants_table, watch_tables
from coadjoint.program.shifts.group_correction import unshift_tables
from coadjoint.program.term_table import TermTable
from coadjoint.systems.system_checks import System, has_compiled_bracket

INNER_LOOP_INDEX = 1
"""Index, among the integers, of the address of the tables of an inner loop."""


class CompiledStep(Protocol):
    """Protocol of a scheme with a compiled step."""

    @property
    def compiled_step(self) -> Any:
        """The step: its name in the library, or an object with its address."""

    def constants(self) -> tuple[Sequence[int], Sequence[float]]:
        """Return the integers and the coefficients that the step reads."""

    def restored(self, system: System) -> Mapping[str, Any] | None:
        """Return the invariants that the step restores."""


def step_tables(
    system: System, method: CompiledStep, representation: Any = None, fractions: Sequence[float] = (1.0,)
) -> CompiledTables:
    """Return the tables, a `Stepping` independent of the step, of a step method whose substeps have these fractions.

    Raise TypeError if a function of the user cannot be compiled.
    """
    restored = method.restored(system)
    watched = invariants_table([], system.dim) if restored is None else watch_tables(system, restored)
    made = _tables(system, group_of(system, representation), watched.tables, *method.constants())
    return _stepping(step_address(method.compiled_step), fractions, *made, watched.keepalive)


def function_tables(system: System, function: int, fractions: Sequence[float] = (1.0,)) -> CompiledTables:
    """Return the tables, a `Stepping`, of a step that is a function at an address."""
    constant = sum(term.constant for term in system.hamiltonian.terms())
    none = invariants_table([], system.dim)
    made = _tables(
        system, group_of(system, None), none.tables, [function], [constant], not has_compiled_bracket(system)
    )
    return _stepping(step_address("step_function"), fractions, *made, ())


def numeric_step_tables(
    system: System, step: str, whole: Sequence[int], coefficients: Sequence[float], fractions: Sequence[float] = (1.0,)
) -> CompiledTables:
    """Return the tables, a `Stepping`, of a named step that reads only integers, coefficients and the dimension."""
    none = invariants_table([], system.dim)
    made = _tables(system, group_of(system, None), none.tables, whole, coefficients, True)
    return _stepping(step_address(step), fractions, *made, none.keepalive)


def wrapped_step_tables(system: System, step: str, inner: CompiledLoop, restored: Mapping[str, Any]) -> CompiledTables:
    """Return the tables, a `Stepping`, of a named step that takes one step of `inner` and then restores energy and
    invariants.

    `inner` is a loop for one member; `restored` maps names to `Polynomial` or `Quadratic`.
    """
    places, keepalive = inner_loop_integers(inner, system, None)
    return named_step_tables(system, step, watch_tables(system, restored), places, None, keepalive)


def inner_loop_integers(inner: CompiledLoop, system: System, representation: Any) -> tuple[list[int], tuple[Any, ...]]:
    """Return the integers with which a step calls the steps of `inner`, a loop for one member, and the objects to keep
    alive.

    They are the addresses of the loop, of its tables and of an empty watch, the size of its memory, and the address of
    the tables that rotate the group element by the shift of the Hamiltonian, or 0.
    """
    loop = ctypes.cast(getattr(kernels(), f"{inner.name}_inside"), ctypes.c_void_p).value
    none = invariants_table([], system.dim)
    read, watch = as_structure(inner.tables), as_structure(none.tables)
    keepalive, turning = (*none.keepalive, *inner.keepalive, inner, read, watch), 0
    if inner.shift and representation is not None and system.algebra is not None:
        rho = None if isinstance(representation, str) else representation
        tables = as_structure(unshift_tables(system.algebra, rho, system.sign, inner.shift))
        keepalive, turning = (*keepalive, tables), ctypes.addressof(tables)
    return [loop or 0, ctypes.addressof(read), ctypes.addressof(watch), inner.memory, turning], keepalive


def named_step_tables(
    system: System,
    step: str,
    kept: CompiledTables,
    whole: Sequence[int],
    representation: Any,
    keepalive: tuple[Any, ...],
    coefficients: Sequence[float] = (),
) -> CompiledTables:
    """Return the tables, a `Stepping`, of a named step that reads integers, coefficients and the invariants `kept`."""
    made = _tables(
        system, group_of(system, representation), kept.tables, whole, coefficients, not has_compiled_bracket(system)
    )
    return _stepping(step_address(step), (1.0,), *made, (*kept.keepalive, *keepalive))


def _tables(
    system: System,
    group: GroupField,
    kept: Watch,
    integers: Sequence[int],
    numbers: Sequence[float],
    called: bool = False,
) -> tuple[StepTables, tuple[Any, ...]]:
    field, keepalive = field_of(system, called)
    table = TermTable()
    for term in system.hamiltonian.terms():
        table.add(term)
    values, values_kept = addresses_of(table.functions, len(table), "value", "the Hamiltonian")
    whole, coefficients = np.array(integers, dtype=np.int64), np.array(numbers, dtype=np.float64)
    return StepTables(field, values, group, kept, whole, coefficients), (*keepalive, *values_kept)


def _stepping(
    step: int, fractions: Sequence[float], tables: StepTables, keepalive: tuple[Any, ...], more: tuple[Any, ...]
) -> CompiledTables:
    lengths, moments = substeps(fractions)
    stepping = Stepping(np.array([step], dtype=np.int64), len(lengths), lengths, moments, tables)
    return CompiledTables(stepping, (*keepalive, *more))
