"""Results and archives where open files can be neither renamed nor removed, as on Windows; waits for readers."""

import errno
import os
import stat
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import xarray

import coadjoint as co
from coadjoint.files.archives.store import ArchiveStore
from coadjoint.files.output import atomic_output
from coadjoint.files.output.atomic_output import (
    IN_USE_WAITS,
    LOCK_FILE,
    PendingOutput,
    open_locked,
    remove_leftovers,
    write_atomically,
)
from coadjoint.files.output.output_files import write_dataset

pytestmark = pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="descriptors are not listed")
BODY, X0 = co.systems.rigid_body((1, 2, 3)), (1.0, 0.2, 0.1)


def open_files():
    """Paths of the regular files that this process has open."""
    found = set()
    for number in os.listdir("/proc/self/fd"):
        try:
            if stat.S_ISREG(os.fstat(int(number)).st_mode):
                found.add(os.readlink(f"/proc/self/fd/{number}"))
        except OSError:
            continue
    return found


@pytest.fixture
def windows(monkeypatch):
    """Refuse to rename folders with open files, and to replace or remove open files; count what was refused."""
    refused = []

    def refuse_open(path, dir_fd=None, below=True):
        start = os.getcwd() if dir_fd is None else os.readlink(f"/proc/self/fd/{dir_fd}")
        place = os.path.join(os.path.realpath(start), os.fspath(path))
        if any(name == place or (below and name.startswith(f"{place}{os.sep}")) for name in open_files()):
            refused.append(place)
            raise PermissionError(errno.EACCES, "The process cannot access the file", place)

    def renaming(original):
        def rename(source, target):
            refuse_open(source)
            refuse_open(target, below=False)
            original(source, target)

        return rename

    def removing(original):
        def remove(path, *, dir_fd=None):
            refuse_open(path, dir_fd, below=False)
            original(path, dir_fd=dir_fd)

        return remove

    monkeypatch.setattr(os, "replace", renaming(os.replace))
    monkeypatch.setattr(os, "rename", renaming(os.rename))
    monkeypatch.setattr(os, "unlink", removing(os.unlink))
    monkeypatch.setattr(os, "remove", removing(os.remove))
    return refused


def test_refusals_are_those_of_windows(tmp_path, windows):
    """The simulation itself: a locked file is not removed, and its folder not renamed, until it is closed."""
    (tmp_path / "run").mkdir()
    lock = open_locked(tmp_path / "run" / LOCK_FILE, os.O_CREAT)
    for act in (
        lambda: os.unlink(tmp_path / "run" / LOCK_FILE),
        lambda: os.rename(tmp_path / "run", tmp_path / "moved"),
    ):
        with pytest.raises(PermissionError):
            act()
    os.close(lock)
    os.rename(tmp_path / "run", tmp_path / "moved")
    (tmp_path / "moved" / LOCK_FILE).unlink()
    assert len(windows) == 2


def test_archives_are_written_and_resumed(tmp_path, windows):
    path = tmp_path / "run.zarr"
    whole = co.integrate(BODY, X0, (0, 20), 0.125)
    co.integrate(BODY, X0, (0, 10), 0.125, archive=path)
    np.testing.assert_array_equal(co.resume(path, 20.0).x, whole.x)
    members = np.outer(np.linspace(1.0, 2.0, 7), X0)
    found = co.integrate_ensemble(BODY, members, (0, 2), 0.125, archive=tmp_path / "ensemble.zarr", members_per_block=3)
    np.testing.assert_array_equal(found.x, co.integrate(BODY, members, (0, 2), 0.125).x)
    assert sorted(os.listdir(tmp_path)) == ["ensemble.zarr", "run.zarr"] and not windows


@pytest.mark.parametrize("name", ["run.nc", "run.zarr"])
def test_datasets_are_replaced(tmp_path, windows, name):
    for value in (1.0, 2.0):
        write_dataset(xarray.Dataset({"x": ("time", [value])}), tmp_path / name)
    left = tmp_path / f"{atomic_output._prefix(tmp_path / name)}0123abcd"
    left.mkdir()
    (left / LOCK_FILE).touch()
    remove_leftovers(tmp_path / name)
    with xarray.open_dataset(tmp_path / name, engine={".nc": "h5netcdf", ".zarr": "zarr"}[Path(name).suffix]) as found:
        assert found["x"].values == [2.0]
    assert os.listdir(tmp_path) == [name] and not windows


def test_moved_archive_is_locked_again(tmp_path, windows, monkeypatch):
    """And if another process has opened it before, this one does not write to it."""
    store = ArchiveStore.create_archive(tmp_path / "a.zarr", {})
    store.commit({}, {}, [store.store_state({"number": 1}, {})])
    store.moved(tmp_path / "b.zarr")
    lock = tmp_path / "b.zarr" / ".coadjoint" / LOCK_FILE
    assert open_locked(lock) is None
    rename = os.rename

    def taken(source, target):
        rename(source, target)
        taken.by = open_locked(Path(target) / ".coadjoint" / LOCK_FILE)

    with monkeypatch.context() as patched, pytest.raises(BlockingIOError, match="another process"):
        patched.setattr(os, "rename", taken)
        store.moved(tmp_path / "c.zarr")
    os.close(taken.by)
    again = ArchiveStore.open_existing(tmp_path / "c.zarr")
    again.close()
    assert not windows


def test_state_in_use_is_removed_later(tmp_path, windows):
    """By the next commit; the commit does not fail."""
    store = ArchiveStore.create_archive(tmp_path / "run.zarr", {})
    hidden = tmp_path / "run.zarr" / ".coadjoint"

    def states():
        return sorted(name for name in os.listdir(hidden) if name.startswith("state-"))

    first = store.store_state({"number": 1}, {})
    store.commit({}, {}, [first])
    with open(hidden / first.file, "rb"):
        second = store.store_state({"number": 2}, {})
        store.commit({}, {}, [second])
        assert states() == sorted([first.file, second.file]) and len(windows) == 1
    store.commit({}, {}, [second])
    assert states() == [second.file]
    store.close()


@pytest.mark.parametrize("times", [2, len(IN_USE_WAITS), len(IN_USE_WAITS) + 1])
def test_rename_is_tried_again_for_a_second(tmp_path, monkeypatch, times):
    """While a reader has the target open; after a second in all the old file stays, and nothing else."""
    path, output, replace, waits, tried = tmp_path / "file", tmp_path / "run.nc", os.replace, [], []
    path.write_bytes(b"old")

    def in_use(*arguments):
        tried.append(arguments)
        if len(tried) <= times:
            raise PermissionError(errno.EACCES, "The process cannot access the file")
        replace(*arguments)

    monkeypatch.setattr(os, "replace", in_use)
    monkeypatch.setattr(atomic_output.time, "sleep", waits.append)
    assert 0.5 < sum(IN_USE_WAITS) <= 1 and all(a < b for a, b in pairwise(IN_USE_WAITS))
    if times > len(IN_USE_WAITS):
        with pytest.raises(PermissionError, match="cannot access"):
            write_atomically(path, b"new")
        assert waits == list(IN_USE_WAITS)
        assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["file"]
        return
    write_atomically(path, b"new")
    with PendingOutput(output) as own:
        own.path.write_text("whole")
        tried.clear()
        own.finish()
    assert path.read_bytes() == b"new" and output.read_text() == "whole"
    assert waits == 2 * list(IN_USE_WAITS[:times])
