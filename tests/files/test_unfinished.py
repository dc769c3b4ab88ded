"""Hidden folders of results that are being written: who may see and remove them, and that nothing stays behind."""

import errno
import fcntl
import os
import stat
from pathlib import Path

import pytest

from coadjoint import interruption
from coadjoint.files import unfinished
from coadjoint.files.unfinished import LOCK, REPLACED, Unfinished, locked, remove_leftovers

STRANGER = 65534
AS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")


def open_descriptors():
    """Return the open descriptors of this process; none where the system does not list them."""
    return set(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").is_dir() else set()


def leftover(target, *, ending="0123abcd", lock=True):
    """Make what a killed run to this target has left."""
    folder = target.parent / f"{unfinished._prefix(target)}{ending}"
    folder.mkdir()
    (folder / target.name).write_text("half")
    if lock:
        (folder / LOCK).touch()
    return folder


@pytest.mark.parametrize("mask", [0, 0o022])
def test_nobody_else_sees_what_is_written(tmp_path, mask):
    old = os.umask(mask)
    try:
        with Unfinished(tmp_path / "run.nc") as own:
            assert stat.S_IMODE(own.place.parent.stat().st_mode) == 0o700
            assert stat.S_IMODE((own.place.parent / LOCK).stat().st_mode) == 0o600
    finally:
        os.umask(old)


@pytest.mark.parametrize("how", ["finished", "given up", "failed", "not made", "leftovers"])
def test_nothing_stays_open_or_registered(tmp_path, how):
    target, before, registered = tmp_path / "run.nc", open_descriptors(), list(interruption._unfinished)
    if how == "leftovers":
        leftover(target)
        remove_leftovers(target)
    elif how == "not made":
        with pytest.raises(FileNotFoundError), Unfinished(tmp_path / "none" / "run.nc"):
            pass
    elif how == "failed":
        with pytest.raises(KeyError), Unfinished(target) as own:
            own.place.write_text("half")
            raise KeyError
    else:
        with Unfinished(target) as own:
            assert interruption._unfinished == [*registered, own.give_up]
            own.place.write_text("whole")
            own.finish() if how == "finished" else own.give_up()
    assert open_descriptors() == before and interruption._unfinished == registered
    assert [path.name for path in tmp_path.iterdir()] == ["run.nc"] * (how == "finished")


def test_only_what_is_not_locked_is_removed(tmp_path):
    target = tmp_path / "run.nc"
    with Unfinished(target) as own:
        left, begun, other = leftover(target), leftover(target, ending="1"), leftover(tmp_path / "run.zarr")
        (begun / LOCK).unlink()
        (begun / "run.nc").unlink()  # killed before it was locked
        remove_leftovers(target)
        assert not left.exists() and not begun.exists()
        assert own.place.parent.is_dir() and other.is_dir()


def test_without_a_lock_only_an_empty_folder_is_removed(tmp_path):
    """Its process may be about to lock it."""
    folder = leftover(tmp_path / "run.nc", lock=False)
    remove_leftovers(tmp_path / "run.nc")
    assert (folder / "run.nc").read_text() == "half"


@AS_ROOT
@pytest.mark.parametrize("what", ["folder", "lock alone"])
def test_what_another_user_has_left_stays(tmp_path, what):
    folder = leftover(tmp_path / "run.nc")
    os.chown(folder if what == "folder" else folder / LOCK, STRANGER, STRANGER)
    remove_leftovers(tmp_path / "run.nc")
    assert folder.exists() == (what == "folder")


def test_links_in_what_was_left_are_removed_and_not_followed(tmp_path):
    target, precious = tmp_path / "run.zarr", tmp_path / "precious"
    precious.mkdir()
    (precious / "kept").write_text("dear")
    folder = leftover(target)
    for name, to in (("to folder", precious), ("to file", precious / "kept"), ("to nothing", tmp_path / "none")):
        (folder / name).symlink_to(to)
    (folder / "inside").mkdir()
    (folder / "inside" / "link").symlink_to(precious)
    remove_leftovers(target)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["precious"]
    assert (precious / "kept").read_text() == "dear"


@pytest.mark.parametrize("kind", ["link", "fifo", "folder"])
def test_a_lock_is_a_regular_file(tmp_path, kind):
    """A link is not followed, and nobody waits for a pipe; a folder with such a lock is left alone."""
    folder, before = leftover(tmp_path / "run.nc", lock=False), open_descriptors()
    if kind == "link":
        (tmp_path / "kept").write_text("dear")
        (folder / LOCK).symlink_to(tmp_path / "kept")
    elif kind == "fifo":
        os.mkfifo(folder / LOCK)
    else:
        (folder / LOCK).mkdir()
    for create in (0, os.O_CREAT):
        with pytest.raises(OSError) as refused:
            locked(folder / LOCK, create)
        assert refused.value.errno in {"link": (errno.ELOOP,), "fifo": (errno.EINVAL,), "folder": (errno.EISDIR,)}[kind]
    remove_leftovers(tmp_path / "run.nc")
    assert (folder / "run.nc").exists() and open_descriptors() == before


def test_a_lock_that_was_removed_meanwhile_is_not_held(tmp_path, monkeypatch):
    """Otherwise two processes would hold locks of one name."""
    place, flock, before = tmp_path / LOCK, fcntl.flock, open_descriptors()

    def removed(descriptor, how):
        flock(descriptor, how)
        place.unlink()

    with monkeypatch.context() as patched:
        patched.setattr(fcntl, "flock", removed)
        assert locked(place, os.O_CREAT) is None
    held = locked(place, os.O_CREAT)
    assert held is not None and locked(place, os.O_CREAT) is None
    os.close(held)
    assert open_descriptors() == before


def test_a_file_system_without_locks(tmp_path, monkeypatch):
    """Results are written there, and nothing is taken for a leftover."""

    def unknown(descriptor, how):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", unknown)
    target = tmp_path / "run.nc"
    folder = leftover(target)
    with Unfinished(target) as own:
        own.place.write_text("whole")
        own.finish()
    remove_leftovers(target)
    assert target.read_text() == "whole" and (folder / "run.nc").exists()


def test_a_replaced_store_comes_back_only_where_no_other_is(tmp_path):
    target = tmp_path / "run.zarr"
    for there in (True, False):
        folder = leftover(target)
        (folder / REPLACED).mkdir()
        (folder / REPLACED / "old").touch()
        if there:
            target.mkdir()
        remove_leftovers(target)
        assert [path.name for path in target.iterdir()] == ([] if there else ["old"]) and not folder.exists()
        if there:
            target.rmdir()


def test_a_lock_is_removed_last(tmp_path, monkeypatch):
    """What is left of a removal that is cut short is still recognized."""
    folder, removed = leftover(tmp_path / "run.nc"), []
    for name in ("a", "z"):
        (folder / name).touch()
    unlink = Path.unlink
    monkeypatch.setattr(Path, "unlink", lambda self, **more: (removed.append(self.name), unlink(self, **more))[1])
    remove_leftovers(tmp_path / "run.nc")
    assert sorted(removed) == ["a", LOCK, "run.nc", "z"] and removed[-1] == LOCK


@pytest.mark.parametrize("name", [b"\xff\xfe.nc", "é".encode() * 120 + b".nc", b"a b\n.nc"])
def test_any_name_of_a_file(tmp_path, name):
    target = tmp_path / os.fsdecode(name)
    with Unfinished(target) as own:
        own.place.write_text("whole")
        own.finish()
    leftover(target)
    remove_leftovers(target)
    assert os.listdir(os.fsencode(tmp_path)) == [name] and target.read_text() == "whole"
