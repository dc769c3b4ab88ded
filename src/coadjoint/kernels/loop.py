"""The compiled loops over steps: one way of calling them for all families of schemes."""

from __future__ import annotations

import ctypes
from functools import cache, partial
from typing import Any

import numpy as np

from coadjoint.kernels.arrays import Block, Layout
from coadjoint.kernels.library import kernels, pointed

# Tables, watch, members, first, last, stride; extent, schedule, results, work, k0, k1.
ARGUMENTS = [ctypes.c_void_p] * 3 + [ctypes.c_int64] * 3 + [ctypes.c_void_p] * 4 + [ctypes.c_int64] * 2


class Crew:
    """The members that one call of a loop advances, first to last - 1, with what it reads for them.

    Parameters
    ----------
    loop : str
        The name of the loop in the library.
    tables, watch : NamedTuple
        Tables of the scheme and of the invariants, as they are or `pointed`.
    first, last : int
        The members.
    stride : int
        With it the constants of the tables differ by member: `stride` of them side by side, where there was one. They
        are read in whole lanes, 32 at most: the last must be followed by as many.
    base : int
        The member that the first of them belong to.

    Attributes
    ----------
    count : int
        How many members there are.
    """

    def __init__(
        self, loop: str, tables: Any, watch: Any, first: int, last: int, stride: int = 0, base: int = 0
    ) -> None:
        self.count = last - first
        given, members = (pointed(tables), pointed(watch)), np.arange(base, last)
        self._keep = given, members
        places = members.ctypes.data, first - base, last - base, stride
        self._advance = partial(_loop(loop), *map(ctypes.byref, given), *places)

    def advance(self, layout: Layout, schedule: Any, results: Block, work: Block, k0: int, k1: int) -> int:
        """Take the steps k0 + 1 to k1 of the `pointed` schedule; where k0 is 0 the start is saved first.

        Returns how many of the members have failed; after the last step also those of an energy that is not finite.
        """
        return self._advance(layout.address, schedule, results.address, work.address, k0, k1)


@cache
def _loop(name: str) -> Any:
    found = getattr(kernels(), name)
    found.argtypes, found.restype = ARGUMENTS, ctypes.c_int64
    return found


def widest_crowd() -> int:
    """Return the dimension up to which the loops advance members side by side."""
    return int(kernels().widest_crowd())
