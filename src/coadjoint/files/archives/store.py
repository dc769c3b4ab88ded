"""Writing of archives: a Zarr store that is written during a run and can be opened by readers at any time.

Content of the folder::

    zarr.json              the root: attributes, and the shapes of all arrays (consolidated metadata)
    x/c.0.0, energy/c.0    chunks of arrays; those over ``time`` and ``crossing`` grow
    x/zarr.json            the array alone, for readers without consolidated metadata
    .coadjoint/lock        locked while a process writes
    .coadjoint/state-...   numbers and arrays from which the run resumes, `ArchiveStore.store_state`
    .coadjoint/block-...   of an ensemble: markers of blocks, `ArchiveStore.write_marker`, and their locks

States and markers have a checksum of the committed rows of each chunk. Chunks that are rewritten, the last ones of
arrays that grow, keep these rows.

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
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archives.archive import (
    FORMAT,
    GROUP_METADATA,
    HIDDEN_FOLDER,
    RUN,
    STATE_FILE_PREFIX,
    STATES,
    SUM_PREFIX,
    VERSION_ATTRIBUTE,
    Archive,
    Marker,
    MemberBlock,
    StoredState,
    digest_of_marker,
    read_root,
    root_content,
    sums_among,
)
from coadjoint.files.archives.folder import ArchiveError, ArchiveFolder
from coadjoint.files.archives.stored_arrays import METADATA_FILE, StoredArray, chunk_file, serialize_numbers
from coadjoint.files.output.atomic_output import LOCK_FILE, rename_when_free, sync_to_disk


class ArchiveUnwritten(OSError):
    """An archive could not be written during its run; it contains the last commit, and can be resumed.

    Attributes
    ----------
    partial : Solution or None
        Saved points computed since the last commit, which the archive does not contain. None if there are none, or if
        another process computed them.
    """

    partial: Any = None


def unwritten_archive(path: Path, reason: OSError | ArchiveError, ending: str) -> ArchiveUnwritten:
    """Return the error for an archive that could not be written."""
    problem = getattr(reason, "strerror", None) or str(reason)
    return ArchiveUnwritten(f"{path}: the archive could not be written ({problem}); {ending}")


class ArchiveStore(Archive):
    """An archive open for writing; `arrays` and `attributes` are those of the last commit."""

    folder: ArchiveFolder

    def __init__(
        self,
        folder: ArchiveFolder,
        arrays: Mapping[str, StoredArray],
        attributes: Mapping[str, Any],
        lock_file: str = LOCK_FILE,
    ) -> None:
        super().__init__(folder, arrays, attributes)
        self._lock_file = lock_file
        self._lock: int | None = None
        self._touched: set[str] = set()
        self._pending: dict[str, dict[tuple[int, ...], tuple[int, int]]] = {}
        self._next_sums: dict[str, NDArray[Any]] | None = None

    @property
    def path(self) -> Path:
        """The path of the folder."""
        return self.folder.path

    def lock(self) -> bool:
        """Lock the archive, or the block; return whether no other process holds the lock."""
        self._lock = self.folder.lock(HIDDEN_FOLDER, self._lock_file)
        self._touch_lock()
        return self._lock is not None

    def take_over(self, seconds: float) -> bool:
        """Lock the block in place of a process that has not written for so long; return whether this was possible."""
        # A process that was stopped finds its lock replaced before it writes again.
        with suppress(OSError):
            if time.time() - os.lstat(self.folder.file(HIDDEN_FOLDER, self._lock_file)).st_mtime > seconds:
                self.folder.remove(HIDDEN_FOLDER, self._lock_file)
                return self.lock()
        return False

    def _touch_lock(self) -> None:
        """Set the time of the lock, by which other processes see that this one is alive."""
        if self._lock is not None and os.utime in os.supports_fd:
            os.utime(self._lock)

    @classmethod
    def create_archive(cls, path: Path, arrays: Mapping[str, StoredArray]) -> ArchiveStore:
        """Create an archive in a new folder; it is empty until the first `commit`."""
        for name in ("", HIDDEN_FOLDER, *arrays):
            (path / name).mkdir()
        store = cls(ArchiveFolder(path), arrays, {VERSION_ATTRIBUTE: FORMAT, RUN: secrets.token_hex(16)})
        store.sums = {}
        with ExitStack() as after_failures:
            after_failures.callback(store.close)
            store.folder.write(HIDDEN_FOLDER, METADATA_FILE, _json({**GROUP_METADATA, "attributes": {}}))
            store.lock()
            store._write_arrays(arrays)
            after_failures.pop_all()
        return store

    @classmethod
    def open_existing(cls, path: Path) -> ArchiveStore:
        """Open an archive to resume it, and remove leftovers of a killed process; ArchiveError if it is locked."""
        folder = ArchiveFolder(path)
        store = cls(folder, *read_root(folder))
        with ExitStack() as after_failures:
            after_failures.callback(store.close)
            try:
                if not store.lock():
                    raise ArchiveError(f"{path}: another process is writing to this archive; wait until it has ended")
                # Read again: it may have changed before it was locked.
                store.arrays, store.attributes = read_root(folder)
                for name in ("", HIDDEN_FOLDER, *store.arrays):
                    folder.remove_unfinished(name)
                store._write_arrays(store.arrays)
            except OSError as reason:
                raise unwritable_error(path, reason) from None
            after_failures.pop_all()
        return store

    def moved(self, path: Path) -> None:
        """Rename the folder; if the target exists or another process opens it first, close it and raise OSError."""
        self.close()  # Windows renames no folder in which a file is open
        rename_when_free(lambda: os.rename(self.path, path))
        self.folder = ArchiveFolder(path)
        if not self.lock():
            raise BlockingIOError(errno.EAGAIN, "another process is writing to it")

    def close(self) -> None:
        """Release the lock."""
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)

    def check_lock(self) -> None:
        """Raise OSError if the lock file was replaced (another process may write), or is no longer at its path."""
        with suppress(OSError):
            status = os.lstat(self.folder.file(HIDDEN_FOLDER, self._lock_file))
            if self._lock is not None and os.path.samestat(os.fstat(self._lock), status):
                return self._touch_lock()
        raise OSError(errno.ESTALE, "its folder or its lock file was moved or replaced")

    def write(self, name: str, values: Any, first: tuple[int, ...] = ()) -> None:
        """Write a region of an array that begins at `first` (0 along the other dimensions), to be committed later."""
        # Along the dimension that grows it may begin within a chunk, along the others it consists of whole ones.
        array, region = self.arrays[name], np.asarray(values)
        begin = (*first, *(0,) * (region.ndim - len(first)))
        for indices, inside, outside in array.chunks_in(
            [range(a, a + n) for a, n in zip(begin, region.shape, strict=True)]
        ):
            chunk = array.empty()
            if array.grows and inside[0].start > 0:
                chunk[: inside[0].start] = self.chunk(name, indices)[: inside[0].start]
            chunk[inside] = region[outside]
            content = array.encoded(chunk)
            self.check_lock()
            self.folder.write(name, chunk_file(indices), content)
            place = self.place_of(name, indices)
            self._pending.setdefault(name, {})[place] = inside[0].stop, array.sum_of(chunk[: inside[0].stop])
        self._touched.add(name)

    def committed(self, name: str, indices: tuple[int, ...]) -> tuple[int, int | None]:
        pending = self._pending.get(name, {}).get(self.place_of(name, indices))
        return pending or super().committed(name, indices)

    def _numbers_and_sums(self, numbers: Mapping[str, Any], sums: Mapping[str, NDArray[Any]]) -> bytes:
        """Serialize numbers with the checksums of all chunks: `sums`, and those of chunks written since."""
        if self.attributes[VERSION_ATTRIBUTE] < FORMAT:
            return serialize_numbers(numbers)
        self._next_sums = dict(sums)
        for name, written in self._pending.items():
            places = np.array(list(written))
            before = self._next_sums.get(name, np.zeros((0,) * places.shape[1], np.uint32))
            after = np.zeros(np.maximum(before.shape, places.max(axis=0) + 1), np.uint32)
            after[tuple(map(slice, before.shape))] = before
            after[tuple(places.T)] = [checksum for _, checksum in written.values()]
            self._next_sums[name] = after
        return serialize_numbers({**numbers, **{f"{SUM_PREFIX}{name}": sums for name, sums in self._next_sums.items()}})

    def store_state(self, numbers: Mapping[str, Any], about: Mapping[str, Any]) -> StoredState:
        """Write the numbers from which a run resumes; return the entry for `commit`, with `about`."""
        self.check_lock()
        raw, file = self._numbers_and_sums(numbers, self.sums), f"{STATE_FILE_PREFIX}{secrets.token_hex(6)}.npz"
        self.folder.write(HIDDEN_FOLDER, file, raw)
        self._touched.add(HIDDEN_FOLDER)
        return StoredState(file, hashlib.sha256(raw).hexdigest(), dict(about))

    def begin_block(self, block: MemberBlock) -> Marker | None:
        """Return the marker from which a block resumes; None if it begins, also if its marker is damaged."""
        marker = self.intact_marker(block)
        self._progress[block.number] = marker and (marker.head["rows"], sums_among(marker.numbers))
        return marker

    def write_marker(self, block: MemberBlock, about: Mapping[str, Any], stored: Mapping[str, Any]) -> None:
        """Commit a block by its marker, atomically: a line of JSON with checksums, then the numbers."""
        self._sync(self._touched)
        before = self._progress_of(block.number)
        raw = self._numbers_and_sums(stored, before[1] if before else {})
        head = json.dumps({"about": dict(about), "bytes": len(raw), "numbers": hashlib.sha256(raw).hexdigest()})
        line = f"{digest_of_marker(self.attributes, block, head)} {head}\n"
        self.check_lock()
        self.folder.write(HIDDEN_FOLDER, block.marker, line.encode() + raw)
        self._sync([HIDDEN_FOLDER])
        self._progress[block.number] = about["rows"], self._next_sums or {}
        self._touched, self._pending = set(), {}

    def commit(self, attributes: Mapping[str, Any], lengths: Mapping[str, int], states: Iterable[StoredState]) -> None:
        """Commit everything written so far, atomically; states not in `states` are removed."""
        arrays = {
            name: array._replace(shape=(lengths[array.dims[0]], *array.shape[1:])) if array.grows else array
            for name, array in self.arrays.items()
        }
        states = list(states)
        merged = {**self.attributes, **attributes, STATES: json.dumps(states)}
        self._sync(self._touched)
        changed = {name: array for name, array in arrays.items() if array != self.arrays[name]}
        self.check_lock()
        self.folder.write("", METADATA_FILE, _json(root_content(arrays, merged)))
        self.arrays, self.attributes, self._touched, self._pending = arrays, merged, set(), {}
        self.sums = self.sums if self._next_sums is None else self._next_sums
        self._sync([""])
        self._write_arrays(changed)
        retained = {state.file for state in states}
        for file in self.folder.names(HIDDEN_FOLDER):
            if file.startswith(STATE_FILE_PREFIX) and file not in retained:
                # Windows keeps the files that a reader has open; the next commit removes them.
                with suppress(PermissionError):
                    self.folder.remove(HIDDEN_FOLDER, file)

    def _sync(self, folders: Iterable[str]) -> None:
        """Sync the directory entries of some subfolders to disk."""
        self.check_lock()
        for folder in folders:
            sync_to_disk(self.folder.file(folder))

    def _write_arrays(self, arrays: Mapping[str, StoredArray]) -> None:
        """Write the metadata of single arrays, for readers without consolidated metadata."""
        for name, array in arrays.items():
            self.folder.write(name, METADATA_FILE, _json(array.metadata()))


def unwritable_error(path: Path, reason: OSError) -> ArchiveError:
    """Return the error for an archive that cannot be written, raised before anything runs."""
    return ArchiveError(f"{path}: cannot be written ({reason.strerror or reason}); its content is unchanged")


def _json(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content).encode("utf-8")
