"""Archives of killed runs and full disks: committed data remain, and the run resumes."""

import errno
import itertools
import os
import re
import shutil
import stat
import subprocess
import sys

import numpy as np
import pytest
from killed_runs import check_archive_prefix, killed

import coadjoint as co
from coadjoint.files.archives.reading import ArchiveError
from coadjoint.files.archives.store import ArchiveUnwritten
from long import long_beyond

BODY, X = co.systems.rigid_body(inertia=(1, 2, 3)), (0.3, -1.0, 0.7)
RUN = (BODY, X, (0.0, 5.0), 0.125, co.GaussLegendre(2))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked")
@pytest.mark.parametrize("seed", long_beyond(1, range(3)))
def test_killed_runs_resume(tmp_path, seed):
    """`make soak` repeats this with more seeds."""
    killed(seed, tmp_path)


@pytest.fixture
def small_pieces(monkeypatch):
    monkeypatch.setattr("coadjoint.files.archives.archived_run.COMMIT_INTERVAL", 0)
    monkeypatch.setattr("coadjoint.files.archives.archived_run.COMMIT_RATIO", 0)
    monkeypatch.setattr("coadjoint.files.archives.archived_run.FIRST_ADVANCE", 10)
    monkeypatch.setattr("coadjoint.files.archives.archived_run.BLOCKS", 2)
    monkeypatch.setattr("coadjoint.files.archives.archived_run.ADVANCE_SECONDS", 0.0)
    monkeypatch.setattr("coadjoint.files.archives.stored_arrays.MIN_CHUNK_ROWS", 8)
    monkeypatch.setattr("coadjoint.files.archives.stored_arrays.MAX_CHUNK_ROWS", 8)


FULL = "No space left on device"


def fail_from(calls, original):
    """Return a function that fails from some call on, as on a full disk."""
    left = itertools.count(calls, -1)

    def full(*args, **options):
        if next(left) <= 1:
            raise OSError(errno.ENOSPC, FULL)
        return original(*args, **options)

    return full


@pytest.mark.long
@pytest.mark.parametrize("every", long_beyond(1, [3, 1]))
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_full_disk_at_any_write(tmp_path, monkeypatch, small_pieces, call, every):
    """At each write: one sentence, an archive up to its last commit, and the complete run later."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    run, original, reached, unmade = (BODY, X, (0.0, 2.0), 0.125, co.GaussLegendre(2)), getattr(os, call), set(), 0
    expected = co.integrate(*run)
    for calls in itertools.chain(range(1, 24, 4), range(24, 48, every), itertools.count(48, 7 * every)):
        path = tmp_path / f"run{calls}.zarr"
        try:
            with monkeypatch.context() as patched:
                patched.setattr(os, call, fail_from(calls, original))
                co.integrate(*run, archive=path)
            break
        except ArchiveError as refused:
            assert str(refused) == f"{path}: cannot be created ({FULL}); give another name"
            assert not list(tmp_path.glob(f"*run{calls}.zarr*"))
            unmade += 1
            continue
        except ArchiveUnwritten as unwritten:
            steps = co.open_archive(path).reached
            assert str(unwritten) == (
                f"{path}: the archive could not be written ({FULL}); it holds the run up to step {steps}, "
                "from which co.resume continues"
            )
        reached.add(steps)
        check_archive_prefix(path, expected)
        found = co.resume(path)
        assert np.array_equal(found.x, expected.x) and not list(path.rglob("*.writing"))
        assert np.array_equal(found.drift()["energy"].tenths, expected.drift()["energy"].tenths)
    assert unmade > 3 and calls > 80 and len(reached) > 5


@pytest.mark.parametrize(("number", "raised"), [(errno.ENOSPC, True), (errno.EIO, True), (errno.EINVAL, False)])
def test_errors_of_syncing_a_folder(tmp_path, monkeypatch, number, raised):
    """File systems that cannot sync folders are accepted; full or broken ones are not."""

    def failing_sync(descriptor):
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", failing_sync)
    if raised:
        with pytest.raises(ArchiveError, match=re.escape(f"cannot be created ({os.strerror(number)})")):
            co.integrate(*RUN, archive=tmp_path / "run.zarr")
    else:
        assert co.integrate(*RUN, archive=tmp_path / "run.zarr").finished


def test_full_disk_while_extending_a_run(tmp_path, monkeypatch):
    path = tmp_path / "run.zarr"
    co.integrate(*RUN, archive=path)
    with monkeypatch.context() as patched:
        patched.setattr("coadjoint.files.archives.extended_runs.ArchiveStore.store_state", fail_from(1, None))
        with pytest.raises(ArchiveError, match=re.escape(f"cannot be written ({FULL}); its content is unchanged")):
            co.resume(path, 10.0)
    assert co.open_archive(path).finished
    assert np.array_equal(co.resume(path, 10.0).x, co.integrate(BODY, X, (0.0, 10.0), *RUN[3:]).x)


SMALL_DISK = """
import os, sys
import numpy as np
import coadjoint as co
from coadjoint.files.archives import stored_arrays
from coadjoint.files.archives.store import ArchiveUnwritten

