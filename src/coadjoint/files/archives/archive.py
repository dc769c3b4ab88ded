"""Reading of archives, as last committed: the root with its attributes, the arrays, and the states of runs.

The layout of the folder is described in `coadjoint.files.archives.store`, which writes it. An ensemble is stored in
blocks of members, each written by one process; a run without blocks is read as an ensemble of one block.

An archive may be untrusted. Its metadata must be what the library writes: plain names, and the codecs, types and chunks
of `StoredArray`. Files are reached through `ArchiveFolder`, which follows no links. Nothing is unpickled.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import cached_property
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archives.folder import (
    ArchiveError,
    ArchiveFolder,
    ArchiveUnreadable,
    Folder,
    Location,
    open_location,
    reading,
)
from coadjoint.files.archives.root import (
    FORMAT,
    HIDDEN_FOLDER,
    RUN,
    VERSION_ATTRIBUTE,
    identity_of,
    read_root,
)
from coadjoint.files.archives.stored_arrays import StoredArray, deserialize_numbers
from coadjoint.files.datasets.named_axes import MEMBER
from coadjoint.files.records.entries import Entry, decode_json
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short

STATE_FILE_PREFIX = "state-"
SUM_PREFIX = "sum "
"""Prefix of the checksums of chunks among the numbers of a state or marker: CRC-32C of the committed rows of each."""
COMMIT_WAITS = (0.05, 0.2, 0.75, None)
"""Waits (s) for a commit in progress."""
MAX_LOST_CHUNKS = 1000  # of an array of format 1, in which each lost chunk is found by its name
FINISHED: str = "archive_finished"
STEPS: str = "archive_steps"
STATES: str = "archive_states"
ACCOUNTS_ATTRIBUTE: str = "archive_accounts"
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


class StoredState(NamedTuple):
    """Entry of a stored state: its file in the hidden folder, the SHA-256 of the file, and further plain numbers."""

    file: str
    digest: str
    about: dict[str, Any]


class ChunkOfOthers(ArchiveError):
    """A chunk is intact, but it is not the committed one."""


class Marker(NamedTuple):
    """Progress of a block, and the numbers from which it resumes."""

    head: dict[str, Any]
    numbers: dict[str, NDArray[Any]]


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
        self._progress = dict[int, tuple[int, dict[str, NDArray[Any]]] | None]()

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

    @cached_property
    def blocks(self) -> list[MemberBlock]:
        """The blocks of members that are run together."""
        members = self.members
        return blocks_of(members, int(self.attributes.get(BLOCK_SIZE_ATTRIBUTE, members)))

    @cached_property
    def sums(self) -> dict[str, NDArray[Any]]:
        """Checksums of the committed content of all chunks that no block writes, by array; none in format 1."""
        if self.attributes[VERSION_ATTRIBUTE] < FORMAT:
            return {}
        return sums_among(self.read_state(self.states[-1]))

    def check_extent(self) -> None:
        """Raise ArchiveError if there are more chunks than checksums, or in format 1 files: Python loops over them."""
        with self.opened() as folder:
            for name, array in self.arrays.items():
                if self.axis_of_blocks(name) is not None or not (expected := prod(array.chunk_counts)):
                    continue
                if self.attributes[VERSION_ATTRIBUTE] == FORMAT:
                    if self.sums.get(name, np.zeros(0)).shape != array.chunk_counts:
                        raise ArchiveError(f"{self.path}: {name} has {expected} chunks, and checksums of other ones")
                elif isinstance(folder, ArchiveFolder) and expected > MAX_LOST_CHUNKS + len(self._names(folder, name)):
                    raise ArchiveError(f"{self.path}: most of the {expected} chunks of {name} are missing")

    def _names(self, folder: Folder, name: str) -> set[str]:
        """Return the names of the files of an array."""
        try:
            with reading(self.path, name):
                return folder.names(name)
        except FileNotFoundError:
            raise ArchiveError(f"{self.path}: the folder {name} is missing; restore it") from None

    def read_marker(self, folder: Folder, block: MemberBlock, only_head: bool = False) -> Marker | None:
        """Return the progress of a block, and the numbers from which it resumes; None if it has not begun."""
        try:
            with reading(self.path, f"{HIDDEN_FOLDER}/{block.marker}"):
                content = folder.read(HIDDEN_FOLDER, block.marker, head=MAX_HEAD_BYTES if only_head else None)
                line, _, raw = content.partition(b"\n")
                digest, _, text = line.decode("utf-8").partition(" ")
                if digest != digest_of_marker(self.attributes, block, text):
                    raise ValueError("its checksum does not match")
                head = decode_json(text)
                about = head["about"]
                for name in HEAD_COUNTS:
                    Entry(about[name], name).integer()
                if Entry(about["seconds"], "seconds").number() < 0.0:
                    raise ValueError("its seconds are negative")
                if not only_head and hashlib.sha256(raw).hexdigest() != head["numbers"]:
                    raise ValueError("its checksum does not match")
                return Marker(about, {} if only_head else deserialize_numbers(raw))
        except FileNotFoundError:
            return None

    def intact_marker(self, folder: Folder, block: MemberBlock, only_head: bool = False) -> Marker | None:
        """Return `read_marker`, also None if it is damaged: the block is computed again."""
        try:
            return self.read_marker(folder, block, only_head)
        except ArchiveUnreadable:
            raise
        except ArchiveError:
            return None

    def read_heads(self, whole_markers: bool = False) -> list[dict[str, Any]]:
        """Return the progress of each block; empty for blocks that have not begun, or whose marker is damaged."""
        if not self.has_blocks:
            return [self.attributes]
        heads = []
        with self.opened() as folder:
            for block in self.blocks:
                marker = self.intact_marker(folder, block, not whole_markers)
                heads.append(marker.head if marker else {})
        return heads

    @cached_property
    def heads(self) -> list[dict[str, Any]]:
        """`read_heads` on first use."""
        return self.read_heads()

    def _progress_of(self, folder: Folder, number: int) -> tuple[int, dict[str, NDArray[Any]]] | None:
        """Return the number of saved points of a block, and its checksums; None if it has not begun."""
        if number not in self._progress:
            marker = self.read_marker(folder, self.blocks[number])
            self._progress[number] = marker and (marker.head["rows"], sums_among(marker.numbers))
        return self._progress[number]

    def axis_of_blocks(self, name: str) -> int | None:
        """Return the axis of an array along which the blocks of an ensemble write it; None if they do not."""
        array = self.arrays[name]
        return array.dims.index(MEMBER) if self.has_blocks and is_computed(name, array) else None

    def place_of(self, name: str, indices: tuple[int, ...]) -> tuple[int, ...]:
        """Return the place of a chunk among the checksums of its array, those of its block if a block writes it."""
        axis = self.axis_of_blocks(name)
        return indices if axis is None else (*indices[:axis], 0, *indices[axis + 1 :])

    def committed(self, folder: Folder, name: str, indices: tuple[int, ...]) -> tuple[int, int | None]:
        """Return how many rows of a chunk are committed, and their checksum, None in format 1."""
        array, sums, axis = self.arrays[name], self.sums, self.axis_of_blocks(name)
        rows = array.shape[0]
        if axis is not None:
            of_block = self._progress_of(folder, indices[axis])
            if of_block is None:
                return 0, None
            rows, sums = of_block if array.grows else (rows, of_block[1])
        rows = min(rows - indices[0] * array.chunk[0], array.chunk[0])
        if rows <= 0 or self.attributes[VERSION_ATTRIBUTE] < FORMAT:
            return max(rows, 0), None
        with reading(self.path, f"the checksum of {name}/{chunk_file(indices)}"):
            return rows, int(sums[name][self.place_of(name, indices)])

    def chunk(self, folder: Folder, name: str, indices: tuple[int, ...]) -> NDArray[Any]:
        """Return a chunk as committed, with fill values elsewhere; ArchiveError if it is missing or damaged."""
        latest = self
        for wait in COMMIT_WAITS:
            try:
                return latest._committed_chunk(folder, name, indices)
            except ArchiveUnreadable:
                raise
            except ArchiveError as reason:
                latest = self.as_it_is_now()
                superseded = latest.attributes != self.attributes
                is_other = isinstance(reason, ChunkOfOthers)
                if name not in BLOCK_ARRAYS:
                    raise self._resumed_error() if superseded and is_other else reason from None
                # The chunk of a run that is being written is replaced before its checksum is.
                at_rest = latest.attributes[FINISHED] and not superseded
                if wait is None or at_rest or not is_other:
                    raise
                time.sleep(wait)
        raise AssertionError("the last attempt returns or raises")

    def _committed_chunk(self, folder: Folder, name: str, indices: tuple[int, ...]) -> NDArray[Any]:
        array, file = self.arrays[name], chunk_file(indices)
        rows, recorded = self.committed(folder, name, indices)
        if not rows:
            return array.empty()
        try:
            with reading(self.path, f"{name}/{file}"):
                chunk = array.decoded(folder.read(name, file, array.max_encoded_bytes))
        except FileNotFoundError:
            raise self._missing_error(name, indices) from None
        if recorded is not None and array.sum_of(chunk[:rows]) != recorded:
            raise ChunkOfOthers(f"{self.path}: {name}/{file} is damaged: its content is that of another chunk or run")
        chunk[rows:] = array.empty()[rows:]
        return chunk

    def as_it_is_now(self) -> Archive:
        """Read the root again; ArchiveError if another run has taken the place of this one."""
        latest = Archive(self.path, *read_root(self.path))
        if identity_of(latest.attributes) != identity_of(self.attributes):
            raise ArchiveError(
                f"{self.path}: another run has taken the place of the one that was opened; open it again"
            )
        return latest

    def _resumed_error(self) -> ArchiveError:
        return ArchiveError(
            f"{self.path}: was resumed to a later end after it was opened, and its last point at that time, of step "
            f"{self.attributes.get(STEPS)}, was replaced; open it again"
        )

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
        if self.attributes[VERSION_ATTRIBUTE] < FORMAT:
            self._check_unchanged(array.grows and array.shape[0] - 1 in ranges[0])
        return values

    def _check_unchanged(self, has_last_point: bool) -> None:
        """Raise ArchiveError if a run of format 1, or its last point, was replaced: contents have no checksums."""
        steps, latest = int(self.attributes.get(STEPS, 0)), self.as_it_is_now()
        save_every = int(self.attributes.get(SAVE_EVERY, steps or 1))
        # A later end follows a shorter last interval.
        if has_last_point and self.attributes.get(FINISHED) and steps % save_every:
            if latest.attributes.get(STEPS) != steps:
                raise self._resumed_error()

    def lost_chunks(self, folder: Folder) -> Iterator[tuple[str, tuple[int, ...]]]:
        """Yield the name of the array and the indices of committed chunks that are missing, at most one of a block."""
        for name, array in self.arrays.items():
            files, axis = self._names(folder, name), self.axis_of_blocks(name)
            for k, head in enumerate([{"rows": array.shape[0]}] if axis is None else self.heads):
                rows = head.get("rows", 0) if array.grows or not head else array.shape[0]
                for indices in array.chunk_indices(axis, k):
                    if indices[0] * array.chunk[0] >= rows:
                        break
                    if chunk_file(indices) not in files:
                        yield name, indices
                        break

    def check_complete(self) -> None:
        """Raise ArchiveError if committed chunks are missing, or the last chunks of growing arrays are damaged."""
        with self.opened() as folder:
            lost = next(self.lost_chunks(folder), None)
        if lost is not None:
            self.as_it_is_now()
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
            with self.opened() as folder, reading(path, f"the state {file}"):
                raw = folder.read(HIDDEN_FOLDER, file)
                if hashlib.sha256(raw).hexdigest() != state.digest:
                    raise ValueError("its checksum does not match")
                return deserialize_numbers(raw)
        except FileNotFoundError:
            raise ArchiveError(
                f"{path}: the state {file} of the hidden folder {HIDDEN_FOLDER} is missing; copy the archive with this "
                "folder, or read its results alone by co.load"
            ) from None


def is_computed(name: str, array: StoredArray) -> bool:
    """Whether an array of an ensemble is written by its blocks, rather than when the archive is begun."""
    return MEMBER in array.dims and (array.grows or name in BLOCK_ARRAYS)


def total_progress(heads: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Combine the progress of all blocks."""
    heads = list(heads)
    least = {name: min(int(head.get(name, 0)) for head in heads) for name in (FINISHED, STEPS)}
    return least | {name: sum(head.get(name, 0) for head in heads) for name in ("evaluations", "iterations", "seconds")}


def sums_among(numbers: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the checksums among the numbers of a state or of a marker, by array."""
    return {name.removeprefix(SUM_PREFIX): sums for name, sums in numbers.items() if name.startswith(SUM_PREFIX)}


def digest_of_marker(attributes: Mapping[str, Any], block: MemberBlock, text: str) -> str:
    """Return the checksum of the head of a marker, with run and block since format 2."""
    bound = f"{attributes[RUN]} {block.marker} {text}" if RUN in attributes else text
    return hashlib.sha256(bound.encode()).hexdigest()


def chunk_file(indices: tuple[int, ...]) -> str:
    """Return the file name of a chunk, such as c.3.0."""
    return ".".join(("c", *map(str, indices)))
