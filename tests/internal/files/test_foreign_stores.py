"""Zarr stores written by xarray and Zarr: runs are read, chunks of wrong lengths are refused."""

import random

import numcodecs
import numpy as np
import pytest
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec, ZstdCodec

import coadjoint as co
from coadjoint.errors import OneLineError
from coadjoint.files.output.file_validation import check_zarr
from coadjoint.memory import UNCHECKED_BYTES
from refusals import refused

pytestmark = [
    pytest.mark.filterwarnings("ignore::zarr.errors.UnstableSpecificationWarning"),
    pytest.mark.filterwarnings("ignore:Consolidated metadata"),
    pytest.mark.filterwarnings("ignore:Failed to open Zarr store with consolidated metadata"),
]


PACKERS = {
    (2, "none"): None,
    (2, "blosc"): numcodecs.Blosc("lz4"),
    (2, "zstd"): numcodecs.Zstd(1),
    (3, "none"): None,
    (3, "blosc"): BloscCodec(cname="lz4"),
    (3, "zstd"): ZstdCodec(),
    (3, "sum"): Crc32cCodec(),
    (3, "sum in blosc"): [Crc32cCodec(), BloscCodec(cname="zstd")],
    (3, "sum in zstd"): [Crc32cCodec(), ZstdCodec()],
    (3, "sum around blosc"): [BloscCodec(cname="zstd"), Crc32cCodec()],
    (3, "sums in and around zstd"): [Crc32cCodec(), ZstdCodec(), Crc32cCodec()],
}
NUMBERS = [">f8", "<f8", "<f4", "i1", "<i2", "<i4", ">i8", "u1", "<u2", "<u4", "<u8", "bool"]
TEXTS = [str, "<U3", ">U12", "S11"]
SHAPES = [((5, 3), (2, 2)), ((7,), (7,)), ((4, 1, 3), (1, 1, 3)), ((), ()), ((0, 3), (1, 3)), ((70,), (64,))]


def write_array(path, version, packer, kind, shape, chunk, rng):
    """Write an array by Zarr, with or without folders of chunks; return the chunk files."""
    separator = {"name": {2: "v2", 3: "default"}[version], "separator": rng.choice("./")}
    group = zarr.open_group(path, mode="w", zarr_format=version)
    array = group.create_array(
        "x", shape=shape, chunks=chunk, dtype=kind, compressors=PACKERS[version, packer], chunk_key_encoding=separator
    )
    if kind in TEXTS:
        words = ["".join(rng.choices("aé€", k=rng.randint(1, 3))) if kind != "S11" else "abc" for _ in range(70)]
        values = np.array(words, dtype=object if kind is str else kind)
    else:
        values = np.random.default_rng(rng.randrange(100)).integers(1, 100, 70).astype(kind)
    if 0 not in shape:
        array[...] = values[: max(1, int(np.prod(shape)))].reshape(shape)
    metadata = (".zgroup", ".zattrs", ".zarray", "zarr.json")
    return sorted(file for file in path.rglob("*") if file.is_file() and file.name not in metadata)


def longer_and_shorter(packed, packer):
    """Compress the content of a chunk with one byte more, and with one byte less."""
    codec = {"blosc": numcodecs.Blosc("zstd"), "zstd": numcodecs.Zstd(1)}[packer]
    content = bytes(codec.decode(packed))
    return [bytes(codec.encode(other)) for other in (content + b"\0", content[:-1])]


@pytest.mark.thinned(12)
@pytest.mark.parametrize(("version", "packer"), PACKERS, ids=str)
def test_wrong_chunk_lengths_are_refused(tmp_path, version, packer):
    """Numbers and text of every type and shape, with any codecs; chunks at an edge are stored in full."""
    rng = random.Random(f"{version} {packer}")
    shapes = rng.sample(SHAPES, len(SHAPES)) * 3
    for k, (kind, (shape, chunk)) in enumerate(zip([*NUMBERS, *TEXTS], shapes, strict=False)):
        path = tmp_path / str(k)
        files = write_array(path, version, packer, kind, shape, chunk, rng)
        assert bool(files) == (0 not in shape)
        check_zarr(path)
        name = next((name for name in ("blosc", "zstd") if name in packer), None)
        if not files or name is None:
            continue
        file, sums = rng.choice(files), 4 if "around" in packer else 0
        content = file.read_bytes()
        end = len(content) - sums
        for other in longer_and_shorter(content[:end], name):
            file.write_bytes(other + content[end:])
            with pytest.raises(ValueError, match=r"another length|other lengths|utf-8"):
                check_zarr(path)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("kind", ["<c16", "<M8[s]"])
def test_complex_and_time_types_are_refused(tmp_path, version, kind):
    zarr.open_group(tmp_path, mode="w", zarr_format=version).create_array("x", shape=(3,), dtype=kind)
    with refused(ValueError, "numbers", "text"):
        check_zarr(tmp_path)


def zstd_frame_without_length(blocks):
    """Return a Zstd frame (RFC 8878) of blocks that repeat a byte 2^17 times, without its length."""
    size = 2**17
    head = b"\x28\xb5\x2f\xfd\x00\x48"  # a window of 2^19
    return head + b"".join(
        ((k == blocks - 1) | 1 << 1 | size << 3).to_bytes(3, "little") + b"\0" for k in range(blocks)
    )


@pytest.mark.parametrize("version", [2, 3])
def test_text_of_undeclared_length_is_not_decompressed(tmp_path, monkeypatch, version):
    (file,) = write_array(tmp_path, version, "zstd", str, (3,), (3,), random.Random(0))
    assert len(bytes(numcodecs.Zstd().decode(zstd_frame_without_length(3)))) == 3 * 2**17
    file.write_bytes(zstd_frame_without_length(3))
    monkeypatch.setattr(numcodecs.Zstd, "decode", lambda *args: pytest.fail("it is unpacked"))
    with refused(ValueError, "length"):
        check_zarr(tmp_path)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("packer", ["blosc", "zstd"])
def test_text_of_excessive_length_is_not_decompressed(tmp_path, monkeypatch, version, packer):
    (file,) = write_array(tmp_path, version, packer, str, (3,), (3,), random.Random(0))
    length = UNCHECKED_BYTES + 1
    head = {
        "blosc": b"\x02\x01\x21\x01" + length.to_bytes(4, "little"),
        "zstd": b"\x28\xb5\x2f\xfd\xa0" + length.to_bytes(4, "little"),
    }
    file.write_bytes(head[packer] + bytes(24))
    monkeypatch.setattr(numcodecs.Zstd, "decode", lambda *args: pytest.fail("it is unpacked"))
    monkeypatch.setattr(numcodecs.Blosc, "decode", lambda *args: pytest.fail("it is unpacked"))
    with refused(ValueError, "length"):
        check_zarr(tmp_path)
    with pytest.raises(OneLineError):
        co.load(tmp_path)


@pytest.mark.parametrize("version", [2, 3])
def test_large_array_may_be_one_chunk(tmp_path, version):
    """Above a size that is not checked, a chunk must not exceed its array; it need not be stored."""
    group, count = zarr.open_group(tmp_path, mode="w", zarr_format=version), UNCHECKED_BYTES // 8 + 1
    group.create_array("x", shape=(count,), chunks=(count,), dtype="f8")
    check_zarr(tmp_path)
    group.create_array("energy", shape=(count - 1,), chunks=(count,), dtype="f8")
    with refused(ValueError, "'energy'", "chunks"):
        check_zarr(tmp_path)
