"""Archives as sinks of runs: each piece is committed atomically."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.files.archives.reading import ArchiveError, StoredState
from coadjoint.files.archives.store import ArchiveStore, ArchiveUnwritten, unwritten_archive
from coadjoint.files.archives.stored_arrays import TYPES, StoredArray, chunk_of, rows_of_chunk
from coadjoint.files.datasets.export import failure_attributes
from coadjoint.files.datasets.variables import (
    Variables,
    coordinates_of,
    start_variables,
    summary_variables,
    time_coordinate,
    time_variables,
)
from coadjoint.runs.piecewise_run import PiecewiseRun, Sink

if TYPE_CHECKING:
    from coadjoint.errors import IntegrationError
    from coadjoint.runs.prepared_run import PreparedRun
    from coadjoint.runs.results.solution import Solution
    from coadjoint.runs.start import Start
    from coadjoint.runs.times import Times

FINISHED: str = "archive_finished"
STEPS: str = "archive_steps"
STATES: str = "archive_states"
ACCOUNTS_ATTRIBUTE: str = "archive_accounts"
FIRST_STEP: str = "archive_first_step"
SAVE_EVERY: str = "archive_save_every"
BLOCKS, MIN_STATE_BYTES = 64, 2**24
"""A run has about 64 blocks, if their states take at most a quarter of the archive, or 16 MB."""


class ArchiveSink(Sink):
    """An archive that takes the pieces of a run; `began` is the time at which the call of the run began."""

    failure: IntegrationError | None = None

    def __init__(self, store: ArchiveStore, began: float) -> None:
        self.store, self._began, self._states = store, began, states_of(store.attributes)
        self._seconds, self._elapsed = (float(store.attributes.get(name, 0.0)) for name in ("seconds", "elapsed"))

    def take(self, run: PiecewiseRun) -> None:
        """Commit the steps computed so far; ArchiveUnwritten if that fails: the archive holds the last commit."""
        store = self.store
        if run.number == store.attributes[STEPS]:
            return
        piece: Solution | None = None
        try:
            piece = run.piece()
            for name, (_, values, _) in growing_variables(piece).items():
                store.write(name, values, (run.first,))
            for name, (_, values, _) in summary_variables(piece).items():
                store.write(name, values)
            self.failure = failure = run.failure(piece) if run.is_over else None
            lengths = {"time": run.first + run.points_held}
            states = self._store_states(run, lengths)
            attributes = {**self._attributes(run, piece, states), **(failure_attributes(failure) if failure else {})}
            store.commit(attributes, lengths, states)
            self._states = states
        except (OSError, ArchiveError) as reason:
            was_committed = store.attributes.get(STEPS) == run.number
            raise unwritten_error(store, reason, None if was_committed else piece) from reason

    def _store_states(self, run: PiecewiseRun, lengths: Mapping[str, int]) -> list[StoredState]:
        """Store the state; return the states to retain: those at block starts, and the last of an unfinished run."""
        store = self.store
        blocks = [state for state in self._states if state.about["block"]]
        bytes_of_state = 8 * run.run.state.arrays.numbers.size
        max_state_bytes = max(
            MIN_STATE_BYTES, 8 * lengths["time"] * sum(prod(array.shape[1:]) for array in store.arrays.values()) // 4
        )
        steps_of_block = run.number - (blocks[-1].about["number"] if blocks else 0)
        starts_block = (
            not run.is_over
            and steps_of_block * BLOCKS >= run.run.times.steps
            and (len(blocks) + 1) * bytes_of_state <= max_state_bytes
        )
        state = store.store_state(
            run.stored(starts_block), {"number": run.number, **lengths, "block": int(starts_block)}
        )
        if run.is_over and not self._states[-1].about["block"]:
            blocks.append(self._states[-1])
        return [*blocks, state]

    def _attributes(self, run: PiecewiseRun, piece: Solution, states: Sequence[StoredState]) -> dict[str, Any]:
        stats = piece.stats
        return {
            STEPS: run.number,
            FINISHED: int(run.is_over),
            STATES: json.dumps(states),
            "evaluations": stats.evaluations,
            "iterations": stats.iterations,
            "seconds": self._seconds + stats.seconds,
            "elapsed": self._elapsed + time.perf_counter() - self._began,
        }


def states_of(attributes: Mapping[str, Any]) -> list[StoredState]:
    """Return the states of an archive: of its blocks, and the last one."""
    return [StoredState(*entry) for entry in json.loads(attributes[STATES])]


def growing_variables(piece: Solution) -> Variables:
    """Return the variables over time of a piece of a run."""
    return {**time_variables(piece), **time_coordinate(piece.t)}


def new_arrays(
    piece: Solution, total_points: int, more: Variables
) -> tuple[dict[str, StoredArray], Variables, Variables]:
    """Return the arrays of a new archive, first values of those that grow, and values of the fixed ones."""
    growing = growing_variables(piece)
    fixed: Variables = {**start_variables(piece), **summary_variables(piece), **more}
    fixed |= {name: entry for name, entry in coordinates_of(piece).items() if name not in growing}
    row_size = max(prod(np.shape(values)[1:]) for _, values, _ in growing.values())
    rows = rows_of_chunk(row_size, total_points)
    arrays = {}
    for name, (dims, values, attributes) in (growing | fixed).items():
        kind = TYPES.get(np.asarray(values).dtype.kind, "string")
        shape = np.shape(values)
        shape = (0, *shape[1:]) if name in growing else shape
        arrays[name] = StoredArray(dims, kind, shape, chunk_of(dims, shape, rows), attributes)
    return arrays, growing, fixed


def first_step(prepared: PreparedRun, times: Times, start: Start) -> str:
    """Return a digest of the state after the first step, which identifies the computation of a run."""
    run = prepared.begun(times._replace(max_points=2), start)
    run.advance(until=min(1, times.steps))
    return hashlib.sha256(run.state.arrays.numbers.tobytes()).hexdigest()


def unwritten_error(
    store: ArchiveStore, reason: OSError | ArchiveError, partial: Solution | None = None
) -> ArchiveUnwritten:
    """Return the error for an archive that could not be written, with the points missing from it."""
    steps = store.attributes.get(STEPS, 0)
    error = unwritten_archive(
        store.path,
        reason,
        f"the run was written up to step {steps}, and the new content of this path was not changed",
        f"it holds the run up to step {steps}, from which co.resume continues",
    )
    error.partial = partial
    return error
