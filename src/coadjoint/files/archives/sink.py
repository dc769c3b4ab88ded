"""Writing of runs to archives, piece by piece."""

from __future__ import annotations

import time
from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np

from coadjoint.files.archives.archive import DONE, FAILED, FINISHED, PENDING, STATUS, STEPS, MemberBlock, StoredState
from coadjoint.files.archives.folder import ArchiveError
from coadjoint.files.archives.store import ArchiveStore, unwritten_archive
from coadjoint.files.datasets.export import failure_attributes
from coadjoint.files.datasets.variables import summary_variables, time_coordinate, time_variables
from coadjoint.runs.error_estimates import lost_invariant
from coadjoint.runs.piecewise_run import PiecewiseRun
from coadjoint.runs.results.solution import Solution

LOST = 1e300
"""Largest deviation of an invariant, relative to its size, that is stored."""
BLOCKS, MIN_STATE_BYTES = 64, 2**24
"""A run has about 64 blocks, if their states take at most a quarter of the archive, or 16 MB."""


class ArchiveSink:
    """Takes the pieces of a run into an archive, whose root has its progress; or of a `block`, with its own marker.

    `head` is the progress as last committed; `began` is the time at which the call of a run began.
    """

    def __init__(
        self, store: ArchiveStore, head: Mapping[str, Any], block: MemberBlock | None = None, began: float = 0.0
    ) -> None:
        self.store, self.head, self.block, self._began = store, head, block, began
        self._states = [] if block else store.states
        self._seconds, self._elapsed = (float(head.get(name, 0.0)) for name in ("seconds", "elapsed"))

    def take(self, run: PiecewiseRun) -> None:
        """Commit the steps computed so far; ArchiveUnwritten if that fails: the archive holds the last commit."""
        if run.number == self.head.get(STEPS):
            return
        piece: Solution | None = None
        try:
            piece = run.piece()
            self._write(run, piece)
            if self.block is None:
                self._commit_run(run, progress_of(run, piece, self._seconds))
            else:
                self._commit_block(self.block, run, piece)
        except (OSError, ArchiveError) as reason:
            if self.block is not None:
                raise
            steps = self.store.attributes.get(STEPS, 0)
            error = unwritten_archive(
                self.store.path,
                reason,
                f"the run was written up to step {steps}, and the new content of this path was not changed",
                f"it holds the run up to step {steps}, from which co.resume continues",
            )
            error.partial = None if steps == run.number else piece
            raise error from reason

    def _write(self, run: PiecewiseRun, piece: Solution) -> None:
        """Write the points of a piece; the times of an ensemble are written when its archive is begun."""
        members = () if self.block is None else (self.block.first,)
        series = time_variables(piece) | (time_coordinate(piece.t) if self.block is None else {})
        for name, (_, values, _) in series.items():
            self.store.write(name, values, (run.first, *members))
        for name, (_, values, _) in summary_variables(piece).items():
            self.store.write(name, values, members)

    def _commit_run(self, run: PiecewiseRun, progress: dict[str, Any]) -> None:
        lengths = {"time": run.first + run.points_held}
        states = self._store_states(run, lengths)
        elapsed = self._elapsed + time.perf_counter() - self._began
        self.store.commit({**progress, "elapsed": elapsed}, lengths, states)
        self._states, self.head = states, self.store.attributes

    def _commit_block(self, block: MemberBlock, run: PiecewiseRun, piece: Solution) -> None:
        failed = np.asarray(piece.failed)
        status = np.where(failed, FAILED, DONE) if run.is_over else np.full(len(failed), PENDING)
        self.store.write(STATUS, status, (block.first,))
        self.head = {
            **progress_of(run, piece, self._seconds),
            "failed": int(failed.sum()),
            "first_failed": block.first + int(failed.argmax()) if failed.any() else -1,
            "rows": run.first + run.points_held,
        }
        if run.is_over and (lost := lost_invariant(piece)).large:
            self.head["lost"] = [*lost._replace(ratio=min(lost.ratio, LOST), member=block.first + lost.member)]
        if "failed_reason" in self.head:
            # Members are numbered within the block here; the ensemble adds the member that failed.
            failed_members = f" for {failed.sum()} of {len(failed)} members (first: member {failed.argmax()})"
            self.head["failed_reason"] = self.head["failed_reason"].replace(failed_members, "")
        self.store.write_marker(block, self.head, run.stored())

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
