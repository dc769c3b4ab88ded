"""The arrays of a run: what it leaves, and what it works with, each in one block that the loops find their way in."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.library import pointed

TENTHS = 10
WHOLE = frozenset(("status", "step", "evaluations", "iterations"))
"""The arrays of whole numbers; all others are of float64."""


# The first number of a contiguous array that can be written to; twenty times quicker than its `ctypes`.
number_at: Any = ctypes.c_double.from_buffer


class Extent(NamedTuple):
    """How much there is: K saved points of M members, of dimension n, with d*d entries of a group element, I invariants
    and so many numbers that a member remembers from step to step.
    """

    members: int
    points: int
    size: int
    square: int
    invariants: int
    remembered: int


class Places:
    """Where arrays stand in a block, one after the other."""

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self.shapes = shapes
        self.slices: dict[str, slice] = {}
        self.size = 0
        for name, shape in shapes.items():
            self.slices[name] = slice(self.size, self.size + prod(shape))
            self.size += prod(shape)


class Block:
    """Arrays in one piece of memory, by name: `block["x"]` is a view."""

    __slots__ = ("address", "numbers", "places")

    def __init__(self, places: Places) -> None:
        self.places = places
        self.numbers = np.empty(places.size)
        self.address = ctypes.byref(number_at(self.numbers))

    def __getitem__(self, name: str) -> NDArray[Any]:
        found = self.numbers[self.places.slices[name]]
        return (found.view(np.int64) if name in WHOLE else found).reshape(self.places.shapes[name])

    def place_of(self, name: str) -> int:
        """Return where an array stands in memory."""
        return ctypes.addressof(number_at(self.numbers)) + 8 * self.places.slices[name].start

    def copy(self) -> Block:
        """Return another block with the same numbers."""
        other = Block(self.places)
        other.numbers[:] = self.numbers
        return other


class Layout:
    """The blocks of a run, in the order of `source/boundary/arrays.hpp`.

    Of what is left, the `results`: `x` (K, M, n); `group` (K, M, d*d), transposed matrices; `values` (K, M, I), of the
    invariants; `worst` (M, 10, I), the largest deviation in each tenth of the run; and of every member how it fares,
    (M,): `status`, the `step` that failed, the `residual` of its last iteration, and the work done, `evaluations`
    (elementary flows of a program, or evaluations of the vector field) and `iterations`.

    Of what is worked with, `work`: `first` and `last` (M, I), the values of the invariants at the start and at the step
    before; `momenta` (M, n) and `groups` (M, d*d), each followed by what compensated sums owe, `errors` and
    `group_errors`; and the `memory` (M, remembered) of a scheme.
    """

    def __init__(self, extent: Extent) -> None:
        members, points, size, square, invariants, remembered = extent
        self.table = pointed(extent)
        self.address = ctypes.byref(self.table)
        self.results = Places(
            {
                "x": (points, members, size),
                "group": (points, members, square),
                "values": (points, members, invariants),
                "worst": (members, TENTHS, invariants),
                "residual": (members,),
                **dict.fromkeys(("status", "step", "evaluations", "iterations"), (members,)),
            }
        )
        self.work = Places(
            {
                "first": (members, invariants),
                "last": (members, invariants),
                "momenta": (members, size),
                "errors": (members, size),
                "groups": (members, square),
                "group_errors": (members, square),
                "memory": (members, remembered),
            }
        )
