"""The record of a run: plain arrays and numbers, given, computed or read from files on first use."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray

    from coadjoint.kernels.arrays import Layout, NamedArrays
    from coadjoint.methods.protocol.method import Method
    from coadjoint.runs.events import RecordedEvents, TerminalEvent
    from coadjoint.runs.loops.loops import GroupCorrection
    from coadjoint.runs.start import Start
    from coadjoint.runs.times import Times
    from coadjoint.systems.batch import Batch
    from coadjoint.systems.system_checks import System


@dataclass(frozen=True)
class Statistics:
    """Work of a run.

    Parameters
    ----------
    steps : int
        Steps of each member.
    evaluations : int
        Elementary flows (splitting) or evaluations of the vector field, summed over members.
    iterations : int
        Iterations of implicit schemes, summed over members.
    seconds : float
        Wall-clock time in the loop over the steps, including compilation at the first call; in an ensemble in blocks
        summed over the workers.
    elapsed : float
        Wall-clock time of the call: validation, preparation, steps, and writing of an archive. NaN if it is not known.
    """

    steps: int
    evaluations: int
    iterations: int
    seconds: float
    elapsed: float = math.nan


class RunAttributes:
    """Attributes of a `Solution`, which are fields of its record; see there."""

    system: System | Batch
    method: Method
    watched: bool
    t: NDArray[np.float64]
    x: NDArray[Any]
    x0: NDArray[Any]
    t_eval: NDArray[np.float64] | None
    energy: NDArray[np.float64]
    casimirs: Mapping[str, NDArray[np.float64]]
    initial: Mapping[str, Any]
    work: Mapping[str, Mapping[str, NDArray[np.float64]]]
    observed: Mapping[str, NDArray[np.float64]]
    attitude: NDArray[np.float64] | None
    attitude0: NDArray[np.float64] | None
    carried: str | None
    failed: NDArray[np.bool_] | None
    events: RecordedEvents | None
    stats: Statistics
    incomplete: str | None
    t_span: tuple[float, float]
    asked_span: tuple[float, float]
    step: float
    save_every: int
    choice: Any
    path: Path
    attributes: dict[str, Any]
    inputs: Callable[..., dict[str, Any]]
    dataset: xarray.Dataset
    finished: bool
    reached: int
    check_complete: Callable[[], None]
    status: NDArray[np.int64]
    blocks: Sequence[Any]
    progress_text: str


class RunRecord(RunAttributes):
    """Arrays and numbers of a run, from which `Solution` is built.

    A field is given as a value, or as a function of the record that is called on first use. Copies have the fields of
    `COPIED_FIELDS`, as values.

    Attributes
    ----------
    system, method, watched, t, x, x0, ...
        The attributes of `Solution`; those of stored runs only where they apply.
    accounts : tuple of (str, str)
        Force and invariant of each column of recorded work.
    worst : ndarray, shape (tenths, k) or (members, tenths, k)
        Largest deviation of each invariant in each tenth of the run; then, with forces, those of the balances.
    starts : ndarray, shape (members, n), or None
        Initial momenta of a run with `accuracy`.
    error : ndarray, shape (1 + groups, members), or None
        Estimated errors at the end of the state and of its groups of coordinates, once they are known.
    times, start, ending
        Times, initial state, and the terminal event that ended the run.
    given_system, saved, state, saved_points, names, seconds, elapsed,
        corrected_groups, initial_values
        In memory: the system or a function that builds it, the arrays of the loops, and what is needed to read them.
    shared, layout, momenta, numbers
        Of short runs, from which the former are made: fields of all runs of a setup, and the arrays in one allocation.
    path, attributes, arrays, read, inputs, arguments
        Of stored runs: place, attributes and arrays; a function that reads an entire array; a function that returns
        the arguments of `integrate`, and its result.
    to_xarray, text, reopen
        Of some stored runs: a function that returns the dataset, the text of ``repr``, and a function with its
        arguments that makes a copy of the solution.
    """

    functions: Mapping[str, Callable[[RunRecord], Any]] = {}  # those of copies
    accounts: tuple[tuple[str, str], ...]
    worst: NDArray[np.float64]
    starts: NDArray[np.float64] | None
    error: NDArray[np.float64] | None

    times: Times
    start: Start
    ending: TerminalEvent | None

    given_system: System | Batch | partial[System | Batch]
    saved: NamedArrays
    state: NamedArrays
    saved_points: int
    names: list[str]
    seconds: float
    elapsed: float
    corrected_groups: GroupCorrection
    initial_values: NDArray[np.float64] | None

    shared: Mapping[str, Any]
    layout: Layout
    momenta: NDArray[np.float64]
    numbers: NDArray[np.float64]

    arrays: Mapping[str, Any]
    read: Callable[[str], NDArray[Any]]
    arguments: dict[str, Any]
    to_xarray: Callable[[], xarray.Dataset]
    text: str
    reopen: tuple[Callable[..., Any], tuple[Any, ...]]

    def __init__(self, functions: Mapping[str, Callable[[RunRecord], Any]], values: dict[str, Any]) -> None:
        values["functions"] = functions
        self.__dict__ = values

    def __contains__(self, name: str) -> bool:
        return name in self.__dict__ or name in self.functions

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name not in self.functions:
                raise AttributeError(f"the record of this run has no {name!r}")
            value = self.__dict__[name] = self.functions[name](self)
            return value

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in COPIED_FIELDS if name in self}


SOLUTION_FIELDS = RunAttributes.__annotations__
COPIED_FIELDS = (*SOLUTION_FIELDS, "accounts", "worst", "starts", "error")


def _t_span(record: RunRecord) -> tuple[float, float]:
    return record.times.t0, record.times.end if record.ending is None else record.ending.t


FROM_TIMES: Mapping[str, Callable[[RunRecord], Any]] = {
    "t_span": _t_span,
    "asked_span": lambda record: (record.times.t0, record.times.end),
    "step": lambda record: abs(record.times.h),
    "save_every": lambda record: record.times.save_every,
}
"""Fields of every kind of record."""
