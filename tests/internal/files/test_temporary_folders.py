"""Temporary folders of results: permissions, locks, removal of leftovers, and restored stores."""

import contextlib
import errno
import fcntl
import os
import shutil
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
AS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")


def leftover(target, *, ending="0123abcd", lock=True):
    """Create a leftover of a killed run."""
    folder = target.parent / f"{unfinished._prefix(target)}{ending}"
    folder.mkdir()
    (folder / target.name).write_text("half")
    if lock:
        (folder / LOCK_FILE).touch()
    return folder


@pytest.mark.parametrize("mask", [0, 0o022])
def test_temporary_folder_is_private(tmp_path, mask):
    old = os.umask(mask)
    try:
        with PendingOutput(tmp_path / "run.nc") as own:
            assert stat.S_IMODE(own.path.parent.stat().st_mode) == 0o700
            assert stat.S_IMODE((own.path.parent / LOCK_FILE).stat().st_mode) == 0o600
    finally:
        os.umask(old)


@pytest.mark.parametrize("how", ["finished", "abandoned", "failed", "not created", "leftovers"])
def test_descriptors_and_cleanups_are_released(tmp_path, how):
    target, before, registered = tmp_path / "run.nc", open_descriptors(), list(interruption._cleanups)
    if how == "leftovers":
        leftover(target)
        remove_leftovers(target)
    elif how == "not created":
        with pytest.raises(FileNotFoundError), PendingOutput(tmp_path / "none" / "run.nc"):
            pass
    elif how == "failed":
        with pytest.raises(KeyError), PendingOutput(target) as own:
            own.path.write_text("half")
            raise KeyError
    else:
        with PendingOutput(target) as own:
            assert interruption._cleanups == [*registered, own.abandon]
            own.path.write_text("whole")
            own.finish() if how == "finished" else own.abandon()
    assert open_descriptors() == before and interruption._cleanups == registered
    assert [path.name for path in tmp_path.iterdir()] == ["run.nc"] * (how == "finished")


def test_only_unlocked_leftovers_are_removed(tmp_path):
    """The folder name contains the beginning of a long name, and its checksum."""
    target, similar = (tmp_path / f"{'a' * 40}{k}.nc" for k in range(2))
    with PendingOutput(target) as own:
        left, begun = leftover(target), leftover(target, ending="1")
        others = [leftover(similar), leftover(target.with_suffix(".zarr"))]
        (begun / LOCK_FILE).unlink()
        (begun / target.name).unlink()  # killed before it was locked
        remove_leftovers(target)
        assert not left.exists() and not begun.exists()
        assert own.path.parent.is_dir() and all(other.is_dir() for other in others)


def test_folder_without_a_lock_remains_if_not_empty(tmp_path):
    """Its process may be about to lock it."""
    folder = leftover(tmp_path / "run.nc", lock=False)
    remove_leftovers(tmp_path / "run.nc")
    assert (folder / "run.nc").read_text() == "half"


@AS_ROOT
@pytest.mark.parametrize("what", ["folder", "lock alone"])
def test_leftovers_of_other_users_remain(tmp_path, what):
    folder = leftover(tmp_path / "run.nc")
    os.chown(folder if what == "folder" else folder / LOCK_FILE, OTHER_USER, OTHER_USER)
    remove_leftovers(tmp_path / "run.nc")
    assert folder.exists() == (what == "folder")


def test_links_in_leftovers_are_not_followed(tmp_path):
    target, precious = tmp_path / "run.zarr", tmp_path / "precious"
    precious.mkdir()
    (precious / "kept").write_text("precious")
    folder = leftover(target)
    for name, to in (("to folder", precious), ("to file", precious / "kept"), ("to nothing", tmp_path / "none")):
        (folder / name).symlink_to(to)
    (folder / "inside").mkdir()
    (folder / "inside" / "link").symlink_to(precious)
    remove_leftovers(target)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["precious"]
    assert (precious / "kept").read_text() == "precious"


@pytest.mark.parametrize("kind", ["link", "fifo", "folder"])
def test_lock_must_be_a_regular_file(tmp_path, kind):
    """Links are not followed and pipes not awaited; a folder with such a lock remains."""
    folder, before = leftover(tmp_path / "run.nc", lock=False), open_descriptors()
    if kind == "link":
        (tmp_path / "kept").write_text("precious")
        (folder / LOCK_FILE).symlink_to(tmp_path / "kept")
    elif kind == "fifo":
        os.mkfifo(folder / LOCK_FILE)
    else:
        (folder / LOCK_FILE).mkdir()
    for create in (0, os.O_CREAT):
        with pytest.raises(OSError) as refused:
            open_locked(folder / LOCK_FILE, create)
        assert refused.value.errno in {"link": (errno.ELOOP,), "fifo": (errno.EINVAL,), "folder": (errno.EISDIR,)}[kind]
    remove_leftovers(tmp_path / "run.nc")
    assert (folder / "run.nc").exists() and open_descriptors() == before


