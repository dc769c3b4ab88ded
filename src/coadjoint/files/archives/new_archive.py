"""Creation of archives, of runs and of ensembles, before the first step, and comparison with those that exist."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coadjoint.files.archives.archive import (
    ACCOUNTS_ATTRIBUTE,
    BLOCK_SIZE_ATTRIBUTE,
    DONE,
    FAILED,
    FINISHED,
    PENDING,
    STATUS,
    STEPS,
    is_computed,
)
from coadjoint.files.archives.folder import ArchiveError, read_archive_path
from coadjoint.files.archives.root import FIRST_STEP
from coadjoint.files.archives.run_checks import (
    FUNCTIONS_ATTRIBUTE,
    OBSERVED_ATTRIBUTE,
    function_attributes,
    same_fingerprint,
)
from coadjoint.files.archives.store import ArchiveStore
from coadjoint.files.archives.stored_arrays import TYPES, StoredArray, chunk_of, rows_of_chunk
from coadjoint.files.datasets.export import attributes_of
from coadjoint.files.datasets.named_axes import MEMBER
from coadjoint.files.datasets.variables import (
    TIME,
    Variables,
    accounts_of_work,
    coordinates_of,
    parameters_of,
    start_variables,
    summary_variables,
    time_coordinate,
    time_variables,
)
from coadjoint.files.output.atomic_output import PendingOutput, remove_leftovers
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
    ACCOUNTS_ATTRIBUTE: "the forces",
    "coadjoint_version": "the version of coadjoint",
    FIRST_STEP: "the first step, by a function or a number that is not stored,",
}
"""Attributes that an archive must share with a run that continues it, and their names in messages."""
START_NAMES = {"x0": "x0", "attitude0": "the initial attitude"}


class PlannedRun(NamedTuple):
    """A prepared run of all members, its times and start, and variables and attributes that are stored with it."""

    prepared: PreparedRun
    times: Times
    start: Start
    coordinates: Variables
    further: Mapping[str, Any]

    def in_pieces(self, max_points: int, stored: Mapping[str, Any] | None = None) -> PiecewiseRun:
        """Return the run in pieces of so many points, resumed from stored numbers if there are any."""
        return PiecewiseRun(self.prepared, self.times, self.start, max_points, stored)

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
            ACCOUNTS_ATTRIBUTE: json.dumps(accounts_of_work(piece)),
            **function_attributes(self.prepared),
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
        store.chunk(store.folder, name, indices)[inside].tobytes() == np.ascontiguousarray(values[outside]).tobytes()
        for indices, inside, outside in store.arrays[name].chunks_in(list(map(range, values.shape)))
    )


def size_of_blocks(members: int, numbers: int, workers: int) -> int:
    """Return the default block size: several blocks per worker for load balance, full lanes, and limited chunks."""
    fair = -(-members // (BLOCKS_PER_WORKER * workers))
    if fair > MEMBERS_PER_BATCH:
        fair = -(-fair // MEMBERS_PER_BATCH) * MEMBERS_PER_BATCH
    return max(1, min(fair, members, MAX_STATE_BYTES // (8 * max(1, numbers))))


def create_archive(
    planned: PlannedRun,
    archive: str | Path,
    workers: int | None = None,
    size: int | None = None,
) -> ArchiveStore:
    """Create an archive from which a run, or with `workers` an ensemble in blocks, can be resumed."""
    target, run = check_new(archive), planned.at_start()
    piece, points = run.piece(), planned.times.total_points
    coordinates = {**parameters_of(piece.system), **planned.coordinates}
    variables = time_variables(piece)
    numbers_of_row = max(prod(np.shape(values)[1:]) for _, values, _ in variables.values())
    variables |= start_variables(piece) | summary_variables(piece) | coordinates | coordinates_of(piece)
    rows_stored = run.points_held
    if workers is not None:
        members = len(planned.start.momenta)
        size = min(members, size or size_of_blocks(members, numbers_of_row // members, workers))
        numbers_of_row, rows_stored = numbers_of_row // members * size, points
        variables[STATUS] = ((MEMBER,), np.full(members, PENDING), STATUS_ATTRIBUTES)
        variables |= time_coordinate(planned.times.saved_times)
    rows = rows_of_chunk(numbers_of_row)
    if workers is not None:
        rows = min(rows, max(MIN_BLOCK_ROWS, points))
    arrays = {}
    for name, (dims, values, about) in variables.items():
        shape = np.shape(values)
        shape = (rows_stored, *shape[1:]) if dims[0] == TIME else shape
        kind = TYPES.get(np.asarray(values).dtype.kind, "string")
        arrays[name] = StoredArray(dims, kind, shape, chunk_of(dims, shape, rows, size), about)
    attributes = {
        **planned.attributes(piece),
        "platform": f"{platform.platform()}, Python {platform.python_version()}, NumPy {np.__version__}",
        FINISHED: int(run.is_over and workers is None),
        STEPS: 0,
        **planned.further,
    }
    if coordinates:
        attributes["coordinates"] = " ".join(coordinates)

    def write(store: ArchiveStore) -> None:
        for name, (_, values, _) in variables.items():
            if workers is None or not is_computed(name, arrays[name]):
                store.write(name, values)
        lengths = {TIME: rows_stored}
        if workers is not None:
            attributes[BLOCK_SIZE_ATTRIBUTE] = size
        numbers = run.stored() if workers is None else {}
        store.commit(attributes, lengths, [store.store_state(numbers, {"number": 0, **lengths, "block": 1})])

    return _created_in_place(target, arrays, write)


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


def _created_in_place(
    target: Path, arrays: Mapping[str, StoredArray], write: Callable[[ArchiveStore], None]
) -> ArchiveStore:
    """Return an archive that is written in a hidden folder, then renamed; an interrupt leaves it unlocked."""
    with ExitStack() as after_failures:
        try:
            with PendingOutput(target) as unfinished:
                store = ArchiveStore.create_archive(unfinished.path, arrays)
                after_failures.callback(store.close)
                write(store)
                store.moved(target)
        except OSError as reason:
            raise _creation_error(target, reason) from None
        after_failures.pop_all()
    return store


def _creation_error(target: Path, reason: OSError) -> ArchiveError:
    return ArchiveError(f"{target}: cannot be created ({reason.strerror}); give another name")
