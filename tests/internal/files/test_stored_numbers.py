"""Serialized arrays: every memory layout is read back, and damaged or hostile bytes are refused."""

import io
import zipfile

import numpy as np
import pytest

from coadjoint.files.archives.stored_arrays import StoredArray, deserialize_numbers, serialize_numbers
from refusals import refused

GRID = np.arange(24.0).reshape(2, 3, 4)
ARRAYS = {
    "by rows": GRID,
    "by columns": np.asfortranarray(GRID),
    "transposed": GRID[0].T,
    "strided": GRID[:, ::2, ::-1],
    "one": np.array(0.5),
    "none": np.zeros((0, 3)),
    "whole": np.arange(-3, 4, dtype=np.int32),
    "flags": np.array([[True, False], [False, False]]),
    "swapped": np.arange(3, dtype=">f8"),
    "special": np.array([np.nan, np.inf, -0.0]),
    "plain": 3,
}


def test_every_layout_is_read_back():
    found = deserialize_numbers(serialize_numbers(ARRAYS))
    assert list(found) == list(ARRAYS)
    for name, values in ARRAYS.items():
        wanted = np.asarray(values)
        assert found[name].shape == wanted.shape and found[name].dtype == wanted.dtype, name
        np.testing.assert_array_equal(found[name], wanted, err_msg=name)
        found[name][...] = 0  # writable: a resumed run changes it
    assert np.signbit(deserialize_numbers(serialize_numbers(ARRAYS))["special"][2])


def archive(write, **options):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", **options) as file:
        write(file)
    return content.getvalue()


def raw(array, version=(1, 0)):
    content = io.BytesIO()
    np.lib.format.write_array(content, array, version=version, allow_pickle=True)
    return content.getvalue()


def declared(shape):
    """Return an array of six numbers whose header declares another shape."""
    content, old = raw(np.zeros(6)), b"(6,), }" + b" " * 20
    assert old in content
    return content.replace(old, f"{shape}, }}".encode().ljust(len(old)))


ENTRIES = {
    "objects": (raw(np.array([1, None], dtype=object)), "not of numbers"),
    "text": (raw(np.array(["a"])), "not of numbers"),
    "times": (raw(np.array(["2026"], dtype="M8[Y]")), "not of numbers"),
    "complex": (raw(np.zeros(2, dtype=complex)), "not of numbers"),
    "many axes": (raw(np.zeros((1,) * 9)), "not of numbers"),
    "second version": (raw(np.zeros(2), (2, 0)), "an unknown version"),
    "longer": (raw(np.zeros(6)) + b"\0", "contradicts its shape"),
    "shorter": (raw(np.zeros(6))[:-1], "contradicts its shape"),
    "huge": (declared((10**12,)), "contradicts its shape"),
    "negative": (declared((-6,)), "not of numbers"),
    "twice negative": (declared((-2, -3)), "not of numbers"),
    "no shape": (declared(6), "."),
    "no array": (b"nothing", "."),
    "empty": (b"", "."),
}


@pytest.mark.parametrize("name", ENTRIES)
def test_invalid_entries_are_refused(name):
    content, message = ENTRIES[name]
    with pytest.raises(ValueError, match=message):
        deserialize_numbers(archive(lambda file: file.writestr("x.npy", content)))


@pytest.mark.parametrize("compression", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_compressed_entries_are_refused(compression):
    """A few bytes could expand to any size."""
    with refused(ValueError, "compressed"):
        deserialize_numbers(archive(lambda file: file.writestr("x.npy", raw(np.zeros(6))), compression=compression))


def test_overlapping_entries_are_refused():
    """Many directory entries could refer to one array."""
    content = archive(lambda file: file.writestr("x.npy", raw(np.zeros(1000))))
    end = content.rindex(b"PK\5\6")
    begin = int.from_bytes(content[end + 16 : end + 20], "little")
    entry, count = content[begin:end], 50
    tail = bytearray(content[end:])
    for at, number, size in ((8, count, 2), (10, count, 2), (12, count * len(entry), 4), (16, begin, 4)):
        tail[at : at + size] = number.to_bytes(size, "little")
    with refused(ValueError, "longer"):
        deserialize_numbers(content[:begin] + entry * count + bytes(tail))


FLIPPED = bytearray(serialize_numbers({"x": GRID}))
FLIPPED[FLIPPED.index(GRID[1, 1].tobytes()) + 3] ^= 1


@pytest.mark.parametrize("content", [b"", b"PK", b"nothing" * 100, serialize_numbers(ARRAYS)[:-30], bytes(FLIPPED)])
def test_other_bytes_are_refused(content):
    with pytest.raises(ValueError, match="BadZipFile"):
        deserialize_numbers(content)


def stored(axes, length=1):
    return StoredArray(tuple("abcdefghijk"[:axes]), "float64", (length,) * axes, (1,) * axes, {})


@pytest.mark.parametrize(
    ("within", "beyond"),
    [
        (stored(8), stored(9)),
        (stored(1, 2**62), stored(1, 2**62 + 1)),
        (
            StoredArray(("time",), "float64", (1,), (2**16,), {}),
            StoredArray(("time",), "float64", (1,), (2**16 + 1,), {}),
        ),
        (
            StoredArray(("time", "x"), "float64", (1, 2**10), (512, 2**10), {}),
            StoredArray(("time", "x"), "float64", (1, 2**10), (513, 2**10), {}),
        ),
    ],
    ids=["axes", "length", "rows", "bytes"],
)
def test_sizes_of_arrays_are_limited(within, beyond):
    within.check()
    with pytest.raises(ValueError):
        beyond.check()


def test_stored_numbers_have_eight_axes_at_most():
    """Nine are among the invalid entries."""
    assert deserialize_numbers(serialize_numbers({"x": np.zeros((1,) * 8)}))["x"].ndim == 8
