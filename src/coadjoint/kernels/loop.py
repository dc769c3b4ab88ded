"""The compiled loops over steps: one way of calling them for all families of schemes."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np

from coadjoint.algebra.polynomial import Polynomial
from coadjoint.kernels.arrays import Layout, NamedArrays
from coadjoint.kernels.description import codes
from coadjoint.kernels.library import kernels, listening_kernels
from coadjoint.kernels.structures import pointed
from coadjoint.program.parts import Parts

# What a loop takes: tables, watch, members, first, last, stride; extent, schedule, saved, state, k0, k1, stop. All are
# given as what they are in C. To have them converted, by declared types, takes half as long as a short call.
number: Any = ctypes.c_int64


@dataclass(frozen=True)
class CompiledLoop:
    """A compiled loop over steps, by its name in the library, with its tables.

    Parameters
    ----------
    name : str
        The name of the loop.
    tables : NamedTuple
        What it reads.
    keep : tuple
        What must live as long: the machine code of functions of the user.
    shift : tuple of (Polynomial, float)
        What was taken off the Hamiltonian, Casimirs and factors: it turns the group element at output.
    memory : int
        How many numbers a member remembers from step to step.
    accounts : tuple of (str, str)
        What forces have done is added up behind the coordinates of a state: for each place the force and the invariant.
    parts : Parts or None
        The parts whose flows it takes, where it is made of flows.
    held : mapping of int to CompiledLoop or NamedTuple
        What the step reads at addresses: the place of the address among the whole numbers of its tables -> a loop whose
        steps it takes inside, or a table.
    """

    name: str
    tables: Any
    keep: tuple[Any, ...] = ()
    shift: tuple[tuple[Polynomial, float], ...] = ()
    memory: int = 0
    accounts: tuple[tuple[str, str], ...] = ()
    parts: Parts | None = None
    held: Mapping[int, Any] = field(default_factory=dict)

    def raised(self) -> BaseException | None:
        """Return what a function of the user has raised in the loop, once, if it did."""
        return next((error for kept in self.keep if (error := getattr(kept, "raised", lambda: None)())), None)


class Stop:
    """How another thread tells the loops of a run to end."""

    def __init__(self) -> None:
        self._said = ctypes.c_int64(0)
        self.address = ctypes.byref(self._said)

    def say(self) -> None:
        """Let every loop that was given this end, within a fraction of a second."""
        self._said.value = 1


class Crew:
    """The members that one call of a loop advances, first to last - 1, and what the loop reads for them.

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
        members = np.arange(base, last)
        places = number(first - base), number(last - base), number(stride)
        self._places = ctypes.c_void_p(members.ctypes.data), *places
        self._loop, self._members = _loop(loop), members
        self._read(pointed(tables), pointed(watch))

    def _read(self, tables: Any, watch: Any) -> None:
        self._given = tables, watch
        self._advance = partial(self._loop, ctypes.byref(tables), ctypes.byref(watch), *self._places)

    def reading(self, tables: Any, watch: Any) -> Crew:
        """Return the same members with other tables, `pointed`; in less time than a new crew takes."""
        other: Crew = object.__new__(Crew)
        other.count, other._places = self.count, self._places
        other._loop, other._members = self._loop, self._members
        other._read(tables, watch)
        return other

    def among(self, members: Any) -> Crew:
        """Return a crew of other members, ascending, that reads the same; its constants must not differ by member."""
        other: Crew = object.__new__(Crew)
        other._loop, other._members, other.count = self._loop, np.array(members, dtype=np.int64), len(members)
        address = ctypes.c_void_p(other._members.ctypes.data)
        other._places = address, number(0), number(other.count), number(0)
        other._read(*self._given)
        return other

    def advance(
        self, layout: Layout, schedule: Any, saved: NamedArrays, state: NamedArrays, k0: int, k1: int, stop: Stop
    ) -> int:
        """Take the steps k0 + 1 to k1 of the `pointed` schedule; where k0 is 0 the start is saved first.

        In the main thread signals are heard meanwhile, some times a second, and what their handlers raise is raised
        here. The other threads hear `stop`.

        Returns how many of the members have failed. After the last step, members whose energy is not finite count too.

        Raises
        ------
        KeyboardInterrupt
            Or what else a handler of signals raises, or `stop` was said. The arrays of the crew are then of no use.
        MemoryError
            There is none for what the loop works with.
        """
        wrong: int = self._advance(
            layout.address, schedule, saved.address, state.address, number(k0), number(k1), stop.address
        )
        return wrong if wrong >= 0 else refused(wrong)

    def repeated(
        self, layout: Layout, schedule: bytes, saved: NamedArrays, state: NamedArrays, steps: int, stop: Stop
    ) -> Callable[[], int]:
        """Return what takes the steps 1 to `steps`, for many calls with the same arrays.

        It returns how many members have failed; a negative number is for `refused`.
        """
        arrays = layout.address, schedule, saved.address, state.address
        return partial(self._advance, *arrays, number(0), number(steps), stop.address)


@cache
def _loop(name: str) -> Any:
    found = getattr(listening_kernels(), name)
    found.restype = number
    return found


def refused(outcome: int) -> int:
    """Raise what a loop says that did not take all of its steps."""
    if outcome == codes("Outcome")["NO_MEMORY"]:
        raise MemoryError("there is no memory for the working arrays of the loop")
    raise KeyboardInterrupt


def remembered(loop: str, tables: Any) -> int:
    """Return how many numbers a member remembers from step to step.

    Parameters
    ----------
    loop : str
        The name of the loop in the library.
    tables : NamedTuple
        Tables of the scheme.

    Returns
    -------
    int
    """
    ask, table = getattr(kernels(), f"{loop}_remembers"), pointed(tables)
    ask.restype = ctypes.c_int64
    count = int(ask(ctypes.byref(table)))
    if count < 0:
        raise MemoryError("there is no memory to lay out the steps of the loop")
    return count
