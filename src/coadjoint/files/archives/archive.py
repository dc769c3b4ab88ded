"""Reading of archives, as last committed: the root with its attributes, the arrays, and the states of runs.

The layout of the folder is described in `coadjoint.files.archives.store`, which writes it. An ensemble is stored in
blocks of members, each written by one process; a run without blocks is read as an ensemble of one block. Crossings of
events are among the numbers of the last state, or of the markers of the blocks. The checksum of the root covers all
attributes and array metadata, however the JSON is formatted; it detects damage, not forgery.

An archive may be untrusted. Its metadata must be what the library writes: plain names, and the codecs, types and chunks
of `StoredArray`. Files are reached through `ArchiveFolder`, which follows no links. Nothing is unpickled.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archives.folder import (
    MAX_NAME_LENGTH,
    ArchiveError,
    ArchiveFolder,
    ArchiveUnreadable,
    Folder,
    reading,
)
from coadjoint.files.archives.stored_arrays import METADATA_FILE, StoredArray, chunk_file, deserialize_numbers
from coadjoint.files.datasets.named_axes import MEMBER
from coadjoint.files.records.entries import Entry, decode_json
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.validation import is_integer

FORMAT = 2
"""Version of the format; later versions of the library read earlier ones. Format 1 has checksums of chunks and states
alone, which do not bind them to their place or to the run.
"""
HIDDEN_FOLDER = ".coadjoint"
GROUP_METADATA = {"zarr_format": 3, "node_type": "group"}
VERSION_ATTRIBUTE = "archive_format"
FIRST_STEP: str = "archive_first_step"
RUN, ROOT_DIGEST = "archive_run", "archive_sha256"
"""Attributes with the random name of the run, and with the checksum of attributes and array metadata."""
MAX_ARRAYS = 10**5  # of an archive, which has some ten and one for each observed name

STATE_FILE_PREFIX = "state-"
SUM_PREFIX = "sum "
"""Prefix of the checksums of chunks among the numbers of a state or marker: CRC-32C of the committed rows of each."""
COMMIT_WAITS = (0.05, 0.2, 0.75, None)
"""Waits (s) for a commit in progress."""
MAX_LOST_CHUNKS = 1000  # of an array of format 1, in which each lost chunk is found by its name
FINISHED: str = "archive_finished"
STEPS: str = "archive_steps"
STATES: str = "archive_states"
WORK_INTEGRALS_ATTRIBUTE: str = "archive_accounts"
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


def identity_of(attributes: Mapping[str, Any]) -> str:
    """Return what tells a run from others: its random name, or in format 1 the digest of its first step."""
    return str(attributes.get(RUN, attributes.get(FIRST_STEP)))


def root_content(arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of the root."""
    metadata = {name: array.metadata() for name, array in arrays.items()}
    metadata[HIDDEN_FOLDER] = {**GROUP_METADATA, "attributes": {}}
    plain = {name: getattr(value, "item", lambda value=value: value)() for name, value in attributes.items()}
    if plain[VERSION_ATTRIBUTE] == FORMAT:
        plain[ROOT_DIGEST] = _digest(plain, metadata)
    return {
        **GROUP_METADATA,
        "attributes": plain,
        "consolidated_metadata": {"kind": "inline", "must_understand": False, "metadata": metadata},
    }


