"""Archives of runs and of ensembles: what identifies a run, creation before the first step, and writing by pieces."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from collections.abc import Mapping
from contextlib import ExitStack
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coadjoint.files.archives.archive import (
    BLOCK_SIZE_ATTRIBUTE,
    DONE,
    FAILED,
    FINISHED,
    FIRST_STEP,
    PENDING,
    STATUS,
    STEPS,
    WORK_INTEGRALS_ATTRIBUTE,
    MemberBlock,
    StoredState,
    is_computed,
)
from coadjoint.files.archives.folder import ArchiveError, read_archive_path
from coadjoint.files.archives.run_checks import (
    EVENTS_ATTRIBUTE,
    FUNCTIONS_ATTRIBUTE,
    OBSERVED_ATTRIBUTE,
    function_attributes,
    same_fingerprint,
)
from coadjoint.files.archives.store import ArchiveStore, unwritten_archive
from coadjoint.files.archives.stored_arrays import TYPES, StoredArray, chunk_of, rows_of_chunk
from coadjoint.files.datasets.export import ENDED_ATTRIBUTE, attributes_of, failure_attributes
from coadjoint.files.datasets.named_axes import MEMBER
from coadjoint.files.datasets.variables import (
    TIME,
    Variables,
    coordinates_of,
    parameters_of,
    start_variables,
    summary_variables,
    time_coordinate,
    time_variables,
    work_integrals_of_solution,
)
from coadjoint.files.output.atomic_output import PendingOutput, remove_leftovers
from coadjoint.memory import format_bytes
from coadjoint.runs.error_estimates import lost_invariant
from coadjoint.runs.events import Event
from coadjoint.runs.piecewise_run import PiecewiseRun
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.start import Start
from coadjoint.runs.times import Times

MAX_STATE_BYTES = 2**22
"""Limit on the state of a block at one time, for the default block size."""
MEMBERS_PER_BATCH = 32
"""Members that the kernels advance side by side."""
MIN_BLOCK_ROWS = 2**10  # points: the end of an ensemble in blocks is fixed
BLOCKS_PER_WORKER = 4  # so that workers of different speed end at about the same time
STATUS_ATTRIBUTES = {
    "long_name": "whether the member has been computed to its end",
    "flag_values": [PENDING, DONE, FAILED],
    "flag_meanings": "not_computed done failed",
}

IDENTITY_ATTRIBUTES = {
    "system": "the system",
    "sign": "the sign of the system",
    "method": "the scheme",
    "t_span": "t_span",
    "step": "the step",
    "save_every": "save_every",
    "watch": "watch",
    "attitude_carried": "the attitude",
    OBSERVED_ATTRIBUTE: "observe",
    EVENTS_ATTRIBUTE: "events",
    WORK_INTEGRALS_ATTRIBUTE: "the forces",
    "coadjoint_version": "the version of coadjoint",
    FIRST_STEP: "the first step, by a function or a number that is not stored,",
}
"""Attributes that an archive must share with a run that continues it, and their names in messages."""
START_NAMES = {"x0": "x0", "attitude0": "the initial attitude"}
MAX_CROSSING_BYTES = 2**27
"""Limit on the crossings of a run or of a block, which are stored anew with each state."""
LOST = 1e300
"""Largest deviation of an invariant, relative to its size, that is stored."""
BLOCKS, MIN_STATE_BYTES = 64, 2**24
"""A run has about 64 blocks, if their states take at most a quarter of the archive, or 16 MB."""


class PlannedRun(NamedTuple):
    """A prepared run of all members, its times and start, and variables and attributes that are stored with it."""

    prepared: PreparedRun
    times: Times
    start: Start
    coordinates: Variables
    further: Mapping[str, Any]
    events: tuple[Event, ...] = ()

    def in_pieces(self, max_points: int, stored: Mapping[str, Any] | None = None) -> PiecewiseRun:
        """Return the run in pieces of so many points, resumed from stored numbers if there are any."""
        return PiecewiseRun(self.prepared, self.times, self.start, max_points, stored, self.events)

    def at_start(self) -> PiecewiseRun:
        """Return the run before its first step."""
        run = self.in_pieces(1)
        run.advance(0)
        return run

    def first_step(self) -> str:
        """Return a digest of the state after the first step, which identifies the computation of the run."""
        run = self.prepared.begun(self.times._replace(max_points=2), self.start)
        run.advance(until=min(1, self.times.steps))
        return hashlib.sha256(run.state.arrays.numbers.tobytes()).hexdigest()

    def attributes(self, piece: Solution) -> dict[str, Any]:
        """Return the attributes that identify the run; `piece` is its solution at the start."""
        return {
            **attributes_of(piece),
            WORK_INTEGRALS_ATTRIBUTE: json.dumps(work_integrals_of_solution(piece)),
            **function_attributes(self.prepared, self.events),
            FIRST_STEP: self.first_step(),
        }

    def check_same_run(self, store: ArchiveStore) -> None:
        """Raise ArchiveError if the archive is that of another run, with the first difference."""
        start_solution, stored = self.at_start().piece(), store.attributes
        own = self.attributes(start_solution)
        if not store.has_blocks:
            raise ArchiveError(f"{store.path}: is the archive of one run, not of an ensemble; give another name")
        differences = [
            f"{START_NAMES[name]} differs"
            for name, (_, values, _) in start_variables(start_solution).items()
            if name in START_NAMES and not _is_stored(store, name, np.asarray(values))
        ]
        fingerprints = [json.loads(attributes[FUNCTIONS_ATTRIBUTE]) for attributes in (stored, own)]
        differences += [
            f"the code or the numbers of functions of {name} differ"
            for name in fingerprints[0].keys() | fingerprints[1].keys()
            if not same_fingerprint(*(functions.get(name, {}) for functions in fingerprints))
        ]
        differences += [
            f"{what} differs" for key, what in IDENTITY_ATTRIBUTES.items() if own.get(key) != stored.get(key)
        ]
        if differences:
            raise ArchiveError(f"{store.path}: is the archive of another ensemble: {differences[0]}; give another name")


def _is_stored(store: ArchiveStore, name: str, values: Any) -> bool:
    """Whether the archive has an array of these bits; it is read chunk by chunk."""
    if name not in store.arrays or store.arrays[name].shape != values.shape:
        return False
    return all(
        store.chunk(name, indices)[inside].tobytes() == np.ascontiguousarray(values[outside]).tobytes()
        for indices, inside, outside in store.arrays[name].chunks_in(list(map(range, values.shape)))
    )


def size_of_blocks(members: int, numbers: int, workers: int) -> int:
    """Return the default block size: several blocks per worker for load balance, full lanes, and limited chunks."""
    fair = -(-members // (BLOCKS_PER_WORKER * workers))
    if fair > MEMBERS_PER_BATCH:
        fair = -(-fair // MEMBERS_PER_BATCH) * MEMBERS_PER_BATCH
    return max(1, min(fair, members, MAX_STATE_BYTES // (8 * max(1, numbers))))


def create_archive(
    planned: PlannedRun, archive: str | Path, workers: int | None = None, size: int | None = None
) -> ArchiveStore:
    """Create an archive from which a run, or with `workers` an ensemble in blocks, can be resumed."""
    target, run = check_new(archive), planned.at_start()
    piece, points = run.piece(), planned.times.total_points
    coordinates = {**parameters_of(piece.system), **planned.coordinates}
    variables = time_variables(piece)
    numbers_of_row = max(prod(np.shape(values)[1:]) for _, values, _ in variables.values())
    variables |= start_variables(piece) | summary_variables(piece) | coordinates | coordinates_of(piece)
    rows, rows_stored = rows_of_chunk(numbers_of_row), run.points_held
    attributes = {
        **planned.attributes(piece),
        "platform": f"{platform.platform()}, Python {platform.python_version()}, NumPy {np.__version__}",
        FINISHED: int(run.is_over and workers is None),
        STEPS: 0,
        **planned.further,
        **({"coordinates": " ".join(coordinates)} if coordinates else {}),
    }
    if workers is not None:
        members = len(planned.start.momenta)
        size = min(members, size or size_of_blocks(members, numbers_of_row // members, workers))
        rows = min(rows_of_chunk(numbers_of_row // members * size), max(MIN_BLOCK_ROWS, points))
        rows_stored, attributes[BLOCK_SIZE_ATTRIBUTE] = points, size
        variables[STATUS] = ((MEMBER,), np.full(members, PENDING), STATUS_ATTRIBUTES)
        variables |= time_coordinate(planned.times.saved_times)
    arrays, lengths = {}, {TIME: rows_stored}
    for name, (dims, values, about) in variables.items():
        shape = np.shape(values)
        shape = (rows_stored, *shape[1:]) if dims[0] == TIME else shape
        kind = TYPES.get(np.asarray(values).dtype.kind, "string")
        arrays[name] = StoredArray(dims, kind, shape, chunk_of(dims, shape, rows, size), about)
    with ExitStack() as after_failures:
        try:
            with PendingOutput(target) as unfinished:  # a hidden folder; an interrupt leaves the archive unlocked
                store = ArchiveStore.create_archive(unfinished.path, arrays)
                after_failures.callback(store.close)
                for name, (_, values, _) in variables.items():
                    if workers is None or not is_computed(name, arrays[name]):
                        store.write(name, values)
                state = store.store_state(run.stored() if workers is None else {}, {"number": 0, **lengths, "block": 1})
                store.commit(attributes, lengths, [state])
                store.moved(target)
        except OSError as reason:
            raise _creation_error(target, reason) from None
        after_failures.pop_all()
    return store


def check_new(archive: str | Path) -> Path:
    """Validate the path of a new archive; ArchiveError if it exists or cannot be created."""
    target = read_archive_path(archive)
    try:
        if os.path.lexists(target):
            raise ArchiveError(f"{target}: exists; co.resume continues an archive, and a new one needs another name")
        if not target.parent.is_dir():
            raise ArchiveError(f"{target}: the folder {target.parent} does not exist; create it first")
        remove_leftovers(target)
    except OSError as reason:
        raise _creation_error(target, reason) from None
    return target


def _creation_error(target: Path, reason: OSError) -> ArchiveError:
    return ArchiveError(f"{target}: cannot be created ({reason.strerror}); give another name")


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
            ending = f"it holds the run up to step {steps}, from which co.resume continues"
            error = unwritten_archive(self.store.path, reason, ending)
            error.partial = None if steps == run.number else piece
            raise error from reason

    def _write(self, run: PiecewiseRun, piece: Solution) -> None:
        """Write the points of a piece; the times of an ensemble are written when its archive is begun."""
        if run.bytes_of_crossings > MAX_CROSSING_BYTES:
            whose, limit = "run" if self.block is None else "block of members", format_bytes(MAX_CROSSING_BYTES)
            raise ArchiveError(
                f"its events have crossed {len(piece.events or ())} times, and an archive holds at most {limit} of "
                f"crossings for a {whose}; give the events a count, or integrate without archive"
            )
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
        bytes_of_state = run.bytes_of_state
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
        **({} if run.run.ending is None else {ENDED_ATTRIBUTE: run.number}),
    }
