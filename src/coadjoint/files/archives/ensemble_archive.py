"""Archives of ensembles: creation, comparison with a run that continues them, and completion. All times are known."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from coadjoint.files.archives.archived_run import ACCOUNTS_ATTRIBUTE, FINISHED, FIRST_STEP, STEPS, first_step
from coadjoint.files.archives.blocks import (
    BLOCK_SIZE_ATTRIBUTE,
    MEMBER,
    PENDING,
    STATUS,
    STATUS_ATTRIBUTES,
    Block,
    blocks_of,
    is_complete,
    lock_file,
    marker_file,
    read_head,
    size_of_blocks,
)
from coadjoint.files.archives.metadata_checks import CROSSING_PREFIX, RESERVED_NAMES, SERIES_PREFIXES
from coadjoint.files.archives.reading import HIDDEN_FOLDER, ArchiveError
from coadjoint.files.archives.resume import check_new, created_in_place
from coadjoint.files.archives.store import ArchiveStore
from coadjoint.files.archives.stored_arrays import TYPES, StoredArray, rows_of_chunk
from coadjoint.files.datasets.export import attributes_of
from coadjoint.files.datasets.variables import (
    ExtraMetadata,
    Variables,
    accounts_of,
    coordinates_of,
    start_variables,
    summary_variables,
    time_coordinate,
    time_variables,
)
from coadjoint.files.records.fingerprints import same_fingerprint
from coadjoint.files.records.required_functions import FUNCTIONS_ATTRIBUTE, OBSERVED_ATTRIBUTE, function_attributes
from coadjoint.runs.piecewise_run import PiecewiseRun

if TYPE_CHECKING:
    from coadjoint.runs.prepared_run import PreparedRun
    from coadjoint.runs.results.solution import Solution
    from coadjoint.runs.start import Start
    from coadjoint.runs.times import Times

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


class Ensemble(NamedTuple):
    """A prepared run of all members, with its start and times."""

    prepared: PreparedRun
    times: Times
    start: Start

    def at_start(self) -> Solution:
        """Return the solution before the first step."""
        run = PiecewiseRun(self.prepared, self.times, self.start, 1)
        run.advance(0)
        return run.piece()


def create_archive(
    ensemble: Ensemble, archive: str | Path, size: int | None, workers: int, metadata: ExtraMetadata
) -> ArchiveStore:
    """Create an archive with the initial states of all members.

    `size` is the number of members per block; if None, it is chosen for this number of workers.
    """
    target = check_new(archive)
    start_solution = ensemble.at_start()
    metadata = metadata.with_batch_parameters(start_solution.system)
    members = len(ensemble.start.momenta)
    growing = time_variables(start_solution)
    row_size = max(prod(np.shape(values)[1:]) for _, values, _ in growing.values()) // members
    size = min(members, size or size_of_blocks(members, row_size, workers))
    rows = rows_of_chunk(row_size * size, ensemble.times.total_points)
    times = time_coordinate(ensemble.times.saved_times)
    fixed: Variables = {
        **start_variables(start_solution),
        **metadata.coordinates,
        **coordinates_of(start_solution),
        **times,
    }
    computed: Variables = {
        **growing,
        **summary_variables(start_solution),
        STATUS: ((MEMBER,), np.full(members, PENDING), STATUS_ATTRIBUTES),
    }
    reserved = sorted(
        name
        for name in metadata.coordinates
        if name in RESERVED_NAMES or name.startswith((*SERIES_PREFIXES, CROSSING_PREFIX))
    )
    if reserved:
        raise ValueError(f"coordinates has the name {reserved[0]!r}, which is reserved")
    points = ensemble.times.total_points
    arrays = {name: _array(*entry, size, rows, points) for name, entry in (fixed | computed).items()}
    platform_text = f"{platform.platform()}, Python {platform.python_version()}, NumPy {np.__version__}"
    attributes = {
        **identity_attributes(ensemble, start_solution),
        "platform": platform_text,
        BLOCK_SIZE_ATTRIBUTE: size,
        FINISHED: 0,
        STEPS: 0,
    }
    attributes |= metadata.attributes
    if metadata.coordinates:
        attributes["coordinates"] = " ".join(metadata.coordinates)

    def create(folder: Path) -> ArchiveStore:
        store = ArchiveStore.create_archive(folder, arrays)
        try:
            for name, (_, values, _) in fixed.items():
                store.write(name, np.asarray(values))
            store.commit(attributes, {"time": points})
        except BaseException:
            store.close()
            raise
        return store

    return created_in_place(target, create)


def identity_attributes(ensemble: Ensemble, piece: Solution) -> dict[str, Any]:
    """Return the attributes that identify a run."""
    return {
        **attributes_of(piece),
        ACCOUNTS_ATTRIBUTE: json.dumps(accounts_of(piece)),
        **function_attributes(ensemble.prepared, ()),
        FIRST_STEP: first_step(ensemble.prepared, ensemble.times, ensemble.start),
    }


def _array(
    dims: tuple[str, ...], values: Any, attributes: Mapping[str, Any], size: int, rows: int, points: int
) -> StoredArray:
    """Return an array whose chunks along the members are blocks."""
    shape = list(np.shape(values))
    if dims[0] == "time":
        shape[0] = points
    lengths = {"time": rows, MEMBER: size}
    chunk = [max(1, lengths.get(name, length)) for name, length in zip(dims, shape, strict=True)]
    kind = TYPES.get(np.asarray(values).dtype.kind, "string")
    return StoredArray(dims, kind, tuple(shape), tuple(chunk), dict(attributes))


def check_same_run(ensemble: Ensemble, store: ArchiveStore) -> None:
    """Raise ArchiveError if the archive is that of another run, with the first difference."""
    start_solution = ensemble.at_start()
    own_attributes, stored_attributes = identity_attributes(ensemble, start_solution), store.attributes
    if BLOCK_SIZE_ATTRIBUTE not in stored_attributes:
        raise ArchiveError(f"{store.path}: is the archive of one run, not of an ensemble; give another name")
    for name, (_, values, _) in start_variables(start_solution).items():
        array = store.arrays.get(name)
        if array is None or not _equal(store, name, array, np.asarray(values)):
            what = {"x0": "x0", "attitude0": "the initial attitude"}[name]
            raise _different_run_error(store, f"{what} differs")
    stored_fingerprints, fingerprints = (
        json.loads(stored_attributes[FUNCTIONS_ATTRIBUTE]),
        json.loads(own_attributes[FUNCTIONS_ATTRIBUTE]),
    )
    for name in stored_fingerprints.keys() | fingerprints.keys():
        if not same_fingerprint(stored_fingerprints.get(name, {}), fingerprints.get(name, {})):
            raise _different_run_error(store, f"the code or the numbers of functions of {name} differ")
    for key, what in IDENTITY_ATTRIBUTES.items():
        if own_attributes.get(key) != stored_attributes.get(key):
            raise _different_run_error(store, f"{what} differs")


def _different_run_error(store: ArchiveStore, difference: str) -> ArchiveError:
    return ArchiveError(f"{store.path}: is the archive of another ensemble: {difference}; give another name")


def _equal(store: ArchiveStore, name: str, array: StoredArray, values: Any) -> bool:
    """Whether an array is bitwise equal to these numbers; read chunk by chunk."""
    if array.shape != values.shape:
        return False
    for indices, inside, outside in array.chunks_at((0,) * len(array.shape), array.shape):
        chunk = store.chunk(name, indices)[inside]
        if chunk.tobytes() != np.ascontiguousarray(values[outside]).tobytes():
            return False
    return True


def unfinished_blocks(store: ArchiveStore) -> list[Block]:
    """Return the unfinished blocks."""
    unfinished = []
    for block in blocks_of(store.arrays["x0"].shape[0], int(store.attributes[BLOCK_SIZE_ATTRIBUTE])):
        head = read_head(store.folder, block.number)
        if head is not None and not is_complete(store.folder, store.arrays, block, int(head["rows"])):
            store.folder.remove(HIDDEN_FOLDER, marker_file(block.number))
            head = None
        if head is None or not head[FINISHED]:
            unfinished.append(block)
    return unfinished


def finish_ensemble(store: ArchiveStore, began: float) -> dict[str, Any]:
    """Mark the ensemble as finished in the root, with the time since its call began; return its attributes."""
    blocks = blocks_of(store.arrays["x0"].shape[0], int(store.attributes[BLOCK_SIZE_ATTRIBUTE]))
    heads = [read_head(store.folder, block.number) or {} for block in blocks]
    attributes: dict[str, Any] = {
        FINISHED: 1,
        STEPS: min(int(head[STEPS]) for head in heads),
        "evaluations": sum(int(head["evaluations"]) for head in heads),
        "iterations": sum(int(head["iterations"]) for head in heads),
        "seconds": sum(float(head["seconds"]) for head in heads),
        "elapsed": float(store.attributes.get("elapsed", 0.0)) + time.perf_counter() - began,
    }
    failures = [head for head in heads if head.get("run_failed")]
    if failures:
        count, first = sum(head["failed"] for head in heads), failures[0]
        members = store.arrays["x0"].shape[0]
        attributes |= {name: value for name, value in first.items() if name.startswith(("run_failed", "failed_"))}
        if count:
            failed_members = (
                f"{count} of {members} members failed, the first of them is member {first['first_failed']}: "
            )
            attributes["failed_reason"] = f"{failed_members}{first['failed_reason']}"
    store.commit(attributes, {"time": store.arrays["time"].shape[0]})
    for block in blocks:
        store.folder.remove(HIDDEN_FOLDER, lock_file(block.number))
    return attributes