def test_removed_lock_is_not_held(tmp_path, monkeypatch):
    """Otherwise two processes would hold locks of one name."""
    path, flock, before = tmp_path / LOCK_FILE, fcntl.flock, open_descriptors()

    def removed(descriptor, how):
        flock(descriptor, how)
        path.unlink()

    with monkeypatch.context() as patched:
        patched.setattr(fcntl, "flock", removed)
        assert open_locked(path, os.O_CREAT) is None
    held = open_locked(path, os.O_CREAT)
    assert held is not None and open_locked(path, os.O_CREAT) is None
    os.close(held)
    assert open_descriptors() == before


def test_file_system_without_locks(tmp_path, monkeypatch):
    """Results are written there, and nothing counts as a leftover."""
    before = open_descriptors()

    def unknown(descriptor, how):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", unknown)
    target = tmp_path / "run.nc"
    folder = leftover(target)
    with PendingOutput(target) as own:
        own.path.write_text("whole")
        own.finish()
    remove_leftovers(target)
    assert target.read_text() == "whole" and (folder / "run.nc").exists() and open_descriptors() == before


def test_replaced_store_is_restored_to_a_free_path(tmp_path):
    target = tmp_path / "run.zarr"
    for there in ("folder", "link to nothing", None):
        folder = leftover(target)
        (folder / REPLACED_FOLDER).mkdir()
        (folder / REPLACED_FOLDER / "old").touch()
        if there == "folder":
            target.mkdir()
        elif there:
            target.symlink_to(tmp_path / "none")
        remove_leftovers(target)
        assert os.listdir(tmp_path) == ["run.zarr"] and target.is_symlink() == (there == "link to nothing")
        if there == "folder":
            target.rmdir()
        elif there:
            target.unlink()
    assert os.listdir(target) == ["old"]


@pytest.mark.parametrize("by", ["the run", "the next one"])
def test_unrestorable_store_is_restored_later(tmp_path, monkeypatch, by):
    """Neither old nor new content is at the target then; the old one is found and restored later."""
    target, replace = tmp_path / "run.zarr", os.replace
    target.mkdir()
    (target / "old").write_text("precious")

    def full(source, place):
        if Path(place) == target:
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, place)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", full)
        if by == "the run":
            with pytest.raises(OSError, match="No space left"), PendingOutput(target) as own:
                own.path.mkdir()
                own.finish()
        else:
            (leftover(target) / REPLACED_FOLDER).mkdir()
            target.rename(next(tmp_path.glob(".*")) / REPLACED_FOLDER)
        remove_leftovers(target)
        assert not target.exists()
    remove_leftovers(target)
    assert os.listdir(tmp_path) == ["run.zarr"] and (target / "old").read_text() == "precious"


def obstruct(folder, kind, monkeypatch):
    """Change a leftover so that it is not removed."""
    if kind in ("pipe", "link", "folder"):
        (folder / LOCK_FILE).unlink()
        {"pipe": os.mkfifo, "link": lambda lock: lock.symlink_to(folder / "run.zarr"), "folder": os.mkdir}[kind](
            folder / LOCK_FILE
        )
    elif kind == "without a lock":
        (folder / LOCK_FILE).unlink()
    elif kind == "file":
        shutil.rmtree(folder)
        folder.write_text("precious")
    elif kind == "file in use":
        unlink = Path.unlink

        def busy(path, **kwargs):
            if path.parent == folder:
                raise OSError(errno.EBUSY, "Device or resource busy")
            unlink(path, **kwargs)

        monkeypatch.setattr(Path, "unlink", busy)
    elif kind == "folder in use":
        rmtree = shutil.rmtree
        (folder / "inside").mkdir()
        monkeypatch.setattr(shutil, "rmtree", lambda path, **kwargs: None if path.parent == folder else rmtree(path))


OBSTACLES = ["pipe", "link", "folder", "without a lock", "file", "file in use", "folder in use", "gone", "running"]


