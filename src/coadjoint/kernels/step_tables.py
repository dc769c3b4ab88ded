"""From a system and a step method to the arrays of the compiled loop."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from coadjoint.kernels.field import GroupField
from coadjoint.kernels.field_tables import field_of, group_of, substeps
from coadjoint.kernels.library import kernels
from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.stepping import Stepping, StepTables, step_address
from coadjoint.kernels.structures import pointed
from coadjoint.kernels.tables import Compiled, addresses_of, invariants_table, watch_tables
from coadjoint.kernels.watching import Watch
from coadjoint.program.term_table import TermTable
from coadjoint.program.unshift import unshift_tables
from coadjoint.systems.kinds import System, tabulated

PLACE_OF_INNER = 1
"""Where among the whole numbers the address of the tables of an inner loop stands."""


class CompiledStep(Protocol):
    """What a scheme with a compiled step says of itself."""

    @property
    def compiled_step(self) -> Any:
        """The step, by its name in the library, or its address."""

    def constants(self) -> tuple[Sequence[int], Sequence[float]]:
        """Return the whole numbers and the coefficients that it reads."""

    def restored(self, system: System) -> Mapping[str, Any] | None:
        """Return the invariants that it restores."""


def step_tables(
    system: System, method: CompiledStep, representation: Any = None, fractions: Sequence[float] = (1.0,)
) -> Compiled:
    """Return a step method on a system as arrays for the loop of `coadjoint.kernels.stepping`.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    method : CompiledStep
        The scheme of one substep.
    representation : None, "coadjoint" or (n, d, d) array
        The group element that is carried along.
    fractions : sequence of float
        Lengths of the substeps of a step.

    Returns
    -------
    Compiled
        With a `Stepping`; it does not depend on the step.

    Raises
    ------
    TypeError
        A function of the user cannot be compiled.
    """
    restored = method.restored(system)
    watched = invariants_table([], system.dim) if restored is None else watch_tables(system, restored)
    made = _tables(system, group_of(system, representation), watched.tables, *method.constants())
    return _stepping(step_address(method.compiled_step), fractions, *made, watched.keep)


def function_tables(system: System, function: int, fractions: Sequence[float] = (1.0,)) -> Compiled:
    """Return the same for a step that is a function, at an address.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    function : int
        Where the function stands.
    fractions : sequence of float
        Lengths of the substeps of a step.

    Returns
    -------
    Compiled
        With a `Stepping`.
    """
    constant = sum(term.constant for term in system.hamiltonian.terms())
    none = invariants_table([], system.dim)
    made = _tables(system, group_of(system, None), none.tables, [function], [constant], not tabulated(system))
    return _stepping(step_address("step_function"), fractions, *made, ())


def step_numbers(
    system: System, step: str, whole: Sequence[int], coefficients: Sequence[float], fractions: Sequence[float] = (1.0,)
) -> Compiled:
    """Return the tables of a step of this library that reads nothing of the system but these numbers.

    Parameters
    ----------
    system : GeneralSystem
        For its dimension.
    step : str
        The name of the step.
    whole, coefficients : sequences
        What it reads.
    fractions : sequence of float
        Lengths of the substeps of a step.

    Returns
    -------
    Compiled
        With a `Stepping`.
    """
    none = invariants_table([], system.dim)
    made = _tables(system, group_of(system, None), none.tables, whole, coefficients, True)
    return _stepping(step_address(step), fractions, *made, none.keep)


def tables_around(system: System, step: str, inner: CompiledLoop, restored: Mapping[str, Any]) -> Compiled:
    """Return the tables of a step that takes a step of another loop, and then restores invariants.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    step : str
        The name of the step.
    inner : CompiledLoop
        The other loop, of one member.
    restored : mapping
        Name -> `Polynomial` or `Quadratic`, beside the energy.

    Returns
    -------
    Compiled
        With a `Stepping`.
    """
    places, keep = places_of(inner, system, None)
    return step_tables_of(system, step, watch_tables(system, restored), places, None, keep)


def places_of(inner: CompiledLoop, system: System, representation: Any) -> tuple[list[int], tuple[Any, ...]]:
    """Return what a step reads that takes a step of another loop, and what must live as long.

    Parameters
    ----------
    inner : CompiledLoop
        The other loop, of one member.
    system : LiePoissonSystem or PoissonSystem
        The system.
    representation : None, "coadjoint" or (n, d, d) array
        The group element that is carried along.

    Returns
    -------
    places : list of int
        Addresses of the loop, of its tables and of a watch of nothing, how many numbers it remembers, and the address
        of the tables by which what was taken off the Hamiltonian turns the group element, or zero.
    keep : tuple
    """
    loop = ctypes.cast(getattr(kernels(), f"{inner.name}_inside"), ctypes.c_void_p).value
    none = invariants_table([], system.dim)
    read, watch = pointed(inner.tables), pointed(none.tables)
    keep, turning = (*none.keep, *inner.keep, inner, read, watch), 0
    if inner.shift and representation is not None and system.algebra is not None:
        rho = None if isinstance(representation, str) else representation
        tables = pointed(unshift_tables(system.algebra, rho, system.sign, inner.shift))
        keep, turning = (*keep, tables), ctypes.addressof(tables)
    return [loop or 0, ctypes.addressof(read), ctypes.addressof(watch), inner.memory, turning], keep


def step_tables_of(
    system: System,
    step: str,
    kept: Compiled,
    whole: Sequence[int],
    representation: Any,
    keep: tuple[Any, ...],
    coefficients: Sequence[float] = (),
) -> Compiled:
    """Return the tables of a step of this library that reads whole numbers and invariants.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    step : str
        The name of the step.
    kept : Compiled
        The invariants, a `Watch`.
    whole : sequence of int
        The whole numbers.
    representation : None, "coadjoint" or (n, d, d) array
        The group element that is carried along.
    keep : tuple
        What must live as long.
    coefficients : sequence of float
        The coefficients.

    Returns
    -------
    Compiled
        With a `Stepping`.
    """
    made = _tables(system, group_of(system, representation), kept.tables, whole, coefficients, not tabulated(system))
    return _stepping(step_address(step), (1.0,), *made, (*kept.keep, *keep))


def _tables(
    system: System,
    group: GroupField,
    kept: Watch,
    integers: Sequence[int],
    numbers: Sequence[float],
    called: bool = False,
) -> tuple[StepTables, tuple[Any, ...]]:
    field, keep = field_of(system, called)
    table = TermTable()
    for term in system.hamiltonian.terms():
        table.add(term)
    values, values_kept = addresses_of(table.functions, len(table), "value", "the Hamiltonian")
    whole, coefficients = np.array(integers, dtype=np.int64), np.array(numbers, dtype=np.float64)
    return StepTables(field, values, group, kept, whole, coefficients), (*keep, *values_kept)


def _stepping(
    step: int, fractions: Sequence[float], tables: StepTables, keep: tuple[Any, ...], more: tuple[Any, ...]
) -> Compiled:
    lengths, moments = substeps(fractions)
    stepping = Stepping(np.array([step], dtype=np.int64), len(lengths), lengths, moments, tables)
    return Compiled(stepping, (*keep, *more))
