"""Runs in pieces, with memory independent of their length; between pieces a run can be stored and resumed bitwise."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.interface import codes
from coadjoint.runs.run import first_point_not_finite
from coadjoint.runs.solution import REPORTED, Solution
from coadjoint.runs.start import Start
from coadjoint.runs.state import RunState
from coadjoint.runs.times import Times

if TYPE_CHECKING:
    from coadjoint.runs.prepared_run import PreparedRun

STATE = "state."
"""Prefix of the arrays of a `RunState` among those that are stored."""
NEVER = np.array([-1.0, np.nan])
"""Step and time of an event that has not occurred."""


class PiecewiseRun:
    """A run that holds only its most recent saved points: those since `let_go`, at most `most` of them.

    Pieces end at multiples of `most` points, counted over the whole run; `stored` resumes a run. `torn` is True if an
    interrupt has left the saved points of a batch in an undefined order; no further `piece` can be taken.
    """

    def __init__(
        self, ready: PreparedRun, times: Times, start: Start, most: int, stored: Mapping[str, Any] | None = None
    ) -> None:
        self._observed = ready.observed(start)
        state = None if stored is None else state_of(stored)
        if state is not None and state.number == 0:
            state = None  # no step yet: begin at the start
        self._most = most
        passed = 0 if state is None else times.after(state.number).passed
        held = most - passed % most if passed else max(2, most)  # the start alone would leave no place for a step
        self.run = ready.begun(times._replace(most=held), start, state=state)
        worst = self.run.state["worst"]
        self._earlier: NDArray[np.float64] = np.zeros_like(worst)
        self._undefined = {"energy": NEVER, "attitude": NEVER}
        self._turns = start.representation is not None and self.run.loops.attitude_may_overflow(start, times)
        if stored is not None:
            self._earlier = np.array(stored["earlier"])
            self._undefined = {name: np.array(stored[f"undefined {name}"]) for name in self._undefined}
            self.run.initial = np.array(stored["initial"])
        self.torn = False

    @property
    def number(self) -> int:
        """Number of steps taken."""
        return self.run.state.number

    @property
    def reach(self) -> int:
        """Last step that can be taken before `let_go`."""
        return self.run.times.reach

    @property
    def held(self) -> int:
        """Number of saved points in memory."""
        numbers, state = self.run.times.saved, self.run.state
        if self.run.start.single and state["status"][0] not in (codes("Status")["DONE"], codes("Status")["ENDED"]):
            return int(np.searchsorted(numbers, state["step"][0]))
        return int(np.searchsorted(numbers, state.number, side="right"))

    @property
    def over(self) -> bool:
        """Whether no steps remain: all are done, or the only member has failed."""
        return self.number == self.run.times.steps or (self.run.start.single and bool(self.run.state["status"][0]))

    def advance(self, until: int) -> None:
        """Take the steps up to number `until`, at most `reach`; an interrupt discards all of them."""
        before = self.run.state.copy()
        try:
            self.run.advance(until=until)
        except BaseException:
            self.run.state = before
            self.torn = self.run.loops.order is not None
            raise
        if self.run.initial is None:
            first, order = self.run.saved["values"][0], self.run.loops.order
            if order is None or until == self.run.times.steps:
                self.run.initial = first.copy()
            else:
                self.run.initial = first[np.argsort(order)]

    def piece(self) -> Solution:
        """Return the points in memory, with drifts and work of all steps so far; must be followed by `let_go`."""
        run, order = self.run, self.run.loops.order
        if order is not None and self.number < run.times.steps:
            run.saved = run.saved.take(np.argsort(order), 1)
        found = Solution(run, self.held, self._observed)
        reported = run.state.arrays.only(REPORTED)
        reported["worst"][:] = self.worst
        found.__dict__["_state"] = reported
        self._note_undefined(found)
        return found

    @property
    def first(self) -> int:
        """Index, among all saved points, of the first one in memory."""
        return self.run.times.passed

    def let_go(self) -> None:
        """Release the saved points in memory; no-op before the first step."""
        run = self.run
        if self.number:
            run.times = run.times._replace(most=self._most - run.times.after(self.number).passed % self._most)
            run.let_go()

    @property
    def worst(self) -> NDArray[np.float64]:
        """Largest deviations in each tenth of the run so far, (members, tenths, invariants)."""
        return larger(self._earlier, self.run.state["worst"])

    def stored(self, begin_block: bool = False) -> dict[str, Any]:
        """Return numbers and arrays, by name, from which the run resumes bitwise.

        ``block`` (members, invariants) holds the largest deviations since the last block began; `begin_block` begins
        another.
        """
        assert self.run.initial is not None
        block = reduce(larger, np.moveaxis(self.run.state["worst"], 1, 0))
        if begin_block:
            self._earlier = self.worst
            self.run.state["worst"][:] = 0.0
        return {
            **{f"{STATE}{name}": value for name, value in self.run.state.to_mapping().items()},
            "earlier": self._earlier,
            "block": block,
            "initial": self.run.initial,
            **{f"undefined {name}": found for name, found in self._undefined.items()},
        }

    def failure(self, partial: Any) -> IntegrationError | None:
        """Return the error of a run that is `over`, with its partial solution, or None."""
        if self.run.state["status"].any():
            return self.run.failure(partial)
        for name, error in (("energy", self.run.energy_error), ("attitude", self.run.attitude_error)):
            step, when = self._undefined[name].tolist()
            if step >= 0:
                return error(int(step), when, partial)
        return None

    def _note_undefined(self, found: Solution) -> None:
        """Record where an energy or a group element is first not finite although the state is."""
        sound, shape = self.run.state["status"] == 0, (len(found.t), len(self.run.state["status"]))
        series = {"energy": found.energy.reshape(shape)[:, sound]}
        if self._turns and found.attitude is not None:
            series["attitude"] = found.attitude.reshape(*shape, found.attitude.shape[-1] ** 2)[:, sound]
        for name, values in series.items():
            first = first_point_not_finite(values)
            if first is not None and self._undefined[name][0] < 0:
                self._undefined[name] = np.array([self.run.times.saved[first], found.t[first]])


def state_of(stored: Mapping[str, Any]) -> RunState:
    """Extract the `RunState` from the stored arrays of a run."""
    return RunState.from_mapping({name[len(STATE) :]: stored[name] for name in stored if name.startswith(STATE)})


def larger(earlier: NDArray[np.float64], later: NDArray[np.float64]) -> NDArray[np.float64]:
    """Combine the largest deviations of two successive pieces of a run with the NaN semantics of the loops.

    Examples
    --------
    >>> larger(np.array([1.0, 2.0, np.nan, 3.0]), np.array([2.0, 1.0, 0.0, np.nan]))
    array([ 2.,  2., nan, nan])
    """
    return np.where((later <= earlier) | (later == 0.0), earlier, later)
