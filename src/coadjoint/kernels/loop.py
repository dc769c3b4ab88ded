"""Calls of the compiled time-stepping loops, the memory layout of a run that they share, and limits on BLAS threads."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterable, Mapping, Set
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, fields
from functools import cache, lru_cache, partial
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.kernels.interface import codes, kernel_interface
from coadjoint.kernels.library import interruptible_kernels, kernels
from coadjoint.kernels.tables.compiled import CompiledTables, as_structure

# First number of a contiguous, writable array as a ctypes object; twenty times faster than `array.ctypes`.
as_c_double: Any = ctypes.c_double.from_buffer


class Extent(NamedTuple):
    """Sizes of a run: M members, K points, dimension n, d*d entries of a group element, I invariants, scheme memory."""

    members: int
    points: int
    size: int
    square: int
    invariants: int
    memory_size: int


class ArrayOffsets:
    """Offsets of named arrays in one contiguous allocation: int64 for `int64_names`, otherwise float64."""

    def __init__(self, shapes: Mapping[str, tuple[int, ...]], int64_names: Set[str]) -> None:
        self.shapes, self.int64_names = shapes, int64_names
        self.slices: dict[str, slice] = {}
        self.size = 0
        for name, shape in shapes.items():
            self.slices[name] = slice(self.size, self.size + prod(shape))
            self.size += prod(shape)


class NamedArrays:
    """Arrays in one contiguous allocation, initially zero, or in given `numbers`; `arrays["x"]` is a view."""

    __slots__ = ("address", "numbers", "offsets")

    def __init__(self, offsets: ArrayOffsets, numbers: NDArray[np.float64] | None = None) -> None:
        self.offsets = offsets
        # At least one number: an empty array has no address.
        self.numbers = np.zeros(offsets.size or 1) if numbers is None else numbers
        self.address = ctypes.byref(as_c_double(self.numbers))

    def __getitem__(self, name: str) -> NDArray[Any]:
        offsets = self.offsets
        numbers = self.numbers[offsets.slices[name]]
        return (numbers.view(np.int64) if name in offsets.int64_names else numbers).reshape(offsets.shapes[name])

    def address_of(self, name: str) -> int:
        return ctypes.addressof(as_c_double(self.numbers)) + 8 * self.offsets.slices[name].start

    def take(self, members: NDArray[np.int64], axis: int) -> NamedArrays:
        """Return the arrays of these members, in this order, along an axis common to all arrays."""
        copies = NamedArrays(self.offsets)
        for name in self.offsets.shapes:
            self[name].take(members, axis=axis, out=copies[name])
        return copies

    def subset(self, names: Iterable[str]) -> NamedArrays:
        offsets = self.offsets
        copies = NamedArrays(ArrayOffsets({name: offsets.shapes[name] for name in names}, offsets.int64_names))
        for name in copies.offsets.shapes:
            copies[name][:] = self[name]
        return copies

    def copy(self) -> NamedArrays:
        copies = NamedArrays(self.offsets)
        copies.numbers[:] = self.numbers
        return copies


class Layout:
    """Arrays of a run, "saved" at K points and the "state" between steps, as in `boundary/arrays.hpp`.

    Matrices are transposed; `worst` has the largest deviations in each tenth of the run.
    """

    def __init__(self, extent: Extent) -> None:
        self.extent = extent
        self.table = as_structure(extent)
        self.address = ctypes.byref(self.table)
        self.saved, self.state = self._offsets("saved"), self._offsets("state")
        # Both in one allocation, as short runs have them.
        self.size, momenta = self.saved.size + self.state.size, self.state.slices["momenta"]
        self.momenta = slice(self.saved.size + momenta.start, self.saved.size + momenta.stop)

    def saved_in(self, numbers: NDArray[np.float64]) -> NamedArrays:
        # An array of no numbers has no address; nothing is then read at that of the state.
        return NamedArrays(self.saved, numbers[: self.saved.size or 1])

    def state_in(self, numbers: NDArray[np.float64]) -> NamedArrays:
        return NamedArrays(self.state, numbers[self.saved.size :])

    def _offsets(self, kind: str) -> ArrayOffsets:
        description = kernel_interface()
        sizes = {**description.codes["Limit"], **self.extent._asdict()}
        arrays = description.arrays[kind]
        return ArrayOffsets(
            {name: tuple(sizes[axis] for axis in axes) for name, (_, axes) in arrays.items()},
            {name for name, (numbers, _) in arrays.items() if numbers == "integers"},
        )


layout_of = lru_cache(maxsize=64)(Layout)

# Arguments of a loop: tables, watch, members, first, last, stride; extent, schedule, saved, state, k0, k1, stop. All
# are passed as C types: conversion by declared argtypes takes half as long as a short call.
as_int64: Any = ctypes.c_int64
# Arguments of a loop that takes all steps of a run, as numbers and addresses: tables, watch, members, first, last,
# stride, extent, schedule, stop.
WholeRun: Any = ctypes.c_int64 * 9


@dataclass(frozen=True, kw_only=True)
class CompiledLoop(CompiledTables):
    """A compiled loop: tables and name in the library; `memory`: numbers of a member that the scheme keeps.

    `work_integrals`: those behind the coordinates, as (force, invariant).
    """

    name: str
    shift: tuple[tuple[Polynomial, float], ...] = ()
    memory: int = 0
    work_integrals: tuple[tuple[str, str], ...] = ()


NEVER_STOPPED = ctypes.c_int64(0)
"""Flag of runs in the calling thread; 1 in another run's stops its loops within a fraction of a second."""


