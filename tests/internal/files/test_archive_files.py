"""Files of an archive: commits, concurrent readers, refusals, and the order of writes."""

import errno
import io
import json
import os
import stat
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import xarray

from coadjoint.files.archives.archive import Archive, read_root
from coadjoint.files.archives.folder import ArchiveError, ArchiveFolder
from coadjoint.files.archives.store import ArchiveStore
from coadjoint.files.archives.stored_arrays import METADATA_FILE, StoredArray, deserialize_numbers
from guards import open_descriptors
from refusals import refused

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
    found = ArchiveStore.create_archive(tmp_path / "run.zarr", arrays())
    found.write("component", ["e1", "é2", "e3"])
    found.write("failed", [True, False])
    found.write("tenth", np.arange(10))
    found.commit({"mood": "calm"}, {"time": 0}, [found.store_state({}, {"number": 0})])
    yield found
    found.close()


def written(store, first, last):
    store.write("x", X[first:last], (first,))
    store.write("time", T[first:last], (first,))
    return store.store_state({"momenta": X[:last]}, {"number": last})


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("consolidated", [True, False])
def test_xarray_reads_exactly_the_committed_part(store, consolidated):
    for first, last in ((0, 5), (5, 16), (16, 17), (17, 90), (90, 100)):
        stored = written(store, first, last)
        if consolidated:
            with xarray.open_zarr(store.path, chunks=None) as before:
                assert np.array_equal(before["x"], X[:first]) and np.array_equal(before["time"], T[:first])
        store.commit({"steps": last}, {"time": last}, [stored])
        with xarray.open_zarr(store.path, chunks=None, consolidated=consolidated) as found:
            assert np.array_equal(found["x"], X[:last]) and np.array_equal(found["time"], T[:last])
            assert found["x"].dims == ("time", "component") and found["x"].attrs == {"long_name": "momentum"}
            assert found["component"].values.tolist() == ["e1", "é2", "e3"]
            assert found["failed"].values.tolist() == [True, False] and found["tenth"].values.tolist() == list(
                range(10)
            )
            assert {name: found.attrs[name] for name in ("mood", "steps")} == {"mood": "calm", "steps": last}
        assert np.array_equal(store.read_state(stored)["momenta"], X[:last])


def test_readers_see_the_commit_of_their_root(store):
    store.commit({}, {"time": 20}, [written(store, 0, 20)])
    known = Archive.at(store.folder)
    known.check_extent()  # reads the checksums of this commit, as when an archive is opened
    store.commit({}, {"time": 50}, [written(store, 20, 50)])
    assert np.array_equal(known.read("x"), X[:20])
    assert known.read("component").tolist() == ["e1", "é2", "e3"]
    (store.path / "x" / "c.1.0").unlink()
    with refused(ArchiveError, "x/c.1.0"):
        known.read("x")
    part = [range(3, 15, 4), range(1, 3)]
    assert np.array_equal(known.read("x", part), X[3:15:4, 1:3])


def test_full_disk_leaves_the_last_commit(store, monkeypatch):
    """Public tests let the names and the syncs fail; here the files cannot be opened for writing."""
    stored, original = written(store, 0, 20), open
    store.commit({}, {"time": 20}, [stored])

    def full(*args, **options):
        if args[1:] == ("rb",):
            return original(*args, **options)
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("builtins.open", full)
        for write in (lambda: written(store, 20, 30), lambda: store.commit({}, {"time": 30}, [stored])):
            with pytest.raises(OSError, match="No space left"):
                write()
    known = Archive.at(store.folder)
    assert np.array_equal(known.read("x"), X[:20])
    assert np.array_equal(store.read_state(stored)["momenta"], X[:20])
    assert not list(store.path.rglob("*.writing"))


def test_only_committed_states_remain(store):
    stored = [store.store_state({"k": k}, {"number": k}) for k in range(4)]
    store.commit({}, {"time": 0}, [stored[1], stored[3]])
    files = {name for name in os.listdir(store.path / ".coadjoint") if name.startswith("state-")}
    assert files == {stored[1].file, stored[3].file}
    assert store.read_state(stored[3])["k"] == 3
    for one in (stored[0], stored[2]):
        with refused(ArchiveError, one.file, "missing"):
            store.read_state(one)


