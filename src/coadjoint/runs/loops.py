"""The compiled loops of a run, made once for a system and a step: which members are advanced by which tables."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import Extent, Layout, NamedArrays
from coadjoint.kernels.blas_threads import rows_of
from coadjoint.kernels.loop import CompiledLoop, Crew
from coadjoint.methods.base import Method
from coadjoint.runs.rows_of_crews import Pieces, Tables, shared_out
from coadjoint.runs.shifted_attitude import Unshift, plainly
from coadjoint.runs.start import Representation, Start
from coadjoint.runs.times import Times
from coadjoint.systems.kinds import System, unforced
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.quadratic import Quadratic

NOTHING = Quadratic(0.0)
"""Stands for an invariant that the loops do not follow."""
OF_THIS_PROCESS = ("prepared", "watch", "_keep", "_given", "_plan")
"""What loops of a system have addresses in, and what is made of these."""
Turned = Callable[[Start, Times, NamedArrays, int], NDArray[np.float64]]


class Plan:
    """What runs of so many members and saved points have in common.

    Attributes
    ----------
    layout : Layout
        Of their arrays.
    rounds : list of list of Crew
        The crews that are at work together, one round after the other.
    """

    def __init__(self, key: tuple[int, ...], layout: Layout, rounds: list[list[Crew]]) -> None:
        self.key, self.layout, self.rounds = key, layout, rounds


class Loops(ABC):
    """The compiled loops of a run, and what else it needs of its system; runs in several threads may share them.

    Attributes
    ----------
    order : ndarray or None
        In which order a run holds the members, where that is not the order in which they were given.
    names : list of str
        The invariants that are followed, the energy first.
    accounts : tuple of (str, str)
        What the places behind the coordinates of a state add up: what a force has done to an invariant. Where there are
        any, each of `names` is followed once more, less what forces have done to it.
    size : int
        How many numbers a state has: the dimension of the system, and the accounts.
    memory : int
        How many numbers a member remembers from step to step.
    rows : int
        Of the matrices that move, or 0.
    measures : bool
        Whether `measure` has something to do.
    block : int
        So many members with the same tables go side by side.
    turned : callable
        ``turned(start, times, saved, points)`` returns the group elements (points, members, d, d) of the run from
        those that the loops left. It does not keep the tables of the loops alive.
    """

    order: NDArray[np.int64] | None = None
    names: list[str]
    accounts: tuple[tuple[str, str], ...] = ()
    size: int
    memory: int
    rows: int = 0
    measures: bool = False
    block: int = 1
    turned: Turned
    _plan: Plan | None = None

    @property
    def followed(self) -> int:
        """How many numbers are followed of a member."""
        return len(self.names) * (2 if self.accounts else 1)

    def plan(self, members: int, points: int, square: int, workers: int) -> Plan:
        """Return the plan of a run; that of the last one is kept."""
        key = (members, points, square, workers)
        plan = self._plan
        if plan is None or plan.key != key:
            extent = Extent(members, points, self.size, square, self.followed, self.memory)
            plan = self._plan = Plan(key, Layout(extent), self.rounds(members, workers))
        return plan

    @abstractmethod
    def rounds(self, members: int, workers: int) -> list[list[Crew]]:
        """Return the crews that are at work together, one round after the other."""

    def rounds_among(self, members: NDArray[np.int64], workers: int) -> list[list[Crew]] | None:
        """Return the crews of some members, ascending, side by side; None where that is not possible."""
        return None

    @abstractmethod
    def pieces(self, watch: Any = None) -> Pieces:
        """Return the tables of the members, with another watch where one is given."""

    def attitude_may_overflow(self, start: Start, times: Times) -> bool:
        """Return whether `turned` might make elements that are not finite from those of the loops, which are."""
        return any(unshift.may_overflow(start, times) for unshift in self.unshifts)

    def make_all(self) -> None:
        """Make now what would be made when it is first needed."""
        for unshift in self.unshifts:
            unshift.make()

    @property
    def unshifts(self) -> Sequence[Unshift]:
        """What `turned` takes back, for each system where a Casimir was taken off."""
        return [self.turned] if isinstance(self.turned, Unshift) else []

    def unshift_of(self, member: int) -> Unshift | None:
        """Return what `turned` takes back for a member, or None where nothing was taken off."""
        return self.turned if isinstance(self.turned, Unshift) else None

    def turned_at(
        self, start: Start, members: NDArray[np.int64], elapsed: NDArray[np.float64], held: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return group elements (m, d, d) of members at times since their starts, from those of the loops (m, d*d)."""
        d = start.groups.shape[1]
        found = np.array(np.swapaxes(held.reshape(-1, d, d), 1, 2))
        for row, member in enumerate(members.tolist()):
            unshift = self.unshift_of(member)
            if unshift is not None:
                found[row] = unshift.at(start, member, float(elapsed[row]), held[row])
        return found

    def values_at(self, state: NDArray[np.float64], t: float, last: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the invariants of the only member at a state; multivalued ones are those next to the `last` ones."""
        raise TypeError(f"{type(self).__name__} has many members")

    def measure(
        self, times: Times, start: Start, saved: NamedArrays, worst: NDArray[Any], points: NDArray[np.int64]
    ) -> None:
        """Fill in the invariants that the loops do not follow, at saved points; of most systems there are none.

        Parameters
        ----------
        times : Times
            The steps.
        start : Start
            Where the first of them begins.
        saved : NamedArrays
            What was saved.
        worst : (members, tenths, invariants) array
            The largest deviations in each tenth of the run.
        points : ndarray of int
            Those of the saved points that are new.
        """
        return

    def measured_at(self, states: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the invariants of states (m, size) at times (m,) that the loops do not follow; None where they do."""
        return None

    @property
    def can_be_sent(self) -> bool:
        """Whether it can go to another process, by `pickle`."""
        return False

    @abstractmethod
    def raised(self) -> BaseException | None:
        """Return what a function of the user raised in a loop, once, or None."""

    @abstractmethod
    def started(self, groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the group elements that the loops start from, transposed, (members, d*d) or (d*d,) for all."""


class SystemLoops(Loops):
    """One system: every member has the same tables.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    method : Method
        The scheme.
    h : float
        Step, negative for backward.
    representation : ndarray of shape (n, d, d), "coadjoint", or None
        What the group element is carried in.
    casimirs : mapping, optional
        The invariants that are followed beside the energy; None is all Casimirs of the system.
    prepared : CompiledLoop, optional
        The loop, where it is not that of `method` alone.

    Attributes
    ----------
    prepared : CompiledLoop
        The loop.
    watch : Watch
        The invariants.
    """

    def __init__(
        self,
        system: System,
        method: Method,
        h: float,
        representation: Representation,
        casimirs: Mapping[str, Any] | None = None,
        prepared: CompiledLoop | None = None,
    ) -> None:
        from coadjoint.kernels.description import limit
        from coadjoint.kernels.tables import balance_tables, watch_tables

        followed = system.casimirs if casimirs is None else casimirs
        prepared = prepared or method.loop(system, h, representation)
        self.accounts = prepared.accounts
        plain = unforced(system)
        self.rows = rows_of(system)
        self._matrices = plain if isinstance(plain, MatrixSystem) else None
        self.measures = self._matrices is not None
        if self._matrices:
            count = (1 + len(followed)) * (2 if self.accounts else 1) - 1
            watch = watch_tables(system, dict.fromkeys(map(str, range(count)), NOTHING))
        else:
            watch = balance_tables(system, followed, self.accounts) if self.accounts else watch_tables(system, followed)
        self.names = ["energy", *followed]
        self.size, self.memory = system.dim + len(self.accounts), prepared.memory
        self._shifted = representation is not None and bool(prepared.shift)
        self.turned = Unshift(system, prepared.shift, representation) if self._shifted else plainly
        self.block = limit("LARGEST_CROWD") if system.dim <= limit("WIDEST") else 1
        self._read(prepared, watch)

    def _read(self, prepared: CompiledLoop, watch: Any) -> None:
        from coadjoint.kernels.structures import pointed

        self._keep = watch.keep
        self.prepared, self.watch = prepared, watch.tables
        # Made C structures here, once for all plans.
        self._given = prepared.name, pointed(prepared.tables), pointed(watch.tables)

    @property
    def can_be_sent(self) -> bool:
        """Whether it can go to another process, by `pickle`: nothing but functions stands at its addresses."""
        from coadjoint.kernels.sent import can_be_sent, loop_can_be_sent

        return loop_can_be_sent(self.prepared) and can_be_sent(self._keep)

    def __getstate__(self) -> dict[str, Any]:
        """Return the tables and all else, as they go to another process."""
        from coadjoint.kernels.sent import sent, sent_loop

        other = {name: value for name, value in vars(self).items() if name not in OF_THIS_PROCESS}
        return {**other, "sent": (sent_loop(self.prepared), sent(self.watch, self._keep))}

    def __setstate__(self, state: dict[str, Any]) -> None:
        from coadjoint.kernels.sent import received, received_loop

        loop, watch = state.pop("sent")
        self.__dict__.update(state)
        self._read(received_loop(loop), received(watch))

    def rounds(self, members: int, workers: int) -> list[list[Crew]]:
        """Return one round with a crew for each worker. Members that the kernels advance side by side share a crew."""
        return [[self.crew(*places) for places in shared_out(0, members, workers, self.block)]]

    def rounds_among(self, members: NDArray[np.int64], workers: int) -> list[list[Crew]] | None:
        own = self.crew(0, 1)
        return [[own.among(members[slice(*places)]) for places in shared_out(0, len(members), workers, self.block)]]

    def pieces(self, watch: Any = None) -> Pieces:
        """Return the tables that all members have."""
        return [(Tables(*self._given[:2], watch or self._given[2]), None)]

    def crew(self, first: int, last: int, base: int = 0) -> Crew:
        """Return the members first to last - 1 as a crew; `base` as for `Crew`."""
        return Crew(*self._given, first, last, base=base)

    def measure(
        self, times: Times, start: Start, saved: NamedArrays, worst: NDArray[Any], points: NDArray[np.int64]
    ) -> None:
        """Take the energy and the invariants of the saved matrices."""
        if self._matrices is None or not len(points):
            return
        first = self._values(start.momenta, times.t0)
        for k in points.tolist():
            number = int(times.saved[k])
            found = saved["values"][k] = self._values(saved["x"][k], float(times.at(times.saved[k])))
            tenth = max(0, number - 1) * worst.shape[1] // max(1, times.steps)
            with np.errstate(invalid="ignore"):  # infinities of members that are about to fail
                worst[:, tenth] = np.fmax(worst[:, tenth], np.abs(found - first))

    def values_at(self, state: NDArray[np.float64], t: float, last: NDArray[np.float64]) -> NDArray[np.float64]:
        if self._matrices is not None:
            return self._values(state[None], t)[0]
        return values_of_watch(self.watch, state, t, last)

    def measured_at(self, states: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the energy and the invariants of matrices."""
        if self._matrices is None:
            return None
        return np.concatenate([self._values(x[None], when) for x, when in zip(states, t.tolist(), strict=True)])

    def _values(self, states: NDArray[np.float64], t: float) -> NDArray[np.float64]:
        system = self._matrices
        assert system is not None
        # Later states of members that have failed are NaN, and no function is asked about them.
        sound = np.isfinite(states[:, : system.dim]).all(axis=-1)
        found = np.full((len(states), len(self.names) * (2 if self.accounts else 1)), np.nan)
        W = system.from_vector(states[sound, : system.dim])
        with np.errstate(all="ignore"):
            values = [system.energy(W, t), *system.casimirs_at(W).values()]
        if self.accounts:
            # less what forces have done to each, which stands behind the numbers of a state, and not of a start
            done = {name: np.zeros(len(W)) for name in self.names}
            for (_, name), column in zip(self.accounts, states[sound, system.dim :].T, strict=False):
                done[name] += column
            values += [value - done[name] for value, name in zip(values, self.names, strict=True)]
        found[sound] = np.stack(values, axis=-1)
        return found

    def raised(self) -> BaseException | None:
        """Return what a function of the user raised in the loop."""
        return self.prepared.raised()

    def started(self, groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the given elements; for a shifted run unit elements, which `turned` multiplies by the given ones."""
        return unit_row(groups.shape[-1]) if self._shifted else as_rows(groups)


def values_of_watch(watch: Any, state: NDArray[np.float64], t: float, last: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the invariants of a watch at a state; multivalued ones are those next to the `last` ones."""
    from coadjoint.kernels.watching import values_along

    found = np.empty((1, 1, len(last)))
    values_along(watch, state[None, None], np.array([t]), found)
    period = getattr(watch, "source", watch).period
    with np.errstate(divide="ignore", invalid="ignore"):
        turns = np.where(period > 0.0, np.floor((last - found[0, 0]) / period + 0.5), 0.0)
    return np.asarray(found[0, 0] + period * turns)


@lru_cache(maxsize=8)
def unit_row(size: int) -> NDArray[np.float64]:
    """Return the unit element as the loops hold it, (d*d,)."""
    return np.eye(size).ravel()


def as_rows(groups: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return group elements (members, d, d) as the loops hold them: transposed, (members, d*d)."""
    return np.swapaxes(groups, 1, 2).reshape(len(groups), -1)
