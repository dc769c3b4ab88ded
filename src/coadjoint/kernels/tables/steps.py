"""Tables of the loop for step methods: schemes with one compiled step of their own."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.library import kernels
from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.tables.compiled import LIBRARY_ADDRESSES, CompiledTables, addresses_of
from coadjoint.kernels.tables.field import (
    Field,
    GroupField,
    field_of,
    group_of,
    sources_of_field,
    substeps,
    terms_of_field,
)
from coadjoint.kernels.tables.invariants import invariants_table, watch_tables
from coadjoint.kernels.tables.recording import Watch
from coadjoint.kernels.tables.structures import as_structure
from coadjoint.program.generators import given_matrices
from coadjoint.program.group_correction import unshift_tables
from coadjoint.program.sources import CoefficientNumbers, Multiples, Sources
from coadjoint.systems.system import System


class StepTables(NamedTuple):
    """Tables that a step reads: field, values of the terms of H, group equation, invariants, and numbers."""

    field: Field
    values: NDArray[np.int64]
    group: GroupField
    restored: Watch
    whole: NDArray[np.int64]
    coefficients: NDArray[np.float64]


class Stepping(NamedTuple):
    """A compiled step, by address, and its tables; a step of the run consists of `substeps` of it. They have the
    lengths `fraction`, at the moments `moment`, in units of the step. `serial` is the number that the loop assigns to
    the tables when it first reads them.
    """

    step: NDArray[np.int64]
    substeps: int
    fraction: NDArray[np.float64]
    moment: NDArray[np.float64]
    tables: StepTables
    serial: int = 0

    def at_step(self, h: float) -> Stepping:
        """Return the tables of another step: they do not depend on it, except for those of an inner loop."""
        return self


def step_address(step: Any) -> int:
    """Return the address of a step: an object with an ``address``, or a name (`STEP_SCHEME` in its C++ file)."""
    if isinstance(step, str):
        try:
            function = getattr(kernels(), f"{step}_step")
        except AttributeError as error:
            raise ValueError(
                f"the kernels have no step {step!r}; put its C++ file into the folder of the scheme, and build them by "
                "make kernels"
            ) from error
        address = ctypes.cast(function, ctypes.c_void_p).value or 0
    else:
        address = int(step.address)
    LIBRARY_ADDRESSES[address] = step_address, step
    return address


STEP_LOOP = "stepping_advance"
"""Name of the loop for all schemes whose tables contain their step."""


INNER_LOOP_INDEX = 1
"""Index, among the integers, of the address of the tables of an inner loop."""


def step_tables(
    system: System, method: Any, representation: Any = None, fractions: Sequence[float] = (1.0,)
) -> CompiledTables:
    """Return the tables, a `Stepping` independent of the step, of a `CompiledStepMethod` with these substeps."""
    restored = method.restored(system)
    watched = invariants_table([], system.dim) if restored is None else watch_tables(system, restored)
    tables = _tables(system, group_of(system, representation), watched, *method.constants())
    return _stepping(step_address(method.compiled_step), fractions, tables)


def function_tables(
    system: System, function: int, fractions: Sequence[float] = (1.0,), compiled: bool = False
) -> CompiledTables:
    """Return the `Stepping` of a step at an address; if `compiled`, it reads the system from the tables."""
    constant = sum(term.constant for term in system.hamiltonian.terms())
    no_invariants = invariants_table([], system.dim)
    tables = _tables(
        system, group_of(system, None), no_invariants, [function], [constant], not system.has_compiled_bracket
    )

    def of_function() -> Sources:
        numbers = np.arange(CoefficientNumbers.of(system.hamiltonian.terms()).size)
        if not compiled:
            return Sources(computed={"whole": numbers})
        return Sources({"coefficients": Multiples(np.array([0]), numbers[-1:], np.ones(1))})

    return _stepping(step_address("step_function"), fractions, tables, of_function)


def numeric_step_tables(
    system: System,
    step: str,
    integers: Sequence[int],
    coefficients: Sequence[float],
    fractions: Sequence[float] = (1.0,),
) -> CompiledTables:
    """Return the tables, a `Stepping`, of a named step that reads only integers, coefficients and the dimension."""
    tables = _tables(system, group_of(system, None), invariants_table([], system.dim), integers, coefficients, True)
    return _stepping(step_address(step), fractions, tables)


def wrapped_step_tables(system: System, step: str, inner: CompiledLoop, restored: Mapping[str, Any]) -> CompiledTables:
    """Return the `Stepping` of a named step: one of `inner`, for one member, then a correction of `restored`."""
    integers, keepalive = inner_loop_integers(inner, system, None)
    return named_step_tables(system, step, watch_tables(system, restored), integers, None, keepalive)


def inner_loop_integers(inner: CompiledLoop, system: System, representation: Any) -> tuple[list[int], tuple[Any, ...]]:
    """Return the integers by which a step calls `inner`, a loop for one member, and the objects to keep alive. The
    integers are the addresses of the loop, of its tables and of an empty watch, the size of its memory, and the address
    of the tables that rotate the group element by the shift of the Hamiltonian, or 0.
    """
    loop = ctypes.cast(getattr(kernels(), f"{inner.name}_inside"), ctypes.c_void_p).value
    no_invariants = invariants_table([], system.dim)
    structure, watch = as_structure(inner.tables), as_structure(no_invariants.tables)
    keepalive, shift_address = (*no_invariants.keepalive, *inner.keepalive, inner, structure, watch), 0
    if inner.shift and representation is not None and system.algebra is not None:
        rho = given_matrices(representation)
        shift_tables = as_structure(unshift_tables(system.algebra, rho, system.sign, inner.shift))
        keepalive, shift_address = (*keepalive, shift_tables), ctypes.addressof(shift_tables)
    return [loop or 0, ctypes.addressof(structure), ctypes.addressof(watch), inner.memory, shift_address], keepalive


def named_step_tables(
    system: System,
    step: str,
    invariants: CompiledTables,
    integers: Sequence[int],
    representation: Any,
    keepalive: tuple[Any, ...],
    coefficients: Sequence[float] = (),
) -> CompiledTables:
    """Return the tables, a `Stepping`, of a named step that reads integers, coefficients and `invariants`."""
    tables = _tables(
        system,
        group_of(system, representation),
        replace(invariants, keepalive=(*invariants.keepalive, *keepalive)),
        integers,
        coefficients,
        not system.has_compiled_bracket,
    )

    def of_shift() -> Sources:
        return Sources(
            computed={"whole": CoefficientNumbers.of(system.hamiltonian.terms()).others} if integers[4] else {}
        )

    return _stepping(step_address(step), (1.0,), tables, of_shift)


def _tables(
    system: System,
    group: GroupField,
    invariants: CompiledTables,
    integers: Sequence[int],
    numbers: Sequence[float],
    called: bool = False,
) -> CompiledTables:
    field, keepalive = field_of(system, called)
    table = terms_of_field(system)
    values, values_keepalive = addresses_of(table.functions, len(table), "value", "the Hamiltonian")
    integer_array, coefficient_array = np.array(integers, dtype=np.int64), np.array(numbers, dtype=np.float64)
    tables = StepTables(field, values, group, invariants.tables, integer_array, coefficient_array)
    return CompiledTables(
        tables,
        (*keepalive, *values_keepalive, *invariants.keepalive),
        lambda: sources_of_field(system, field).and_of(invariants.sources().within("restored.")),
    )


def _stepping(
    step: int, fractions: Sequence[float], tables: CompiledTables, more: Callable[[], Sources] = Sources
) -> CompiledTables:
    """Return a step with its tables; `more` returns further sources of these."""
    lengths, moments = substeps(fractions)
    stepping = Stepping(np.array([step], dtype=np.int64), len(lengths), lengths, moments, tables.tables)
    return CompiledTables(stepping, tables.keepalive, lambda: tables.sources().and_of(more()).within("tables."))
