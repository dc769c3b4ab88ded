"""The store of an archive: a Zarr store that a run writes while it runs, and that any reader may open at any time.

Content of the folder::

    zarr.json              the root: attributes, and the shapes of all arrays (consolidated metadata)
    x/c.0.0, energy/c.0    chunks of arrays; those over ``time`` and ``crossing`` grow
    x/zarr.json            the array alone, for readers without consolidated metadata
    .coadjoint/lock        locked as long as somebody writes
    .coadjoint/state-...   numbers and arrays from which the run goes on, `ArchiveStore.keep`

**The root is the one point of commitment**: chunks are written first, then the state, and then the root is replaced. It
says how many rows of every array count, and which state belongs to them. Whatever else is in the folder does not count:
rows that are written before the root is are not seen, and are written again by who goes on. Every file is replaced
whole. So a process may be killed at any moment, and at any moment a reader finds arrays of one length, without a hole.

An archive may be written by several processes at once where each writes chunks of its own, and one of them commits.

An archive may come from a stranger. Its metadata must be what the library writes: plain names, and the codecs, types
and chunks of `StoredArray`. Files are reached through `ArchiveFolder`, which follows no links. Nothing is unpickled.
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
from coadjoint.files.archive_folder import ArchiveFolder
from coadjoint.files.stored_arrays import StoredArray
from coadjoint.files.stored_numbers import numbers_from, numbers_to
from coadjoint.files.unfinished import LOCK
from coadjoint.memory import check_room
from coadjoint.wording import short

FORMAT = 1
"""The version of the format; a later version of the library reads earlier ones."""
ROOT = "zarr.json"
HIDDEN = ".coadjoint"
VERSION = "archive_format"
STATE = "state-"
LONGEST_NAME = 255
GROUP = {"zarr_format": 3, "node_type": "group"}
BYTES_OF_JSON = 32
"""Memory that JSON takes when it is parsed, for each of its bytes."""
MOST_ARRAYS = 10**5


class ArchiveError(OneLineError):
    """There is no archive, it is damaged or in use, or one cannot be made; found before anything runs."""


class ArchiveMoved(ArchiveError):
    """A file is missing that the root has named: somebody has committed since it was read, or the file was removed."""


class ArchiveUnwritten(OSError):
    """An archive could not be written during its run; it contains what was committed before, and can be resumed.

    Attributes
    ----------
    partial : Solution or None
        The saved points that were computed since the last commit, which the archive does not contain. None if there
        are none, or if another process has computed them.
    """

    partial: Any = None


class ArchiveReplaced(OSError):
    """The folder of an archive, or its lock file, is no longer the one that the run has begun to write."""


def path_of(given: Any) -> Path:
    """Return the path of an archive, or refuse what is none.

    Examples
    --------
    >>> path_of(3)
    Traceback (most recent call last):
    TypeError: archive is 3; it must be the path of a folder, such as 'run.zarr'
    """
    if not isinstance(given, str | os.PathLike):
        raise TypeError(f"archive is {short(given)}; it must be the path of a folder, such as 'run.zarr'")
    path = os.fspath(given)
    if not isinstance(path, str) or not path or "\0" in path:
        raise ValueError(f"archive is {short(given)}; it must be the path of a folder, such as 'run.zarr'")
    if max(map(len, Path(path).parts), default=0) > LONGEST_NAME:
        raise ValueError(f"archive is {short(given)}; its name is too long")
    return Path(path)


class Kept(NamedTuple):
    """A state that is kept in an archive.

    Parameters
    ----------
    file : str
        Its file in the hidden folder.
    digest : str
        SHA-256 of the file.
    about : dict
        What else is known of it: plain numbers.
    """

    file: str
    digest: str
    about: dict[str, Any]


class ArchiveStore:
    """An archive that is being written; `begun` and `opened` return one.

    Attributes
    ----------
    path : Path
        Its folder.
    arrays : dict of str to StoredArray
        What it holds, as committed.
    attributes : dict
        Those of the root, as committed.
    """

    def __init__(
        self,
        path: Path,
        arrays: Mapping[str, StoredArray],
        attributes: Mapping[str, Any],
        lock: int | None,
        lock_file: str = LOCK,
        folder: ArchiveFolder | None = None,
    ) -> None:
        self.path, self.arrays, self.attributes = path, dict(arrays), dict(attributes)
        self.folder, self._lock, self._lock_file = folder or ArchiveFolder(path), lock, lock_file
        self._touched: set[str] = set()

    @classmethod
    def begun(cls, path: Path, arrays: Mapping[str, StoredArray]) -> ArchiveStore:
        """Return a new archive, in a folder that is made; nothing is in it before the first `commit`.

        Parameters
        ----------
        path : Path
            A new folder.
        arrays : mapping
            What it will hold; of those that grow no rows yet.
        """
        path.mkdir()
        folder = ArchiveFolder(path)
        try:
            for name in (HIDDEN, *arrays):
                folder.make(name)
            folder.write(HIDDEN, ROOT, _json({**GROUP, "attributes": {}}))
            found = cls(path, arrays, {VERSION: FORMAT}, folder.lock(HIDDEN, LOCK), folder=folder)
            found._write_arrays(arrays)
        except BaseException:
            folder.close()
            raise
        return found

    @classmethod
    def opened(cls, path: Path) -> ArchiveStore:
        """Return an archive that is there, to go on with it; what a killed process has left is removed.

        Raises
        ------
        ArchiveError
            Somebody else is writing to it; or as `read_root`.
        """
        read_root(path)
        folder, lock = open_folder(path), None
        try:
            try:
                lock = folder.lock(HIDDEN, LOCK)
            except OSError as reason:
                raise unwritable(path, reason) from None
            if lock is None:
                raise ArchiveError(f"{path}: another process is writing to this archive; wait until it has ended")
            # Once more: what it was before the lock may have changed.
            found = cls(path, *read_root_in(path, folder), lock, folder=folder)
            try:
                for name in ("", HIDDEN, *found.arrays):
                    folder.remove_unfinished(name)
                found._write_arrays(found.arrays)
            except OSError as reason:
                raise unwritable(path, reason) from None
        except BaseException:
            if lock is not None:
                os.close(lock)
            folder.close()
            raise
        return found

    def moved(self, path: Path) -> None:
        """Rename the folder; nothing must be where it goes.

        Raises
        ------
        OSError
            There is something. The archive is closed.
        """
        try:
            os.rename(self.path, path)
        except OSError:
            self.close()
            raise
        self.path = path
        self.folder.path = path.absolute()

    def close(self) -> None:
        """Let others write."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None
        self.folder.close()

    def check_lock(self) -> None:
        """Refuse to write where the lock file is another one: somebody else may be writing.

        Raises
        ------
        ArchiveReplaced
            The lock file was replaced.
        OSError
            It is gone.
        """
        if self._lock is None:
            return
        try:
            there = self.folder.status(HIDDEN, self._lock_file)
        except FileNotFoundError:
            raise FileNotFoundError(errno.ENOENT, "it was removed meanwhile") from None
        if not os.path.samestat(os.fstat(self._lock), there):
            raise ArchiveReplaced(errno.ESTALE, "its lock file was replaced, so that another process may write to it")

    def check_place(self) -> None:
        """Refuse to go on where the name of the archive leads to another folder than the one that is written.

        Raises
        ------
        ArchiveReplaced
            The folder was renamed, and may have been replaced.
        """
        if self._lock is None:
            return
        try:
            there = os.stat(self.folder.path / HIDDEN / self._lock_file, follow_symlinks=False)
        except OSError:
            there = None
        if there is None or not os.path.samestat(os.fstat(self._lock), there):
            raise ArchiveReplaced(errno.ESTALE, "its folder was moved or replaced; what was computed is in the old one")

    def write(self, name: str, values: Any, first: tuple[int, ...] = ()) -> None:
        """Write a part of an array; it does not count before it is committed.

        Parameters
        ----------
        name : str
            Of the array.
        values : array_like
            A region of it. Along the dimension that grows it may begin within a chunk whose first rows are there.
            Along the others it is made of whole chunks.
        first : tuple of int
            Where the region begins; at the start of the dimensions that are not given.
        """
        self.check_lock()
        array, region = self.arrays[name], np.asarray(values)
        begin = (*first, *(0,) * (region.ndim - len(first)))
        for place, inside, outside in array.chunks_at(begin, region.shape):
            key = array_key(place)
            chunk = array.empty()
            if array.grows and inside[0].start > 0:
                chunk[: inside[0].start] = self.chunk(name, place)[: inside[0].start]
            chunk[inside] = region[outside]
            self.folder.write(name, key, array.encoded(chunk))
        self._touched.add(name)

    def chunk(self, name: str, place: tuple[int, ...]) -> NDArray[Any]:
        """Return a chunk that is there.

        Raises
        ------
        ArchiveError
            It is missing or damaged.
        """
        found = _chunk(self.path, self.folder, name, self.arrays[name], place)
        if found is None:
            raise missing_chunk(self.path, name, place)
        return found

    def keep(self, numbers: Mapping[str, Any], about: Mapping[str, Any]) -> Kept:
        """Write numbers and arrays from which a run goes on, and return what `commit` should say of them.

        Parameters
        ----------
        numbers : mapping
            Name -> number or array.
        about : mapping
            Plain numbers that are to be known without reading them.
        """
        self.check_lock()
        raw, file = numbers_to(numbers), f"{STATE}{secrets.token_hex(6)}.npz"
        self.folder.write(HIDDEN, file, raw)
        self._touched.add(HIDDEN)
        return Kept(file, hashlib.sha256(raw).hexdigest(), dict(about))

    def commit(
        self, attributes: Mapping[str, Any], lengths: Mapping[str, int], kept: Iterable[Kept | None] = ()
    ) -> None:
        """Let everything that was written count, at once.

        Parameters
        ----------
        attributes : mapping
            Those of the root; others stay as they are, and those that are None go.
        lengths : mapping
            How many rows there are along the dimensions that grow.
        kept : iterable of Kept
            The states that stay; the files of all others are removed.

        Raises
        ------
        ArchiveReplaced
            The lock file is another one, and nothing is committed; or the folder was moved, and all is committed in it.
        OSError
            It cannot be written; the last commit stays.
        """
        self.check_lock()
        arrays = {
            name: array._replace(shape=(lengths[array.dims[0]], *array.shape[1:])) if array.grows else array
            for name, array in self.arrays.items()
        }
        merged = {**self.attributes, **attributes}
        merged = {name: value for name, value in merged.items() if value is not None}
        self.folder.settle(self._touched)
        changed = {name: array for name, array in arrays.items() if array != self.arrays[name]}
        self.folder.write("", ROOT, _json(root_of(arrays, merged)))
        self.arrays, self.attributes, self._touched = arrays, merged, set()
        self.folder.settle([""])
        self._write_arrays(changed)
        stay = {one.file for one in kept if one is not None}
        for file in self.folder.names(HIDDEN):
            if file.startswith(STATE) and file not in stay:
                self.folder.remove(HIDDEN, file)
        self.check_place()

    def _write_arrays(self, arrays: Mapping[str, StoredArray]) -> None:
        """Write the metadata of single arrays, for readers without consolidated metadata."""
        for name, array in arrays.items():
            self.folder.write(name, ROOT, _json(array.metadata()))


