"""Lengths of chunks as their headers declare them, and the filters of HDF5 files."""

import zlib

import h5py
import numpy as np
import pytest
from numcodecs import Blosc, Zstd

import coadjoint as co
from coadjoint.files.output.file_validation import _decompressed_length, check_hdf5
from refusals import refused

BOUNDARIES = (1, 2, 100, 254, 255, 256, 257, 300, 2**16 - 1, 2**16, 2**16 + 255, 2**16 + 256, 2**16 + 257, 2**17)


@pytest.mark.parametrize("length", BOUNDARIES)
def test_chunk_length_is_read_from_the_header(length):
    """For every width of the length in the header."""
    content = np.random.default_rng(1).integers(0, 4, length, dtype=np.uint8).tobytes()
    for codec, name in ((Blosc("zstd", 1), "blosc"), (Blosc("lz4", 0), "blosc"), (Zstd(1), "zstd")):
        packed = bytes(codec.encode(content))
        assert len(bytes(codec.decode(packed))) == _decompressed_length(packed[:32], name) == length
    assert _decompressed_length(content[:32], "") is None


@pytest.mark.parametrize("single", [0, 1])
@pytest.mark.parametrize("width", range(4))
@pytest.mark.parametrize("dictionary", range(4))
def test_zstd_frame_headers(single, width, dictionary):
    """RFC 8878: descriptor, window unless the frame is a single segment, dictionary, and the length less 256 in two
    bytes; without a length the content is unbounded.
    """
    size = (single, 2, 4, 8)[width]
    length = 100 if size == 1 else 0x0201 if size == 2 else 0x04030201
    head = b"\x28\xb5\x2f\xfd" + bytes([width << 6 | single << 5 | dictionary])
    head += b"\x77" * (1 - single) + b"\x66" * (0, 1, 2, 4)[dictionary]
    head += (length - (256 if size == 2 else 0)).to_bytes(size, "little") if size else b""
    assert _decompressed_length((head + b"\x55" * 32)[:32], "zstd") == (length if size else -1)
    assert _decompressed_length(b"\x29" + head[1:], "zstd") == -1 and _decompressed_length(head[:4], "zstd") == -1


def hdf5_with(path, filters, chunk=None, mask=0):
    """Write a variable of three numbers whose chunk has these filters in order."""
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk((3,))
    for each in filters:
        getattr(plist, f"set_{each}")(*([1] if each == "deflate" else []))
    with h5py.File(path, "w") as file:
        made = h5py.h5d.create(file.id, b"x", h5py.h5t.NATIVE_DOUBLE, h5py.h5s.create_simple((3,)), plist)
        made.write(h5py.h5s.ALL, h5py.h5s.ALL, np.arange(3.0))
        if chunk is not None:
            made.write_direct_chunk((0,), chunk, mask)
    return path


@pytest.mark.parametrize(
    "filters",
    [
        (), ("shuffle",), ("deflate",), ("fletcher32",), ("shuffle", "deflate"), ("deflate", "fletcher32"),
        ("fletcher32", "deflate"), ("shuffle", "fletcher32", "deflate"), ("shuffle", "deflate", "fletcher32"),
    ],
)  # fmt: skip
def test_filters_are_accepted_in_any_order(tmp_path, filters):
    check_hdf5(hdf5_with(tmp_path / "x.nc", filters))


def sums(content):
    """Append four bytes as a checksum."""
    return content + bytes(4)


PACKED_CHUNKS = {
    "longer": (("deflate",), zlib.compress(bytes(25)), 0, "another length"),
    "shorter": (("deflate",), zlib.compress(bytes(23)), 0, "another length"),
    "far longer": (("deflate",), zlib.compress(bytes(2**20)), 0, "another length"),
    "longer, with a sum behind": (("deflate", "fletcher32"), sums(zlib.compress(bytes(28))), 0, "another length"),
    "without the sum inside": (("fletcher32", "deflate"), zlib.compress(bytes(24)), 0, "another length"),
    "filter left out": (("deflate",), bytes(24), 1, "without all of its filters"),
    "second filter left out": (("shuffle", "deflate"), bytes(24), 2, "without all of its filters"),
    "first filter left out": (("shuffle", "deflate"), zlib.compress(bytes(24)), 1, "without all of its filters"),
    "packed twice": (("deflate", "deflate"), zlib.compress(zlib.compress(bytes(24))), 0, "has the filters"),
    "not packed": (("deflate",), bytes(24), 0, "."),
}  # fmt: skip


@pytest.mark.parametrize("kind", PACKED_CHUNKS)
def test_wrong_hdf5_chunks_are_refused(tmp_path, kind):
    filters, chunk, mask, message = PACKED_CHUNKS[kind]
    path = hdf5_with(tmp_path / "x.nc", filters, chunk, mask)
    with pytest.raises((ValueError, zlib.error), match=message):
        check_hdf5(path)
    with refused(ValueError, "x.nc"):
        co.load(path)


def test_texts_of_hdf5_have_one_dimension(tmp_path):
    with h5py.File(tmp_path / "x.nc", "w") as file:
        file.create_dataset("names", data=np.array(["a", "b"], dtype=object), dtype=h5py.string_dtype())
    check_hdf5(tmp_path / "x.nc")
    with h5py.File(tmp_path / "x.nc", "w") as file:
        file.create_dataset("names", (2, 2), dtype=h5py.string_dtype())
    with refused(ValueError, "2 dimensions"):
        check_hdf5(tmp_path / "x.nc")
