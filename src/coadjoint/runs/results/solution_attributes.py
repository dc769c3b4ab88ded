"""The attributes of solutions, and members of ensembles that have not been computed to the last saved point."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method
from coadjoint.runs.events import RecordedEvents
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.system import System

if TYPE_CHECKING:
    import xarray

    from coadjoint.runs.results.solution import Solution

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Statistics:
    """Work of a run.

    Parameters
    ----------
    steps : int
        Steps of each member; of a failed run of one member those before the failure, and of an interrupted one those up
        to its last saved point.
    evaluations : int
        Elementary flows (splitting) or evaluations of the vector field, summed over members. An interrupted run has not
        counted those since the last update of its progress, nor its iterations.
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


class StateAt(NamedTuple):
    """States at given times, in the shapes of `Solution` at its saved points; without the first axis for a single time.

    Parameters
    ----------
    t : float or ndarray, shape (k,)
        Times.
    x : ndarray, shape (n,) or (k, n), or with an axis of members before the last
        Momentum.
    energy : float or ndarray
        The Hamiltonian.
    casimirs : mapping
        Name -> values.
    attitude : ndarray or None
        Group element, if it was computed.
    """

    t: Any
    x: Any
    energy: Any
    casimirs: Mapping[str, Any]
    attitude: Any

    def __repr__(self) -> str:
        times = f"t = {self.t:g}" if np.ndim(self.t) == 0 else f"{len(self.t)} times"
        parts = {"x": self.x, "energy": self.energy, "casimirs": dict(self.casimirs), "attitude": self.attitude}
        held = ", ".join(f"{name} {_shown(value)}" for name, value in parts.items() if value is not None)
        return f"<states at {times}: {held}>"


def _shown(value: Any) -> str:
    """Format a short value for one line; of a large array, its shape."""
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(f"{name}: {_shown(entry)}" for name, entry in list(value.items())[:4])
            + (f", and {len(value) - 4} more}}" if len(value) > 4 else "}")
        )
    numbers = np.asarray(value)
    if numbers.size > 8:
        return f"of shape {numbers.shape}"
    return " ".join(np.array2string(numbers, precision=6, separator=", ").split())


