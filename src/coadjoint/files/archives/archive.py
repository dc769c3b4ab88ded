"""Reading of archives, as last committed: the root with its attributes, the arrays, and the states of runs.

The layout of the folder is described in `coadjoint.files.archives.store`, which writes it. An ensemble is stored in
blocks of members, each written by one process; a run without blocks is read as an ensemble of one block.

An archive may be untrusted. Its metadata must be what the library writes: plain names, and the codecs, types and chunks
of `StoredArray`. Files are reached through `ArchiveFolder`, which follows no links. Nothing is unpickled.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import OneLineError, in_one_line
from coadjoint.files.archives.folder import ArchiveFolder, RemoteFolder, is_url, remote_folder
from coadjoint.files.archives.stored_arrays import StoredArray, deserialize_numbers
from coadjoint.files.datasets.named_axes import MEMBER
from coadjoint.files.records.entries import Entry
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.validation import is_integer

FORMAT = 1
"""Version of the format; later versions of the library read earlier ones."""
ROOT_FILE = "zarr.json"
HIDDEN_FOLDER = ".coadjoint"
STATE_FILE_PREFIX = "state-"
VERSION_ATTRIBUTE = "archive_format"
FINISHED: str = "archive_finished"
STEPS: str = "archive_steps"
STATES: str = "archive_states"
ACCOUNTS_ATTRIBUTE: str = "archive_accounts"
FIRST_STEP: str = "archive_first_step"
SAVE_EVERY: str = "archive_save_every"
BLOCK_SIZE_ATTRIBUTE = "archive_block"
"""Attribute of the archives of ensembles: members per block."""
STATUS = "status"
PENDING, DONE, FAILED = 0, 1, 2  # states of a member, stored in archives
BLOCK_ARRAYS = ("drift", "change", "balance", "failed", STATUS)
"""Arrays over the members, and not over time, that a block writes."""
HEAD_COUNTS = (STEPS, FINISHED, "evaluations", "iterations", "failed", "rows")
"""Whole numbers in the head of every marker."""
MAX_HEAD_BYTES = 2**16
"""Limit on the first line of a marker, in bytes."""
MAX_NAME_LENGTH = 255  # bytes, of file systems
JSON_MEMORY_FACTOR = 32
"""Memory needed to parse JSON, per byte."""
MAX_ARRAYS = 10**5  # of an archive, which has some ten and one for each observed name

Folder = ArchiveFolder | RemoteFolder
Location = Path | RemoteFolder


class ArchiveError(OneLineError):
    """An archive is missing, damaged, in use, or cannot be created; raised before anything runs."""


class StoredState(NamedTuple):
    """Entry of a stored state: its file in the hidden folder, the SHA-256 of the file, and further plain numbers."""

    file: str
    digest: str
    about: dict[str, Any]


class MemberBlock(NamedTuple):
    """The members `first` to `last` - 1 of an ensemble."""

    number: int
    first: int
    last: int

    @property
    def marker(self) -> str:
        """Name in the hidden folder of the file with the progress of the block, and with what it resumes from."""
        return f"block-{self.number:06d}"

    @property
    def lock_file(self) -> str:
        """Name in the hidden folder of the file that is locked while a process runs the block."""
        return f"block-{self.number:06d}.lock"


def blocks_of(members: int, size: int) -> list[MemberBlock]:
    """Return all blocks of an ensemble."""
    return [MemberBlock(k, first, min(first + size, members)) for k, first in enumerate(range(0, members, size))]


class Archive:
    """The path (of one elsewhere its `RemoteFolder`), arrays and attributes of an archive when its root was read."""

    def __init__(self, path: Location, arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> None:
        self.path, self.arrays, self.attributes = path, dict(arrays), dict(attributes)

    def opened(self) -> AbstractContextManager[Folder]:
        """Open the folder."""
        return open_location(self.path)

    @property
    def states(self) -> list[StoredState]:
        """The states of a run without blocks: those at the starts of parts of it, and the last one."""
        return [StoredState(*entry) for entry in json.loads(self.attributes[STATES])]

    @property
    def members(self) -> int:
        """Number of members, 1 of a single run."""
        x0 = self.arrays["x0"]
        return x0.shape[0] if x0.dims[0] == MEMBER else 1

    @property
    def has_blocks(self) -> bool:
        """Whether the blocks of an ensemble have markers; a run without them is one block, described by the root."""
        return BLOCK_SIZE_ATTRIBUTE in self.attributes

    @property
    def blocks(self) -> list[MemberBlock]:
        """The blocks of members that are run together."""
        members = self.members
        return blocks_of(members, int(self.attributes.get(BLOCK_SIZE_ATTRIBUTE, members)))

    def read_heads(self) -> list[dict[str, Any]]:
        """Return the progress of each block; empty for blocks that have not begun, or whose marker is damaged."""
        if not self.has_blocks:
            return [self.attributes]
        with self.opened() as folder:
            markers = [read_marker(folder, block, only_head=True) for block in self.blocks]
        return [marker[0] if marker else {} for marker in markers]

    @cached_property
    def heads(self) -> list[dict[str, Any]]:
        """`read_heads` on first use."""
        return self.read_heads()

    def may_be_missing(self, name: str, indices: tuple[int, ...]) -> bool:
        """Whether a chunk may not be written yet, since its block has not ended."""
        array = self.arrays[name]
        if not self.has_blocks or self.attributes[FINISHED] or not is_computed(name, array):
            return False
        head = self.heads[indices[array.dims.index(MEMBER)]]
        return not head or (array.grows and indices[0] * array.chunk[0] >= head["rows"])

    def chunk(self, folder: Folder, name: str, indices: tuple[int, ...]) -> NDArray[Any]:
        """Return a chunk, of fill values if it may be missing; ArchiveError if it is missing or damaged."""
        array, file = self.arrays[name], chunk_file(indices)
        try:
            return array.decoded(folder.read(name, file, array.max_encoded_bytes))
        except FileNotFoundError:
            if self.may_be_missing(name, indices):
                return array.empty()
            raise self._missing_error(name, indices) from None
        except (OSError, ValueError) as reason:
            problem = getattr(reason, "strerror", None) or reason
            raise ArchiveError(f"{self.path}: {name}/{file} cannot be read ({problem})") from None

    def _missing_error(self, name: str, indices: tuple[int, ...]) -> ArchiveError:
        return ArchiveError(
            f"{self.path}: {name}/{chunk_file(indices)} is missing, although it was committed; restore the file"
        )

    def read(self, name: str, part: Sequence[range] | None = None) -> NDArray[Any]:
        """Return an array, or the ascending ranges `part` along its axes; NaN where nothing is written yet."""
        array = self.arrays[name]
        ranges = tuple(map(range, array.shape)) if part is None else tuple(part)
        shape = tuple(map(len, ranges))
        what = f"{name} of the archive {self.path}"
        check_available_memory(16 * prod(shape), what, f"read a part of to_xarray()[{name!r}]")
        values = np.empty(shape, dtype=object if array.kind == "string" else array.kind)
        with self.opened() as folder:
            for indices, inside, outside in array.chunks_in(ranges):
                values[outside] = self.chunk(folder, name, indices)[inside]
        if array.grows and array.shape[0] - 1 in ranges[0]:
            self._check_last_point()
        return values

    def _check_last_point(self) -> None:
        """Raise ArchiveError if the last point was replaced: a later end follows a shorter last interval."""
        steps = int(self.attributes.get(STEPS, 0))
        save_every = int(self.attributes.get(SAVE_EVERY, steps or 1))
        if self.attributes.get(FINISHED) and steps % save_every and read_root(self.path)[1].get(STEPS) != steps:
            raise ArchiveError(
                f"{self.path}: was resumed to a later end after it was opened, and its last point at that time, of "
                f"step {steps}, was replaced; open it again"
            )

    def lost_chunks(self, folder: Folder) -> Iterator[tuple[str, tuple[int, ...]]]:
        """Yield the name of the array and the indices of each chunk that was committed and is missing."""
        for name, array in self.arrays.items():
            try:
                files = folder.names(name)
            except OSError as reason:
                raise ArchiveError(f"{self.path}: {name} cannot be read ({reason.strerror})") from None
            corners = [range(0, size, step) for size, step in zip(array.shape, array.chunk, strict=True)]
            for indices, _, _ in array.chunks_in(corners):
                if chunk_file(indices) not in files and not self.may_be_missing(name, indices):
                    yield name, indices

    def check_complete(self) -> None:
        """Raise ArchiveError if committed chunks are missing, or the last chunks of growing arrays are damaged."""
        with self.opened() as folder:
            lost = next(self.lost_chunks(folder), None)
        if lost is not None:
            raise self._missing_error(*lost)
        for name, array in self.arrays.items():
            if array.grows:
                first_row = max(0, array.shape[0] - 1) // array.chunk[0] * array.chunk[0]
                self.read(name, [range(first_row, array.shape[0]), *map(range, array.shape[1:])])

    def read_state(self, state: StoredState) -> dict[str, NDArray[Any]]:
        """Return the numbers of `ArchiveStore.store_state`; ArchiveError if the file is missing or was changed."""
        path, file = self.path, state.file
        if not (file.startswith(STATE_FILE_PREFIX) and file.replace("-", "_").replace(".", "_").isidentifier()):
            raise ArchiveError(f"{path}: a state is called {short(file)}, which is no plain name")
        try:
            with self.opened() as folder:
                raw = folder.read(HIDDEN_FOLDER, file)
        except FileNotFoundError:
            raise ArchiveError(f"{path}: the state {file} is missing") from None
        except OSError as reason:
            raise ArchiveError(f"{path}: the state {file} cannot be read ({reason.strerror})") from None
        if hashlib.sha256(raw).hexdigest() != state.digest:
            raise ArchiveError(f"{path}: the state {file} is damaged: its checksum does not match")
        try:
            return deserialize_numbers(raw)
        except ValueError as reason:
            raise ArchiveError(f"{path}: the state {file} is damaged ({reason})") from None


def is_computed(name: str, array: StoredArray) -> bool:
    """Whether an array of an ensemble is written by its blocks, rather than when the archive is begun."""
    return MEMBER in array.dims and (array.grows or name in BLOCK_ARRAYS)


def total_progress(heads: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Combine the progress of all blocks."""
    heads = list(heads)
    least = {name: min(int(head.get(name, 0)) for head in heads) for name in (FINISHED, STEPS)}
    return least | {name: sum(head.get(name, 0) for head in heads) for name in ("evaluations", "iterations", "seconds")}


