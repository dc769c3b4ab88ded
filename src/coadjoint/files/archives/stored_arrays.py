"""Encoding of archives: arrays in chunks of Zarr format 3, readable by any Zarr reader, and states as NumPy files.

An array that grows does so along its first dimension; chunks are stored complete, padded with `FILL`. Numbers use the
codecs bytes, blosc and crc32c; names use vlen-utf8.

Chunks are coded by numcodecs, as in zarr-python, but not by zarr-python itself. Its thread and event loop take 1 ms or
more for each chunk, where the codecs of a small one take 0.01 to 0.1 ms: runs of 10^3 to 10^6 cheap steps would take 30
to 60 percent longer. It allocates whatever length a chunk declares, its local store syncs nothing to disk and follows
symbolic links, and after an interrupt its thread goes on writing, when the archive is no longer locked.
"""

from __future__ import annotations

import io
import itertools
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from coadjoint.errors import in_one_line
from coadjoint.files.output.file_validation import decode_texts
from coadjoint.short_repr import short

GROWING_DIMENSIONS = ("time", "crossing")
"""Dimensions along which arrays grow."""
MAX_CHUNK_ROWS = 2**16  # points; also of short runs, which may be resumed to a later end
CHUNK_BYTES = 2**22
"""Size of a chunk before compression, unless a single row is longer."""
TYPES = {"f": "float64", "i": "int64", "b": "bool"}
FILL: dict[str, Any] = {"float64": "NaN", "int64": 0, "bool": False, "string": ""}
BLOSC = {"typesize": 8, "cname": "zstd", "clevel": 3, "shuffle": "shuffle", "blocksize": 0}
NUMBER_CODECS: list[dict[str, Any]] = [
    {"name": "bytes", "configuration": {"endian": "little"}},
    {"name": "blosc", "configuration": BLOSC},
]
CODECS: dict[str, list[dict[str, Any]]] = {"string": [{"name": "vlen-utf8"}], "bool": [{"name": "bytes"}]}
"""Codecs of other types than numbers, before the checksum."""
SEPARATOR = "."
METADATA_FILE = "zarr.json"
MAX_AXES = 8
MAX_AXIS_LENGTH, MAX_READ_ROWS = 2**62, 2**16
"""Limits on axis lengths, and on the rows of a chunk, when reading."""
ITEM_BYTES = 8
"""Bytes of a number."""
BLOSC_HEADER_BYTES = 16
"""Bytes of the Blosc header, by which a compressed chunk may exceed its data."""
CHECKSUM_BYTES = 4
"""Bytes of the checksum of a chunk."""