class SolutionAttributes:
    """Attributes of a `Solution`; its classes have them as fields, or compute or read them on first use."""

    @cached_property
    def system(self) -> System | Batch:
        """The system, with the inputs of the run."""
        raise NotImplementedError

    @cached_property
    def method(self) -> Method:
        """The scheme."""
        raise NotImplementedError

    @cached_property
    def watched(self) -> bool:
        """Whether invariants were computed after every step."""
        raise NotImplementedError

    @cached_property
    def t(self) -> Floats:
        """The saved times, (k,): t0, every save_every-th step, and the last; or `t_eval`."""
        raise NotImplementedError

    @cached_property
    def x(self) -> NDArray[Any]:
        """The states (momenta), (k, n) or (k, members, n)."""
        raise NotImplementedError

    @cached_property
    def x0(self) -> NDArray[Any]:
        """The initial state, without the axis of times, whether it was saved or not."""
        raise NotImplementedError

    @cached_property
    def t_eval(self) -> Floats | None:
        """The argument of the run."""
        raise NotImplementedError

    @cached_property
    def energy(self) -> Floats:
        """The Hamiltonian, (k,) or (k, members)."""
        raise NotImplementedError

    @cached_property
    def casimirs(self) -> Mapping[str, Floats]:
        """Name -> Casimir, (k,) or (k, members)."""
        raise NotImplementedError

    @cached_property
    def initial(self) -> Mapping[str, Any]:
        """Initial energy and Casimirs: "energy" or name -> number, or (members,)."""
        raise NotImplementedError

    @cached_property
    def work(self) -> Mapping[str, Mapping[str, Floats]]:
        """Work of each force since the start: its label -> "energy", or a Casimir that it changes -> values."""
        raise NotImplementedError

    @cached_property
    def observed(self) -> Mapping[str, Floats]:
        """Name -> quantity of `observe`, over the saved times."""
        raise NotImplementedError

    @cached_property
    def attitude(self) -> Floats | None:
        """Group elements (attitudes), (k, d, d) or (k, members, d, d); None if they were not computed."""
        raise NotImplementedError

    @cached_property
    def attitude0(self) -> Floats | None:
        """The initial group element, without the axis of times; None if none was computed."""
        raise NotImplementedError

    @cached_property
    def carried(self) -> str | None:
        """Matrices in which the group element is stored: "representation", "coadjoint", or None."""
        raise NotImplementedError

    @cached_property
    def failed(self) -> NDArray[np.bool_] | None:
        """Which members of an ensemble failed, (members,); None for a single run."""
        raise NotImplementedError

    @cached_property
    def events(self) -> RecordedEvents | None:
        """Crossings of the events given to the run."""
        raise NotImplementedError

    @cached_property
    def stats(self) -> Statistics:
        """Steps, evaluations, iterations, seconds."""
        raise NotImplementedError

    @cached_property
    def incomplete(self) -> str | None:
        """Why the run has not reached its end: "failed", "unfinished" (an archive), or what interrupted it; or None."""
        raise NotImplementedError

    @cached_property
    def t_span(self) -> tuple[float, float]:
        """Start and end; the end is before that of `asked_span` if an event ended the run."""
        raise NotImplementedError

    @cached_property
    def asked_span(self) -> tuple[float, float]:
        """The argument `t_span` of the run."""
        raise NotImplementedError

    @cached_property
    def step(self) -> float:
        """The argument of the run."""
        raise NotImplementedError

    @cached_property
    def save_every(self) -> int:
        """The argument of the run."""
        raise NotImplementedError

    @cached_property
    def choice(self) -> Any:
        """For runs with `accuracy`: the result of `choose`; or None."""
        raise NotImplementedError

    # Of stored runs only.
    path: Path | str
    attributes: dict[str, Any]
    dataset: xarray.Dataset
    inputs: Callable[..., dict[str, Any]]
    check_complete: Callable[[], None]
    finished: bool
    reached: int
    status: NDArray[np.int64]
    blocks: Sequence[Any]
    progress_text: str


def missing_attitude(solution: Any) -> str:
    """Explain why a run has no group element, and where its attitude is found."""
    what = f"the run of {solution.system.name} has no"
    if getattr(solution.system.unforced, "has_attitude", False):
        return f"{what} group element, since attitudes are part of its states; take sol.rotation"
    return f"{what} attitude; give attitude=True to integrate"


def member_count(solution: Solution) -> int:
    """Return the number of members, 1 of a single run."""
    return 1 if solution.failed is None else len(solution.failed)


def unfinished_members(solution: Solution) -> NDArray[np.bool_]:
    """Return which members, (members,), are not at the last saved point, without having failed."""
    members = member_count(solution)
    if solution.failed is None or not solution.incomplete or not len(solution.t):
        return np.zeros(members, dtype=bool)
    if (pending := solution._pending_members) is not None:
        return pending
    waiting = ~np.isfinite(solution.x[-1]).reshape(members, -1).all(axis=1) & ~solution.failed
    return waiting if solution.events is None else waiting & np.isnan(solution.events.ends(members))


def ends_by_events(solution: Solution) -> NDArray[np.float64]:
    """Return the times at which events ended the members; NaN where none did, and for a single run."""
    if solution.failed is None or solution.events is None:
        return np.full(member_count(solution), np.nan)
    return solution.events.ends(member_count(solution))


def last_times(solution: Solution, unfinished: NDArray[np.bool_], direction: float) -> NDArray[np.float64]:
    """Return the last saved times of unfinished members, (members,); before all times where none is, and of others."""
    ends = np.full(len(unfinished), -direction * np.inf)
    for m in np.flatnonzero(unfinished).tolist():
        saved = np.flatnonzero(np.isfinite(solution.x[:, m]).reshape(len(solution.t), -1).all(axis=1))
        if len(saved):
            ends[m] = solution.t[saved[-1]]
    return ends


def members_text(mask: NDArray[np.bool_]) -> str:
    """Describe members for messages: all, or their numbers."""
    numbers = np.flatnonzero(mask).tolist()
    return "all members" if len(numbers) == len(mask) else f"the members {short(numbers)}"