def read_marker(
    folder: Folder, block: MemberBlock, only_head: bool = False
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]] | None:
    """Return the progress of a block, and the numbers from which it resumes; None if missing or damaged."""
    try:
        content = folder.read(HIDDEN_FOLDER, block.marker, head=MAX_HEAD_BYTES if only_head else None)
        line, _, raw = content.partition(b"\n")
        digest, _, text = line.decode("utf-8").partition(" ")
        head = json.loads(text)
        about = head["about"]
        for name in HEAD_COUNTS:
            Entry(about[name], name).integer()
        damaged = hashlib.sha256(text.encode()).hexdigest() != digest or Entry(about["seconds"], "").number() < 0.0
        if damaged or not (only_head or hashlib.sha256(raw).hexdigest() == head["numbers"]):
            return None
        return about, {} if only_head else deserialize_numbers(raw)
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None


def read_location(value: Any) -> Location:
    """Validate the place from which an archive is read: a path, a URL, or a mapping of fsspec."""
    return remote_folder(value) or read_archive_path(value, "a path, such as 'run.zarr', a URL, or a mapping of fsspec")


def read_archive_path(value: Any, wanted: str = "the path of a folder, such as 'run.zarr'") -> Path:
    """Validate the path of an archive that is written."""
    hint = f"archive is {short(value)}; it must be {wanted}"
    if not isinstance(value, str | os.PathLike):
        raise TypeError(hint)
    if is_url(value):
        raise ValueError(
            f"archive is {short(value)}; runs are written and resumed in folders of this machine, since a URL has no "
            "locks: give a path and copy the folder, and open_archive reads it from the URL"
        )
    path = os.fspath(value)
    if not isinstance(path, str) or not path or "\0" in path:
        raise ValueError(hint)
    if max(map(len, Path(path).parts), default=0) > MAX_NAME_LENGTH:
        raise ValueError(f"archive is {short(value)}; its name is too long")
    return Path(path)


