"""Continuation of an archived run to a later end, with the drifts of a run that had this end from the beginning.

Only three results depend on the end: the last point, which is always saved; events in the last step; and the drifts,
recorded as maxima in each tenth of the steps. So the run returns to the last state committed before its end. The
largest drifts of each block of steps are stored. A block that overlaps two tenths of the longer run is recomputed from
the state at its start.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archives.archived_run import FINISHED, SAVE_EVERY, STATES, STEPS, states_of
from coadjoint.files.archives.store import ArchiveError, ArchiveStore, StoredState, read_state
from coadjoint.runs.piecewise_run import STATE_PREFIX, PiecewiseRun, larger_deviations
from coadjoint.runs.times import times_between
from coadjoint.validation import read_number

if TYPE_CHECKING:
    from coadjoint.runs.prepared_run import PreparedRun
    from coadjoint.runs.start import Start
    from coadjoint.runs.times import Times


def extended_times(store: ArchiveStore, times: Times, ready: PreparedRun, t_end: Any) -> Times:
    """Return the times of a run with another end.

    The end must be a whole number of steps from the start, and later than the steps already taken.
    """
    end, attributes = read_number(t_end, "t_end"), store.attributes
    found = times_between((times.t0, end), ready.step, attributes[SAVE_EVERY])
    if found.steps == times.steps and found.h == times.h:
        return times
    if attributes["between_steps"]:
        raise ArchiveError(f"{store.path}: the run saves states at given times, and cannot be continued to a later end")
    done = attributes[STEPS]
    if found.h != times.h or found.steps < done or (attributes[FINISHED] and found.steps == done):
        raise ArchiveError(
            f"{store.path}: t_end is {end:g}, and the run has reached t = {times.t0 + done * times.h:g} on its way to "
            f"{times.end:g}; give a later end"
        )
    return found


def extend_run(store: ArchiveStore, ready: PreparedRun, times: Times, start: Start) -> None:
    """Set another end of a run, and return it to the last state that does not depend on the old one."""
    states = states_of(store.attributes)
    # The last state of a finished run depends on the end, unless it has no steps.
    kept = (states[:-1] if store.attributes[FINISHED] else states) or states
    base = kept[-1]
    stored = read_state(store.path, base)
    stored["earlier"] = _worst(store, kept, ready, times, start)
    stored[f"{STATE_PREFIX}worst"] = np.zeros_like(stored[f"{STATE_PREFIX}worst"])
    new = store.store_state(stored, {**base.about, "block": 1})
    blocks = [one for one in kept[:-1] if one.about["block"]]
    attributes = {
        "t_span": json.dumps([times.t0, times.end]),
        "steps": times.steps,
        "save_every": times.save_every,
        STEPS: base.about["number"],
        FINISHED: 0,
        STATES: json.dumps([*blocks, new]),
    }
    lengths = {name: length for name, length in base.about.items() if name not in ("number", "block")}
    store.commit(attributes, lengths, [*blocks, new])


def _worst(
    store: ArchiveStore, kept: list[StoredState], ready: PreparedRun, times: Times, start: Start
) -> NDArray[np.float64]:
    """Return the largest deviations in each tenth of a longer run, over the steps up to the last given state."""
    worst: NDArray[np.float64] | None = None
    before: dict[str, Any] | None = None
    for state in kept:
        found = read_state(store.path, state)
        first, last = 1 if before is None else int(before[f"{STATE_PREFIX}number"]) + 1, state.about["number"]
        own = np.zeros_like(found["earlier"])
        tenths = [(step - 1) * own.shape[1] // times.steps for step in (first, max(first, last))]
        if tenths[0] == tenths[1]:
            own[:, tenths[0]] = found["block"]
        else:
            own = _recompute(store, before, found, ready, times, start)
        worst = own if worst is None else larger_deviations(worst, own)
        before = found
    assert worst is not None
    return worst


def _recompute(
    store: ArchiveStore, before: Any, after: Any, ready: PreparedRun, times: Times, start: Start
) -> NDArray[np.float64]:
    """Recompute the steps between two states; return the largest deviations in each tenth."""
    if before is not None:
        nothing = np.zeros_like(before["earlier"])
        before = {**before, "earlier": nothing, f"{STATE_PREFIX}worst": nothing}
    run, last = (
        PiecewiseRun(ready, times, start, store.arrays["time"].chunk[0], before),
        int(after[f"{STATE_PREFIX}number"]),
    )
    while run.number < last:
        run.advance(min(last, run.reach))
        if run.number < last:
            run.release_points()
    if not np.array_equal(run.run.state["momenta"], after[f"{STATE_PREFIX}momenta"], equal_nan=True):
        raise ArchiveError(
            f"{store.path}: recomputed steps have other bits than before; resume on the machine where "
            "the archive was begun, and with the same system"
        )
    return run.worst
