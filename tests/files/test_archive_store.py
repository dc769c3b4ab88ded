"""The files of an archive: what counts, what a peer reads at any time, and what is refused."""

import json
import os
import shutil

import numpy as np
import pytest
import xarray

from coadjoint.files.archive_store import (
    FORMAT,
    ROOT,
    ArchiveError,
    ArchiveReplaced,
    ArchiveStore,
    read_array,
    read_kept,
    read_root,
)
from coadjoint.files.stored_arrays import StoredArray

ROWS = 16
X, T = np.arange(300.0).reshape(100, 3), np.arange(100.0)


def arrays():
    return {
        "time": StoredArray(("time",), "float64", (0,), (ROWS,), {}),
        "x": StoredArray(("time", "component"), "float64", (0, 3), (ROWS, 2), {"long_name": "momentum"}),
        "component": StoredArray(("component",), "string", (3,), (3,), {}),
        "failed": StoredArray(("member",), "bool", (2,), (2,), {}),
        "tenth": StoredArray(("tenth",), "int64", (10,), (10,), {}),
    }


@pytest.fixture
def store(tmp_path):
    found = ArchiveStore.begun(tmp_path / "run.zarr", arrays())
    found.write("component", ["e1", "é2", "e3"])
    found.write("failed", [True, False])
    found.write("tenth", np.arange(10))
    found.commit({"mood": "calm"}, {"time": 0})
    yield found
    found.close()


def written(store, first, last):
    store.write("x", X[first:last], (first,))
    store.write("time", T[first:last], (first,))
    return store.keep({"momenta": X[:last]}, {"number": last})


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("consolidated", [True, False])
def test_a_peer_reads_all_that_was_committed_and_nothing_else(store, consolidated):
    for first, last in ((0, 5), (5, 16), (16, 17), (17, 90), (90, 100)):
        kept = written(store, first, last)
        if consolidated:
            with xarray.open_zarr(store.path, chunks=None) as before:
                assert np.array_equal(before["x"], X[:first]) and np.array_equal(before["time"], T[:first])
        store.commit({"steps": last}, {"time": last}, [kept])
        with xarray.open_zarr(store.path, chunks=None, consolidated=consolidated) as found:
            assert np.array_equal(found["x"], X[:last]) and np.array_equal(found["time"], T[:last])
            assert found["x"].dims == ("time", "component") and found["x"].attrs == {"long_name": "momentum"}
            assert found["component"].values.tolist() == ["e1", "é2", "e3"]
            assert found["failed"].values.tolist() == [True, False] and found["tenth"].values.tolist() == list(
                range(10)
            )
            assert found.attrs == {"archive_format": FORMAT, "mood": "calm", "steps": last}
        assert np.array_equal(read_kept(store.path, kept)["momenta"], X[:last])


def test_own_readers_see_what_was_committed_when_the_root_was_read(store):
    written(store, 0, 20)
    store.commit({}, {"time": 20})
    known, _ = read_root(store.path)
    written(store, 20, 50)
    store.commit({}, {"time": 50})
    assert np.array_equal(read_array(store.path, "x", known["x"]), X[:20])
    assert read_array(store.path, "component", known["component"]).tolist() == ["e1", "é2", "e3"]
    (store.path / "x" / "c.1.0").unlink()
    with pytest.raises(ArchiveError, match=r"x/c\.1\.0 is missing"):
        read_array(store.path, "x", known["x"])
    lost = read_array(store.path, "x", known["x"], may_be_missing=lambda place: place == (1, 0))
    assert np.isnan(lost[16:, :2]).all() and np.array_equal(lost[16:, 2], X[16:20, 2])
    part = [range(3, 15, 4), range(1, 3)]
    assert np.array_equal(read_array(store.path, "x", known["x"], part), X[3:15:4, 1:3])


def test_who_goes_on_writes_again_what_did_not_count(store):
    written(store, 0, 10)
    store.commit({}, {"time": 10})
    store.write("x", -X[10:30], (10,))
    (store.path / "x" / ".c.5.0.writing").write_bytes(b"half of a chunk")
    (store.path / ".coadjoint" / "state-lost.npz").write_bytes(b"nobody's")
    store.close()
    again = ArchiveStore.opened(store.path)
    written(again, 10, 40)
    again.commit({}, {"time": 40})
    with xarray.open_zarr(store.path, chunks=None) as found:
        assert np.array_equal(found["x"], X[:40])
    assert sorted(os.listdir(store.path / ".coadjoint")) == ["lock", ROOT]
    assert [name for name in os.listdir(store.path / "x") if name.endswith(".writing")] == []
    again.close()