class MemberBatch:
    """Members `first` to `last` - 1 of one call of a loop, with its tables, plain or `as_structure`.

    With a nonzero `stride`, constants have one column per member from `base` on, padded to a multiple of 32 (SIMD).
    """

    def __init__(
        self, loop: str, tables: Any, watch: Any, first: int, last: int, stride: int = 0, base: int = 0
    ) -> None:
        self.count = last - first
        members = np.arange(base, last)
        columns = as_int64(first - base), as_int64(last - base), as_int64(stride)
        self._positions = ctypes.c_void_p(members.ctypes.data), *columns
        self._name, self._members = loop, members
        self._bind(as_structure(tables), as_structure(watch))

    def _bind(self, tables: Any, watch: Any) -> None:
        self._pointed_tables = tables, watch
        self._advance = partial(kernel_loop(self._name), ctypes.byref(tables), ctypes.byref(watch), *self._positions)

    def with_tables(self, tables: Any, watch: Any) -> MemberBatch:
        """Return the same members with other `as_structure` tables; faster than a new batch."""
        batch: MemberBatch = object.__new__(MemberBatch)
        batch.count, batch._positions = self.count, self._positions
        batch._name, batch._members = self._name, self._members
        batch._bind(tables, watch)
        return batch

    def among(self, members: Any) -> MemberBatch:
        """Return a batch of other members, ascending; the constants of its tables must not differ by member."""
        batch: MemberBatch = object.__new__(MemberBatch)
        batch._name, batch._members, batch.count = self._name, np.array(members, dtype=np.int64), len(members)
        address = ctypes.c_void_p(batch._members.ctypes.data)
        batch._positions = address, as_int64(0), as_int64(batch.count), as_int64(0)
        batch._bind(*self._pointed_tables)
        return batch

    def advance(
        self,
        layout: Layout,
        schedule: Any,
        saved: NamedArrays,
        state: NamedArrays,
        k0: int,
        k1: int,
        stop: ctypes.c_int64,
    ) -> int:
        """Take steps k0 + 1 to k1 (save the start if k0 is 0); return failed members, with those of nonfinite energy.

        An exception of a signal, such as KeyboardInterrupt, invalidates the arrays of the batch.
        """
        failed_count: int = self._advance(
            layout.address, schedule, saved.address, state.address, as_int64(k0), as_int64(k1), ctypes.byref(stop)
        )
        return failed_count if failed_count >= 0 else raise_outcome(failed_count)

    def whole_run(self, layout: Layout, schedule: Any) -> Callable[[Any], int]:
        """Return a function of the address of the arrays, saved then state, that takes all steps, for many calls.

        It returns the number of failed members (all if a momentum is not finite), or a negative outcome.
        """
        pointed = *self._pointed_tables, layout.table, schedule, NEVER_STOPPED
        tables, watch, extent, schedule_address, stop = map(ctypes.addressof, pointed)
        members, first, last, stride = (int(position.value or 0) for position in self._positions)
        run = WholeRun(tables, watch, members, first, last, stride, extent, schedule_address, stop)
        run.pointed = pointed, self._members
        return partial(kernel_loop(f"{self._name}_whole"), ctypes.byref(run))


@cache
def kernel_loop(name: str) -> Any:
    """Return a function of the library that can be interrupted, and that returns a count or a negative outcome."""
    function = getattr(interruptible_kernels(), name)
    function.restype = as_int64
    return function


def raise_outcome(outcome: int) -> int:
    """Raise the exception of a loop that ended before its last step."""
    if outcome == codes("Outcome")["NO_MEMORY"]:
        raise MemoryError("not enough memory for the working arrays of the loop")
    raise KeyboardInterrupt


def scheme_memory(loop: str, tables: Any) -> int:
    """Return the numbers of scheme memory per member for a loop in the library and its tables."""
    function, table = getattr(kernels(), f"{loop}_memory_size"), as_structure(tables)
    function.restype = ctypes.c_int64
    count = int(function(ctypes.byref(table)))
    if count < 0:
        raise MemoryError("not enough memory for the step plan of the loop")
    return count


def loop_over(name: str, tables: CompiledTables, **more: Any) -> CompiledLoop:
    """Return the loop of this name in the library with its tables, and with the memory that its scheme keeps."""
    common = {one.name: getattr(tables, one.name) for one in fields(CompiledTables)}
    return CompiledLoop(**{**common, **more}, name=name, memory=scheme_memory(name, tables.tables))


CONCURRENT_ROWS = 128
"""Above this number of rows, threads share the steps of one member after the other: several need much memory."""


def matrix_rows(system: Any) -> int:
    """Return the number of rows of the matrices of a system; 0 if its states are vectors."""
    shape = system.shape
    return 0 if len(shape) == 1 else int(shape[-1])


@cache
def cores() -> int:
    """Return the number of cores of the machine."""
    return os.cpu_count() or 1


def concurrent_members(rows: int) -> int:
    """Return the number of members to advance concurrently: 1 for large matrices, whose steps threads share."""
    return 1 if rows > CONCURRENT_ROWS else cores()


def single_blas_thread(rows: int) -> AbstractContextManager[Any]:
    """Limit BLAS to one thread in the context: the threads of a run share products; not for vectors (`rows` 0)."""
    return _pools().limit(limits=1) if rows else nullcontext()


@cache
def _pools() -> Any:
    import scipy.linalg.blas  # noqa: F401, loads SciPy's BLAS so that threadpoolctl finds it
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")