def test_length_of_chunks_is_limited(store):
    store.commit({}, {"time": 20}, [written(store, 0, 20)])
    most = store.arrays["x"].max_encoded_bytes
    (store.path / "x" / "c.0.0").write_bytes(bytes(most + 1))
    with refused(ArchiveError, most + 1, most):
        store.read("x")
    (store.path / "x" / "c.0.0").write_bytes(bytes(most))
    with refused(ArchiveError, "x/c.0.0 is damaged", "checksum"):
        store.read("x")


def test_archive_folder_reads_regular_files_only(tmp_path, monkeypatch):
    """Also the beginning of a file; files that do not fit into memory are refused."""
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "file").write_bytes(b"0123456789")
    os.mkfifo(tmp_path / "in" / "pipe")
    (tmp_path / "in" / "link").symlink_to("file")
    (tmp_path / "in" / "nowhere").symlink_to("none")
    before = open_descriptors()
    folder = ArchiveFolder(tmp_path)
    read = [folder.read("in", "file", **more) for more in ({}, {"head": 4}, {"head": 40}, {"max_bytes": 10})]
    assert read == [b"0123456789", b"0123", b"0123456789", b"0123456789"]
    for name, number in (("pipe", errno.EINVAL), ("link", errno.ELOOP), ("nowhere", errno.ELOOP)):
        with pytest.raises(OSError) as error:
            folder.read("in", name)
        assert error.value.errno == number
    with pytest.raises(OSError):
        folder.read("", "in")
    with refused(ValueError, 10, 9):
        folder.read("in", "file", max_bytes=9)
    with monkeypatch.context() as patched:
        patched.setattr("coadjoint.memory.UNCHECKED_BYTES", 0)
        patched.setattr("coadjoint.memory.available", lambda: 19)
        assert folder.read("in", "file", head=9) == b"012345678"
        with pytest.raises(ValueError, match="it needs about"):
            folder.read("in", "file")
    folder.remove("in", "link")
    folder.remove("in", "link")
    assert open_descriptors() == before


def test_archive_folder_follows_no_links(tmp_path, monkeypatch):
    """Also where the system cannot refuse them, as on Windows, which has no O_NOFOLLOW."""
    for name in ("in", "outside"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_bytes(b"0123456789")
    (tmp_path / "in" / "link").symlink_to(tmp_path / "outside" / "file")
    (tmp_path / "linked").symlink_to(tmp_path / "outside")
    monkeypatch.delattr(os, "O_NOFOLLOW", raising=False)
    before = open_descriptors()
    folder = ArchiveFolder(tmp_path)
    assert folder.read("in", "file", head=4) == b"0123"
    for place in (("in", "link"), ("linked", "file")):
        for read in (folder.read, partial(folder.read, head=4)):
            with pytest.raises(OSError) as error:
                read(*place)
            assert error.value.errno == errno.ELOOP
        with pytest.raises(OSError) as error:
            folder.lock(*place)
        assert error.value.errno == errno.ELOOP
    (tmp_path / "in" / "new").symlink_to(tmp_path / "outside" / "new")
    with pytest.raises(OSError):
        folder.lock("in", "new")
    assert not (tmp_path / "outside" / "new").exists()
    folder.write("in", "link", b"own")
    assert folder.read("in", "link") == b"own"
    assert (tmp_path / "outside" / "file").read_bytes() == b"0123456789"
    assert open_descriptors() == before


def test_archive_folder_follows_no_junctions(tmp_path, monkeypatch):
    """Junctions of Windows are folders with a tag."""
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "file").write_bytes(b"0123456789")
    monkeypatch.setattr(stat, "IO_REPARSE_TAG_MOUNT_POINT", 0xA0000003, raising=False)
    status, tags = os.stat, {tmp_path / "in": 0xA0000003}

    def tagged(path, **how):
        found = status(path, **how)
        return SimpleNamespace(st_mode=found.st_mode, st_reparse_tag=tags.get(path, 0))

    monkeypatch.setattr(os, "stat", tagged)
    folder = ArchiveFolder(tmp_path)
    with pytest.raises(OSError) as error:
        folder.read("in", "file")
    assert error.value.errno == errno.ELOOP
    tags.clear()
    assert folder.read("in", "file") == b"0123456789"


