"""Arrays of a run, results and working state, each group contiguous in memory for the compiled loops."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping, Set
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import kernel_interface
from coadjoint.kernels.tables.structures import as_structure

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
        """Return the memory address of an array."""
        return ctypes.addressof(as_c_double(self.numbers)) + 8 * self.offsets.slices[name].start

    def take(self, members: NDArray[np.int64], axis: int) -> NamedArrays:
        """Return the arrays of these members, in this order, along an axis common to all arrays."""
        copies = NamedArrays(self.offsets)
        for name in self.offsets.shapes:
            self[name].take(members, axis=axis, out=copies[name])
        return copies

    def subset(self, names: Iterable[str]) -> NamedArrays:
        """Return a copy of some of the arrays."""
        offsets = self.offsets
        copies = NamedArrays(ArrayOffsets({name: offsets.shapes[name] for name in names}, offsets.int64_names))
        for name in copies.offsets.shapes:
            copies[name][:] = self[name]
        return copies

    def copy(self) -> NamedArrays:
        """Return an independent copy."""
        copies = NamedArrays(self.offsets)
        copies.numbers[:] = self.numbers
        return copies


class Layout:
    """The arrays of a run by name, "saved" at K points and the "state" carried between steps, as the library describes
    them in `boundary/arrays.hpp`; matrices are transposed, and `worst` has the largest deviations in each tenth of the
    run.
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
        """Return the saved arrays in one allocation of `size` numbers."""
        # An array of no numbers has no address; nothing is then read at that of the state.
        return NamedArrays(self.saved, numbers[: self.saved.size or 1])

    def state_in(self, numbers: NDArray[np.float64]) -> NamedArrays:
        """Return the state in one allocation of `size` numbers."""
        return NamedArrays(self.state, numbers[self.saved.size :])

    def _offsets(self, kind: str) -> ArrayOffsets:
        description = kernel_interface()
        sizes = {**description.codes["Limit"], **self.extent._asdict()}
        arrays = description.arrays[kind]
        return ArrayOffsets(
            {name: tuple(sizes[axis] for axis in axes) for name, (_, axes) in arrays.items()},
            {name for name, (numbers, _) in arrays.items() if numbers == "integers"},
        )
