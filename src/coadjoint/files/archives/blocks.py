"""Blocks of an ensemble in an archive: members that are run together, by one writer.

Blocks have one size, which is the chunk size of all arrays along the members, so that no two blocks share a file. In
the hidden folder of the archive each block has::

    block-000012           its marker: progress, and the numbers from which it resumes
    block-000012.lock      locked while a process runs it

A marker is replaced atomically, after all chunks that it refers to. A block is done when its marker records it as
finished. A damaged marker is ignored: the block is run again, with the same bits.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from numpy.typing import NDArray

from coadjoint.files.archives.reading import HIDDEN_FOLDER, chunk_file
from coadjoint.files.archives.stored_arrays import deserialize_numbers, serialize_numbers

if TYPE_CHECKING:
    from coadjoint.files.archives.folder import ArchiveFolder
    from coadjoint.files.archives.stored_arrays import StoredArray

BLOCK_SIZE_ATTRIBUTE = "archive_block"
"""Attribute of an archive: members per block."""
MEMBER = "member"
START_ARRAYS = ("x0", "attitude0")
STATUS = "status"
BLOCK_ARRAYS = ("drift", "change", "balance", "failed", STATUS)
"""Arrays over the members, and not over time, that a block writes."""
PENDING, DONE, FAILED = 0, 1, 2  # states of a member, stored in archives
STATUS_ATTRIBUTES = {
    "long_name": "whether the member has been computed to its end",
    "flag_values": [PENDING, DONE, FAILED],
    "flag_meanings": "not_computed done failed",
}
MAX_STATE_BYTES = 2**22
"""Limit on the state of a block at one time, for the default block size."""
MEMBERS_PER_BATCH = 32
"""Members that the kernels advance side by side."""
BLOCKS_PER_WORKER = 4  # so that workers of different speed end at about the same time
HEAD_TYPES: dict[str, Any] = {
    name: int for name in ("archive_steps", "archive_finished", "evaluations", "iterations", "failed", "rows")
} | {"seconds": int | float}
"""Numbers that every marker has."""
MAX_HEAD_BYTES = 2**16
"""Limit on the first line of a marker, in bytes."""


class Block(NamedTuple):
    """The members `first` to `last` - 1 of an ensemble."""

    number: int
    first: int
    last: int


def blocks_of(members: int, size: int) -> list[Block]:
    """Return all blocks of an ensemble.

    Examples
    --------
    >>> blocks_of(5, 2)
    [Block(number=0, first=0, last=2), Block(number=1, first=2, last=4), Block(number=2, first=4, last=5)]
    """
    return [Block(k, first, min(first + size, members)) for k, first in enumerate(range(0, members, size))]


def size_of_blocks(members: int, numbers: int, workers: int) -> int:
    """Return the default block size: several blocks per worker for load balance, full lanes, and limited chunks.

    Examples
    --------
    >>> size_of_blocks(1000, 3, 2), size_of_blocks(10, 3, 2), size_of_blocks(1000, 10**6, 2)
    (128, 2, 1)
    """
    fair = -(-members // (BLOCKS_PER_WORKER * workers))
    if fair > MEMBERS_PER_BATCH:
        fair = -(-fair // MEMBERS_PER_BATCH) * MEMBERS_PER_BATCH
    return max(1, min(fair, members, MAX_STATE_BYTES // (8 * max(1, numbers))))


class Marker(NamedTuple):
    """Progress of a block: plain numbers and text `about` it, and the arrays `stored` from which it resumes."""

    about: dict[str, Any]
    stored: dict[str, NDArray[Any]]


def marker_file(number: int) -> str:
    """Return the name of a block's marker in the hidden folder."""
    return f"block-{number:06d}"


def lock_file(number: int) -> str:
    """Return the name of a block's lock file in the hidden folder."""
    return f"block-{number:06d}.lock"


def write_marker(folder: ArchiveFolder, number: int, about: Mapping[str, Any], stored: Mapping[str, Any]) -> None:
    """Write the marker of a block atomically: a line of JSON with checksums, then the numbers."""
    raw = serialize_numbers(stored)
    head = json.dumps({"about": dict(about), "bytes": len(raw), "numbers": hashlib.sha256(raw).hexdigest()})
    line = f"{hashlib.sha256(head.encode()).hexdigest()} {head}\n"
    folder.write(HIDDEN_FOLDER, marker_file(number), line.encode() + raw)
    folder.sync_to_disk([HIDDEN_FOLDER])


def read_head(folder: ArchiveFolder, number: int) -> dict[str, Any] | None:
    """Return the head of a block's marker, without its numbers; None if it is missing or damaged."""
    content = _marker(folder, number, MAX_HEAD_BYTES)
    return None if content is None else content[0]["about"]


def read_marker(folder: ArchiveFolder, number: int) -> Marker | None:
    """Return the marker of a block; None if it is missing or damaged."""
    marker = _marker(folder, number)
    if marker is None or hashlib.sha256(marker[1]).hexdigest() != marker[0].get("numbers"):
        return None
    try:
        return Marker(marker[0]["about"], deserialize_numbers(marker[1]))
    except ValueError:
        return None


def _marker(folder: ArchiveFolder, number: int, head: int | None = None) -> tuple[dict[str, Any], bytes] | None:
    """Return the head of a marker and its raw numbers; None if it is missing or damaged."""
    try:
        line, _, raw = folder.read(HIDDEN_FOLDER, marker_file(number), head=head).partition(b"\n")
        return _head(line), raw
    except (OSError, ValueError, RecursionError):
        return None


def _head(line: bytes) -> dict[str, Any]:
    digest, _, text = line.decode("utf-8").rstrip("\n").partition(" ")
    if hashlib.sha256(text.encode()).hexdigest() != digest:
        raise ValueError("the marker is damaged")
    content = json.loads(text)
    if not isinstance(content, dict) or not isinstance(content.get("about"), dict):
        raise ValueError("the marker is damaged")
    about = content["about"]
    for name, kinds in HEAD_TYPES.items():
        if isinstance(about.get(name), bool) or not isinstance(about.get(name), kinds) or not 0 <= about[name] < 2**62:
            raise ValueError("the marker is damaged")
    return content


def is_computed(name: str, array: StoredArray) -> bool:
    """Whether an array is written by the blocks, rather than when the archive is begun."""
    return array.grows or name in BLOCK_ARRAYS


def chunks_of(arrays: Mapping[str, StoredArray], block: Block, rows: int) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Yield the chunks of a block with this many rows: array name, and chunk indices."""
    for name, array in arrays.items():
        if MEMBER not in array.dims or name in START_ARRAYS:
            continue
        ranges = [range(-(-size // chunk)) for size, chunk in zip(array.shape, array.chunk, strict=True)]
        ranges[array.dims.index(MEMBER)] = range(block.number, block.number + 1)
        if array.grows:
            ranges[0] = range(-(-rows // array.chunk[0]))
        for indices in itertools.product(*ranges):
            yield name, indices


def is_complete(folder: ArchiveFolder, arrays: Mapping[str, StoredArray], block: Block, rows: int) -> bool:
    """Whether all chunks that a marker refers to exist; some may have been removed."""
    files_of = dict[str, set[str]]()
    for name, indices in chunks_of(arrays, block, rows):
        files_of.setdefault(name, set()).add(chunk_file(indices))
    return all(files <= folder.names(name) for name, files in files_of.items())
