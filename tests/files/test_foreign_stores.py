"""Zarr stores written by xarray and Zarr: runs are read, chunks of wrong lengths are refused."""

import json
import random

import numcodecs
import numpy as np
import pytest
import xarray
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec, ZstdCodec

import coadjoint as co
from coadjoint.files.datasets.loaded_solution import LoadError
from coadjoint.files.output.file_validation import check_zarr
from coadjoint.memory import UNCHECKED_BYTES

pytestmark = [
    pytest.mark.filterwarnings("ignore::zarr.errors.UnstableSpecificationWarning"),
    pytest.mark.filterwarnings("ignore:Consolidated metadata"),
    pytest.mark.filterwarnings("ignore:Failed to open Zarr store with consolidated metadata"),
]


@pytest.fixture(scope="module")
def sol():
    fluid = co.systems.torus_euler(N=3)
    return co.integrate(fluid, fluid.random(1, degrees=(1, 1)), (7.5, 8.5), 0.125)


@pytest.mark.thinned(9)
@pytest.mark.parametrize("names", ["fixed", "variable"])
@pytest.mark.parametrize(("version", "index"), [(2, "whole"), (2, "absent"), (3, "whole"), (3, "absent"), (3, "null")])
def test_runs_are_read_with_any_index_and_text_type(tmp_path, sol, version, index, names):
    """The index of format 3 is part of its root and may be null."""
    path, dataset = tmp_path / "run.zarr", sol.to_xarray()
    texts = [name for name, values in dataset.variables.items() if values.dtype.kind in "UO"]
    assert texts
    kinds = {name: dataset[name].astype({"fixed": "U", "variable": object}[names]) for name in texts}
    dataset.assign_coords(kinds).to_zarr(path, zarr_format=version, consolidated=index == "whole")
    if index == "null":
        root = json.loads((path / "zarr.json").read_text())
        (path / "zarr.json").write_text(json.dumps({**root, "consolidated_metadata": None}))
    found = co.load(path)
    for name, values in sol.to_xarray().variables.items():
        np.testing.assert_array_equal(found.dataset[name].values, values.values, err_msg=str(name))
    assert found.attributes == sol.to_xarray().attrs


@pytest.mark.parametrize("consolidated", [True, False])
def test_archive_copied_by_xarray_is_read(tmp_path, consolidated):
    """The copy has the codecs of the archive, with a checksum after each chunk."""
    system = co.systems.paper_a37()
    sol = co.integrate(system, [(0.3, 1.0, 0.7), (0.1, 0.5, 0.2)], (7.5, 8.5), 0.125, archive=tmp_path / "archive.zarr")
    with xarray.open_zarr(tmp_path / "archive.zarr", chunks=None) as opened:
        opened.to_zarr(tmp_path / "copy.zarr", consolidated=consolidated)
    codecs = json.loads((tmp_path / "copy.zarr" / "component" / "zarr.json").read_text())["codecs"]
    assert [codec["name"] for codec in codecs] == ["vlen-utf8", "crc32c"]
    np.testing.assert_array_equal(co.load(tmp_path / "copy.zarr").x, sol.x)


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
    with pytest.raises(ValueError, match="neither numbers nor text"):
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
    with pytest.raises(ValueError, match="another length"):
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
    with pytest.raises(ValueError, match="another length"):
        check_zarr(tmp_path)
    with pytest.raises(LoadError):
        co.load(tmp_path)


@pytest.mark.parametrize("version", [2, 3])
def test_large_array_may_be_one_chunk(tmp_path, version):
    """Above a size that is not checked, a chunk must not exceed its array; it need not be stored."""
    group, count = zarr.open_group(tmp_path, mode="w", zarr_format=version), UNCHECKED_BYTES // 8 + 1
    group.create_array("x", shape=(count,), chunks=(count,), dtype="f8")
    check_zarr(tmp_path)
    group.create_array("energy", shape=(count - 1,), chunks=(count,), dtype="f8")
    with pytest.raises(ValueError, match="the chunks of 'energy' are larger than the array"):
        check_zarr(tmp_path)
