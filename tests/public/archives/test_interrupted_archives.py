"""Runs that are interrupted or killed, full disks and moved folders: committed data remain, and the run resumes."""

import errno
import itertools
import os
import shutil
import stat

import numpy as np
import pytest
from killed_runs import check_archive_prefix, killed
from storing import BODY, STEP, X, at_write, contents, raising

import coadjoint as co
from guards import FORKS
from long import long_between, long_beyond
from refusals import refused
from same_runs import check_same

FULL = "No space left on device"
MANY = np.multiply.outer(np.linspace(0.5, 1.0, 171), X)
RUN = (BODY, MANY, (0.0, 3200 * STEP), STEP, co.Splitting(order=2))
"""A run of four chunks of 4 MB."""


@pytest.fixture(scope="module")
def expected():
    return co.integrate(*RUN)


def begin(path):
    return co.integrate(*RUN[:2], (0.0, 2 * STEP), *RUN[3:], archive=path)


def go_on(path, **options):
    return co.resume(path, RUN[2][1], **options)


@FORKS
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked")
@pytest.mark.parametrize("seed", long_beyond(1, range(3)))
def test_killed_runs_resume(tmp_path, seed):
    """`make soak` repeats this with more seeds."""
    killed(seed, tmp_path)


def fails_from(count, call, patched):
    """Let a function of `os` fail from some call on, as on a full disk."""
    original, calls = getattr(os, call), itertools.count(1)

    def full(*args, **options):
        if next(calls) >= count:
            raise OSError(errno.ENOSPC, FULL)
        return original(*args, **options)

    patched.setattr(os, call, full)


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize("count", long_between(4, [1, 9, 20, 27, 28, 29, 33, 41, 42, 43, 50, 57, 70, 80, 90, 100, 104]))
def test_full_disk_at_any_write(tmp_path, no_fsync, expected, call, count):
    """One sentence, an archive up to its last commit or none, and the complete run later."""
    path, steps = tmp_path / "run.zarr", None
    with pytest.MonkeyPatch.context() as patched:
        fails_from(count, call, patched)
        try:
            begin(path)
            go_on(path)
        except OSError as unwritten:
            steps = co.open_archive(path).reached
            assert f"{path}: " in str(unwritten) and FULL in str(unwritten) and f"step {steps}" in str(unwritten)
        except ValueError as not_begun:
            assert str(not_begun).startswith(f"{path}: cannot be ") and FULL in str(not_begun)
    if not path.exists():
        assert steps is None and os.listdir(tmp_path) == []
        begin(path)
    elif steps and steps > 2:
        check_archive_prefix(path, expected)
    check_same(go_on(path), expected)
    assert not list(path.rglob("*.writing"))


@pytest.mark.parametrize(("number", "raised"), [(errno.ENOSPC, True), (errno.EIO, True), (errno.EINVAL, False)])
def test_errors_of_syncing_a_folder(tmp_path, monkeypatch, number, raised):
    """File systems that cannot sync folders are accepted; full or broken ones are not."""

    def failing_sync(descriptor):
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", failing_sync)
    if raised:
        with refused(ValueError, "cannot be created", os.strerror(number)):
            begin(tmp_path / "run.zarr")
    else:
        assert begin(tmp_path / "run.zarr").finished


def test_full_disk_before_a_run_is_extended(tmp_path):
    path = tmp_path / "run.zarr"
    before = begin(path)
    with at_write(lambda name: name.startswith("state-"), 1, raising(OSError(errno.ENOSPC, FULL))):
        with refused(ValueError, "cannot be written", FULL):
            go_on(path)
    check_same(co.open_archive(path), before)
    assert go_on(path).finished


def move(path):
    path.rename(path.with_name("aside"))


def exchange(path):
    move(path)
    path.with_name("other.zarr").rename(path)


@pytest.mark.parametrize("chunk", ["c.1.0", "c.3.0"])
@pytest.mark.parametrize("change", [move, exchange])
def test_folder_moved_during_the_run(tmp_path, no_fsync, expected, change, chunk):
    """The committed part is in the moved folder, the rest in the error; what has taken its place stays unchanged."""
    path = tmp_path / "run.zarr"
    begin(path)
    if change is exchange:
        co.integrate(BODY, X, (0.0, 1.0), STEP, archive=tmp_path / "other.zarr")
    before = contents(tmp_path / "other.zarr")
    with at_write(lambda name: name == chunk, 1, lambda: change(path), after=True):
        with refused(OSError, "run.zarr", "moved or replaced") as error:
            go_on(path)
    assert sorted(os.listdir(tmp_path)) == ["aside"] + ["run.zarr"] * (change is exchange)
    partial = error.value.partial
    assert len(partial.x) and np.array_equal(partial.x, expected.x[np.isin(expected.t, partial.t)])
    assert contents(path) == (before if change is exchange else {})
    check_same(co.resume(tmp_path / "aside"), expected)


