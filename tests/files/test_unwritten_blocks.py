"""Ensemble blocks that cannot be written or read: named members, remaining data, and continuation."""

import errno
import os
import platform
import re
import shutil

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.archives import run_in_blocks as ensembles
from coadjoint.files.archives.archived_run import FINISHED
from coadjoint.files.archives.block_run import BlockRun, run_block
from coadjoint.files.archives.blocks import Block, lock_file, marker_file
from coadjoint.files.archives.folder import ArchiveFolder
from coadjoint.files.archives.reading import ArchiveError, read_root
from coadjoint.files.archives.store import ArchiveUnwritten
from coadjoint.runs.prepared_run import PreparedRun
from guards import open_descriptors

pytestmark = pytest.mark.usefixtures("no_fsync")

MEMBERS = 7
SPIRAL = co.systems.paper_a37()
FLUID = co.systems.torus_euler(N=3)
RUNS = {
    "a37": (SPIRAL, np.abs(np.random.default_rng(3).standard_normal((MEMBERS, 3))) + 0.1),
    "torus": (FLUID, np.stack([FLUID.random(seed, degrees=(1, 1)) for seed in range(MEMBERS)])),
}
SPAN = (7.5, 8.5)


def ensemble(path, name, size):
    system, x0 = RUNS[name]
    return co.ensemble(system, x0, SPAN, 0.125, archive=path, members_per_block=size)


def check_next_call(path, name, size):
    """Check that the next call has the bits of one run."""
    system, x0 = RUNS[name]
    expected = co.integrate(system, x0, SPAN, 0.125)
    np.testing.assert_array_equal(ensemble(path, name, size).x, expected.x)


ERRORS = {
    "full": (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
    "plain": (OSError("the disk is asleep"), "the disk is asleep"),
    "missing": (FileNotFoundError(errno.ENOENT, "No such file or directory", "c.0"), "No such file or directory"),
}


@pytest.mark.thinned(12)
@pytest.mark.parametrize(("size", "number"), [(1, 0), (1, 6), (2, 1), (3, 1), (3, 2), (4, 0), (7, 0)])
@pytest.mark.parametrize(("name", "error"), [("a37", "full"), ("torus", "plain"), ("a37", "missing")])
def test_members_of_an_unwritten_block_are_named(tmp_path, monkeypatch, size, number, name, error):
    """The archive lacks these and the later ones, which were not begun."""
    path, before, write = tmp_path / "many.zarr", open_descriptors(), ArchiveFolder.write
    raised, message = ERRORS[error]

    def full(self, folder, file, content):
        if file == marker_file(number):
            raise raised
        write(self, folder, file, content)

    with monkeypatch.context() as patched, pytest.raises(ArchiveUnwritten) as unwritten:
        patched.setattr(ArchiveFolder, "write", full)
        ensemble(path, name, size)
    members = np.arange(MEMBERS)[number * size :][:size]
    assert str(unwritten.value) == (
        f"{path}: members {members[0]} to {members[-1]} could not be written on {platform.node()} ({message}); "
        "the next call with this archive continues"
    )
    assert unwritten.value.__cause__ is raised and unwritten.value.partial is None
    assert not any((path / ".coadjoint" / marker_file(k)).exists() for k in range(number, MEMBERS))
    done = co.open_archive(path).status == 1
    assert done[: members[0]].all() and not done[members[-1] + 1 :].any()
    assert open_descriptors() == before
    check_next_call(path, name, size)


def moved(path):
    path.rename(path.with_name("aside"))


def replaced(path):
    moved(path)
    shutil.copytree(path.with_name("aside"), path)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("change", [moved, replaced, shutil.rmtree])
@pytest.mark.parametrize("blocks", [1, 2])
def test_archive_moved_between_blocks(tmp_path, monkeypatch, change, blocks):
    """Nothing is written to the new content of the path."""
    path, ran, before = tmp_path / "many.zarr", [], open_descriptors()

    def then(archive, *args):
        ran.append(run_block(archive, *args))
        if len(ran) == blocks:
            change(path)
        return ran[-1]

    monkeypatch.setattr(ensembles, "run_block", then)
    with pytest.raises(ArchiveUnwritten) as unwritten:
        ensemble(path, "a37", 3)
    assert re.match(f"{path}: .*moved or replaced.*not changed$", str(unwritten.value))
    assert len(ran) == blocks and open_descriptors() == before
    monkeypatch.undo()
    if change is not shutil.rmtree:
        check_next_call(tmp_path / "aside", "a37", 3)


def test_ensemble_that_cannot_be_marked_as_finished(tmp_path, monkeypatch):
    """All members are present, and the next call computes none."""
    path, before, write = tmp_path / "many.zarr", open_descriptors(), ArchiveFolder.write

    def full(self, folder, file, content):
        if (path / ".coadjoint" / marker_file(2)).exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, folder, file, content)

    with monkeypatch.context() as patched, pytest.raises(ArchiveUnwritten) as unwritten:
        patched.setattr(ArchiveFolder, "write", full)
        ensemble(path, "a37", 3)
    assert re.match(rf"{path}: .*\(No space left on device\); .*continues$", str(unwritten.value))
    assert open_descriptors() == before
    assert co.open_archive(path).status.tolist() == [1] * MEMBERS and read_root(path)[1][FINISHED] == 0
    monkeypatch.setattr(ensembles, "run_block", lambda *args: pytest.fail("a block is run again"))
    check_next_call(path, "a37", 3)
    assert read_root(path)[1][FINISHED] == 1


