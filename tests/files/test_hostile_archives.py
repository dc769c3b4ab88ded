"""Archives of untrusted origin: refused in one sentence, in bounded memory, without effects outside the archive."""

import itertools
import json
import os
import shutil
import subprocess
import sys

import google_crc32c
import numpy as np
import pytest
from hostile_archives import BODY, HIDDEN, ROOT, SPAN, STEP, X, archives, attacked, outside_names, snapshot
from numcodecs import Blosc

import coadjoint as co
from coadjoint import cli
from coadjoint.files.archives.reading import ArchiveError
from coadjoint.files.archives.resume import archive_run
from coadjoint.files.archives.stored_arrays import StoredArray
from coadjoint.files.output.atomic_output import remove_leftovers
from coadjoint.runs.prepared_run import PreparedRun

NAMES = ("vector", "members", "finished", "blocks")
KINDS = ("metadata", "chunk", "state", "link")
pytestmark = [pytest.mark.skipif(os.name == "nt", reason="links and FIFOs"), pytest.mark.usefixtures("no_fsync")]


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile") / "base"
    assert tuple(archives(folder)) == NAMES
    return folder


def check(base, tmp_path, name, kind, seeds):
    if (name, kind) == ("blocks", "state"):
        return
    for seed in seeds:
        assert not attacked(base, tmp_path / "try", name, kind, seed), (name, kind, seed)


@pytest.mark.thinned(7)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_random_attacks(base, tmp_path, name, kind):
    check(base, tmp_path, name, kind, range(4))


@pytest.mark.long
def test_many_random_attacks(base, tmp_path):
    for name, kind in itertools.product(NAMES, KINDS):
        check(base, tmp_path, name, kind, range(4, 130))


def half(path):
    return archive_run(PreparedRun(BODY, co.GaussLegendre(2), STEP), X, SPAN, 2, path, until=13)


@pytest.fixture
def run(tmp_path):
    """An unfinished archive beside a folder of the user."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "kept").write_bytes(b"a file of the user")
    half(tmp_path / "run.zarr")
    return tmp_path / "run.zarr", outside


def edit_root(path, change):
    root = json.loads((path / ROOT).read_text())
    change(root["attributes"], root["consolidated_metadata"]["metadata"])
    (path / ROOT).write_text(json.dumps(root))


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    "name", [0, 1, 2, 3, 4, "..", ".", "...", "", " ", "a b", "a-b", "1x", ".hidden", "x.0", "x\0", "x" * 256]
)
def test_paths_as_array_names_are_refused(run, name, capsys):
    """Paths that lead out of the archive, and other names that are no identifiers, are refused."""
    path, outside = run
    name = outside_names(outside)[name] if isinstance(name, int) else name
    edit_root(path, lambda _, arrays: arrays.update({name: arrays.pop("energy")}))
    before = snapshot(outside)
    for call in (co.open_archive, co.resume, co.load):
        with pytest.raises(ArchiveError, match="which is no plain name"):
            call(path)
    assert cli.main(["resume", str(path)]) == 2 and capsys.readouterr().err.count("\n") == 1
    assert snapshot(outside) == before


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    "name",
    [
        "x",
        HIDDEN,
        f"{HIDDEN}/lock",
        f"{HIDDEN}/.zarr.json.writing",
        ".zarr.json.writing",
        "x/.c.0.0.writing",
        "x/c.0.0",
    ],
)
def test_links_are_not_followed(run, name):
    """A link replaces a folder or a file of the archive, or a file to be written."""
    path, outside = run
    link = path / name
    if link.is_dir():
        shutil.move(link, outside / "there")
        link.symlink_to(outside / "there")
    else:
        link.unlink(missing_ok=True)
        link.symlink_to(outside / ("new" if name.endswith("lock") else "kept"))
    before = snapshot(outside)
    if name.endswith(".writing"):
        assert co.resume(path).finished  # taken for a leftover of a killed process
    else:
        with pytest.raises(ArchiveError, match="symbolic link"):
            co.resume(path)
    assert snapshot(outside) == before


def test_archive_path_may_be_a_link(run, tmp_path):
    (tmp_path / "link").symlink_to(run[0])
    assert co.resume(tmp_path / "link").finished and co.open_archive(run[0]).finished


def test_links_are_not_removed_as_leftovers(tmp_path):
    """A link with the name of a leftover is not followed."""
    target, precious = tmp_path / "run.zarr", tmp_path / "precious"
    precious.mkdir()
    for name in ("lock", "kept"):
        (precious / name).touch()
    from coadjoint.files.output.atomic_output import _prefix

    (tmp_path / f"{_prefix(target)}01234567").symlink_to(precious)
    remove_leftovers(target)
    assert sorted(os.listdir(precious)) == ["kept", "lock"]


CHILD = """
import resource, sys
import coadjoint as co
found = co.open_archive(sys.argv[1])
found.t, found.to_xarray()["energy"].values
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for read in (lambda: found.x, lambda: found.to_xarray()["x"].values):
    try:
        read()
    except ValueError as refused:
        print(refused)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def with_checksum(body):
    return body + int(google_crc32c.value(body)).to_bytes(4, "little")


