"""The store of an archive: a Zarr store that is written during a run and can be opened by readers at any time.

Content of the folder::

    zarr.json              the root: attributes, and the shapes of all arrays (consolidated metadata)
    x/c.0.0, energy/c.0    chunks of arrays; those over ``time`` and ``crossing`` grow
    x/zarr.json            the array alone, for readers without consolidated metadata
    .coadjoint/lock        locked while a process writes
    .coadjoint/state-...   numbers and arrays from which the run resumes, `ArchiveStore.store_state`

**Replacing the root is the commit**: chunks are written first, then the state, then the root. The root holds the number
of rows of every array, and the state that belongs to them. Anything else in the folder is ignored: uncommitted rows are
invisible, and are overwritten on resume. Every file is replaced atomically. So the process may be killed at any moment,
and a reader always finds arrays of one length without gaps. Several processes may write an archive at once if each
writes its own chunks and one of them commits.

An archive may be untrusted. Its metadata must be what the library writes: plain names, and the codecs, types and chunks
of `StoredArray`. Files are reached through `ArchiveFolder`, which follows no links. Nothing is unpickled.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import OneLineError, in_one_line
from coadjoint.files.archives.folder import ArchiveFolder
from coadjoint.files.archives.stored_arrays import StoredArray, deserialize_numbers, serialize_numbers
from coadjoint.files.output.atomic_output import LOCK_FILE
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short

FORMAT = 1
"""Version of the format; later versions of the library read earlier ones."""
ROOT_FILE = "zarr.json"
HIDDEN_FOLDER = ".coadjoint"
VERSION_ATTRIBUTE = "archive_format"
STATE_PREFIX = "state-"
MAX_NAME_LENGTH = 255
GROUP_METADATA = {"zarr_format": 3, "node_type": "group"}
JSON_MEMORY_FACTOR = 32
"""Memory needed to parse JSON, per byte."""
MAX_ARRAYS = 10**5


class ArchiveError(OneLineError):
    """An archive is missing, damaged, in use, or cannot be created; raised before anything runs."""


class ArchiveMoved(ArchiveError):
    """A file named by the root is missing: another process has committed since it was read, or the file was removed."""


class ArchiveUnwritten(OSError):
    """An archive could not be written during its run; it contains the last commit, and can be resumed.

    Attributes
    ----------
    partial : Solution or None
        Saved points computed since the last commit, which the archive does not contain. None if there are none, or if
        another process computed them.
    """

    partial: Any = None


class ArchiveReplaced(OSError):
    """The folder of an archive, or its lock file, was replaced while the run was writing to it."""


def unwritten_archive(path: Path, reason: OSError | ArchiveError, replaced: str, otherwise: str) -> ArchiveUnwritten:
    """Return the error for an archive that could not be written, ending with `replaced` or `otherwise`."""
    problem = getattr(reason, "strerror", None) or str(reason)
    ending = replaced if isinstance(reason, ArchiveReplaced) else otherwise
    return ArchiveUnwritten(f"{path}: the archive could not be written ({problem}); {ending}")


def read_archive_path(value: Any) -> Path:
    """Validate the path of an archive.

    Examples
    --------
    >>> read_archive_path(3)
    Traceback (most recent call last):
    TypeError: archive is 3; it must be the path of a folder, such as 'run.zarr'
    """
    if not isinstance(value, str | os.PathLike):
        raise TypeError(f"archive is {short(value)}; it must be the path of a folder, such as 'run.zarr'")
    path = os.fspath(value)
    if not isinstance(path, str) or not path or "\0" in path:
        raise ValueError(f"archive is {short(value)}; it must be the path of a folder, such as 'run.zarr'")
    if max(map(len, Path(path).parts), default=0) > MAX_NAME_LENGTH:
        raise ValueError(f"archive is {short(value)}; its name is too long")
    return Path(path)


class StoredState(NamedTuple):
    """Entry of a stored state: its file in the hidden folder, the SHA-256 of the file, and further plain numbers."""

    file: str
    digest: str
    about: dict[str, Any]


class ArchiveStore:
    """An archive open for writing, from `create_archive` or `open_existing`; `arrays` and `attributes` are those of the
    last commit.
    """

    def __init__(
        self,
        path: Path,
        arrays: Mapping[str, StoredArray],
        attributes: Mapping[str, Any],
        lock: int | None,
        lock_file: str = LOCK_FILE,
        folder: ArchiveFolder | None = None,
    ) -> None:
        self.path, self.arrays, self.attributes = path, dict(arrays), dict(attributes)
        self.folder, self._lock, self._lock_file = folder or ArchiveFolder(path), lock, lock_file
        self._touched: set[str] = set()

    @classmethod
    def create_archive(cls, path: Path, arrays: Mapping[str, StoredArray]) -> ArchiveStore:
        """Create an archive in a new folder; it is empty until the first `commit`."""
        path.mkdir()
        folder = ArchiveFolder(path)
        try:
            for name in (HIDDEN_FOLDER, *arrays):
                folder.make(name)
            folder.write(HIDDEN_FOLDER, ROOT_FILE, _json({**GROUP_METADATA, "attributes": {}}))
            store = cls(path, arrays, {VERSION_ATTRIBUTE: FORMAT}, folder.lock(HIDDEN_FOLDER, LOCK_FILE), folder=folder)
            store._write_arrays(arrays)
        except BaseException:
            folder.close()
            raise
        return store

    @classmethod
    def open_existing(cls, path: Path) -> ArchiveStore:
        """Open an archive to resume it, and remove leftovers of a killed process; ArchiveError if it is locked."""
        read_root(path)
        folder, lock = open_folder(path), None
        try:
            try:
                lock = folder.lock(HIDDEN_FOLDER, LOCK_FILE)
            except OSError as reason:
                raise unwritable_error(path, reason) from None
            if lock is None:
                raise ArchiveError(f"{path}: another process is writing to this archive; wait until it has ended")
            # Read again: it may have changed before it was locked.
            store = cls(path, *read_root_in(path, folder), lock, folder=folder)
            try:
                for name in ("", HIDDEN_FOLDER, *store.arrays):
                    folder.remove_unfinished(name)
                store._write_arrays(store.arrays)
            except OSError as reason:
                raise unwritable_error(path, reason) from None
        except BaseException:
            if lock is not None:
                os.close(lock)
            folder.close()
            raise
        return store

    def moved(self, path: Path) -> None:
        """Rename the folder; if the target exists, close the archive and raise OSError."""
        try:
            os.rename(self.path, path)
        except OSError:
            self.close()
            raise
        self.path = path
        self.folder.path = path.absolute()

    def close(self) -> None:
        """Release the lock and close the folder."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None
        self.folder.close()

    def check_lock(self) -> None:
        """Raise ArchiveReplaced if the lock file was replaced (another process may write); OSError if it is gone."""
        if self._lock is None:
            return
        try:
            status = self.folder.status(HIDDEN_FOLDER, self._lock_file)
        except FileNotFoundError:
            raise FileNotFoundError(errno.ENOENT, "it was removed meanwhile") from None
        if not os.path.samestat(os.fstat(self._lock), status):
            raise ArchiveReplaced(errno.ESTALE, "its lock file was replaced, so that another process may write to it")

    def check_not_replaced(self) -> None:
        """Raise ArchiveReplaced if the path of the archive no longer leads to the folder being written."""
        if self._lock is None:
            return
        try:
            status = os.stat(self.folder.path / HIDDEN_FOLDER / self._lock_file, follow_symlinks=False)
        except OSError:
            status = None
        if status is None or not os.path.samestat(os.fstat(self._lock), status):
            raise ArchiveReplaced(errno.ESTALE, "its folder was moved or replaced; the computed part is in the old one")

    def write(self, name: str, values: Any, first: tuple[int, ...] = ()) -> None:
        """Write a region of an array that begins at `first` (0 along the other dimensions), to be committed later.

        Along the dimension that grows, the region may begin within a chunk whose first rows are written. Along the
        others it consists of whole chunks.
        """
        self.check_lock()
        array, region = self.arrays[name], np.asarray(values)
        begin = (*first, *(0,) * (region.ndim - len(first)))
        for indices, inside, outside in array.chunks_at(begin, region.shape):
            key = chunk_file(indices)
            chunk = array.empty()
            if array.grows and inside[0].start > 0:
                chunk[: inside[0].start] = self.chunk(name, indices)[: inside[0].start]
            chunk[inside] = region[outside]
            self.folder.write(name, key, array.encoded(chunk))
        self._touched.add(name)

    def chunk(self, name: str, indices: tuple[int, ...]) -> NDArray[Any]:
        """Return a chunk; ArchiveError if it is missing or damaged."""
        chunk = _chunk(self.path, self.folder, name, self.arrays[name], indices)
        if chunk is None:
            raise missing_chunk_error(self.path, name, indices)
        return chunk

    def store_state(self, numbers: Mapping[str, Any], about: Mapping[str, Any]) -> StoredState:
        """Write the numbers and arrays from which a run resumes; return the entry for `commit`.

        `about` holds plain numbers that can be read without the file.
        """
        self.check_lock()
        raw, file = serialize_numbers(numbers), f"{STATE_PREFIX}{secrets.token_hex(6)}.npz"
        self.folder.write(HIDDEN_FOLDER, file, raw)
        self._touched.add(HIDDEN_FOLDER)
        return StoredState(file, hashlib.sha256(raw).hexdigest(), dict(about))

    def commit(
        self, attributes: Mapping[str, Any], lengths: Mapping[str, int], states: Iterable[StoredState | None] = ()
    ) -> None:
        """Commit everything written so far, atomically.

        `attributes` are merged into those of the root (None removes); `lengths` are the rows along dimensions that
        grow; states not in `states` are removed. ArchiveReplaced: the lock file was replaced, and nothing is committed;
        or the folder was moved, and everything is committed in it. OSError: the previous commit stays valid.
        """
        self.check_lock()
        arrays = {
            name: array._replace(shape=(lengths[array.dims[0]], *array.shape[1:])) if array.grows else array
            for name, array in self.arrays.items()
        }
        merged = {**self.attributes, **attributes}
        merged = {name: value for name, value in merged.items() if value is not None}
        self.folder.sync_to_disk(self._touched)
        changed = {name: array for name, array in arrays.items() if array != self.arrays[name]}
        self.folder.write("", ROOT_FILE, _json(root_content(arrays, merged)))
        self.arrays, self.attributes, self._touched = arrays, merged, set()
        self.folder.sync_to_disk([""])
        self._write_arrays(changed)
        retained = {state.file for state in states if state is not None}
        for file in self.folder.names(HIDDEN_FOLDER):
            if file.startswith(STATE_PREFIX) and file not in retained:
                self.folder.remove(HIDDEN_FOLDER, file)
        self.check_not_replaced()

    def _write_arrays(self, arrays: Mapping[str, StoredArray]) -> None:
        """Write the metadata of single arrays, for readers without consolidated metadata."""
        for name, array in arrays.items():
            self.folder.write(name, ROOT_FILE, _json(array.metadata()))


