"""Atomic replacement of files: links are not followed, nothing is left behind, and content is synced first."""

import errno
import os
import stat
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from pathlib import Path

import numpy as np
import pytest
import xarray

from coadjoint.files.datasets.writers import MAX_CACHED_BYTES, PAGE_BYTES, DeferredErrorFile
from coadjoint.files.output import atomic_output
from coadjoint.files.output.atomic_output import PendingOutput, sync_to_disk, write_atomically
from coadjoint.files.output.output_files import OutputError, write_dataset

NEW, OLD = b"new" * 100, b"old"


@pytest.fixture(params=["path", "working folder"])
def target(request, tmp_path, monkeypatch):
    """Return a folder, and arguments of `write_atomically` for a file in it, for each way to name it."""
    folder = tmp_path / "folder"
    folder.mkdir()
    if request.param == "path":
        return folder, lambda: (folder / "file", NEW)
    monkeypatch.chdir(folder)
    return folder, lambda: (Path("file"), NEW)


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


@pytest.mark.thinned(6)
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
    """Errors of failing or full disks are raised; the folder is closed in any case."""
    synced = []
    with monkeypatch.context() as patched:
        patched.setattr(atomic_output.os, "fsync", lambda descriptor: synced.append(os.fstat(descriptor).st_ino))
        sync_to_disk(tmp_path)
    assert synced == [tmp_path.stat().st_ino]
    opened = os.listdir("/proc/self/fd")

    def failing(descriptor):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", failing)
    if number in UNKNOWN:
        sync_to_disk(tmp_path)
    else:
        with pytest.raises(OSError) as raised:
            sync_to_disk(tmp_path)
        assert raised.value.errno == number
    assert os.listdir("/proc/self/fd") == opened


# Datasets, and files whose writes fail.

SMALL = xarray.Dataset({"x": ("time", np.arange(3.0))}, {"time": [0.0, 1.0, 2.0]}, {"about": "three numbers"})


@contextmanager
def full(self):
    raise OSError("no space left on device")
    yield


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="open descriptors are not listed")
@pytest.mark.parametrize("name", ["run.nc", "run.zarr"])
def test_a_failed_dataset_leaves_the_old_one_and_no_descriptor(tmp_path, monkeypatch, name):
    engine = {".nc": "h5netcdf", ".zarr": "zarr"}[Path(name).suffix]
    write_dataset(SMALL, tmp_path / name)
    write_dataset(SMALL.rename(x="y"), tmp_path / name)
    before = len(os.listdir("/proc/self/fd"))
    with monkeypatch.context() as patched, pytest.raises(OutputError, match=rf"{name}: .*no space left"):
        patched.setattr(PendingOutput, "writing", full)
        write_dataset(SMALL, tmp_path / name)
    assert len(os.listdir("/proc/self/fd")) == before
    with xarray.open_dataset(tmp_path / name, engine=engine) as stored:
        assert list(stored) == ["y"]
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_deferred_error_file_reads_its_writes(tmp_path):
    rng = np.random.default_rng(1)
    wanted, broken = bytearray(), False

    @contextmanager
    def failing_from_the_middle_on():
        if broken:
            raise OSError("no space left")
        yield

    file = DeferredErrorFile(tmp_path / "image", failing_from_the_middle_on)
    for turn in range(200):
        broken = turn >= 100
        at, length = int(rng.integers(0, 4 * PAGE_BYTES)), int(rng.integers(1, 2 * PAGE_BYTES))
        piece = rng.bytes(length)
        wanted.extend(bytes(max(0, at + length - len(wanted))))
        wanted[at : at + length] = piece
        assert file.seek(at) == at and file.write(piece) == length and file.tell() == at + length
        assert file.seek(0, os.SEEK_END) == len(wanted)
        at = int(rng.integers(0, len(wanted)))
        file.seek(at)
        assert file.read(PAGE_BYTES) == wanted[at : at + PAGE_BYTES]
    file.seek(0)
    file.write(b"1" * (MAX_CACHED_BYTES + 1))  # dropped, so that memory is bounded
    assert file.seek(0) == 0 and file.read(len(wanted)) == wanted
    assert file.truncate(10) == 10 and file.seek(0) == 0 and file.read() == wanted[:10]
    with pytest.raises(OSError, match="no space left"):
        file.close()


def test_partial_reads_and_writes_are_continued(tmp_path, monkeypatch):
    real, large = (os.pwrite, os.pread), SMALL.assign(y=("point", np.arange(5000.0)))
    monkeypatch.setattr(os, "pwrite", lambda file, piece, at: real[0](file, piece[:1000], at))
    monkeypatch.setattr(os, "pread", lambda file, length, at: real[1](file, min(length, 700), at))
    write_dataset(large, tmp_path / "run.nc")
    monkeypatch.undo()
    with xarray.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as found:
        xarray.testing.assert_equal(found.load(), large)
    with DeferredErrorFile(tmp_path / "image", nullcontext) as file:
        monkeypatch.setattr(os, "pread", lambda file, length, at: real[1](file, min(length, 700), at))
        assert file.write(bytes(range(256)) * 10) == 2560 and file.seek(0) == 0
        assert file.read() == bytes(range(256)) * 10


def test_deferred_error_file_positions(tmp_path):
    with DeferredErrorFile(tmp_path / "image", nullcontext) as file:
        file.write(b"0123456789")
        assert file.seek(-3, os.SEEK_CUR) == 7 and file.read() == b"789" and file.tell() == 10
        assert file.seek(-4, os.SEEK_END) == 6 and file.read(2) == b"67"
        assert file.seek(1, os.SEEK_CUR) == 9 and file.seek(2) == 2 and file.truncate() == 2
        assert file.seek(0, os.SEEK_END) == 2 and file.truncate(4) == 4
        assert file.seek(0) == 0 and file.read() == b"01\0\0" and file.seek(9) == 9 and file.read() == b""
    assert (tmp_path / "image").read_bytes() == b"01\0\0"


def test_abandoned_output_is_not_written(tmp_path):
    with PendingOutput(tmp_path / "run.nc") as unfinished:
        unfinished.abandon()
        with pytest.raises(RuntimeError, match="abandoned"), unfinished.writing():
            pass
    assert list(tmp_path.iterdir()) == []


def test_abandoning_waits_for_the_current_write(tmp_path):
    with PendingOutput(tmp_path / "run.nc") as unfinished, ThreadPoolExecutor(1) as pool:
        begun, ended = threading.Event(), threading.Event()

        def write():
            with unfinished.writing():
                begun.set()
                # `abandon` must wait for this; a file created later would remain.
                assert not abandoned.wait(timeout=0.2)
                unfinished.path.write_text("a piece")
                ended.set()

        abandoned = threading.Event()
        written = pool.submit(write)
        assert begun.wait(timeout=60)
        unfinished.abandon()
        abandoned.set()
        assert ended.is_set() and written.exception(timeout=60) is None
    assert list(tmp_path.iterdir()) == []