@pytest.mark.parametrize("kind", OBSTACLES)
@pytest.mark.parametrize("at", [0, 2, 4])
def test_undeletable_leftover_does_not_block_the_others(tmp_path, monkeypatch, kind, at):
    """In any order of the listing; a replaced store is restored from any of them."""
    target, scandir, before = tmp_path / "run.zarr", os.scandir, open_descriptors()
    folders = [leftover(target, ending=str(k)) for k in range(5)]
    one, last = folders[at], folders[-1 if at < 4 else 0]
    (last / REPLACED_FOLDER).mkdir()
    (last / REPLACED_FOLDER / "old").touch()
    held = open_locked(one / LOCK_FILE) if kind == "running" else None

    def in_order(place):
        with scandir(place) as entries:
            found = sorted(entries, key=lambda entry: entry.name)
        if kind == "gone" and place == tmp_path and one.exists():
            for name in os.listdir(one):
                os.unlink(one / name)
            os.rmdir(one)
        return contextlib.nullcontext(found)

    with monkeypatch.context() as patched:
        obstruct(one, kind, patched)
        with monkeypatch.context() as listed:
            listed.setattr("coadjoint.files.output.atomic_output.os.scandir", in_order)
            remove_leftovers(target)
    left = [] if kind == "gone" else [one.name]
    assert sorted(os.listdir(tmp_path)) == [*left, "run.zarr"] and os.listdir(target) == ["old"]
    if held is not None:
        os.close(held)
    assert open_descriptors() == before
    remove_leftovers(target)
    removable = kind in ("file in use", "folder in use", "gone", "running")
    assert one.exists() == (not removable), "recognized again without the obstacle"


@pytest.mark.parametrize("times", [1, 2])
def test_folder_taken_by_another_process_is_not_used(tmp_path, monkeypatch, times):
    """Another process saw it before it was locked; the next folder is used."""
    taken = []

    def lost(path, *args):
        if len(taken) < times:
            path.parent.rmdir()
            taken.append(path.parent)
            return None
        return open_locked(path, *args)

    monkeypatch.setattr(unfinished, "open_locked", lost)
    with PendingOutput(tmp_path / "run.nc") as own:
        folder = own.path.parent
        assert folder not in taken and os.listdir(tmp_path) == [folder.name] and open_locked(folder / LOCK_FILE) is None
    assert not os.listdir(tmp_path)


def test_failed_lock_leaves_nothing(tmp_path, monkeypatch):
    def many(path, *args):
        raise OSError(errno.EMFILE, "Too many open files")

    registered = list(interruption._cleanups)
    monkeypatch.setattr(unfinished, "open_locked", many)
    with pytest.raises(OSError, match="Too many open files"), PendingOutput(tmp_path / "run.nc"):
        pass
    assert not os.listdir(tmp_path) and interruption._cleanups == registered


def test_lock_is_removed_last(tmp_path, monkeypatch):
    """An interrupted removal leaves a recognizable leftover."""
    folder, removed = leftover(tmp_path / "run.nc"), []
    for name in ("a", "z"):
        (folder / name).touch()
    unlink = Path.unlink
    monkeypatch.setattr(Path, "unlink", lambda self, **kwargs: (removed.append(self.name), unlink(self, **kwargs))[1])
    remove_leftovers(tmp_path / "run.nc")
    assert sorted(removed) == ["a", LOCK_FILE, "run.nc", "z"] and removed[-1] == LOCK_FILE


@pytest.mark.parametrize("name", [b"\xff\xfe.nc", "é".encode() * 120 + b".nc", b"a b\n.nc"])
def test_unusual_file_names(tmp_path, name):
    target = tmp_path / os.fsdecode(name)
    with PendingOutput(target) as own:
        own.path.write_text("whole")
        own.finish()
    leftover(target)
    remove_leftovers(target)
    assert os.listdir(os.fsencode(tmp_path)) == [name] and target.read_text() == "whole"


def test_failed_cleanup_does_not_hide_an_error(tmp_path, monkeypatch):
    """The folder becomes a leftover, which a later run removes."""
    target = tmp_path / "run.nc"

    def busy(path, **kwargs):
        raise OSError(errno.EBUSY, "Device or resource busy")

    with monkeypatch.context() as patched, pytest.raises(KeyError, match="first"), PendingOutput(target) as own:
        own.path.write_text("half")
        patched.setattr(Path, "unlink", busy)
        raise KeyError("first")
    assert len(os.listdir(tmp_path)) == 1
    remove_leftovers(target)
    assert not os.listdir(tmp_path)