def unwritable_error(path: Path, reason: OSError) -> ArchiveError:
    """Return the error for an archive that cannot be written, raised before anything runs."""
    return ArchiveError(f"{path}: cannot be written ({reason.strerror or reason}); its content is unchanged")


def chunk_file(indices: tuple[int, ...]) -> str:
    """Return the file name of a chunk.

    Examples
    --------
    >>> chunk_file((3, 0))
    'c.3.0'
    """
    return ".".join(("c", *map(str, indices)))


def root_content(arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of the root."""
    metadata = {name: array.metadata() for name, array in arrays.items()}
    metadata[HIDDEN_FOLDER] = {**GROUP_METADATA, "attributes": {}}
    return {
        **GROUP_METADATA,
        "attributes": {name: getattr(value, "item", lambda value=value: value)() for name, value in attributes.items()},
        "consolidated_metadata": {"kind": "inline", "must_understand": False, "metadata": metadata},
    }


def open_folder(path: Path) -> ArchiveFolder:
    """Open the folder of an archive; ArchiveError if there is none."""
    try:
        return ArchiveFolder(path)
    except FileNotFoundError:
        raise ArchiveError(f"{path}: there is no archive of a run") from None
    except NotADirectoryError:
        raise ArchiveError(f"{path}: is a file; an archive is a folder, which a run with archive= writes") from None
    except OSError as reason:
        raise ArchiveError(f"{path}: cannot be read ({reason.strerror})") from None


def read_root(path: Path) -> tuple[dict[str, StoredArray], dict[str, Any]]:
    """Return the arrays and attributes of an archive, as currently committed.

    ArchiveError: missing, damaged, or of a later format.
    """
    with open_folder(path) as folder:
        return read_root_in(path, folder)


def read_root_in(path: Path, folder: ArchiveFolder) -> tuple[dict[str, StoredArray], dict[str, Any]]:
    """Like `read_root`, for an open folder."""
    try:
        content = folder.read("", ROOT_FILE)
        check_available_memory(JSON_MEMORY_FACTOR * len(content), ROOT_FILE)
        root = json.loads(content.decode("utf-8"), object_pairs_hook=_reject_duplicates)
        attributes = root["attributes"]
        version = attributes[VERSION_ATTRIBUTE]
        metadata = root["consolidated_metadata"]["metadata"]
    except FileNotFoundError:
        raise ArchiveError(f"{path}: there is no archive of a run") from None
    except OSError as reason:
        raise ArchiveError(f"{path}: {ROOT_FILE} cannot be read ({reason.strerror})") from None
    except (ValueError, LookupError, TypeError, RecursionError):
        raise ArchiveError(f"{path}: is no archive of a run, or its {ROOT_FILE} is damaged") from None
    if isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise ArchiveError(f"{path}: {VERSION_ATTRIBUTE} is {short(version)}; it must be a whole number from 1 up")
    if version > FORMAT:
        raise ArchiveError(
            f"{path}: is an archive of format {short(version)}, and this version of coadjoint reads formats up to "
            f"{FORMAT}; install a later version"
        )
    try:
        return _arrays_of(metadata), attributes
    except (LookupError, TypeError, AttributeError, ValueError, RecursionError) as reason:
        problem = f" ({in_one_line(str(reason), 200)})" if isinstance(reason, ValueError) else ""
        raise ArchiveError(f"{path}: the arrays in {ROOT_FILE} are damaged{problem}") from None


def _reject_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        raise ValueError("a name is given twice")
    return table


def _arrays_of(metadata: Mapping[str, Any]) -> dict[str, StoredArray]:
    """Parse the metadata of all arrays; ValueError unless they are what `StoredArray.metadata` returns."""
    if len(metadata) > MAX_ARRAYS:
        raise ValueError(f"{len(metadata)} arrays")
    arrays, rows = {}, set()
    for name, entry in metadata.items():
        if name == HIDDEN_FOLDER and entry["node_type"] == "group":
            continue
        # The name becomes a path: allow only identifiers.
        if not name.isidentifier() or len(name.encode()) > MAX_NAME_LENGTH:
            raise ValueError(f"an array is called {short(name)}, which is no plain name")
        array = StoredArray.of_metadata(entry)
        if array.metadata() != entry:
            raise ValueError(f"the metadata of {short(name)} are not those that the library writes")
        array.check()
        arrays[name] = array
        rows |= {array.shape[0]} if array.grows else set()
    if len(rows) > 1:
        raise ValueError(f"arrays over time have the lengths {short(sorted(rows))}")
    return arrays


def missing_chunk_error(path: Path, name: str, indices: tuple[int, ...]) -> ArchiveError:
    """Return the error for a chunk that was committed and is missing."""
    return ArchiveError(f"{path}: {name}/{chunk_file(indices)} is missing, although it was committed; restore the file")


def _chunk(
    path: Path, folder: ArchiveFolder, name: str, array: StoredArray, indices: tuple[int, ...]
) -> NDArray[Any] | None:
    """Return a chunk, or None if it is missing."""
    file = chunk_file(indices)
    try:
        return array.decoded(folder.read(name, file, array.max_encoded_bytes))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as reason:
        problem = getattr(reason, "strerror", None) or reason
        raise ArchiveError(f"{path}: {name}/{file} cannot be read ({problem})") from None


def read_array(
    path: Path,
    name: str,
    array: StoredArray,
    part: Sequence[range] | None = None,
    may_be_missing: Callable[[tuple[int, ...]], bool] | None = None,
) -> NDArray[Any]:
    """Return an array, as it was when the root was read, or the ascending ranges `part` along its axes.

    Chunks for which `may_be_missing` (of the chunk indices) is true are NaN if missing; any other missing or damaged
    chunk raises ArchiveError.
    """
    ranges = tuple(map(range, array.shape)) if part is None else tuple(part)
    values = np.empty(tuple(map(len, ranges)), dtype=object if array.kind == "string" else array.kind)
    with open_folder(path) as folder:
        for indices, inside, outside in array.chunks_in(ranges):
            chunk = _chunk(path, folder, name, array, indices)
            if chunk is None:
                if may_be_missing is None or not may_be_missing(indices):
                    raise missing_chunk_error(path, name, indices)
                chunk = array.empty()
            values[outside] = chunk[inside]
    return values


def read_state(path: Path, state: StoredState) -> dict[str, NDArray[Any]]:
    """Return the numbers and arrays of `ArchiveStore.store_state`; ArchiveError if the file is missing or was
    changed.
    """
    if not (state.file.startswith(STATE_PREFIX) and state.file.replace("-", "_").replace(".", "_").isidentifier()):
        raise ArchiveError(f"{path}: a state is called {short(state.file)}, which is no plain name")
    try:
        with open_folder(path) as folder:
            raw = folder.read(HIDDEN_FOLDER, state.file)
    except FileNotFoundError:
        raise ArchiveMoved(f"{path}: the state {state.file} is missing") from None
    except OSError as reason:
        raise ArchiveError(f"{path}: the state {state.file} cannot be read ({reason.strerror})") from None
    if hashlib.sha256(raw).hexdigest() != state.digest:
        raise ArchiveError(f"{path}: the state {state.file} is damaged: its checksum does not match")
    try:
        return deserialize_numbers(raw)
    except ValueError as reason:
        raise ArchiveError(f"{path}: the state {state.file} is damaged ({reason})") from None


def _json(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content).encode("utf-8")