def test_leftovers_of_killed_processes_are_removed(store):
    """Temporary files of every folder go, others stay; lengths of arrays follow the root again."""
    store.commit({}, {"time": 10}, [written(store, 0, 10)])
    store.write("x", -X[10:30], (10,))
    (store.path / ".coadjoint" / "state-lost.npz").write_bytes(b"unknown")
    store.close()
    folders = ("", ".coadjoint", "x", "component")
    for folder in folders:
        for name in (".zarr.json.writing", ".c.0.writing", "own.writing", ".writing.txt"):
            (store.path / folder / name).write_bytes(b"half")
    metadata = store.path / "x" / METADATA_FILE
    metadata.write_text(metadata.read_text().replace("[10, 3]", "[0, 3]"))
    again = ArchiveStore.open_existing(store.path)
    assert json.loads(metadata.read_text())["shape"] == [10, 3]
    again.commit({}, {"time": 40}, [written(again, 10, 40)])
    again.close()
    known = Archive.at(store.folder)
    assert np.array_equal(known.read("x"), X[:40]), "chunks that were not committed"
    assert not (store.path / ".coadjoint" / "state-lost.npz").exists()
    for folder in folders:
        left = {name for name in os.listdir(store.path / folder) if "writing" in name}
        assert left == {"own.writing", ".writing.txt"}, folder


def test_commit_before_the_lock_is_seen(store, monkeypatch):
    """Another process commits and ends between reading the root and locking the archive."""
    lock = ArchiveFolder.lock

    def lock_after_commit(self, *args):
        monkeypatch.undo()
        store.commit({"steps": 10}, {"time": 10}, [written(store, 0, 10)])
        store.close()
        return lock(self, *args)

    monkeypatch.setattr(ArchiveFolder, "lock", lock_after_commit)
    again = ArchiveStore.open_existing(store.path)
    assert again.attributes["steps"] == 10 and again.arrays["x"].shape == (10, 3)
    again.close()


def test_descriptors_and_locks_are_released(store, tmp_path, monkeypatch):
    """Also if an archive cannot be opened, created or moved."""
    store.commit({}, {"time": 10}, [written(store, 0, 10)])
    store.close()
    before = open_descriptors()
    with monkeypatch.context() as patched, refused(ArchiveError, "written"):
        patched.setattr(ArchiveStore, "_write_arrays", lambda *args: (_ for _ in ()).throw(OSError(28, "full")))
        ArchiveStore.open_existing(store.path)
    with monkeypatch.context() as patched, pytest.raises(OSError, match="full"):
        patched.setattr(ArchiveFolder, "write", lambda *args: (_ for _ in ()).throw(OSError(28, "full")))
        ArchiveStore.create_archive(tmp_path / "other.zarr", arrays())
    moved = ArchiveStore.create_archive(tmp_path / "moved.zarr", arrays())
    with pytest.raises(OSError):
        moved.moved(store.path)
    with pytest.raises(ArchiveError):
        read_root(ArchiveFolder(tmp_path / "none.zarr"))
    assert open_descriptors() == before
    again = ArchiveStore.open_existing(store.path)
    again.moved(tmp_path / "there.zarr")
    again.commit({}, {"time": 20}, [written(again, 10, 20)])
    again.close()
    assert open_descriptors() == before and np.array_equal(Archive.at(again.folder).read("x"), X[:20])


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="descriptors are not listed")
def test_order_of_writes_in_a_commit(store, monkeypatch):
    """Files are synced before they are named; chunks and states are named before the root refers to them."""
    events, fsync, replace = [], os.fsync, os.replace

    def synced(descriptor):
        events.append(
            ("sync", os.path.relpath(os.readlink(f"/proc/self/fd/{descriptor}"), os.path.realpath(store.path)))
        )
        fsync(descriptor)

    def replaced(source, target, **folders):
        events.append(("name", os.path.relpath(os.path.realpath(target), os.path.realpath(store.path))))
        replace(source, target, **folders)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", replaced)
    stored = written(store, 0, 20)
    store.commit({}, {"time": 20}, [stored])
    root = events.index(("name", METADATA_FILE))
    named = [name for kind, name in events if kind == "name"]
    assert {f".coadjoint/{stored.file}", "x/c.0.0", "x/c.1.1", "time/c.1"} <= {
        n for k, n in events[:root] if k == "name"
    }
    for name in named:
        folder, _, file = name.rpartition("/")
        written_at = events.index(("sync", os.path.join(folder, f".{file}.writing")))
        assert written_at < events.index(("name", name)), name
        if events.index(("name", name)) < root:
            assert events.index(("name", name)) < events.index(("sync", folder)) < root, name
    assert events.index(("sync", ".")) > root


