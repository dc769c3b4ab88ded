"""Calls of the compiled loops over steps, common to all families of schemes."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.kernels.arrays import Layout, NamedArrays
from coadjoint.kernels.interface import codes
from coadjoint.kernels.library import interruptible_kernels, kernels
from coadjoint.kernels.structures import as_structure
from coadjoint.program.parts.part import Parts

# Arguments of a loop: tables, watch, members, first, last, stride; extent, schedule, saved, state, k0, k1, stop. All
# are passed as C types: conversion by declared argtypes takes half as long as a short call.
as_int64: Any = ctypes.c_int64


@dataclass(frozen=True)
class CompiledLoop:
    """A compiled loop over steps: its name in the library, and its tables.

    Parameters
    ----------
    name : str
        Name of the loop.
    tables : NamedTuple
        Tables that it reads.
    keep : tuple
        Objects that must live as long: the machine code of functions of the user.
    shift : tuple of (Polynomial, float)
        Casimirs and factors subtracted from the Hamiltonian; they rotate the group element at output.
    memory : int
        Numbers of scheme memory per member, carried from step to step.
    accounts : tuple of (str, str)
        Force and invariant of each entry after the coordinates of a state, which accumulates the change by the force.
    parts : Parts or None
        The parts whose flows it computes, if the scheme consists of flows.
    held : mapping of int to CompiledLoop or NamedTuple
        Objects that the step reads by address: position of the address among the integers of its tables -> an inner
        loop, or a table.
    """

    name: str
    tables: Any
    keepalive: tuple[Any, ...] = ()
    shift: tuple[tuple[Polynomial, float], ...] = ()
    memory: int = 0
    accounts: tuple[tuple[str, str], ...] = ()
    parts: Parts | None = None
    referenced: Mapping[int, Any] = field(default_factory=dict)

    def raised(self) -> BaseException | None:
        """Return and clear the exception that a function of the user raised in the loop, if any."""
        return next((error for kept in self.keepalive if (error := getattr(kept, "raised", lambda: None)())), None)


class StopFlag:
    """A flag with which another thread stops the loops of a run."""

    def __init__(self) -> None:
        self._flag = ctypes.c_int64(0)
        self.address = ctypes.byref(self._flag)

    def request(self) -> None:
        """Stop all loops that were given this flag, within a fraction of a second."""
        self._flag.value = 1


class MemberBatch:
    """The members first to last - 1 that one call of a loop advances, with the tables that it reads for them.

    Parameters
    ----------
    loop : str
        Name of the loop in the library.
    tables, watch : NamedTuple
        Tables of the scheme and of the invariants, plain or `as_structure`.
    first, last : int
        The members.
    stride : int
        If nonzero, constants differ by member: each is an array of `stride` columns. They are read in whole lanes,
        up to 32: the last column must be followed by as many.
    base : int
        The member of the first column.
    """

    def __init__(
        self, loop: str, tables: Any, watch: Any, first: int, last: int, stride: int = 0, base: int = 0
    ) -> None:
        self.count = last - first
        members = np.arange(base, last)
        places = as_int64(first - base), as_int64(last - base), as_int64(stride)
        self._positions = ctypes.c_void_p(members.ctypes.data), *places
        self._loop, self._members = _loop(loop), members
        self._read(as_structure(tables), as_structure(watch))

    def _read(self, tables: Any, watch: Any) -> None:
        self._pointed_tables = tables, watch
        self._advance = partial(self._loop, ctypes.byref(tables), ctypes.byref(watch), *self._positions)

    def with_tables(self, tables: Any, watch: Any) -> MemberBatch:
        """Return the same members with other `as_structure` tables; faster than a new crew."""
        other: MemberBatch = object.__new__(MemberBatch)
        other.count, other._positions = self.count, self._positions
        other._loop, other._members = self._loop, self._members
        other._read(tables, watch)
        return other

    def among(self, members: Any) -> MemberBatch:
        """Return a crew of other members, ascending, with the same tables; its constants must not differ by member."""
        other: MemberBatch = object.__new__(MemberBatch)
        other._loop, other._members, other.count = self._loop, np.array(members, dtype=np.int64), len(members)
        address = ctypes.c_void_p(other._members.ctypes.data)
        other._positions = address, as_int64(0), as_int64(other.count), as_int64(0)
        other._read(*self._pointed_tables)
        return other

    def advance(
        self, layout: Layout, schedule: Any, saved: NamedArrays, state: NamedArrays, k0: int, k1: int, stop: StopFlag
    ) -> int:
        """Take the steps k0 + 1 to k1 of the `as_structure` schedule, and save the start if k0 is 0; return the number
        of failed members.

        Members whose energy is not finite after the last step count as failed. Signals are handled several times a
        second in the main thread, other threads check `stop`; the resulting exception, such as KeyboardInterrupt,
        invalidates the arrays of the crew. Raise MemoryError if there is no memory for the working arrays.
        """
        failed_count: int = self._advance(
            layout.address, schedule, saved.address, state.address, as_int64(k0), as_int64(k1), stop.address
        )
        return failed_count if failed_count >= 0 else raise_outcome(failed_count)

    def bound_advance(
        self, layout: Layout, schedule: bytes, saved: NamedArrays, state: NamedArrays, steps: int, stop: StopFlag
    ) -> Callable[[], int]:
        """Return a function that takes the steps 1 to `steps`, for many calls with the same arrays.

        It returns the number of failed members, or a negative outcome for `raise_outcome`.
        """
        arrays = layout.address, schedule, saved.address, state.address
        return partial(self._advance, *arrays, as_int64(0), as_int64(steps), stop.address)


@cache
def _loop(name: str) -> Any:
    found = getattr(interruptible_kernels(), name)
    found.restype = as_int64
    return found


def raise_outcome(outcome: int) -> int:
    """Raise the exception of a loop that ended before its last step."""
    if outcome == codes("Outcome")["NO_MEMORY"]:
        raise MemoryError("there is no memory for the working arrays of the loop")
    raise KeyboardInterrupt


def scheme_memory(loop: str, tables: Any) -> int:
    """Return the numbers of scheme memory per member for a loop in the library and its tables."""
    ask, table = getattr(kernels(), f"{loop}_remembers"), as_structure(tables)
    ask.restype = ctypes.c_int64
    count = int(ask(ctypes.byref(table)))
    if count < 0:
        raise MemoryError("there is no memory for the step plan of the loop")
    return count