def _digest(attributes: Mapping[str, Any], metadata: Mapping[str, Any]) -> str:
    """Return the checksum of attributes and array metadata: SHA-256 of their JSON, in the order of the names."""
    content = json.dumps({"attributes": attributes, "metadata": metadata}, sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


def read_root(folder: Folder) -> tuple[dict[str, StoredArray], dict[str, Any]]:
    """Return the arrays and attributes of an archive, as currently committed."""
    if isinstance(folder, ArchiveFolder) and folder.path.is_file():
        raise ArchiveError(f"{folder}: is a file; an archive is a folder, which a run with archive= writes")
    try:
        with reading(folder, METADATA_FILE):
            content = folder.read("", METADATA_FILE)
            try:
                root = decode_json(content.decode("utf-8"), object_pairs_hook=_reject_duplicates)
                attributes = root["attributes"]
                version = attributes[VERSION_ATTRIBUTE]
                metadata = root["consolidated_metadata"]["metadata"]
            except (ValueError, LookupError, TypeError):
                other = "other results are opened by co.load"
                raise ArchiveError(
                    f"{folder}: is no archive of a run, or its {METADATA_FILE} is damaged; {other}"
                ) from None
    except FileNotFoundError:
        raise ArchiveError(f"{folder}: there is no archive of a run; give the folder that archive= named") from None
    if not is_integer(version) or version < 1:
        raise ArchiveError(f"{folder}: {VERSION_ATTRIBUTE} is {short(version)}; it must be a whole number from 1 up")
    if version > FORMAT:
        raise ArchiveError(
            f"{folder}: is an archive of format {short(version)}, and this version of coadjoint reads formats up to "
            f"{FORMAT}; install a later version"
        )
    with reading(folder, f"the metadata in {METADATA_FILE}"):
        is_checked, checksum = version == FORMAT or ROOT_DIGEST in attributes, attributes.pop(ROOT_DIGEST, "")
        if is_checked and checksum != _digest(attributes, metadata):
            raise ValueError("the checksum does not match")
        return _arrays_of(metadata), attributes


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
    """The folder, arrays and attributes of an archive when its root was read."""

    def __init__(self, folder: Folder, arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> None:
        self.folder, self.arrays, self.attributes = folder, dict(arrays), dict(attributes)
        self._progress = dict[int, tuple[int, dict[str, NDArray[Any]]] | None]()

    @classmethod
    def at(cls, folder: Folder) -> Archive:
        """Return the archive in a folder, as currently committed."""
        return cls(folder, *read_root(folder))

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
        for name, array in self.arrays.items():
            if self.axis_of_blocks(name) is not None or not (expected := prod(array.chunk_counts)):
                continue
            if self.attributes[VERSION_ATTRIBUTE] == FORMAT:
                if self.sums.get(name, np.zeros(0)).shape != array.chunk_counts:
                    raise ArchiveError(f"{self.folder}: {name} has {expected} chunks, and checksums of other ones")
            elif isinstance(self.folder, ArchiveFolder) and expected > MAX_LOST_CHUNKS + len(self._names(name)):
                raise ArchiveError(f"{self.folder}: most of the {expected} chunks of {name} are missing")

    def _names(self, name: str) -> set[str]:
        """Return the names of the files of an array."""
        try:
            with reading(self.folder, name):
                return self.folder.names(name)
        except FileNotFoundError:
            raise ArchiveError(f"{self.folder}: the folder {name} is missing; restore it") from None

    def read_marker(self, block: MemberBlock, only_head: bool = False) -> Marker | None:
        """Return the progress of a block, and the numbers from which it resumes; None if it has not begun."""
        try:
            with reading(self.folder, f"{HIDDEN_FOLDER}/{block.marker}"):
                content = self.folder.read(HIDDEN_FOLDER, block.marker, head=MAX_HEAD_BYTES if only_head else None)
                line, _, raw = content.partition(b"\n")
                digest, _, text = line.decode("utf-8").partition(" ")
                head = decode_json(text)
                is_intact = only_head or hashlib.sha256(raw).hexdigest() == head["numbers"]
                if digest != digest_of_marker(self.attributes, block, text) or not is_intact:
                    raise ValueError("its checksum does not match")
                about = head["about"]
                for name in HEAD_COUNTS:
                    Entry(about[name], name).integer()
                if Entry(about["seconds"], "seconds").number() < 0.0:
                    raise ValueError("its seconds are negative")
                return Marker(about, {} if only_head else deserialize_numbers(raw))
        except FileNotFoundError:
            return None

    def intact_marker(self, block: MemberBlock, only_head: bool = False) -> Marker | None:
        """Return `read_marker`, also None if it is damaged: the block is computed again."""
        try:
            return self.read_marker(block, only_head)
        except ArchiveUnreadable:
            raise
        except ArchiveError:
            return None

    def read_heads(self, whole_markers: bool = False) -> list[dict[str, Any]]:
        """Return the progress of each block; empty for blocks that have not begun, or whose marker is damaged."""
        if not self.has_blocks:
            return [self.attributes]
        markers = (self.intact_marker(block, not whole_markers) for block in self.blocks)
        return [marker.head if marker else {} for marker in markers]

    @cached_property
    def heads(self) -> list[dict[str, Any]]:
        """`read_heads` on first use."""
        return self.read_heads()

    def _progress_of(self, number: int) -> tuple[int, dict[str, NDArray[Any]]] | None:
        """Return the number of saved points of a block, and its checksums; None if it has not begun."""
        if number not in self._progress:
            marker = self.read_marker(self.blocks[number])
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

    def committed(self, name: str, indices: tuple[int, ...]) -> tuple[int, int | None]:
        """Return how many rows of a chunk are committed, and their checksum, None in format 1."""
        array, axis = self.arrays[name], self.axis_of_blocks(name)
        progress = (array.shape[0], self.sums) if axis is None else self._progress_of(indices[axis])
        if progress is None:
            return 0, None
        rows = (progress[0] if array.grows else array.shape[0]) - indices[0] * array.chunk[0]
        if rows <= 0 or self.attributes[VERSION_ATTRIBUTE] < FORMAT:
            return max(0, min(rows, array.chunk[0])), None
        with reading(self.folder, f"the checksum of {name}/{chunk_file(indices)}"):
            return min(rows, array.chunk[0]), int(progress[1][name][self.place_of(name, indices)])

    def chunk(self, name: str, indices: tuple[int, ...]) -> NDArray[Any]:
        """Return a chunk as committed, with fill values elsewhere; ArchiveError if it is missing or damaged."""
        latest = self
        for wait in COMMIT_WAITS:
            try:
                return latest._committed_chunk(name, indices)
            except ArchiveUnreadable:
                raise
            except ArchiveError as reason:
                latest = self.as_it_is_now()
                superseded = latest.attributes != self.attributes
                is_other = isinstance(reason, ChunkOfOthers)
                if name not in BLOCK_ARRAYS and superseded and is_other:
                    raise ArchiveError(
                        f"{self.folder}: was resumed to a later end after it was opened, and its last point at that "
                        f"time, of step {self.attributes.get(STEPS)}, was replaced; open it again"
                    ) from None
                # The chunk of a run that is being written is replaced before its checksum is.
                at_rest = latest.attributes.get(FINISHED) and not superseded
                if name not in BLOCK_ARRAYS or wait is None or at_rest or not is_other:
                    raise
                time.sleep(wait)
        raise AssertionError("the last attempt returns or raises")

    def _committed_chunk(self, name: str, indices: tuple[int, ...]) -> NDArray[Any]:
        array, file = self.arrays[name], chunk_file(indices)
        rows, recorded = self.committed(name, indices)
        if not rows:
            return array.empty()
        try:
            with reading(self.folder, f"{name}/{file}"):
                chunk = array.decoded(self.folder.read(name, file, array.max_encoded_bytes))
        except FileNotFoundError:
            raise self._missing_error(name, indices) from None
        if recorded is not None and array.sum_of(chunk[:rows]) != recorded:
            raise ChunkOfOthers(f"{self.folder}: {name}/{file} is damaged: its content is that of another chunk or run")
        chunk[rows:] = array.empty()[rows:]
        return chunk

    def as_it_is_now(self) -> Archive:
        """Read the root again; ArchiveError if another run has taken the place of this one."""
        latest = Archive.at(self.folder)
        if identity_of(latest.attributes) != identity_of(self.attributes):
            raise ArchiveError(
                f"{self.folder}: another run has taken the place of the one that was opened; open it again"
            )
        return latest

    def _missing_error(self, name: str, indices: tuple[int, ...]) -> ArchiveError:
        return ArchiveError(
            f"{self.folder}: {name}/{chunk_file(indices)} is missing, although it was committed; restore the file"
        )

    def read(self, name: str, part: Sequence[range] | None = None) -> NDArray[Any]:
        """Return an array, or the ascending ranges `part` along its axes; NaN where nothing is written yet."""
        array = self.arrays[name]
        ranges = tuple(map(range, array.shape)) if part is None else tuple(part)
        shape = tuple(map(len, ranges))
        what = f"{name} of the archive {self.folder}"
        check_available_memory(16 * prod(shape), what, f"read a part of to_xarray()[{name!r}]")
        values = np.empty(shape, dtype=object if array.kind == "string" else array.kind)
        for indices, inside, outside in array.chunks_in(ranges):
            values[outside] = self.chunk(name, indices)[inside]
        if self.attributes[VERSION_ATTRIBUTE] < FORMAT:  # without checksums of contents
            self.as_it_is_now()
        return values

    def lost_chunks(self) -> Iterator[tuple[str, tuple[int, ...]]]:
        """Yield the name of the array and the indices of committed chunks that are missing, at most one of a block."""
        for name, array in self.arrays.items():
            files, axis = self._names(name), self.axis_of_blocks(name)
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
        lost = next(self.lost_chunks(), None)
        if lost is not None:
            self.as_it_is_now()
            raise self._missing_error(*lost)
        for name, array in self.arrays.items():
            if array.grows:
                first_row = max(0, array.shape[0] - 1) // array.chunk[0] * array.chunk[0]
                self.read(name, [range(first_row, array.shape[0]), *map(range, array.shape[1:])])

    def read_state(self, state: StoredState) -> dict[str, NDArray[Any]]:
        """Return the numbers of `ArchiveStore.store_state`; ArchiveError if the file is missing or was changed."""
        folder, file = self.folder, state.file
        if not (file.startswith(STATE_FILE_PREFIX) and file.replace("-", "_").replace(".", "_").isidentifier()):
            raise ArchiveError(f"{folder}: a state is called {short(file)}, which is no plain name")
        try:
            with reading(folder, f"the state {file}"):
                raw = folder.read(HIDDEN_FOLDER, file)
                if hashlib.sha256(raw).hexdigest() != state.digest:
                    raise ValueError("its checksum does not match")
                return deserialize_numbers(raw)
        except FileNotFoundError:
            raise ArchiveError(
                f"{folder}: the state {file} of the hidden folder {HIDDEN_FOLDER} is missing; copy the archive with "
                "this folder, or read its results alone by co.load"
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
