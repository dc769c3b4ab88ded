"""Arrays of a run, results and working state, each group contiguous in memory for the compiled loops."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping, Set
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import described
from coadjoint.kernels.structures import pointed

# First number of a contiguous, writable array as a ctypes object; twenty times faster than `array.ctypes`.
number_at: Any = ctypes.c_double.from_buffer


class Extent(NamedTuple):
    """Sizes of a run: K saved points, M members, dimension n, d*d entries of a group element, I invariants, and the
    numbers of scheme memory of a member.
    """

    members: int
    points: int
    size: int
    square: int
    invariants: int
    remembered: int


class Places:
    """Offsets of named arrays of 8-byte numbers in one contiguous allocation; names in `whole` are int64, all others
    float64.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]], whole: Set[str]) -> None:
        self.shapes, self.whole = shapes, whole
        self.slices: dict[str, slice] = {}
        self.size = 0
        for name, shape in shapes.items():
            self.slices[name] = slice(self.size, self.size + prod(shape))
            self.size += prod(shape)


class NamedArrays:
    """Arrays in one contiguous allocation, initially zero; `arrays["x"]` is a view."""

    __slots__ = ("address", "numbers", "places")

    def __init__(self, places: Places) -> None:
        self.places = places
        # At least one number: an empty array has no address.
        self.numbers = np.zeros(places.size or 1)
        self.address = ctypes.byref(number_at(self.numbers))

    def __getitem__(self, name: str) -> NDArray[Any]:
        places = self.places
        found = self.numbers[places.slices[name]]
        return (found.view(np.int64) if name in places.whole else found).reshape(places.shapes[name])

    def place_of(self, name: str) -> int:
        """Return the memory address of an array."""
        return ctypes.addressof(number_at(self.numbers)) + 8 * self.places.slices[name].start

    def take(self, members: NDArray[np.int64], axis: int) -> NamedArrays:
        """Return the arrays of these members, in this order, along an axis common to all arrays."""
        other = NamedArrays(self.places)
        for name in self.places.shapes:
            self[name].take(members, axis=axis, out=other[name])
        return other

    def only(self, names: Iterable[str]) -> NamedArrays:
        """Return a copy of some of the arrays."""
        places = self.places
        other = NamedArrays(Places({name: places.shapes[name] for name in names}, places.whole))
        for name in other.places.shapes:
            other[name][:] = self[name]
        return other

    def copy(self) -> NamedArrays:
        """Return an independent copy."""
        other = NamedArrays(self.places)
        other.numbers[:] = self.numbers
        return other


class Layout:
    """The arrays of a run, in the order, types and shapes that the library describes.

    `saved`, at K points: `x` (K, M, n); `group` (K, M, d*d), transposed matrices; `values` (K, M, I), invariants.

    `state`, everything a run carries from one step to the next: `momenta` (M, n) and `groups` (M, d*d), with the
    carries of their compensated sums, `errors` and `group_errors`; the `memory` (M, remembered) of a scheme; `first`
    and `last` (M, I), invariants at the start and after the previous step; `worst` (M, 10, I), their largest deviation
    in each tenth of the run; and for each member, (M,): `status`, the `step` that failed, the `residual` of its last
    iteration, and the work done, `evaluations` (elementary flows of a program, or evaluations of the vector field) and
    `iterations`.
    """

    def __init__(self, extent: Extent) -> None:
        self.extent = extent
        self.table = pointed(extent)
        self.address = ctypes.byref(self.table)
        self.saved, self.state = self._places("saved"), self._places("state")

    def _places(self, kind: str) -> Places:
        description = described()
        sizes = {**description.codes["Limit"], **self.extent._asdict()}
        arrays = description.arrays[kind]
        return Places(
            {name: tuple(sizes[axis] for axis in array.axes) for name, array in arrays.items()},
            {name for name, array in arrays.items() if array.kind == "integers"},
        )
