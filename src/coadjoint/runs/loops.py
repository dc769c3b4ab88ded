"""The compiled loops of a run, made once for a system and a step: who is advanced by which tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomial import Polynomial
from coadjoint.kernels.varied_tables import BLOCK
from coadjoint.methods.base import Method, System
from coadjoint.runs.prepare import loop_of
from coadjoint.runs.start import Representation, Start
from coadjoint.runs.unshift import unshifted
from coadjoint.systems.lie_poisson import LiePoissonSystem

Crew = tuple[int, int]
"""The members first to last - 1, which one call of a compiled loop advances."""


class Work(NamedTuple):
    """What a compiled loop reads for a crew."""

    advance: Callable[..., None]
    tables: Any
    watch: Any


class Loops(Protocol):
    """What a run needs of its system; it does not change, so that many runs, in several threads, may share it."""

    @property
    def order(self) -> NDArray[np.int64] | None:
        """In which order a run holds the members, where that is not the order in which they were given."""

    @property
    def names(self) -> list[str]:
        """The invariants that are followed, the energy first."""

    @property
    def memory(self) -> int:
        """How many numbers a member remembers from step to step."""

    def record_start(self, saves: Any, schedule: Any, state: tuple[NDArray[np.float64], ...]) -> None:
        """Save the initial states, and the values that deviations are measured from."""

    def rounds(self, members: int, workers: int) -> list[list[Crew]]:
        """Return the crews that are at work together, one round after the other."""

    def work(self, crew: Crew) -> Work:
        """Return what advances a crew."""

    def started(self, groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the group elements (members, d, d) that the loops start from."""

    def turned(self, start: Start, elapsed: NDArray[np.float64], groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the group elements (k, members, d, d) of the run from those of the loops."""


class SystemLoops:
    """One system: every member has the same tables.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        What moves.
    method : Method
        The scheme.
    h : float
        Step, negative for backward.
    representation : ndarray of shape (n, d, d), "coadjoint", or None
        What the group element is carried in.
    casimirs : mapping, optional
        The invariants that are followed beside the energy; None is all Casimirs of the system.
    """

    order: NDArray[np.int64] | None = None

    def __init__(
        self,
        system: System,
        method: Method,
        h: float,
        representation: Representation,
        casimirs: Mapping[str, Any] | None = None,
    ) -> None:
        from coadjoint.kernels.library import pointed
        from coadjoint.kernels.loop import widest_crowd
        from coadjoint.kernels.tables import watch_tables
        from coadjoint.kernels.watching import record_start

        followed = system.casimirs if casimirs is None else casimirs
        prepared, watch = loop_of(system, method, h, representation), watch_tables(system, followed)
        self.names = ["energy", *followed]
        self._system, self._shift = system, prepared.shift
        self._keep = (prepared.keep, watch.keep)
        self._record_start = record_start
        self._block = BLOCK if system.dim <= widest_crowd() else 1
        # As C structures once, not at each call.
        self._work = Work(prepared.advance, pointed(prepared.tables), pointed(watch.tables))
        self.memory = prepared.memory

    def record_start(self, saves: Any, schedule: Any, state: tuple[NDArray[np.float64], ...]) -> None:
        """Save the initial states, and the values that deviations are measured from."""
        self._record_start(self._work.watch, saves, schedule, state, (0, len(state[0])))

    def rounds(self, members: int, workers: int) -> list[list[Crew]]:
        """Return one round, of a crew for each worker; what the kernels advance side by side stays together."""
        return [crews_of(0, members, workers, self._block)]

    def work(self, crew: Crew) -> Work:
        """Return what advances every crew."""
        return self._work

    def started(self, groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return unit elements for a shifted run (`turned` puts the initial ones before them), else the given ones."""
        return start_of_loop(self._shift, groups)

    def turned(self, start: Start, elapsed: NDArray[np.float64], groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the group elements of the run from those of the loop."""
        return unshifted_groups(self._system, self._shift, start, elapsed, groups)


def crews_of(first: int, last: int, workers: int, block: int) -> list[Crew]:
    """Return the members first to last - 1 as a crew for each worker, of whole blocks.

    Examples
    --------
    >>> crews_of(0, 100, 2, 32)
    [(0, 64), (64, 100)]
    """
    blocks = -(-(last - first) // block)
    return list(pairwise(min(last, first + blocks * w // workers * block) for w in range(workers + 1)))


def start_of_loop(shift: tuple[Any, ...], groups: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the group elements (members, d, d) that a loop starts from: units where a Casimir was taken off H."""
    return np.broadcast_to(np.eye(groups.shape[-1]), groups.shape) if shift and groups.size else groups


def unshifted_groups(
    system: System,
    shift: tuple[tuple[Polynomial, float], ...],
    start: Start,
    elapsed: NDArray[np.float64],
    groups: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return group elements (k, members, d, d), turned by the Casimirs that were taken off the Hamiltonian."""
    if not shift or start.representation is None:
        return groups
    assert isinstance(system, LiePoissonSystem)
    return unshifted(system, shift, start.representation, start.momenta, start.groups, elapsed, groups)