GOOD = StoredArray(("time", "component"), "float64", (7, 3), (8, 3), {})


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        *(({"dims": ("time",) * n, "shape": (1,) * n, "chunk": (1,) * n}, "dimensions") for n in (0, 9)),
        *(({"dims": ("time", name)}, "dimensions") for name in ("a b", 3)),
        *(({"shape": shape}, "shape") for shape in ((7,), (7, -1), (7, True), (7, 3.0), (7, 2**62 + 1))),
        *(({"chunk": chunk}, "chunk is") for chunk in ((8,), (0, 3), (8, 0))),
        *(({"chunk": chunk}, "too large") for chunk in ((8, 4), (2**16 + 1, 1))),
        ({"shape": (7, 2**10), "chunk": (2**9 + 1, 2**10)}, "too large"),
        ({"dims": ("row", "component"), "chunk": (8, 3)}, "too large"),
        ({}, None),
        ({"shape": (0, 3)}, None),
        ({"shape": (7, 0), "chunk": (8, 1)}, None),
        ({"chunk": (2**16, 3)}, None),
        ({"shape": (7, 2**20), "chunk": (1, 2**20)}, None),
        ({"dims": ("row",), "shape": (2**19,), "chunk": (2**19,)}, None),
        ({"shape": (7, 2**10), "chunk": (2**9, 2**10)}, None),
        ({"shape": (2**62, 3)}, None),
        ({"dims": tuple("abcdefgh"), "shape": (1,) * 8, "chunk": (1,) * 8}, None),
    ],
)
def test_shapes_of_arrays(changed, named):
    """What is written is accepted and comes back, and the rest is refused."""
    array = GOOD._replace(**changed)
    if named:
        with refused(ValueError, named):
            array.check()
    else:
        array.check()
        assert StoredArray.of_metadata(json.loads(json.dumps(array.metadata()))).metadata() == array.metadata()


def test_locks_that_cannot_be_opened_are_not_those_of_another_process(tmp_path, store):
    """None means that another process holds the lock; every other obstacle is an error of its own."""
    store.close()
    place, before = store.path / ".coadjoint" / "lock", open_descriptors()
    place.unlink()
    (tmp_path / "kept").write_text("precious")
    obstacles = {
        "Is a directory": place.mkdir,
        "the lock is no regular file": lambda: os.mkfifo(place),
        "a symbolic link": lambda: place.symlink_to(tmp_path / "kept"),
        "a symbolic link, which": lambda: place.symlink_to(tmp_path / "missing"),
        "Permission denied": place.touch,
        "Read-only file system": place.touch,
    }
    opened = os.open
    for reason, make in obstacles.items():
        make()
        number = {"Permission denied": errno.EACCES, "Read-only file system": errno.EROFS}.get(reason)

        def refuse(path, flags, *given, number=number, **folder):
            if number and os.fspath(path).endswith("lock"):
                raise OSError(number, os.strerror(number))
            return opened(path, flags, *given, **folder)

        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(os, "open", refuse)
            with pytest.raises(OSError, match=reason):
                ArchiveFolder(store.path).lock(".coadjoint", "lock")
            with pytest.raises(ArchiveError, match=rf"cannot be written \(.*{reason}.*its content is unchanged"):
                ArchiveStore.open_existing(store.path)
        place.rmdir() if place.is_dir() else place.unlink()
    assert open_descriptors() == before and (tmp_path / "kept").read_text() == "precious"
    assert sorted(os.listdir(tmp_path)) == ["kept", "run.zarr"]
    ArchiveStore.open_existing(store.path).close()


@pytest.mark.parametrize(("axes", "accepted"), [(8, True), (9, False)])
def test_stored_numbers_have_not_too_many_axes(axes, accepted):
    content = io.BytesIO()
    np.savez(content, x=np.zeros((1,) * axes))
    if accepted:
        assert deserialize_numbers(content.getvalue())["x"].ndim == axes
    else:
        with pytest.raises(ValueError, match="numbers"):
            deserialize_numbers(content.getvalue())