def test_decompression_bomb_takes_bounded_memory(run):
    """A few kilobytes decompress to 128 MB; memory is measured in a separate process."""
    path, _ = run
    packed = bytes(Blosc("zstd", 1, Blosc.SHUFFLE).encode(np.zeros(2**24)))
    assert len(packed) < 2**17
    (path / "x" / "c.0.0").write_bytes(with_checksum(packed))
    output = subprocess.run([sys.executable, "-c", CHILD, path], capture_output=True, text=True, check=True).stdout
    *refused, more = output.splitlines()
    assert len(refused) == 2 and all("x/c.0.0 cannot be read" in line for line in refused)
    assert int(more) < 2**15  # kB, a quarter of the decompressed size


def test_chunk_lengths_are_checked_before_decompression(monkeypatch):
    array = StoredArray(("time", "component"), "float64", (7, 3), (8, 3), {})
    good = array.encoded(np.arange(24.0).reshape(8, 3))
    assert np.array_equal(array.decoded(good), np.arange(24.0).reshape(8, 3))
    monkeypatch.setattr("numcodecs.Blosc.decode", None)
    for held in (23, 25, 2**25):
        with pytest.raises(ValueError, match="header"):
            array.decoded(with_checksum(bytes(Blosc("zstd", 3, Blosc.SHUFFLE).encode(np.zeros(held)))))
    # Bytes after the end, and too few of them: the length in the header bounds what the decompressor reads.
    packed = bytes(Blosc("zstd", 3, Blosc.SHUFFLE).encode(np.arange(np.prod(array.chunk), dtype=np.float64)))
    for content in (packed + b"\0", packed[:-1], packed[: len(packed) // 2], packed[:16], packed[:15], b""):
        with pytest.raises(ValueError, match="header contradicts its length"):
            array.decoded(with_checksum(content))
    names = StoredArray(("component",), "string", (3,), (3,), {})
    for body in (b"\4\0\0\0" + bytes(16), (2**31 - 1).to_bytes(4, "little") + bytes(12), b"\3\0\0\0" + bytes(11), b""):
        with pytest.raises(ValueError, match=r"another number of texts|texts have other lengths"):
            names.decoded(with_checksum(body))


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda _, arrays: arrays["x"].update(shape=[7, 2**40]), "along component"),
        (lambda _, arrays: arrays["x"].update(shape=[2**40, 3]), "over time"),
        (lambda _, arrays: arrays["x"]["chunk_grid"]["configuration"].update(chunk_shape=[2**17, 3]), "the chunk is"),
        (lambda _, arrays: arrays["x"]["codecs"].insert(1, {"name": "gzip"}), "codecs|not those"),
        (lambda _, arrays: arrays["x"].update(data_type="object"), "damaged"),
        (lambda attributes, _: attributes.update(archive_steps=14), "list of states"),
        (lambda attributes, _: attributes.update(archive_finished=2), "archive_finished is 2"),
        (lambda attributes, _: attributes.update(steps=10**400), "steps is"),
        (lambda attributes, _: attributes.update(archive_accounts="[" * 10**5), "archive_accounts is"),
    ],
)  # fmt: skip
def test_wrong_metadata_is_named(run, change, message):
    edit_root(run[0], change)
    for call in (co.open_archive, co.resume):
        with pytest.raises(ArchiveError, match=message):
            call(run[0])