def unwritable(path: Path, reason: OSError) -> ArchiveError:
    """Return the error for an archive that cannot be written, found before anything runs."""
    return ArchiveError(f"{path}: cannot be written ({reason.strerror or reason}); what it holds stays")


def array_key(place: tuple[int, ...]) -> str:
    """Return the name of the file of a chunk.

    Examples
    --------
    >>> array_key((3, 0))
    'c.3.0'
    """
    return ".".join(("c", *map(str, place)))


def root_of(arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the root of an archive says."""
    metadata = {name: array.metadata() for name, array in arrays.items()}
    metadata[HIDDEN] = {**GROUP, "attributes": {}}
    return {
        **GROUP,
        "attributes": {name: getattr(value, "item", lambda value=value: value)() for name, value in attributes.items()},
        "consolidated_metadata": {"kind": "inline", "must_understand": False, "metadata": metadata},
    }


def open_folder(path: Path) -> ArchiveFolder:
    """Return the open folder of an archive.

    Raises
    ------
    ArchiveError
        There is none.
    """
    try:
        return ArchiveFolder(path)
    except FileNotFoundError:
        raise ArchiveError(f"{path}: there is no archive of a run") from None
    except NotADirectoryError:
        raise ArchiveError(f"{path}: is a file; an archive is a folder, which a run with archive= writes") from None
    except OSError as reason:
        raise ArchiveError(f"{path}: cannot be read ({reason.strerror})") from None


def read_root(path: Path) -> tuple[dict[str, StoredArray], dict[str, Any]]:
    """Return the arrays and attributes of an archive, as they are at this moment.

    Raises
    ------
    ArchiveError
        There is none, it is damaged, or a later version of the library has written it.
    """
    with open_folder(path) as folder:
        return read_root_in(path, folder)


def read_root_in(path: Path, folder: ArchiveFolder) -> tuple[dict[str, StoredArray], dict[str, Any]]:
    """Return what `read_root` does, of a folder that is open."""
    try:
        content = folder.read("", ROOT)
        check_room(BYTES_OF_JSON * len(content), ROOT)
        root = json.loads(content.decode("utf-8"), object_pairs_hook=_without_repetition)
        attributes = root["attributes"]
        version = attributes[VERSION]
        metadata = root["consolidated_metadata"]["metadata"]
    except FileNotFoundError:
        raise ArchiveError(f"{path}: there is no archive of a run") from None
    except OSError as reason:
        raise ArchiveError(f"{path}: {ROOT} cannot be read ({reason.strerror})") from None
    except (ValueError, LookupError, TypeError, RecursionError):
        raise ArchiveError(f"{path}: is no archive of a run, or its {ROOT} is damaged") from None
    if isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise ArchiveError(f"{path}: {VERSION} is {short(version)}; it must be a whole number from 1 up")
    if version > FORMAT:
        raise ArchiveError(
            f"{path}: is an archive of format {short(version)}, and this version of coadjoint reads formats up to "
            f"{FORMAT}; take a later version"
        )
    try:
        return _arrays_of(metadata), attributes
    except (LookupError, TypeError, AttributeError, ValueError, RecursionError) as reason:
        said = f" ({in_one_line(str(reason), 200)})" if isinstance(reason, ValueError) else ""
        raise ArchiveError(f"{path}: the arrays in {ROOT} are damaged{said}") from None


def _without_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name is given twice")
    return found


def _arrays_of(metadata: Mapping[str, Any]) -> dict[str, StoredArray]:
    """Return the arrays that the metadata of an archive describe; refuse what the library does not write.

    Raises
    ------
    ValueError
        A name is no plain name, or the metadata of an array are not what `StoredArray.metadata` gives.
    """
    if len(metadata) > MOST_ARRAYS:
        raise ValueError(f"{len(metadata)} arrays")
    found, rows = {}, set()
    for name, each in metadata.items():
        if name == HIDDEN and each["node_type"] == "group":
            continue
        # A file of this name is read and written: no path, and nothing that leads elsewhere.
        if not name.isidentifier() or len(name.encode()) > LONGEST_NAME:
            raise ValueError(f"an array is called {short(name)}, which is no plain name")
        array = StoredArray.of_metadata(each)
        if array.metadata() != each:
            raise ValueError(f"the metadata of {short(name)} are not those that the library writes")
        array.check()
        found[name] = array
        rows |= {array.shape[0]} if array.grows else set()
    if len(rows) > 1:
        raise ValueError(f"arrays over time have the lengths {short(sorted(rows))}")
    return found


def missing_chunk(path: Path, name: str, place: tuple[int, ...]) -> ArchiveError:
    """Return the error for a chunk that was committed and is not there."""
    return ArchiveError(
        f"{path}: {name}/{array_key(place)} is missing, though the archive was committed with it; restore the file"
    )


def _chunk(
    path: Path, folder: ArchiveFolder, name: str, array: StoredArray, place: tuple[int, ...]
) -> NDArray[Any] | None:
    """Return a chunk, or None where it is missing."""
    file = array_key(place)
    try:
        return array.decoded(folder.read(name, file, array.most_bytes))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as reason:
        said = getattr(reason, "strerror", None) or reason
        raise ArchiveError(f"{path}: {name}/{file} cannot be read ({said})") from None


def read_array(
    path: Path,
    name: str,
    array: StoredArray,
    part: Sequence[range] | None = None,
    may_be_missing: Callable[[tuple[int, ...]], bool] | None = None,
) -> NDArray[Any]:
    """Return an array, as it was when the root was read.

    Parameters
    ----------
    path : Path
        The archive.
    name, array
        What is read.
    part : sequence of range, optional
        Along each axis the entries that are read, ascending; by default all.
    may_be_missing : callable, optional
        Whether a chunk, by its numbers along the axes, may not be written yet: it is empty (NaN) then. By default every
        chunk must be there.

    Raises
    ------
    ArchiveError
        A chunk is missing or damaged, or cannot be read.
    """
    chosen = tuple(map(range, array.shape)) if part is None else tuple(part)
    found = np.empty(tuple(map(len, chosen)), dtype=object if array.kind == "string" else array.kind)
    with open_folder(path) as folder:
        for place, inside, outside in array.chunks_in(chosen):
            chunk = _chunk(path, folder, name, array, place)
            if chunk is None:
                if may_be_missing is None or not may_be_missing(place):
                    raise missing_chunk(path, name, place)
                chunk = array.empty()
            found[outside] = chunk[inside]
    return found


def read_kept(path: Path, kept: Kept) -> dict[str, NDArray[Any]]:
    """Return the numbers and arrays of a state that `ArchiveStore.keep` has written.

    Raises
    ------
    ArchiveError
        The file is missing, or is not the one that was written.
    """
    if not (kept.file.startswith(STATE) and kept.file.replace("-", "_").replace(".", "_").isidentifier()):
        raise ArchiveError(f"{path}: a state is called {short(kept.file)}, which is no plain name")
    try:
        with open_folder(path) as folder:
            raw = folder.read(HIDDEN, kept.file)
    except FileNotFoundError:
        raise ArchiveMoved(f"{path}: the state {kept.file} is missing") from None
    except OSError as reason:
        raise ArchiveError(f"{path}: the state {kept.file} cannot be read ({reason.strerror})") from None
    if hashlib.sha256(raw).hexdigest() != kept.digest:
        raise ArchiveError(f"{path}: the state {kept.file} is damaged: its check sum is another one")
    try:
        return numbers_from(raw)
    except ValueError as reason:
        raise ArchiveError(f"{path}: the state {kept.file} is damaged ({reason})") from None


def _json(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content).encode("utf-8")
