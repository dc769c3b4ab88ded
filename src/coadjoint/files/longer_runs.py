"""How does a run go on to a later end? From a state before its end, with the drifts of a run that had the later end.

What was done does not depend on the end, but for three things: the last point, which is saved wherever the run ends;
events in the last step; and the drifts, of which a run knows the largest in each tenth of its steps. So the run goes
back to the last state that was committed before its end. The steps until then are in blocks, of each of which the
largest drifts are known. A block that lies in two tenths of the longer run is run once more, from the state at which it
begins.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archive_store import ArchiveError, ArchiveStore, Kept, read_kept
from coadjoint.files.archived_run import FINISHED, SAVE_EVERY, STATES, STEPS, states_of
from coadjoint.given import read_number
from coadjoint.runs.piecewise_run import STATE, PiecewiseRun, larger
from coadjoint.runs.times import times_between

if TYPE_CHECKING:
    from coadjoint.runs.prepared_run import PreparedRun
    from coadjoint.runs.start import Start
    from coadjoint.runs.times import Times


def longer_times(store: ArchiveStore, times: Times, ready: PreparedRun, t_end: Any) -> Times:
    """Return the times of a run with another end.

    Raises
    ------
    ValueError
        The end is no whole number of steps from the start, or does not lie behind what was done.
    """
    end, attributes = read_number(t_end, "t_end"), store.attributes
    found = times_between((times.t0, end), ready.step, attributes[SAVE_EVERY])
    if found.steps == times.steps and found.h == times.h:
        return times
    if attributes["between_steps"]:
        raise ArchiveError(f"{store.path}: the run keeps states at given times, and so has no later end")
    done = attributes[STEPS]
    if found.h != times.h or found.steps < done or (attributes[FINISHED] and found.steps == done):
        raise ArchiveError(
            f"{store.path}: t_end is {end:g}, and the run has come to t = {times.t0 + done * times.h:g} on its way to "
            f"{times.end:g}; give a later end"
        )
    return found


def lengthen(store: ArchiveStore, ready: PreparedRun, times: Times, start: Start) -> None:
    """Let a run have another end, and go back to the last state that does not depend on the old one."""
    states = states_of(store.attributes)
    # Of a finished run the last one depends on the end; but for that of a run of no steps.
    kept = (states[:-1] if store.attributes[FINISHED] else states) or states
    base = kept[-1]
    stored = read_kept(store.path, base)
    stored["earlier"] = _worst(store, kept, ready, times, start)
    stored[f"{STATE}worst"] = np.zeros_like(stored[f"{STATE}worst"])
    new = store.keep(stored, {**base.about, "block": 1})
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
    store: ArchiveStore, kept: list[Kept], ready: PreparedRun, times: Times, start: Start
) -> NDArray[np.float64]:
    """Return the largest deviations in each tenth of a longer run, over the steps up to the last of some states."""
    worst: NDArray[np.float64] | None = None
    before: dict[str, Any] | None = None
    for state in kept:
        found = read_kept(store.path, state)
        first, last = 1 if before is None else int(before[f"{STATE}number"]) + 1, state.about["number"]
        own = np.zeros_like(found["earlier"])
        tenths = [(step - 1) * own.shape[1] // times.steps for step in (first, max(first, last))]
        if tenths[0] == tenths[1]:
            own[:, tenths[0]] = found["block"]
        else:
            own = _again(store, before, found, ready, times, start)
        worst = own if worst is None else larger(worst, own)
        before = found
    assert worst is not None
    return worst


def _again(
    store: ArchiveStore, before: Any, after: Any, ready: PreparedRun, times: Times, start: Start
) -> NDArray[np.float64]:
    """Return the largest deviations in each tenth over the steps between two states, which are taken once more."""
    if before is not None:
        nothing = np.zeros_like(before["earlier"])
        before = {**before, "earlier": nothing, f"{STATE}worst": nothing}
    run, last = PiecewiseRun(ready, times, start, store.arrays["time"].chunk[0], before), int(after[f"{STATE}number"])
    while run.number < last:
        run.advance(min(last, run.reach))
        if run.number < last:
            run.let_go()
    if not np.array_equal(run.run.state["momenta"], after[f"{STATE}momenta"], equal_nan=True):
        raise ArchiveError(
            f"{store.path}: steps that were computed again have other bits than before; resume on the machine where "
            "the archive was begun, and with the same system"
        )
    return run.worst
