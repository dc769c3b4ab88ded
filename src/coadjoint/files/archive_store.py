"""Where does a run go while it runs? Into an archive: a Zarr store that any reader may open at any time.

What is where in the folder::

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
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import secrets
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import OneLineError
from coadjoint.files.stored_arrays import StoredArray
from coadjoint.files.unfinished import LOCK, locked
from coadjoint.files.whole_files import WRITING, settle, write_whole
from coadjoint.wording import short

FORMAT = 1
"""The version of the format; a later version of the library reads earlier ones."""
ROOT = "zarr.json"
HIDDEN = ".coadjoint"
VERSION = "archive_format"
STATE = "state-"
LONGEST_NAME = 255
GROUP = {"zarr_format": 3, "node_type": "group"}


class ArchiveError(OneLineError):
    """There is no archive, it is damaged or in use, or one cannot be made; found before anything runs."""


class ArchiveMoved(ArchiveError):
    """A file is missing that the root has named: somebody has committed since it was read, or the file was removed."""


class ArchiveUnwritten(OSError):
    """An archive could not be written while its run went on; it holds what was committed before, and is resumed."""


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
        self, path: Path, arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any], lock: int | None
    ) -> None:
        self.path, self.arrays, self.attributes = path, dict(arrays), dict(attributes)
        self._lock = lock
        self._touched: set[Path] = set()

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
        for folder in (path, path / HIDDEN, *(path / name for name in arrays)):
            folder.mkdir()
        _write_json(path / HIDDEN / ROOT, {**GROUP, "attributes": {}})
        found = cls(path, arrays, {VERSION: FORMAT}, locked(path / HIDDEN / LOCK, os.O_CREAT))
        found._write_arrays(arrays)
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
        try:
            lock = locked(path / HIDDEN / LOCK, os.O_CREAT)
        except OSError as reason:
            raise unwritable(path, reason) from None
        if lock is None:
            raise ArchiveError(f"{path}: another process is writing to this archive; wait until it has ended")
        # Once more: what it was before the lock may have changed.
        try:
            arrays, attributes = read_root(path)
        except BaseException:
            os.close(lock)
            raise
        found = cls(path, arrays, attributes, lock)
        try:
            for folder in (path, path / HIDDEN, *(path / name for name in arrays)):
                for left in folder.glob(f".*{WRITING}"):
                    left.unlink(missing_ok=True)
            found._write_arrays(arrays)
        except OSError as reason:
            found.close()
            raise unwritable(path, reason) from None
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

    def close(self) -> None:
        """Let others write."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

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
        array, region = self.arrays[name], np.asarray(values)
        begin = (*first, *(0,) * (region.ndim - len(first)))
        for place, inside, outside in array.chunks_at(begin, region.shape):
            key = array_key(place)
            chunk = array.empty()
            if array.grows and inside[0].start > 0:
                held = array.decoded((self.path / name / key).read_bytes())
                chunk[: inside[0].start] = held[: inside[0].start]
            chunk[inside] = region[outside]
            write_whole(self.path / name / key, array.encoded(chunk))
        self._touched.add(self.path / name)

    def keep(self, numbers: Mapping[str, Any], about: Mapping[str, Any]) -> Kept:
        """Write numbers and arrays from which a run goes on, and return what `commit` should say of them.

        Parameters
        ----------
        numbers : mapping
            Name -> number or array.
        about : mapping
            Plain numbers that are to be known without reading them.
        """
        content = io.BytesIO()
        np.savez(content, **{name: np.asarray(value) for name, value in numbers.items()})  # type: ignore[arg-type]
        raw, file = content.getvalue(), f"{STATE}{secrets.token_hex(6)}.npz"
        write_whole(self.path / HIDDEN / file, raw)
        self._touched.add(self.path / HIDDEN)
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
        """
        if self._lock is not None and os.fstat(self._lock).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, "it was removed meanwhile")
        arrays = {
            name: array._replace(shape=(lengths[array.dims[0]], *array.shape[1:])) if array.grows else array
            for name, array in self.arrays.items()
        }
        merged = {**self.attributes, **attributes}
        merged = {name: value for name, value in merged.items() if value is not None}
        settle(self._touched)
        changed = {name: array for name, array in arrays.items() if array != self.arrays[name]}
        _write_json(self.path / ROOT, root_of(arrays, merged))
        self.arrays, self.attributes, self._touched = arrays, merged, set()
        settle([self.path])
        self._write_arrays(changed)
        stay = {one.file for one in kept if one is not None}
        for file in (self.path / HIDDEN).glob(f"{STATE}*"):
            if file.name not in stay:
                file.unlink(missing_ok=True)

    def _write_arrays(self, arrays: Mapping[str, StoredArray]) -> None:
        """Tell readers without consolidated metadata what the arrays look like; they see them one after the other."""
        for name, array in arrays.items():
            _write_json(self.path / name / ROOT, array.metadata())


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


def read_root(path: Path) -> tuple[dict[str, StoredArray], dict[str, Any]]:
    """Return the arrays and attributes of an archive, as they are at this moment.

    Raises
    ------
    ArchiveError
        There is none, it is damaged, or a later version of the library has written it.
    """
    try:
        root = json.loads((path / ROOT).read_text(encoding="utf-8"))
        attributes = root["attributes"]
        version = attributes[VERSION]
        metadata = root["consolidated_metadata"]["metadata"]
    except FileNotFoundError:
        raise ArchiveError(f"{path}: there is no archive of a run") from None
    except NotADirectoryError:
        raise ArchiveError(f"{path}: is a file; an archive is a folder, which a run with archive= writes") from None
    except OSError as reason:
        raise ArchiveError(f"{path}: cannot be read ({reason.strerror})") from None
    except (ValueError, LookupError, TypeError, RecursionError):
        raise ArchiveError(f"{path}: is no archive of a run, or its {ROOT} is damaged") from None
    if isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise ArchiveError(f"{path}: {VERSION} is {version!r}; it must be a whole number from 1 up")
    if version > FORMAT:
        raise ArchiveError(
            f"{path}: is an archive of format {version}, and this version of coadjoint reads formats up to {FORMAT}; "
            "take a later version"
        )
    try:
        arrays = {
            name: StoredArray.of_metadata(each) for name, each in metadata.items() if each["node_type"] == "array"
        }
    except (LookupError, TypeError, AttributeError):
        raise ArchiveError(f"{path}: the arrays in {ROOT} are damaged") from None
    return arrays, attributes


def read_array(path: Path, name: str, array: StoredArray) -> NDArray[Any]:
    """Return all of an array, as it was when the root was read.

    Raises
    ------
    ArchiveError
        A chunk is damaged, or cannot be read. What was never written is nothing (NaN).
    """
    found = np.empty(array.shape, dtype=object if array.kind == "string" else array.kind)
    for place, inside, outside in array.chunks_at((0,) * len(array.shape), array.shape):
        file = path / name / array_key(place)
        try:
            found[outside] = array.decoded(file.read_bytes())[inside]
        except FileNotFoundError:
            found[outside] = array.empty()[inside]
        except (OSError, ValueError) as reason:
            said = getattr(reason, "strerror", None) or reason
            raise ArchiveError(f"{path}: {name}/{file.name} cannot be read ({said})") from None
    return found


def read_kept(path: Path, kept: Kept) -> dict[str, NDArray[Any]]:
    """Return the numbers and arrays of a state that `ArchiveStore.keep` has written.

    Raises
    ------
    ArchiveError
        The file is missing, or is not the one that was written.
    """
    place = path / HIDDEN / Path(kept.file).name
    try:
        raw = place.read_bytes()
    except FileNotFoundError:
        raise ArchiveMoved(f"{path}: the state {kept.file} is missing") from None
    except OSError as reason:
        raise ArchiveError(f"{path}: the state {kept.file} cannot be read ({reason.strerror})") from None
    if hashlib.sha256(raw).hexdigest() != kept.digest:
        raise ArchiveError(f"{path}: the state {kept.file} is damaged: its check sum is another one")
    with np.load(io.BytesIO(raw), allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    write_whole(path, json.dumps(content).encode("utf-8"))
