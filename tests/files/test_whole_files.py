"""Atomic replacement of files: links are not followed, nothing is left behind, and content is synced first."""

import errno
import os
import stat
from pathlib import Path

import pytest

from coadjoint.files.output import atomic_output
from coadjoint.files.output.atomic_output import sync_to_disk, write_atomically

NEW, OLD = b"new" * 100, b"old"


@pytest.fixture(params=["path", "descriptor", "working folder"])
def target(request, tmp_path, monkeypatch):
    """Return a folder, and arguments of `write_atomically` for a file in it, for each way to name it."""
    folder = tmp_path / "folder"
    folder.mkdir()
    if request.param == "path":
        yield folder, lambda: (folder / "file", NEW)
    elif request.param == "working folder":
        monkeypatch.chdir(folder)
        yield folder, lambda: (Path("file"), NEW)
    else:
        descriptor = os.open(folder, os.O_RDONLY)
        yield folder, lambda: (Path("file"), NEW, descriptor)
        os.close(descriptor)


def precious(folder):
    """Create a file elsewhere."""
    path = folder.parent / "precious"
    path.write_bytes(b"precious")
    return path


THERE = {
    "nothing": lambda path: None,
    "file": lambda path: path.write_bytes(OLD),
    "longer file": lambda path: path.write_bytes(2 * NEW),
    "read-only file": lambda path: (path.write_bytes(OLD), path.chmod(0o400)),
    "link to a file": lambda path: path.symlink_to(precious(path.parent)),
    "hard link": lambda path: os.link(precious(path.parent), path),
    "link to nothing": lambda path: path.symlink_to("none"),
    "link to itself": lambda path: path.symlink_to(path.name),
    "pipe": os.mkfifo,
}


@pytest.mark.parametrize("there", THERE)
@pytest.mark.parametrize("name", ["file", ".file.writing"])
def test_existing_entries_are_replaced_not_followed(target, there, name):
    """The file itself, and a leftover of a killed process."""
    folder, arguments = target
    THERE[there](folder / name)
    old = os.umask(0o007)
    try:
        write_atomically(*arguments())
    finally:
        os.umask(old)
    found = os.lstat(folder / "file")
    assert stat.S_ISREG(found.st_mode) and stat.S_IMODE(found.st_mode) == 0o660 and found.st_nlink == 1
    assert os.listdir(folder) == ["file"] and (folder / "file").read_bytes() == NEW
    others = {path.name: path.read_bytes() for path in folder.parent.iterdir() if path.is_file()}
    assert set(others.values()) <= {b"precious"}


@pytest.mark.parametrize("before", [None, OLD])
@pytest.mark.parametrize("call", ["fsync", "replace", "open"])
@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()], ids=["full", "interrupted"])
def test_failed_write_changes_nothing(target, monkeypatch, call, error, before):
    folder, arguments = target
    if before is not None:
        (folder / "file").write_bytes(before)

    def failing(*arguments, **kwargs):
        raise error

    with monkeypatch.context() as patched, pytest.raises(type(error)) as raised:
        patched.setattr(os, call, failing)
        write_atomically(*arguments())
    assert raised.value is error
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == ({} if before is None else {"file": before})


def test_content_is_synced_before_it_is_named(target, monkeypatch):
    folder, arguments = target
    events, fsync, replace = [], os.fsync, os.replace

    def synced(descriptor):
        found = os.fstat(descriptor)
        events.append(("synced", found.st_size, os.path.samestat(found, os.stat(folder / ".file.writing"))))
        fsync(descriptor)

    def replaced(*names, **kwargs):
        events.append("named")
        replace(*names, **kwargs)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", replaced)
    write_atomically(*arguments())
    assert events == [("synced", len(NEW), True), "named"]


def test_missing_folder_is_not_created(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_atomically(tmp_path / "none" / "file", NEW)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("name", ["file", ".file.writing"])
def test_folder_at_the_file_path_remains(target, name):
    folder, arguments = target
    (folder / name).mkdir()
    (folder / name / "inside").write_bytes(OLD)
    with pytest.raises(OSError):
        write_atomically(*arguments())
    assert os.listdir(folder) == [name] and (folder / name / "inside").read_bytes() == OLD


UNKNOWN = [errno.EINVAL, errno.EBADF, errno.ENOTSUP, errno.ENOSYS]


@pytest.mark.parametrize("number", [*UNKNOWN, errno.EIO, errno.ENOSPC, errno.EDQUOT, errno.EROFS])
def test_unsupported_sync_of_folders_is_ignored(tmp_path, monkeypatch, number):
    """Errors of failing or full disks are raised."""
    synced, descriptor = [], os.open(tmp_path, os.O_RDONLY)
    try:
        with monkeypatch.context() as patched:
            patched.setattr(atomic_output.os, "fsync", synced.append)
            sync_to_disk(descriptor)
        assert synced == [descriptor]

        def failing(descriptor):
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(os, "fsync", failing)
        if number in UNKNOWN:
            sync_to_disk(descriptor)
        else:
            with pytest.raises(OSError) as raised:
                sync_to_disk(descriptor)
            assert raised.value.errno == number
    finally:
        os.close(descriptor)
