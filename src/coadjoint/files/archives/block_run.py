"""The run of one block of an ensemble, into its own chunks of the archive and its marker."""

from __future__ import annotations

import json
import platform
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint import __version__
from coadjoint.files.archives.archived_run import FINISHED, STEPS
from coadjoint.files.archives.blocks import DONE, FAILED, PENDING, STATUS, Block, lock_file, read_marker, write_marker
from coadjoint.files.archives.reading import HIDDEN_FOLDER, ArchiveError, open_folder, read_root_in
from coadjoint.files.archives.store import ArchiveStore, ArchiveUnwritten
from coadjoint.files.datasets.export import failure_attributes
from coadjoint.files.datasets.variables import summary_variables, time_variables
from coadjoint.runs.piecewise_run import PiecewiseRun, Sink
from coadjoint.runs.times import times_of

if TYPE_CHECKING:
    from coadjoint.errors import IntegrationError
    from coadjoint.files.archives.stored_arrays import StoredArray
    from coadjoint.runs.prepared_run import PreparedRun

BUSY = {"busy": True}


class BlockSink(Sink):
    """The chunks and the marker of a block, which take the pieces of its run; `about` is the head of the marker."""

    failure: IntegrationError | None = None

    def __init__(self, store: ArchiveStore, block: Block, about: dict[str, Any]) -> None:
        self.store, self.block, self.about = store, block, about
        self._seconds = float(about.get("seconds", 0.0))

    def take(self, run: PiecewiseRun) -> None:
        """Commit the steps of the block computed so far."""
        store, block = self.store, self.block
        if run.number == self.about.get(STEPS):
            return
        piece = run.piece()
        variables = {**time_variables(piece), **summary_variables(piece)}
        for name, (dims, values, _) in variables.items():
            store.write(name, values, (run.first, block.first) if dims[0] == "time" else (block.first,))
        self.failure = run.failure(piece) if run.is_over else None
        failed = np.asarray(piece.failed)
        status = np.where(failed, FAILED, DONE) if run.is_over else np.full(len(failed), PENDING)
        store.write(STATUS, status, (block.first,))
        store.folder.sync_to_disk((*variables, STATUS))
        stats = piece.stats
        self.about = {
            STEPS: run.number,
            FINISHED: int(run.is_over),
            "evaluations": stats.evaluations,
            "iterations": stats.iterations,
            "seconds": self._seconds + stats.seconds,
            "failed": int(failed.sum()),
            "first_failed": block.first + int(failed.argmax()) if failed.any() else -1,
            "rows": run.first + run.points_held,
        }
        if self.failure is not None:
            self.about |= failure_attributes(self.failure)
            # Members are numbered within the block here; the ensemble adds the member that failed.
            failed_members = f" for {failed.sum()} of {len(failed)} members (first: member {failed.argmax()})"
            self.about["failed_reason"] = str(self.failure).replace(failed_members, "")
        write_marker(store.folder, block.number, self.about, run.stored())
        store.check_not_replaced()


def run_block(
    archive: str, block: Block, prepared: PreparedRun, all_members: bool, threads: int | None
) -> dict[str, Any]:
    """Run a block to its end from the state in its marker; return the head of the marker, or ``BUSY`` if it is locked.

    `prepared` is the run of all members (`all_members`) or of those of the block. ArchiveError: the archive is missing,
    or of another version of the library. ArchiveUnwritten: it cannot be written.
    """
    path, host = Path(archive), platform.node()
    try:
        folder = open_folder(path)
    except ArchiveError as reason:
        raise _unreadable_error(reason) from None
    store: ArchiveStore | None = None
    try:
        try:
            arrays, attributes = read_root_in(path, folder)
        except ArchiveError as reason:
            raise _unreadable_error(reason) from None
        if attributes["coadjoint_version"] != __version__:
            raise ArchiveError(
                f"{path}: was begun by coadjoint {attributes['coadjoint_version']}, and the worker on {host} has "
                f"{__version__}; install the same version everywhere"
            )
        lock = folder.lock(HIDDEN_FOLDER, lock_file(block.number))
        if lock is None:
            return BUSY
        store = ArchiveStore(path, arrays, attributes, lock, lock_file(block.number), folder)
        times = times_of(_span(attributes), float(attributes["step"]), int(attributes["save_every"]))
        first, last = (block.first, block.last) if all_members else (0, block.last - block.first)
        of_block, marker = prepared.among(first, last, threads), read_marker(folder, block.number)
        sink = BlockSink(store, block, {FINISHED: 0} if marker is None else marker.about)
        x0, attitude = (_of_block(store, name, block) for name in ("x0", "attitude0"))
        stored = None if marker is None else marker.stored
        run = PiecewiseRun(of_block, times, of_block.start(x0, attitude), arrays["time"].chunk[0], stored)
        if marker is None:
            run.advance(0)
        if not sink.about[FINISHED]:
            run.advance_into(sink)
        return sink.about
    except ArchiveUnwritten:
        raise
    except OSError as reason:
        problem = reason.strerror or str(reason)
        raise ArchiveUnwritten(
            f"{path}: members {block.first} to {block.last - 1} could not be written on {host} ({problem}); "
            "the next call with this archive continues"
        ) from reason
    finally:
        if store is not None:
            store.close()
        folder.close()


def _unreadable_error(reason: ArchiveError) -> ArchiveError:
    """Return the error for an archive that a worker cannot read."""
    return ArchiveError(
        f"{reason} on the machine {platform.node()}; every worker must reach the folder by the same path"
    )


def _span(attributes: dict[str, Any]) -> Any:
    return tuple(json.loads(attributes["t_span"]))


def _of_block(store: ArchiveStore, name: str, block: Block) -> Any:
    """Return the initial values of the members of a block, or None if the archive has no such array."""
    array: StoredArray | None = store.arrays.get(name)
    if array is None:
        return None
    chunk = store.chunk(name, (block.number, *(0,) * (len(array.shape) - 1)))
    values = chunk[: block.last - block.first]
    return values[..., 0] + 1j * values[..., 1] if array.dims[-1] == "part" else values
