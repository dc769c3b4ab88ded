"""Temporary folders of results: permissions, locks, removal of leftovers, and restored stores."""

import contextlib
import errno
import fcntl
import os
import stat
from pathlib import Path

import pytest

from coadjoint import interruption
from coadjoint.files.output import atomic_output as unfinished
from coadjoint.files.output.atomic_output import (
    LOCK_FILE,
    REPLACED_FOLDER,
    PendingOutput,
    open_locked,
    remove_leftovers,
)
from guards import open_descriptors

OTHER_USER = 65534


def leftover(target, *, ending="0123abcd", lock=True, replaced=False):
    """Create a leftover of a killed run, with the store that it was replacing."""
    folder = target.parent / f"{unfinished._prefix(target)}{ending}"
    folder.mkdir()
    (folder / target.name).write_text("half")
    if lock:
        (folder / LOCK_FILE).touch()
    if replaced:
        (folder / REPLACED_FOLDER).mkdir()
        (folder / REPLACED_FOLDER / "old").touch()
    return folder


def write_whole(target):
    with PendingOutput(target) as own:
        own.path.write_text("whole")
        own.finish()


def raising(number):
    def fail(*args, **options):
        raise OSError(number, os.strerror(number))

    return fail


@pytest.fixture
def target(tmp_path):
    """The path of a result; descriptors and cleanups are released at the end."""
    before, registered = open_descriptors(), list(interruption.cleanups)
    yield tmp_path / "run.nc"
    assert open_descriptors() == before and interruption.cleanups == registered


@pytest.mark.parametrize("mask", [0, 0o022])
def test_temporary_folder_is_private(target, mask):
    old = os.umask(mask)
    try:
        with PendingOutput(target) as own:
            assert stat.S_IMODE(own.path.parent.stat().st_mode) == 0o700
            assert stat.S_IMODE((own.path.parent / LOCK_FILE).stat().st_mode) == 0o600
    finally:
        os.umask(old)


@pytest.mark.parametrize("how", ["finished", "abandoned", "failed", "not created"])
def test_only_a_finished_result_is_left(tmp_path, target, how):
    registered = list(interruption.cleanups)
    with contextlib.suppress(KeyError, FileNotFoundError):
        with PendingOutput(target if how != "not created" else tmp_path / "none" / "run.nc") as own:
            assert interruption.cleanups == [*registered, own.abandon]
            own.path.write_text("whole")
            if how == "failed":
                raise KeyError
            own.finish() if how == "finished" else own.abandon()
    assert os.listdir(tmp_path) == ["run.nc"] * (how == "finished")


def test_only_unlocked_leftovers_of_the_name_are_removed(tmp_path, target):
    """The folder name contains the beginning of a long name, and its checksum."""
    alike = [tmp_path / f"{'a' * 40}{k}.nc" for k in range(2)]
    with PendingOutput(target) as own:
        left, begun = leftover(target), leftover(target, ending="1")
        others = [leftover(path) for path in (tmp_path / "run.zarr", alike[1])]
        (begun / LOCK_FILE).unlink()
        (begun / "run.nc").unlink()  # killed before it was locked
        beside = leftover(alike[0])
        for path in (target, alike[0]):
            remove_leftovers(path)
        assert not any(path.exists() for path in (left, begun, beside))
        assert own.path.parent.is_dir() and all(path.is_dir() for path in others)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")
@pytest.mark.parametrize("what", ["folder", "lock alone"])
def test_leftovers_of_other_users_remain(target, what):
    folder = leftover(target)
    os.chown(folder if what == "folder" else folder / LOCK_FILE, OTHER_USER, OTHER_USER)
    remove_leftovers(target)
    assert folder.exists() == (what == "folder")


def test_links_in_leftovers_are_not_followed(tmp_path, target):
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "kept").write_text("precious")
    folder = leftover(target)
    (folder / "inside").mkdir()
    places = {"folder": precious, "file": precious / "kept", "nothing": tmp_path / "none", "inside/link": precious}
    for name, to in places.items():
        (folder / name).symlink_to(to)
    remove_leftovers(target)
    assert os.listdir(tmp_path) == ["precious"] and (precious / "kept").read_text() == "precious"


def make_lock(lock, kind):
    """Make a lock that is no regular file."""
    lock.unlink(missing_ok=True)
    if kind == "link":
        (lock.parent / "kept").write_text("precious")
        lock.symlink_to(lock.parent / "kept")
    else:
        {"pipe": os.mkfifo, "folder": os.mkdir}[kind](lock)


@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
@pytest.mark.parametrize("create", [0, os.O_CREAT])
def test_lock_must_be_a_regular_file(tmp_path, target, kind, create):
    """Links are not followed and pipes not awaited."""
    make_lock(tmp_path / LOCK_FILE, kind)
    with pytest.raises(OSError) as refused:
        open_locked(tmp_path / LOCK_FILE, create)
    assert refused.value.errno == {"link": errno.ELOOP, "pipe": errno.EINVAL, "folder": errno.EISDIR}[kind]


def test_removed_lock_is_not_held(target, monkeypatch):
    """Otherwise two processes would hold locks of one name."""
    path, flock = target.with_name(LOCK_FILE), fcntl.flock

    def removed(descriptor, how):
        flock(descriptor, how)
        path.unlink()

    with monkeypatch.context() as patched:
        patched.setattr(fcntl, "flock", removed)
        assert open_locked(path, os.O_CREAT) is None
    held = open_locked(path, os.O_CREAT)
    assert held is not None and open_locked(path, os.O_CREAT) is None
    os.close(held)


def test_file_system_without_locks(target, monkeypatch):
    """Results are written there, and nothing counts as a leftover."""
    monkeypatch.setattr(fcntl, "flock", raising(errno.ENOLCK))
    folder = leftover(target)
    write_whole(target)
    remove_leftovers(target)
    assert target.read_text() == "whole" and (folder / "run.nc").exists()


@pytest.mark.parametrize("there", ["folder", "link to nothing", None])
def test_replaced_store_is_restored_to_a_free_path(tmp_path, target, there):
    leftover(target, replaced=True)
    if there == "folder":
        target.mkdir()
    elif there:
        target.symlink_to(tmp_path / "none")
    remove_leftovers(target)
    assert os.listdir(tmp_path) == ["run.nc"] and target.is_symlink() == (there == "link to nothing")
    assert there == "link to nothing" or os.listdir(target) == ["old"] * (there is None)


def test_lock_is_removed_last(target, monkeypatch):
    """An interrupted removal leaves a recognizable leftover."""
    folder, removed, unlink = leftover(target), [], Path.unlink
    for name in ("a", "z"):
        (folder / name).touch()
    monkeypatch.setattr(Path, "unlink", lambda self, **kwargs: (removed.append(self.name), unlink(self, **kwargs))[1])
    remove_leftovers(target)
    assert sorted(removed) == ["a", LOCK_FILE, "run.nc", "z"] and removed[-1] == LOCK_FILE