def run_one_block(path, number=1):
    ready = PreparedRun(RUNS["a37"][0], None, 0.125)
    return run_block(str(path), Block(number, 3 * number, min(3 * number + 3, MEMBERS)), ready, True, 1)


def begin(path, monkeypatch):
    """Begin an archive in three blocks without running any."""
    with monkeypatch.context() as patched, pytest.raises(ArchiveUnwritten, match="another process is still running"):
        patched.setattr(ensembles, "run_block", lambda *args: {"busy": True})
        ensemble(path, "a37", 3)


@pytest.mark.parametrize("case", ["no folder", "no archive", "file", "damaged"])
def test_archive_that_a_worker_cannot_read(tmp_path, case):
    """The error names the machine, since another one sees the folder."""
    path, before = tmp_path / "many.zarr", open_descriptors()
    if case == "file":
        path.touch()
    elif case != "no folder":
        path.mkdir()
    if case == "damaged":
        (path / "zarr.json").write_text("{")
    message = {"file": "is a file", "damaged": "is damaged"}.get(case, "there is no archive of a run")
    end = f" on the machine {platform.node()}; every worker must reach the folder by the same path"
    with pytest.raises(ArchiveError, match=rf"^{re.escape(str(path))}: .*{message}.*{re.escape(end)}$"):
        run_one_block(path)
    assert open_descriptors() == before and not (path / ".coadjoint").exists()


@pytest.mark.thinned(2)
@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize("how", ["missing", "damaged", "no right"])
def test_block_with_an_unreadable_initial_state(tmp_path, monkeypatch, number, how):
    """The file is named; other blocks run, and the lock is released."""
    path = tmp_path / "many.zarr"
    begin(path, monkeypatch)
    (file,) = (path / "x0").glob(f"*c.{number}.0")
    before, content = open_descriptors(), file.read_bytes()
    if how == "missing":
        file.unlink()
    elif how == "damaged":
        file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    else:
        file.unlink()
        file.mkdir()
    with pytest.raises(ArchiveError, match=rf"x0/{re.escape(file.name)} (is missing|cannot be read)"):
        run_one_block(path, number)
    assert open_descriptors() == before and not (path / ".coadjoint" / marker_file(number)).exists()
    assert run_one_block(path, (number + 1) % 3)[FINISHED] == 1
    if how == "no right":
        file.rmdir()
    file.write_bytes(content)
    assert run_one_block(path, number)[FINISHED] == 1
    check_next_call(path, "a37", 3)


@pytest.mark.parametrize("number", [0, 2])
def test_block_that_cannot_be_locked(tmp_path, monkeypatch, number):
    """A link in place of the lock is not followed; the members are named."""
    path = tmp_path / "many.zarr"
    begin(path, monkeypatch)
    before, lock = open_descriptors(), path / ".coadjoint" / lock_file(number)
    lock.symlink_to(tmp_path / "elsewhere")
    last = min(3 * number + 3, MEMBERS) - 1
    with pytest.raises(
        ArchiveUnwritten, match=f"members {3 * number} to {last} could not be written on .*symbolic link"
    ):
        run_one_block(path, number)
    assert open_descriptors() == before and os.listdir(tmp_path) == ["many.zarr"]
    lock.unlink()
    check_next_call(path, "a37", 3)


def test_archive_errors_are_not_wrapped(tmp_path, monkeypatch):
    path = tmp_path / "many.zarr"
    begin(path, monkeypatch)
    error = ArchiveUnwritten("first")

    def stopped(self, *args):
        raise error

    monkeypatch.setattr(BlockRun, "advance", stopped)
    with pytest.raises(ArchiveUnwritten) as raised:
        run_one_block(path)
    assert raised.value is error