class StoredArray(NamedTuple):
    """An array of an archive: dimensions, type (float64, int64, bool or string), shape, chunk shape, attributes."""

    dims: tuple[str, ...]
    kind: str
    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    attributes: Mapping[str, Any]

    @property
    def grows(self) -> bool:
        """Whether the array grows as the run proceeds."""
        return self.dims[:1] != () and self.dims[0] in GROWING_DIMENSIONS

    def metadata(self) -> dict[str, Any]:
        """Return the Zarr metadata."""
        return {
            "zarr_format": 3,
            "node_type": "array",
            "shape": list(self.shape),
            "data_type": self.kind,
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(self.chunk)}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": SEPARATOR}},
            "fill_value": FILL[self.kind],
            "codecs": [*CODECS.get(self.kind, NUMBER_CODECS), {"name": "crc32c"}],
            "attributes": dict(self.attributes),
            "dimension_names": list(self.dims),
            "storage_transformers": [],
        }

    @classmethod
    def of_metadata(cls, metadata: Mapping[str, Any]) -> StoredArray:
        """Return the array with this metadata."""
        return cls(
            tuple(metadata["dimension_names"]),
            metadata["data_type"],
            tuple(metadata["shape"]),
            tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"]),
            metadata["attributes"],
        )

    def check(self) -> None:
        """Raise ValueError for shapes and chunks that the library does not write."""
        axes = len(self.dims)
        if not all(isinstance(name, str) and name.isidentifier() for name in self.dims) or not 1 <= axes <= MAX_AXES:
            raise ValueError(f"the dimensions are {short(self.dims)}")
        for what, sizes, minimum in (("shape", self.shape, 0), ("chunk", self.chunk, 1)):
            if len(sizes) != axes or any(
                type(size) is not int or not minimum <= size <= MAX_AXIS_LENGTH for size in sizes
            ):
                raise ValueError(f"the {what} is {short(sizes)}; it must be {axes} whole numbers from {minimum} up")
        longest = [max(1, size) for size in self.shape]
        if self.grows:
            longest[0] = MAX_READ_ROWS
        row = ITEM_BYTES * prod(longest[int(self.grows) :])
        if any(size > limit for size, limit in zip(self.chunk, longest, strict=True)) or (
            ITEM_BYTES * prod(self.chunk) > max(CHUNK_BYTES, row)
        ):
            raise ValueError(f"the chunk is {short(self.chunk)}, which is too large for the shape {short(self.shape)}")

    @property
    def max_encoded_bytes(self) -> int | None:
        """Limit on the encoded size of a chunk; None for text."""
        if self.kind == "string":
            return None
        return np.dtype(self.kind).itemsize * prod(self.chunk) + BLOSC_HEADER_BYTES + CHECKSUM_BYTES

    def chunks_in(self, part: Sequence[range]) -> Iterator[tuple[tuple[int, ...], Any, Any]]:
        """Yield the chunks that intersect ascending ranges of entries: indices, and slices of chunk and part."""
        along = [range(r[0] // c, r[-1] // c + 1) if r else range(0) for r, c in zip(part, self.chunk, strict=True)]
        for indices in itertools.product(*along):
            inside, outside = [], []
            for k, r, c in zip(indices, part, self.chunk, strict=True):
                low, high = (-(-(end - r.start) // r.step) for end in (k * c, (k + 1) * c))
                low, high = max(low, 0), min(high, len(r))
                outside.append(slice(low, high))
                inside.append(slice(r.start + low * r.step - k * c, r.start + (high - 1) * r.step + 1 - k * c, r.step))
            if all(slice_.start < slice_.stop for slice_ in outside):
                yield indices, tuple(inside), tuple(outside)

    @property
    def chunk_counts(self) -> tuple[int, ...]:
        """Number of chunks along each axis."""
        return tuple(-(-size // step) for size, step in zip(self.shape, self.chunk, strict=True))

    def chunk_indices(self, axis: int | None, index: int) -> Iterator[tuple[int, ...]]:
        """Yield the indices of all chunks, or of those with an index along an axis, along time in order."""
        along = [*map(range, self.chunk_counts)]
        if axis is not None:
            along[axis] = range(index, index + 1)
        return itertools.product(*along)

    def sum_of(self, rows: NDArray[Any]) -> int:
        """Return the CRC-32C of rows of a chunk, which does not depend on their compression."""
        import google_crc32c

        if self.kind == "string":
            return int(google_crc32c.value(json.dumps(rows.tolist()).encode()))
        return int(google_crc32c.value(np.ascontiguousarray(rows, np.dtype(self.kind).newbyteorder("<")).tobytes()))

    def empty(self) -> NDArray[Any]:
        """Return a chunk of fill values."""
        if self.kind == "string":
            return np.full(self.chunk, "", dtype=object)
        return np.full(self.chunk, np.nan if self.kind == "float64" else 0, dtype=self.kind)

    def encoded(self, chunk: NDArray[Any]) -> bytes:
        """Encode a chunk."""
        from numcodecs import Blosc, VLenUTF8

        if self.kind == "string":
            content = bytes(VLenUTF8().encode(np.asarray(chunk, dtype=object).ravel()))
        else:
            content = np.ascontiguousarray(chunk, dtype=np.dtype(self.kind).newbyteorder("<")).tobytes()
            if self.kind != "bool":
                words = np.frombuffer(content, dtype="<i8")
                content = bytes(Blosc(BLOSC["cname"], BLOSC["clevel"], Blosc.SHUFFLE).encode(words))
        return content + _sum_of(content)

    def decoded(self, content: bytes) -> NDArray[Any]:
        """Decode a chunk; ValueError if it is damaged."""
        content, declared = content[:-CHECKSUM_BYTES], content[-CHECKSUM_BYTES:]
        if _sum_of(content) != declared:
            raise ValueError("a chunk of the archive is damaged: its checksum does not match")
        if self.kind == "string":
            return np.array(decode_texts(content, prod(self.chunk)), dtype=object).reshape(self.chunk)
        kind = np.dtype(self.kind).newbyteorder("<")
        if self.kind != "bool":
            content = decompress(content, kind.itemsize * prod(self.chunk))
        if len(content) != kind.itemsize * prod(self.chunk):
            raise ValueError(f"a chunk of the archive has {len(content)} bytes, which contradicts its shape")
        return np.frombuffer(content, dtype=kind).reshape(self.chunk).copy()


def chunk_file(indices: tuple[int, ...]) -> str:
    """Return the file name of a chunk, such as c.3.0."""
    return SEPARATOR.join(("c", *map(str, indices)))


def decompress(content: bytes, length: int) -> bytes:
    """Decompress Blosc data to a known length; ValueError if it is damaged or of another length."""
    from numcodecs import Blosc

    # Header: versions, flags, item size; lengths of the content, of a block, and of the compressed data.
    declared, declared_packed = (int.from_bytes(content[offset : offset + 4], "little") for offset in (4, 12))
    if len(content) < BLOSC_HEADER_BYTES or declared != length or declared_packed != len(content):
        raise ValueError("a chunk of the archive is damaged: its header contradicts its length")
    try:
        return bytes(Blosc().decode(content))
    except (RuntimeError, ValueError, TypeError) as reason:
        raise ValueError(f"a chunk of the archive is damaged: {in_one_line(str(reason), 100)}") from None


def _sum_of(content: bytes) -> bytes:
    import google_crc32c

    return int(google_crc32c.value(content)).to_bytes(4, "little")


def chunk_of(dims: tuple[str, ...], shape: tuple[int, ...], rows: int, members: int | None = None) -> tuple[int, ...]:
    """Return the chunk shape of an array: all of it, or `rows` rows of one that grows; large ones are split."""
    grows = dims[0] in GROWING_DIMENSIONS
    chunk = [rows, *shape[1:]] if grows else list(shape)
    if members is not None:
        return tuple(max(1, members if name == "member" else size) for name, size in zip(dims, chunk, strict=True))
    for axis in range(int(grows), len(chunk)):
        # Split leading axes first: those of members.
        pieces = max(1, -(-8 * prod(chunk) // CHUNK_BYTES))
        chunk[axis] = max(1, -(-chunk[axis] // pieces))
    return tuple(max(1, size) for size in chunk)


def rows_of_chunk(numbers: int) -> int:
    """Return the rows of a chunk, if a row of the longest array has this many numbers."""
    return max(1, min(CHUNK_BYTES // (8 * max(1, numbers)), MAX_CHUNK_ROWS))


NPY_SUFFIX = ".npy"
MAX_NPY_AXES = 8


def serialize_numbers(numbers: Mapping[str, Any]) -> bytes:
    """Serialize numbers and arrays."""
    content = io.BytesIO()
    np.savez(content, **{name: np.asarray(value) for name, value in numbers.items()})  # type: ignore[arg-type]
    return content.getvalue()


def deserialize_numbers(raw: bytes) -> dict[str, NDArray[Any]]:
    """Deserialize `serialize_numbers`; ValueError if damaged, compressed, or longer than the bytes."""
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            files = archive.infolist()
            if any(file.compress_type != zipfile.ZIP_STORED or file.flag_bits & 1 for file in files):
                raise ValueError("it is compressed or encrypted")
            if sum(file.file_size for file in files) > len(raw):
                raise ValueError("its entries are longer than the file")
            return {file.filename.removesuffix(NPY_SUFFIX): _array_from(archive.read(file)) for file in files}
    except ValueError:
        raise
    except Exception as reason:  # zip and npy readers raise arbitrary errors for damaged bytes
        raise ValueError(f"{type(reason).__name__} while it was read") from reason


def _array_from(raw: bytes) -> NDArray[Any]:
    content = io.BytesIO(raw)
    version = npy.read_magic(content)
    if version != (1, 0):
        raise ValueError("it holds an array of an unknown version")
    shape, by_columns, dtype = npy.read_array_header_1_0(content)
    count = prod(shape)
    if dtype.kind not in "biuf" or min(shape, default=0) < 0 or len(shape) > MAX_NPY_AXES:
        raise ValueError("it contains an array that is not of numbers")
    if count * dtype.itemsize != len(raw) - content.tell():
        raise ValueError("it contains an array whose length contradicts its shape")
    array = np.frombuffer(raw, dtype, count, content.tell())
    return array.reshape(shape, order="F" if by_columns else "C").copy(order="K")
