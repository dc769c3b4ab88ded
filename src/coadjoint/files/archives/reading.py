"""Reading of archives, as last committed: the root with its attributes, the arrays, and the states of runs.

The layout of the folder is described in `coadjoint.files.archives.store`, which writes it.

An archive may be untrusted. Its metadata must be what the library writes: plain names, and the codecs, types and chunks
of `StoredArray`. Files are reached through `ArchiveFolder`, which follows no links. Nothing is unpickled.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import OneLineError, in_one_line
from coadjoint.files.archives.folder import ArchiveFolder
from coadjoint.files.archives.stored_arrays import StoredArray, deserialize_numbers
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short

FORMAT = 1
"""Version of the format; later versions of the library read earlier ones."""
ROOT_FILE = "zarr.json"
HIDDEN_FOLDER = ".coadjoint"
VERSION_ATTRIBUTE = "archive_format"
STATE_PREFIX = "state-"
MAX_NAME_LENGTH = 255  # bytes, of file systems
JSON_MEMORY_FACTOR = 32
"""Memory needed to parse JSON, per byte."""
MAX_ARRAYS = 10**5  # of an archive, which has some ten and one for each observed name


class ArchiveError(OneLineError):
    """An archive is missing, damaged, in use, or cannot be created; raised before anything runs."""


class ArchiveMoved(ArchiveError):
    """A file named by the root is missing: another process has committed since it was read, or the file was removed."""


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


def chunk_file(indices: tuple[int, ...]) -> str:
    """Return the file name of a chunk.

    Examples
    --------
    >>> chunk_file((3, 0))
    'c.3.0'
    """
    return ".".join(("c", *map(str, indices)))


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


def read_chunk(
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
            chunk = read_chunk(path, folder, name, array, indices)
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