def chunk_file(indices: tuple[int, ...]) -> str:
    """Return the file name of a chunk, such as c.3.0."""
    return ".".join(("c", *map(str, indices)))


def _no_archive(path: Location) -> ArchiveError:
    return ArchiveError(f"{path}: there is no archive of a run; give the folder that archive= named")


def open_location(location: Location) -> Folder:
    """Open the folder of an archive to read it; ArchiveError if there is none."""
    return open_folder(location) if isinstance(location, Path) else location


def open_folder(path: Path) -> ArchiveFolder:
    """Open the folder of an archive on this machine; ArchiveError if there is none."""
    try:
        return ArchiveFolder(path)
    except FileNotFoundError:
        raise _no_archive(path) from None
    except NotADirectoryError:
        raise ArchiveError(f"{path}: is a file; an archive is a folder, which a run with archive= writes") from None
    except OSError as reason:
        raise ArchiveError(f"{path}: cannot be read ({reason.strerror})") from None


def read_root(path: Location, folder: Folder | None = None) -> tuple[dict[str, StoredArray], dict[str, Any]]:
    """Return the arrays and attributes of an archive, as currently committed; `folder` is its folder, if open."""
    if folder is None:
        with open_location(path) as opened:
            return read_root(path, opened)
    try:
        content = folder.read("", ROOT_FILE)
        check_available_memory(JSON_MEMORY_FACTOR * len(content), ROOT_FILE)
        root = json.loads(content.decode("utf-8"), object_pairs_hook=_reject_duplicates)
        attributes = root["attributes"]
        version = attributes[VERSION_ATTRIBUTE]
        metadata = root["consolidated_metadata"]["metadata"]
    except FileNotFoundError:
        raise _no_archive(path) from None
    except OSError as reason:
        raise ArchiveError(f"{path}: {ROOT_FILE} cannot be read ({reason.strerror})") from None
    except (ValueError, LookupError, TypeError, RecursionError):
        raise ArchiveError(
            f"{path}: is no archive of a run, or its {ROOT_FILE} is damaged; other results are opened by co.load"
        ) from None
    if not is_integer(version) or version < 1:
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
    arrays = {}
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
    rows = {array.shape[0] for array in arrays.values() if array.grows}
    if len(rows) > 1:
        raise ValueError(f"arrays over time have the lengths {short(sorted(rows))}")
    return arrays
