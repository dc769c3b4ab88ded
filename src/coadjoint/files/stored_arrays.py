"""Which arrays has an archive, and what do they look like in a file? Arrays of Zarr of format 3, in chunks.

An array that grows does so along its first dimension; a chunk is always stored whole, with nothing (`FILL`) behind the
rows that there are. What is written here is read by any reader of Zarr: numbers by the codecs bytes, blosc and crc32c,
names by the codec vlen-utf8.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

GROWING = ("time", "crossing")
"""The dimensions along which arrays grow."""
FEWEST_ROWS, MOST_ROWS = 2**10, 2**16
BYTES = 2**22
"""Of a chunk, before it is compressed, where a row is not longer."""
TYPES = {"f": "float64", "i": "int64", "b": "bool"}
FILL: dict[str, Any] = {"float64": "NaN", "int64": 0, "bool": False, "string": ""}
SEPARATOR = "."


class StoredArray(NamedTuple):
    """An array of an archive.

    Parameters
    ----------
    dims : tuple of str
        Its dimensions; where the first one is among `GROWING`, it grows.
    kind : {"float64", "int64", "bool", "string"}
        Of its numbers.
    shape : tuple of int
        Its shape; of an array that grows as far as it has come.
    chunk : tuple of int
        Of a chunk.
    attributes : mapping
        What is said of it.
    """

    dims: tuple[str, ...]
    kind: str
    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    attributes: Mapping[str, Any]

    @property
    def grows(self) -> bool:
        """Whether there is more of it when the run goes on."""
        return self.dims[:1] != () and self.dims[0] in GROWING

    def metadata(self) -> dict[str, Any]:
        """Return what Zarr is told of it."""
        numbers = self.kind not in ("string", "bool")
        codecs: list[dict[str, Any]] = [{"name": "bytes"}]
        if self.kind == "string":
            codecs = [{"name": "vlen-utf8"}]
        elif numbers:
            codecs = [
                {"name": "bytes", "configuration": {"endian": "little"}},
                {"name": "blosc", "configuration": BLOSC},
            ]
        return {
            "zarr_format": 3,
            "node_type": "array",
            "shape": list(self.shape),
            "data_type": self.kind,
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(self.chunk)}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": SEPARATOR}},
            "fill_value": FILL[self.kind],
            "codecs": [*codecs, {"name": "crc32c"}],
            "attributes": dict(self.attributes),
            "dimension_names": list(self.dims),
            "storage_transformers": [],
        }

    @classmethod
    def of_metadata(cls, metadata: Mapping[str, Any]) -> StoredArray:
        """Return the array that `metadata` was made of."""
        return cls(
            tuple(metadata["dimension_names"]),
            metadata["data_type"],
            tuple(metadata["shape"]),
            tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"]),
            metadata["attributes"],
        )

    def chunks_at(self, first: tuple[int, ...], shape: tuple[int, ...]) -> Iterator[tuple[tuple[int, ...], Any, Any]]:
        """Yield the chunks that a region touches: the number of each along the axes, the part of it, and of the region.

        Parameters
        ----------
        first : tuple of int
            Where the region begins.
        shape : tuple of int
            How far it goes.
        """
        along = [range(a // c, -(-(a + n) // c)) for a, n, c in zip(first, shape, self.chunk, strict=True)]
        for place in itertools.product(*along):
            inside, outside = [], []
            for k, a, n, c in zip(place, first, shape, self.chunk, strict=True):
                low, high = max(a, k * c), min(a + n, (k + 1) * c)
                inside.append(slice(low - k * c, high - k * c))
                outside.append(slice(low - a, high - a))
            yield place, tuple(inside), tuple(outside)

    def empty(self) -> NDArray[Any]:
        """Return a chunk of nothing."""
        if self.kind == "string":
            return np.full(self.chunk, "", dtype=object)
        return np.full(self.chunk, np.nan if self.kind == "float64" else 0, dtype=self.kind)

    def encoded(self, chunk: NDArray[Any]) -> bytes:
        """Return a chunk as bytes."""
        from numcodecs import Blosc, VLenUTF8

        if self.kind == "string":
            content = bytes(VLenUTF8().encode(np.asarray(chunk, dtype=object).ravel()))
        else:
            content = np.ascontiguousarray(chunk, dtype=np.dtype(self.kind).newbyteorder("<")).tobytes()
            if self.kind != "bool":
                whole = np.frombuffer(content, dtype="<i8")
                content = bytes(Blosc(BLOSC["cname"], BLOSC["clevel"], Blosc.SHUFFLE).encode(whole))
        return content + _sum_of(content)

    def decoded(self, content: bytes) -> NDArray[Any]:
        """Return the numbers of a chunk from its bytes.

        Raises
        ------
        ValueError
            They are damaged.
        """
        from numcodecs import Blosc, VLenUTF8

        content, told = content[:-4], content[-4:]
        if _sum_of(content) != told:
            raise ValueError("a chunk of the archive is damaged: its check sum is another one")
        if self.kind == "string":
            return np.asarray(VLenUTF8().decode(content), dtype=object).reshape(self.chunk)
        if self.kind != "bool":
            content = bytes(Blosc().decode(content))
        return np.frombuffer(content, dtype=np.dtype(self.kind).newbyteorder("<")).reshape(self.chunk).copy()


BLOSC = {"typesize": 8, "cname": "zstd", "clevel": 3, "shuffle": "shuffle", "blocksize": 0}


def _sum_of(content: bytes) -> bytes:
    import google_crc32c

    return int(google_crc32c.value(content)).to_bytes(4, "little")


def chunk_of(dims: tuple[str, ...], shape: tuple[int, ...], rows: int) -> tuple[int, ...]:
    """Return the shape of the chunks of an array: all of it, or `rows` rows of one that grows; long ones are split.

    Examples
    --------
    >>> chunk_of(("time", "component"), (11, 3), 64), chunk_of(("component",), (3,), 64)
    ((64, 3), (3,))
    >>> chunk_of(("time", "member", "component"), (1, 10**6, 3), 1)
    (1, 166667, 3)
    """
    grows = dims[0] in GROWING
    chunk = list(shape)
    if grows:
        chunk[0] = rows
    for axis in range(int(grows), len(chunk)):
        # The first axes are split first: those of members.
        over = max(1, -(-8 * prod(chunk) // BYTES))
        chunk[axis] = max(1, -(-chunk[axis] // over))
    return tuple(max(1, size) for size in chunk)


def rows_of_chunk(numbers: int, most: int) -> int:
    """Return how many rows a chunk has, where one row of the longest array has so many numbers.

    Those of a run of few points have some room, since it may be gone on with.

    Examples
    --------
    >>> rows_of_chunk(3, 10**9), rows_of_chunk(3, 11), rows_of_chunk(10**6, 100)
    (65536, 1024, 1)
    """
    return max(1, min(BYTES // (8 * max(1, numbers)), MOST_ROWS, max(FEWEST_ROWS, most)))