stored_arrays.MAX_CHUNK_ROWS = 1024  # points between commits
folder = sys.argv[1]
path, run = folder + "/run.zarr", (co.systems.rigid_body(), (0.3, -1.0, 0.7), (0.0, 6250.0), 0.125, co.GaussLegendre(2))
try:
    co.integrate(*run, archive=path)
except ArchiveUnwritten as unwritten:
    print(unwritten)
whole, found = co.integrate(*run), co.open_archive(path)
count = len(found.t)
assert 0 < found.reached < 50000 and np.array_equal(found.x, whole.x[:count])
for end in (None, 12500.0):
    try:
        co.resume(path, end)
    except ValueError as refused:
        print(refused)
assert os.system(f"mount -o remount,size=64m {folder}") == 0
assert np.array_equal(co.resume(path).x, whole.x)
print("whole")
"""
MOUNT = 'mount -t tmpfs -o size=1m none "$0"'


def can_mount(folder):
    return shutil.which("unshare") and not subprocess.run(["unshare", "-rm", "sh", "-c", MOUNT, folder]).returncode


@pytest.mark.long
def test_run_on_a_small_disk(tmp_path):
    """A file system of 1 MB: the run ends with one sentence, and resumes after more space is added."""
    if not can_mount(tmp_path):
        pytest.skip("file systems cannot be mounted here")
    command = ["unshare", "-rm", "sh", "-c", f'{MOUNT} && "$1" -c "$2" "$0"', tmp_path, sys.executable, SMALL_DISK]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    message, *refused, last = done.stdout.splitlines()
    assert f"could not be written ({FULL})" in message and last == "whole"
    assert refused == [f"{tmp_path}/run.zarr: cannot be written ({FULL}); its content is unchanged"] * 2


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("other", [False, True], ids=["moved", "replaced"])
def test_folder_moved_during_the_run(tmp_path, monkeypatch, small_pieces, other):
    """The computed part is in the moved folder; another archive in its place stays unchanged."""
    path, original = tmp_path / "run.zarr", os.replace
    if other:
        co.integrate(BODY, X, (0.0, 1.0), 0.125, archive=tmp_path / "other.zarr")
    before = contents(tmp_path / "other.zarr")

    def aside(source, target, **options):
        original(source, target, **options)
        if str(target) == "zarr.json" and path.exists() and not (tmp_path / "aside").exists():
            path.rename(tmp_path / "aside")
            if other:
                (tmp_path / "other.zarr").rename(path)

    monkeypatch.setattr(os, "replace", aside)
    with pytest.raises(ArchiveUnwritten, match=r"could not be written \(its folder was moved or replaced") as reported:
        co.integrate(*RUN, archive=path)
    assert sorted(os.listdir(tmp_path)) == ["aside"] + ["run.zarr"] * other
    assert reported.value.partial is None
    monkeypatch.undo()
    if other:
        assert contents(path) == before
    assert np.array_equal(co.resume(tmp_path / "aside").x, co.integrate(*RUN).x)


def test_error_contains_unwritten_points(tmp_path, monkeypatch, small_pieces):
    """The archive is removed or locked again during the run; computed points are not lost."""
    path, original, expected = tmp_path / "run.zarr", co.Solution.change, co.integrate(*RUN)

    def remove():
        shutil.rmtree(path)

    def lock_again():
        (path / ".coadjoint" / "lock").unlink()
        (path / ".coadjoint" / "lock").touch()

    for disturb in (remove, lock_again):
        pieces = itertools.count()

        def meanwhile(self, relative=True, disturb=disturb, pieces=pieces):
            if path.exists() and next(pieces) == 4:
                disturb()
            return original(self, relative)

        with monkeypatch.context() as patched:
            patched.setattr(co.Solution, "change", meanwhile)
            with pytest.raises(ArchiveUnwritten) as reported:
                co.integrate(*RUN, archive=path)
        held, partial = co.open_archive(path).x if path.exists() else expected.x[:0], reported.value.partial
        assert len(partial.x) and np.array_equal(partial.x, expected.x[np.isin(expected.t, partial.t)])
        assert not len(held) or np.array_equal(
            np.concatenate([held, partial.x]), expected.x[: len(held) + len(partial.x)]
        )
        shutil.rmtree(path, ignore_errors=True)


def test_second_writer_is_refused(tmp_path, monkeypatch):
    """The archive stays unchanged while the first process writes."""
    path, refusals = tmp_path / "run.zarr", []
    original = co.Solution.change

    def meanwhile(self, relative=True):
        if path.exists() and not refusals:
            refusals.append(pytest.raises(ArchiveError, match="another process is writing to this archive"))
            with refusals[0]:
                co.resume(path)
        return original(self, relative)

    monkeypatch.setattr(co.Solution, "change", meanwhile)
    found = co.integrate(*RUN, archive=path)
    assert refusals and np.array_equal(found.x, co.integrate(*RUN).x)
