"""Records of runs in memory; fields are computed from the arrays of the loops on first use."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.runs.results.run_record import FROM_TIMES, RunRecord, Statistics
from coadjoint.runs.start import start_of_vector
from coadjoint.systems.protocol import states_of

if TYPE_CHECKING:
    from coadjoint.kernels.arrays import NamedArrays
    from coadjoint.methods.protocol.method import Method
    from coadjoint.runs.results.observables import Observed
    from coadjoint.runs.run import Run
    from coadjoint.runs.run_setup import RunSetup
    from coadjoint.runs.start import Start
    from coadjoint.systems.batch import Batch
    from coadjoint.systems.system_checks import System

# Arrays that a record copies from a large state of a run; a small state is shared, since copying takes a step's time.
REPORTED_ARRAYS = ("worst", "status", "evaluations", "iterations")
# Numbers (8 MB) beyond which a state is large.
MAX_STATE_NUMBERS = 2**20
# Fields of records that are the same for all runs of a setup.
RECORDED = (
    "watched",
    "times",
    "saved_points",
    "names",
    "accounts",
    "corrected_groups",
    "events",
    "ending",
    "initial_values",
)


def record_of_run(run: Run, saved_points: int, observed: Observed | None) -> RunRecord:
    """Return the record of the first saved points of a run in memory; the tables of the run are not kept alive."""
    state = run.state.arrays
    if state.numbers.size > MAX_STATE_NUMBERS:
        state = state.subset(REPORTED_ARRAYS)
    record = record_of_arrays(run.setup, run.method, run.system, run.start, run.saved, state, run.seconds)
    record.watched, record.times, record.saved_points = run.watching, run.times, saved_points
    record.events, record.ending, record.initial_values = run.events, run.ending, run.initial
    if observed is not None:
        # Observed quantities do not use the accounts that may follow the coordinates.
        series = observed.along(record.t, _saved(record, "x"))
        record.observed = {name: _without_member_axis(record, values) for name, values in series.items()}
    return record


def record_of_arrays(
    setup: RunSetup, method: Method, system: Any, start: Start, saved: NamedArrays, state: NamedArrays, seconds: float
) -> RunRecord:
    """Return the record of a run from its setup and its arrays; see `record_of_run`."""
    fields = {
        **setup.recorded,
        "method": method,
        "given_system": system,
        "start": start,
        "saved": saved,
        "state": state,
        "seconds": seconds,
        "elapsed": seconds,
    }
    return RunRecord(IN_MEMORY, fields)


def record_of_short_run(
    setup: RunSetup,
    method: Method,
    system: Any,
    momenta: NDArray[np.float64],
    numbers: NDArray[np.float64],
    seconds: float,
    elapsed: float,
) -> RunRecord:
    """Return the record of a run of one vector without a group element, whose arrays are in one allocation.

    What other records are given is made on first use.
    """
    fields = {
        "shared": setup.recorded,
        "layout": setup.plan.layout,
        "method": method,
        "given_system": system,
        "momenta": momenta,
        "numbers": numbers,
        "seconds": seconds,
        "elapsed": elapsed,
    }
    return RunRecord(OF_SHORT_RUN, fields)


def _saved(record: RunRecord, name: str) -> NDArray[Any]:
    points = record.saved[name]
    return points if len(points) == record.saved_points else points[: record.saved_points]


def _without_member_axis(record: RunRecord, series: NDArray[Any]) -> NDArray[Any]:
    """Drop the axis of members for a single run."""
    return series[:, 0] if record.start.single else series


def _times(record: RunRecord) -> NDArray[np.float64]:
    times = record.times.saved_times[: record.saved_points]
    if record.ending is not None:
        times[-1] = record.ending.t
    return times


def _x(record: RunRecord) -> NDArray[Any]:
    rows = _without_member_axis(record, _saved(record, "x"))
    # Accounts of forces may follow the coordinates.
    return _states(record, rows[..., : record.start.momenta.shape[1]] if record.accounts else rows)


def _states(record: RunRecord, rows: NDArray[np.float64]) -> NDArray[Any]:
    return np.asarray(states_of(record.start.system, rows))


def _initial(record: RunRecord) -> Mapping[str, Any]:
    values = record.saved["values"][0] if record.initial_values is None else record.initial_values
    return {name: values[0, i] if record.start.single else values[:, i] for i, name in enumerate(record.names)}


def _casimirs(record: RunRecord) -> Mapping[str, NDArray[np.float64]]:
    values = _saved(record, "values")
    return {name: _without_member_axis(record, values[..., i + 1]) for i, name in enumerate(record.names[1:])}


def _work(record: RunRecord) -> Mapping[str, Mapping[str, NDArray[np.float64]]]:
    states, dim = _saved(record, "x"), record.start.momenta.shape[1]
    by_force: dict[str, dict[str, NDArray[np.float64]]] = {}
    for column, (force, invariant) in enumerate(record.accounts):
        by_force.setdefault(force, {})[invariant] = _without_member_axis(record, states[..., dim + column])
    return by_force


def _attitude(record: RunRecord) -> NDArray[np.float64] | None:
    start = record.start
    if start.representation is None:
        return None
    groups = record.corrected_groups(start, record.times, record.saved, record.saved_points)
    if record.ending is not None:
        groups[-1] = record.ending.attitude
    return groups[:, 0] if start.single else groups


def _attitude0(record: RunRecord) -> NDArray[np.float64] | None:
    start = record.start
    if start.representation is None:
        return None
    return start.groups[0] if start.single else start.groups


def _stats(record: RunRecord) -> Statistics:
    return Statistics(
        steps=int(record.times.steps if record.ending is None else record.ending.steps),
        evaluations=int(record.state["evaluations"].sum()),
        iterations=int(record.state["iterations"].sum()),
        seconds=record.seconds,
        elapsed=record.elapsed,
    )


def _built_system(record: RunRecord) -> System | Batch:
    system = record.given_system
    return system() if isinstance(system, partial) else system


IN_MEMORY: Mapping[str, Callable[[RunRecord], Any]] = {
    **FROM_TIMES,
    **dict.fromkeys(("choice", "error", "starts", "incomplete"), lambda record: None),
    "observed": lambda record: {},
    "system": _built_system,
    "t": _times,
    "x": _x,
    "x0": lambda record: _states(record, record.start.momenta[0] if record.start.single else record.start.momenta),
    "t_eval": lambda record: None if record.times.between is None else record.t,
    "energy": lambda record: _without_member_axis(record, _saved(record, "values")[..., 0]),
    "casimirs": _casimirs,
    "initial": _initial,
    "work": _work,
    "attitude": _attitude,
    "attitude0": _attitude0,
    "carried": lambda record: record.start.carried,
    "failed": lambda record: None if record.start.single else record.state["status"] != 0,
    "stats": _stats,
    "worst": lambda record: record.state["worst"][0] if record.start.single else record.state["worst"],
}


def _shared(name: str) -> Callable[[RunRecord], Any]:
    return lambda record: record.shared[name]


def _x_of_short_run(record: RunRecord) -> NDArray[np.float64]:
    saved = record.layout.saved
    return record.numbers[saved.slices["x"]].reshape(saved.shapes["x"])[:, 0]


OF_SHORT_RUN: Mapping[str, Callable[[RunRecord], Any]] = {
    **IN_MEMORY,
    **{name: _shared(name) for name in RECORDED},
    "x": _x_of_short_run,
    "start": lambda record: start_of_vector(record.given_system, record.momenta),
    "saved": lambda record: record.layout.saved_in(record.numbers),
    "state": lambda record: record.layout.state_in(record.numbers),
}
