"""Continuation of an archived run to a later end, with the drifts of a run that had this end from the beginning.

Only three results depend on the end: the last point, which is always saved; events in the last step; and the drifts,
recorded as maxima in each tenth of the steps. So the run returns to the last state committed before its end. The
largest drifts of each block of steps are stored. A block that overlaps two tenths of the longer run is recomputed from
the state at its start.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archives.archive import FINISHED, SAVE_EVERY, STATES, STEPS, ArchiveError, StoredState
from coadjoint.files.archives.new_archive import PlannedRun
from coadjoint.files.archives.store import ArchiveStore
from coadjoint.runs.piecewise_run import STATE_PREFIX, larger_deviations
from coadjoint.runs.times import StepDoesNotDivide, Times, times_between
from coadjoint.short_repr import distinct
from coadjoint.validation import read_number


def extended_times(store: ArchiveStore, planned: PlannedRun, t_end: Any) -> Times:
    """Return the times of a run with another end.

    The end must be a whole number of steps from the start, and later than the steps already taken.
    """
    end, attributes, times, step = read_number(t_end, "t_end"), store.attributes, planned.times, planned.prepared.step
    try:
        extended = times_between((times.t0, end), step, attributes[SAVE_EVERY])
    except StepDoesNotDivide:
        # The step of a run that has begun cannot be changed.
        before = times.t0 + math.floor((end - times.t0) / times.h) * times.h
        raise ArchiveError(
            f"{store.path}: t_end {end!r} is between two steps of {step!r}; give {before!r} or {before + times.h!r}"
        ) from None
    if extended.steps == times.steps and extended.h == times.h:
        return times
    if attributes["between_steps"]:
        raise ArchiveError(f"{store.path}: the run saves states at given times, and cannot be continued to a later end")
    done = attributes[STEPS]
    if extended.h != times.h or extended.steps < done or (attributes[FINISHED] and extended.steps == done):
        given, reached, last = distinct(end, times.t0 + done * times.h, times.end)
        raise ArchiveError(
            f"{store.path}: t_end is {given}, but the run has reached t = {reached} on its way to {last}; give a later "
            "end"
        )
    return extended


def extend_run(store: ArchiveStore, planned: PlannedRun) -> None:
    """Set the end of a planned run, and return the run to the last state that does not depend on the old one."""
    states, times = store.states, planned.times
    # The last state of a finished run depends on the end, unless it has no steps.
    retained = (states[:-1] if store.attributes[FINISHED] else states) or states
    last_state = retained[-1]
    stored = store.read_state(last_state)
    stored["earlier"] = reduce(larger_deviations, _deviations(store, retained, planned))
    stored[f"{STATE_PREFIX}worst"] = np.zeros_like(stored[f"{STATE_PREFIX}worst"])
    new = store.store_state(stored, {**last_state.about, "block": 1})
    blocks = [state for state in retained[:-1] if state.about["block"]]
    attributes = {
        "t_span": json.dumps([times.t0, times.end]),
        "steps": times.steps,
        "save_every": times.save_every,
        STEPS: last_state.about["number"],
        FINISHED: 0,
        STATES: json.dumps([*blocks, new]),
    }
    lengths = {name: length for name, length in last_state.about.items() if name not in ("number", "block")}
    store.commit(attributes, lengths, [*blocks, new])


def _deviations(store: ArchiveStore, states: list[StoredState], planned: PlannedRun) -> Iterator[NDArray[np.float64]]:
    """Yield the largest deviations in each tenth of a longer run, over the steps up to each state from the last one."""
    previous: dict[str, Any] | None = None
    for state in states:
        stored = store.read_state(state)
        first, last = 1 if previous is None else int(previous[f"{STATE_PREFIX}number"]) + 1, state.about["number"]
        deviations = np.zeros_like(stored["earlier"])
        tenths = [(step - 1) * deviations.shape[1] // planned.times.steps for step in (first, max(first, last))]
        if tenths[0] == tenths[1]:
            deviations[:, tenths[0]] = stored["block"]
        else:
            deviations = _recompute(store, previous, stored, planned)
        yield deviations
        previous = stored


def _recompute(store: ArchiveStore, previous: Any, next_state: Any, planned: PlannedRun) -> NDArray[np.float64]:
    """Recompute the steps between two states; return the largest deviations in each tenth."""
    if previous is not None:
        zeros = np.zeros_like(previous["earlier"])
        previous = {**previous, "earlier": zeros, f"{STATE_PREFIX}worst": zeros}
    run, last = planned.in_pieces(store.arrays["time"].chunk[0], previous), int(next_state[f"{STATE_PREFIX}number"])
    while run.number < last:
        run.advance(min(last, run.reach))
        if run.number < last:
            run.release_points()
    if not np.array_equal(run.run.state["momenta"], next_state[f"{STATE_PREFIX}momenta"], equal_nan=True):
        raise ArchiveError(
            f"{store.path}: recomputed steps have other bits than before; resume on the machine where "
            "the archive was begun, and with the same system"
        )
    return run.worst
