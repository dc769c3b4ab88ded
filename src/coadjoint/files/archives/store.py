"""Writing of archives: a Zarr store that is written during a run and can be opened by readers at any time.

Content of the folder::

    zarr.json              the root: attributes, and the shapes of all arrays (consolidated metadata)
    x/c.0.0, energy/c.0    chunks of arrays; those over ``time`` and ``crossing`` grow
    x/zarr.json            the array alone, for readers without consolidated metadata
    .coadjoint/lock        locked while a process writes
    .coadjoint/state-...   numbers and arrays from which the run resumes, `ArchiveStore.store_state`
    .coadjoint/block-...   of an ensemble: markers of blocks, `ArchiveStore.write_marker`, and their locks

**Replacing the root is the commit**: chunks are written first, then the state, then the root. The root holds the number
of rows of every array, and the state that belongs to them. Anything else in the folder is ignored: uncommitted rows are
invisible, and are overwritten on resume. Every file is replaced atomically. So the process may be killed at any moment,
and a reader always finds arrays of one length without gaps.

The blocks of an ensemble are written by several processes at once. Blocks have one size, which is the chunk size of all
arrays along the members, so that no two blocks share a file. A marker is replaced atomically, after all chunks that it
refers to. A block is done when its marker records it as finished. A damaged marker is ignored: the block is run again,
with the same bits.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import time
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from coadjoint.files.archives.archive import (
    DONE,
    FAILED,
    FINISHED,
    FORMAT,
    HIDDEN_FOLDER,
    PENDING,
    ROOT_FILE,
    STATE_FILE_PREFIX,
    STATES,
    STATUS,
    STEPS,
    VERSION_ATTRIBUTE,
    Archive,
    ArchiveError,
    MemberBlock,
    StoredState,
    chunk_file,
    open_folder,
    read_root,
)
from coadjoint.files.archives.folder import ArchiveFolder
from coadjoint.files.archives.stored_arrays import StoredArray, serialize_numbers
from coadjoint.files.datasets.export import failure_attributes
from coadjoint.files.datasets.variables import summary_variables, time_coordinate, time_variables
from coadjoint.files.output.atomic_output import LOCK_FILE, rename_when_free
from coadjoint.runs.piecewise_run import PiecewiseRun
from coadjoint.runs.results.solution import Solution

GROUP_METADATA = {"zarr_format": 3, "node_type": "group"}
REPLACED = errno.ESTALE
"""Number of the errors that the folder of an archive, or its lock file, was replaced during a run."""


class ArchiveUnwritten(OSError):
    """An archive could not be written during its run; it contains the last commit, and can be resumed.

    Attributes
    ----------
    partial : Solution or None
        Saved points computed since the last commit, which the archive does not contain. None if there are none, or if
        another process computed them.
    """

    partial: Any = None


def unwritten_archive(path: Path, reason: OSError | ArchiveError, replaced: str, otherwise: str) -> ArchiveUnwritten:
    """Return the error for an archive that could not be written, ending with `replaced` or `otherwise`."""
    problem = getattr(reason, "strerror", None) or str(reason)
    ending = replaced if getattr(reason, "errno", None) == REPLACED else otherwise
    return ArchiveUnwritten(f"{path}: the archive could not be written ({problem}); {ending}")


class ArchiveStore(Archive):
    """An archive open for writing; `arrays` and `attributes` are those of the last commit."""

    path: Path

    def __init__(
        self,
        path: Path,
        arrays: Mapping[str, StoredArray],
        attributes: Mapping[str, Any],
        folder: ArchiveFolder,
        lock_file: str = LOCK_FILE,
    ) -> None:
        super().__init__(path, arrays, attributes)
        self.folder, self._lock_file = folder, lock_file
        self._lock: int | None = None
        self._touched: set[str] = set()

    def opened(self) -> AbstractContextManager[ArchiveFolder]:
        """Return the folder, which stays open."""
        return nullcontext(self.folder)

    def lock(self) -> bool:
        """Lock the archive, or the block; return whether no other process holds the lock."""
        self._lock = self.folder.lock(HIDDEN_FOLDER, self._lock_file)
        return self._lock is not None

    @classmethod
    def create_archive(cls, path: Path, arrays: Mapping[str, StoredArray]) -> ArchiveStore:
        """Create an archive in a new folder; it is empty until the first `commit`."""
        path.mkdir()
        store = cls(path, arrays, {VERSION_ATTRIBUTE: FORMAT}, ArchiveFolder(path))
        try:
            for name in (HIDDEN_FOLDER, *arrays):
                store.folder.make(name)
            store.folder.write(HIDDEN_FOLDER, ROOT_FILE, _json({**GROUP_METADATA, "attributes": {}}))
            store.lock()
            store._write_arrays(arrays)
        except BaseException:
            store.close()
            raise
        return store

    @classmethod
    def open_existing(cls, path: Path) -> ArchiveStore:
        """Open an archive to resume it, and remove leftovers of a killed process; ArchiveError if it is locked."""
        store = cls(path, *read_root(path), open_folder(path))
        with ExitStack() as after_failures:
            after_failures.callback(store.close)
            try:
                if not store.lock():
                    raise ArchiveError(f"{path}: another process is writing to this archive; wait until it has ended")
                # Read again: it may have changed before it was locked.
                store.arrays, store.attributes = read_root(path, store.folder)
                for name in ("", HIDDEN_FOLDER, *store.arrays):
                    store.folder.remove_unfinished(name)
                store._write_arrays(store.arrays)
            except OSError as reason:
                raise unwritable_error(path, reason) from None
            after_failures.pop_all()
        return store

    def moved(self, path: Path) -> None:
        """Rename the folder; if the target exists or another process opens it first, close it and raise OSError."""
        try:
            self._release()  # Windows renames no folder in which a file is open
            rename_when_free(lambda: os.rename(self.path, path))
            self.path = path
            self.folder.path = path.absolute()
            if not self.lock():
                raise BlockingIOError(errno.EAGAIN, "another process is writing to it")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Release the lock and close the folder."""
        self._release()
        self.folder.close()

    def _release(self) -> None:
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)

    def _is_own_lock(self, status: os.stat_result) -> bool:
        return self._lock is None or os.path.samestat(os.fstat(self._lock), status)

    def check_lock(self) -> None:
        """Raise OSError of `REPLACED` if the lock file was replaced (another process may write), or if it is gone."""
        try:
            status = self.folder.status(HIDDEN_FOLDER, self._lock_file)
        except FileNotFoundError:
            raise FileNotFoundError(errno.ENOENT, "it was removed meanwhile") from None
        if not self._is_own_lock(status):
            raise OSError(REPLACED, "its lock file was replaced, so that another process may write to it")

    def check_not_replaced(self) -> None:
        """Raise OSError of `REPLACED` if the path of the archive no longer leads to the folder being written."""
        with suppress(OSError):
            if self._is_own_lock(os.stat(self.folder.path / HIDDEN_FOLDER / self._lock_file, follow_symlinks=False)):
                return
        raise OSError(REPLACED, "its folder was moved or replaced; the computed part is in the old one")

    def write(self, name: str, values: Any, first: tuple[int, ...] = ()) -> None:
        """Write a region of an array that begins at `first` (0 along the other dimensions), to be committed later."""
        # Along the dimension that grows it may begin within a chunk, along the others it consists of whole ones.
        self.check_lock()
        array, region = self.arrays[name], np.asarray(values)
        begin = (*first, *(0,) * (region.ndim - len(first)))
        for indices, inside, outside in array.chunks_in(
            [range(a, a + n) for a, n in zip(begin, region.shape, strict=True)]
        ):
            chunk = array.empty()
            if array.grows and inside[0].start > 0:
                chunk[: inside[0].start] = self.chunk(self.folder, name, indices)[: inside[0].start]
            chunk[inside] = region[outside]
            self.folder.write(name, chunk_file(indices), array.encoded(chunk))
        self._touched.add(name)

    def store_state(self, numbers: Mapping[str, Any], about: Mapping[str, Any]) -> StoredState:
        """Write the numbers from which a run resumes; return the entry for `commit`, with `about`."""
        self.check_lock()
        raw, file = serialize_numbers(numbers), f"{STATE_FILE_PREFIX}{secrets.token_hex(6)}.npz"
        self.folder.write(HIDDEN_FOLDER, file, raw)
        self._touched.add(HIDDEN_FOLDER)
        return StoredState(file, hashlib.sha256(raw).hexdigest(), dict(about))

    def write_marker(self, block: MemberBlock, about: Mapping[str, Any], stored: Mapping[str, Any]) -> None:
        """Commit a block by its marker, atomically: a line of JSON with checksums, then the numbers."""
        self.folder.sync_to_disk(self._touched)
        raw = serialize_numbers(stored)
        head = json.dumps({"about": dict(about), "bytes": len(raw), "numbers": hashlib.sha256(raw).hexdigest()})
        line = f"{hashlib.sha256(head.encode()).hexdigest()} {head}\n"
        self.folder.write(HIDDEN_FOLDER, block.marker, line.encode() + raw)
        self.folder.sync_to_disk([HIDDEN_FOLDER])
        self._touched = set()
        self.check_not_replaced()

    def commit(
        self, attributes: Mapping[str, Any], lengths: Mapping[str, int], states: Iterable[StoredState] = ()
    ) -> None:
        """Commit everything written so far, atomically; states not in `states` are removed."""
        # An error of `REPLACED`: nothing was committed (another lock file), or all in a folder that was moved.
        self.check_lock()
        arrays = {
            name: array._replace(shape=(lengths[array.dims[0]], *array.shape[1:])) if array.grows else array
            for name, array in self.arrays.items()
        }
        merged = {**self.attributes, **attributes}
        self.folder.sync_to_disk(self._touched)
        changed = {name: array for name, array in arrays.items() if array != self.arrays[name]}
        self.folder.write("", ROOT_FILE, _json(root_content(arrays, merged)))
        self.arrays, self.attributes, self._touched = arrays, merged, set()
        self.folder.sync_to_disk([""])
        self._write_arrays(changed)
        retained = {state.file for state in states}
        for file in self.folder.names(HIDDEN_FOLDER):
            if file.startswith(STATE_FILE_PREFIX) and file not in retained:
                # Windows keeps the files that a reader has open; the next commit removes them.
                with suppress(PermissionError):
                    self.folder.remove(HIDDEN_FOLDER, file)
        self.check_not_replaced()

    def _write_arrays(self, arrays: Mapping[str, StoredArray]) -> None:
        """Write the metadata of single arrays, for readers without consolidated metadata."""
        for name, array in arrays.items():
            self.folder.write(name, ROOT_FILE, _json(array.metadata()))


def unwritable_error(path: Path, reason: OSError) -> ArchiveError:
    """Return the error for an archive that cannot be written, raised before anything runs."""
    return ArchiveError(f"{path}: cannot be written ({reason.strerror or reason}); its content is unchanged")


def root_content(arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of the root."""
    metadata = {name: array.metadata() for name, array in arrays.items()}
    metadata[HIDDEN_FOLDER] = {**GROUP_METADATA, "attributes": {}}
    return {
        **GROUP_METADATA,
        "attributes": {name: getattr(value, "item", lambda value=value: value)() for name, value in attributes.items()},
        "consolidated_metadata": {"kind": "inline", "must_understand": False, "metadata": metadata},
    }


def _json(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content).encode("utf-8")


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
        self.store.commit({**progress, STATES: json.dumps(states), "elapsed": elapsed}, lengths, states)
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
