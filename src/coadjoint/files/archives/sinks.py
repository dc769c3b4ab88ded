"""Sinks of runs: a run commits its pieces to an archive, or to the block of an ensemble, atomically."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np

from coadjoint.files.archives.archive import (
    DONE,
    FAILED,
    FINISHED,
    PENDING,
    STATES,
    STATUS,
    STEPS,
    ArchiveError,
    MemberBlock,
    StoredState,
)
from coadjoint.files.archives.store import ArchiveStore, unwritten_archive
from coadjoint.files.datasets.export import failure_attributes
from coadjoint.files.datasets.variables import summary_variables, time_coordinate, time_variables
from coadjoint.runs.piecewise_run import PiecewiseRun, Sink
from coadjoint.runs.results.solution import Solution

BLOCKS, MIN_STATE_BYTES = 64, 2**24
"""A run has about 64 blocks, if their states take at most a quarter of the archive, or 16 MB."""


class ArchiveSink(Sink):
    """An archive that takes the pieces of a run; `began` is the time at which the call of the run began."""

    def __init__(self, store: ArchiveStore, began: float) -> None:
        self.store, self._began, self._states = store, began, store.states
        self._seconds, self._elapsed = (float(store.attributes.get(name, 0.0)) for name in ("seconds", "elapsed"))

    def take(self, run: PiecewiseRun) -> None:
        """Commit the steps computed so far; ArchiveUnwritten if that fails: the archive holds the last commit."""
        store = self.store
        if run.number == store.attributes[STEPS]:
            return
        piece: Solution | None = None
        try:
            piece = run.piece()
            for name, (_, values, _) in {**time_variables(piece), **time_coordinate(piece.t)}.items():
                store.write(name, values, (run.first,))
            for name, (_, values, _) in summary_variables(piece).items():
                store.write(name, values)
            progress = progress_of(run, piece, self._seconds)
            lengths = {"time": run.first + run.points_held}
            states = self._store_states(run, lengths)
            elapsed = self._elapsed + time.perf_counter() - self._began
            store.commit({**progress, STATES: json.dumps(states), "elapsed": elapsed}, lengths, states)
            self._states = states
        except (OSError, ArchiveError) as reason:
            steps = store.attributes.get(STEPS, 0)
            error = unwritten_archive(
                store.path,
                reason,
                f"the run was written up to step {steps}, and the new content of this path was not changed",
                f"it holds the run up to step {steps}, from which co.resume continues",
            )
            error.partial = None if steps == run.number else piece
            raise error from reason

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


class BlockSink(Sink):
    """The chunks and the marker of a block, which take the pieces of its run; `head` is the head of the marker."""

    def __init__(self, store: ArchiveStore, block: MemberBlock, head: dict[str, Any]) -> None:
        self.store, self.block, self.head = store, block, head
        self._seconds = float(head.get("seconds", 0.0))

    def take(self, run: PiecewiseRun) -> None:
        """Commit the steps of the block computed so far."""
        store, block = self.store, self.block
        if run.number == self.head.get(STEPS):
            return
        piece = run.piece()
        failed = np.asarray(piece.failed)
        status = np.where(failed, FAILED, DONE) if run.is_over else np.full(len(failed), PENDING)
        for name, (_, values, _) in time_variables(piece).items():
            store.write(name, values, (run.first, block.first))
        for name, (_, values, _) in {**summary_variables(piece), STATUS: ((), status, {})}.items():
            store.write(name, values, (block.first,))
        self.head = {
            **progress_of(run, piece, self._seconds),
            "failed": int(failed.sum()),
            "first_failed": block.first + int(failed.argmax()) if failed.any() else -1,
            "rows": run.first + run.points_held,
        }
        if "failed_reason" in self.head:
            # Members are numbered within the block here; the ensemble adds the member that failed.
            failed_members = f" for {failed.sum()} of {len(failed)} members (first: member {failed.argmax()})"
            self.head["failed_reason"] = self.head["failed_reason"].replace(failed_members, "")
        store.write_marker(block, self.head, run.stored())


def progress_of(run: PiecewiseRun, piece: Solution, earlier_seconds: float) -> dict[str, Any]:
    """Return the attributes with the progress of a run, and with its failure."""
    failure, stats = run.failure(piece) if run.is_over else None, piece.stats
    return {
        STEPS: run.number,
        FINISHED: int(run.is_over),
        "evaluations": stats.evaluations,
        "iterations": stats.iterations,
        "seconds": earlier_seconds + stats.seconds,
        **(failure_attributes(failure) if failure else {}),
    }