def lock_again(path):
    (path / ".coadjoint" / "lock").unlink()
    (path / ".coadjoint" / "lock").touch()


@pytest.mark.parametrize("commit", [1, 2])
@pytest.mark.parametrize("disturb", [shutil.rmtree, lock_again])
def test_error_contains_unwritten_points(tmp_path, no_fsync, expected, disturb, commit):
    """The archive is removed or locked again during the run; computed points are not lost."""
    path = tmp_path / "run.zarr"
    begin(path)
    first_chunk = f"c.{commit}.0"
    with at_write(lambda name: name == first_chunk, 1, lambda: disturb(path)):
        with pytest.raises(OSError) as error:
            go_on(path)
    partial = error.value.partial
    assert len(partial.x) and np.array_equal(partial.x, expected.x[np.isin(expected.t, partial.t)])
    if path.exists():
        held = co.open_archive(path).x
        assert np.array_equal(np.concatenate([held, partial.x]), expected.x[: len(held) + len(partial.x)])
        check_same(co.resume(path), expected)


def test_second_writer_is_refused(tmp_path, no_fsync, expected):
    """The archive stays unchanged while the first process writes."""
    path, errors = tmp_path / "run.zarr", []
    begin(path)

    def write_too():
        before = contents(path)
        with refused(ValueError, "run.zarr", "another process") as error:
            co.resume(path)
        errors.append(error)
        assert contents(path) == before

    with at_write(lambda name: name == "c.1.0", 1, write_too):
        check_same(go_on(path), expected)
    assert errors


@pytest.mark.parametrize("members", [0, 6])
def test_interrupt_before_the_first_step_leaves_an_archive_that_is_free(tmp_path, members):
    """It comes when the archive has its name, and what was written beside it is removed."""
    path = tmp_path / "run.zarr"
    x0 = np.random.default_rng(5).standard_normal((members, 3)) if members else X
    run = co.integrate_ensemble if members else co.integrate
    with at_write(lambda name: name == "run.zarr", 1, raising(KeyboardInterrupt), after=True):
        with pytest.raises(KeyboardInterrupt):
            run(BODY, x0, (0, 5), 0.1, archive=path)
    assert os.listdir(tmp_path) == ["run.zarr"]
    check_same(co.resume(path), co.integrate(BODY, x0, (0, 5), 0.1))


@pytest.mark.parametrize("file", ["zarr.json", "c.2.0"])
def test_interrupt_in_a_commit(tmp_path, no_fsync, expected, file):
    """Before the metadata of the second piece, or the data of the third, is written."""
    path = tmp_path / "run.zarr"
    begin(path)
    with at_write(lambda name: name == file, 22 if file == "zarr.json" else 1, raising(KeyboardInterrupt)):
        with pytest.raises(KeyboardInterrupt) as interrupt:
            go_on(path)
    partial = interrupt.value.partial
    assert not partial.finished and 0 < partial.reached < 3200 and partial.reached == co.open_archive(path).reached
    check_archive_prefix(path, expected)
    check_same(co.resume(path), expected)


def test_an_energy_that_was_undefined_before_a_resumption_is_an_error(tmp_path):
    def energy(x, t):
        return np.nan if 0.95 < t < 1.05 else 0.5 * (x[0] ** 2 + x[1] ** 2 / 2 + x[2] ** 2 / 3)

    def gradient(x, t):
        return np.array([x[0], x[1] / 2, x[2] / 3])

    system = co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(energy, gradient))
    path, method = tmp_path / "run.zarr", co.GaussLegendre(2)
    with pytest.raises(co.IntegrationError) as whole:
        co.integrate(system, X, (0, 10), 0.1, method)
    co.integrate(system, X, (0, 0.5), 0.1, method, archive=path)
    assert not co.resume(path, 10.0, system=system, until=50).finished
    with pytest.raises(co.IntegrationError) as resumed:
        co.resume(path, system=system)
    assert (str(resumed.value), resumed.value.step) == (str(whole.value), whole.value.step)