@pytest.mark.thinned(6)
@pytest.mark.parametrize("finished", [False, True])
@pytest.mark.parametrize("name", ["x", "time", "energy", "x0", "drift", "component", "attitude"])
def test_missing_chunk_is_named(tmp_path, name, finished):
    path, options = tmp_path / "run.zarr", {"attitude": True}
    ready = PreparedRun(BODY, co.GaussLegendre(2), STEP, **options)
    archive_run(ready, X, SPAN, 2, path, until=None if finished else 13)
    (chunk,) = (path / name).glob("c.*")
    chunk.unlink()
    found = co.open_archive(path)
    message = rf"{name}/{chunk.name} is missing"
    for read in (lambda: found.to_xarray().load(), lambda: found.record.read(name)):
        with pytest.raises(ArchiveError, match=message):
            read()
    if not finished:
        with pytest.raises(ArchiveError, match=message):
            co.resume(path)


def test_missing_chunks_of_an_ensemble_are_refused(tmp_path):
    """Only chunks of members that are not computed yet are NaN."""
    path, x0 = tmp_path / "many.zarr", np.multiply.outer([1.0, 0.5, 0.2], X)
    co.ensemble(BODY, x0, SPAN, STEP, archive=path, members_per_block=2)
    chunk, marker = path / "x" / "c.0.1.0", path / HIDDEN / "block-000001"
    chunk.unlink()
    with pytest.raises(ArchiveError, match="is missing"):
        _ = co.open_archive(path).x
    edit_root(path, lambda attributes, _: attributes.update(archive_finished=0))
    with pytest.raises(ArchiveError, match="is missing"):
        _ = co.open_archive(path).x
    marker.unlink()
    found = co.open_archive(path)
    for x in (found.x, found.to_xarray()["x"].values):
        assert np.isfinite(x[:, :2]).all() and np.isnan(x[:, 2]).all()
    assert np.array_equal(co.resume(path).x, co.integrate(BODY, x0, SPAN, STEP).x)


def test_indexing_equals_numpy_indexing(tmp_path):
    """Slices in both directions, single entries and lists, over several chunks, by xarray."""
    path = tmp_path / "run.zarr"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("coadjoint.files.archives.stored_arrays.MIN_CHUNK_ROWS", 5)
        patched.setattr("coadjoint.files.archives.stored_arrays.MAX_CHUNK_ROWS", 5)
        found = co.integrate(BODY, X, SPAN, STEP, archive=path).to_xarray()["x"]
    x = co.integrate(BODY, X, SPAN, STEP).x
    rng = np.random.default_rng(1)
    for _ in range(60):
        first, last = rng.integers(-40, 40, 2)
        rows = [
            slice(first, last, int(rng.choice([1, 2, 7, -1, -3]))),
            int(rng.integers(-33, 33)),
            list(rng.integers(0, 33, 4)),
        ]
        if rows[0].step < 0 and not len(x[rows[0]]):
            continue  # fails in xarray
        key = (rows[rng.integers(3)], [slice(None), slice(None, None, -1), 1, [2, 0]][rng.integers(4)])
        assert np.array_equal(found[key].values, x[key[0]][..., key[1]]), key