def test_the_second_writer_is_refused(store):
    with pytest.raises(ArchiveError, match="another process is writing to this archive; wait until it has ended"):
        ArchiveStore.opened(store.path)
    store.close()
    ArchiveStore.opened(store.path).close()


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("other", [False, True])
def test_a_folder_that_was_moved_is_noticed_and_has_all(store, tmp_path, other):
    """Another archive at its place stays as it is; what was computed is in the folder that was moved."""
    written(store, 0, 10)
    store.path.rename(tmp_path / "aside")
    if other:
        ArchiveStore.begun(store.path, arrays()).close()
    before = contents(store.path)
    kept = written(store, 10, 20)
    with pytest.raises(ArchiveReplaced, match="its folder was moved or replaced"):
        store.commit({}, {"time": 20}, [kept])
    assert store.path.exists() == other and contents(store.path) == before
    known, _ = read_root(tmp_path / "aside")
    assert np.array_equal(read_array(tmp_path / "aside", "x", known["x"]), X[:20])
    assert np.array_equal(read_kept(tmp_path / "aside", kept)["momenta"], X[:20])


def test_a_folder_that_was_removed_is_not_made_again(store):
    shutil.rmtree(store.path)
    for write in (lambda: written(store, 0, 10), lambda: store.commit({}, {"time": 0})):
        with pytest.raises(FileNotFoundError):
            write()
    assert not store.path.exists()


def test_a_lock_that_was_replaced_is_noticed(store):
    """Somebody has removed the lock file, and another process writes by a lock of its own."""
    written(store, 0, 10)
    (store.path / ".coadjoint" / "lock").unlink()
    second = ArchiveStore.opened(store.path)
    before = contents(store.path)
    for write in (lambda: written(store, 10, 20), lambda: store.commit({}, {"time": 10})):
        with pytest.raises(ArchiveReplaced, match="its lock file was replaced"):
            write()
    assert contents(store.path) == before
    second.close()


@pytest.mark.parametrize("broken", ["write", "fsync", "replace"])
def test_a_full_disk_leaves_the_last_commit(store, monkeypatch, broken):
    kept = written(store, 0, 20)
    store.commit({}, {"time": 20}, [kept])

    opened = open

    def full(*given, **options):
        if given[1:] == ("rb",):
            return opened(*given, **options)
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        if broken == "write":
            patched.setattr("builtins.open", full)
        else:
            patched.setattr(os, broken, full)
        with pytest.raises(OSError, match="No space left"):
            written(store, 20, 30)
        with pytest.raises(OSError, match="No space left"):
            store.commit({}, {"time": 30})
    with xarray.open_zarr(store.path, chunks=None) as found:
        assert np.array_equal(found["x"], X[:20])
    assert np.array_equal(read_kept(store.path, kept)["momenta"], X[:20])
    assert not list(store.path.rglob("*.writing"))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "is no archive of a run, or its zarr.json is damaged"),
        (b"[1]", "is no archive of a run"),
        (b'{"attributes": {}, "consolidated_metadata": {"metadata": {}}}', "is no archive of a run"),
        (
            b'{"attributes": {"archive_format": 2}, "consolidated_metadata": {"metadata": {}}}',
            "of format 2, and this version of coadjoint reads formats up to 1; install a later version",
        ),
        (
            b'{"attributes": {"archive_format": "1"}, "consolidated_metadata": {"metadata": {}}}',
            "archive_format is '1'",
        ),
        (
            b'{"attributes": {"archive_format": 1}, "consolidated_metadata": {"metadata": {"x": {}}}}',
            "the arrays in zarr.json are damaged",
        ),
    ],
)
def test_what_is_no_archive_is_refused(tmp_path, content, message):
    (tmp_path / ROOT).write_bytes(content)
    with pytest.raises(ArchiveError, match=message):
        read_root(tmp_path)


def test_what_was_damaged_is_noticed(store):
    kept = written(store, 0, 20)
    store.commit({}, {"time": 20}, [kept])
    for file, read in (
        (store.path / "x" / "c.0.1", lambda: read_array(store.path, "x", store.arrays["x"])),
        (store.path / ".coadjoint" / kept.file, lambda: read_kept(store.path, kept)),
    ):
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
        with pytest.raises(ArchiveError, match="its check sum does not match"):
            read()


def test_regions_of_members_are_written_by_themselves(tmp_path):
    """As several processes would: each writes chunks of its own, and one commits."""
    grid = {"x": StoredArray(("time", "member"), "float64", (0, 7), (4, 3), {})}
    store, values = ArchiveStore.begun(tmp_path / "run.zarr", grid), np.arange(42.0).reshape(6, 7)
    for first in (6, 0, 3):
        store.write("x", values[:, first : first + 3], (0, first))
    store.commit({}, {"time": 6})
    store.close()
    with xarray.open_zarr(store.path, chunks=None) as found:
        assert np.array_equal(found["x"], values)
    assert json.loads((store.path / ROOT).read_text())["consolidated_metadata"]["metadata"]["x"]["shape"] == [6, 7]
