"""Blocks of an ensemble as tasks of a client: members, resubmission and errors.

The client here runs tasks immediately in this process; `test_workers.py` has real workers.
"""

import os
import platform
import re
import time
import warnings
from concurrent.futures import CancelledError
from types import SimpleNamespace

import numpy as np
import pytest
from distributed import Client

import coadjoint as co
from coadjoint.files.archives import dask_blocks as on_workers
from coadjoint.files.archives.archive import MemberBlock, blocks_of, read_root
from coadjoint.files.archives.archived_run import size_of_blocks
from coadjoint.files.archives.ensemble import BUSY, WorkerPool, read_worker_pool, run_block, run_in_blocks
from coadjoint.files.archives.folder import ArchiveError, ArchiveFolder
from coadjoint.files.archives.store import ArchiveStore, ArchiveUnwritten
from coadjoint.runs.prepared_run import PreparedRun
from guards import open_descriptors
from refusals import refused


def contents(folder):
    """Return the content of every file in a folder."""
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


BODY = co.systems.rigid_body(inertia=(1, 2, 3))
BATCH = co.batch([co.systems.rigid_body(inertia=(1, 2, 2 + 0.0625 * k)) for k in range(7)])
X = np.random.default_rng(3).standard_normal((7, 3))


class Task:
    def __init__(self, work, arguments, retries=0):
        self.status = "finished"
        try:
            self._result = work(*arguments)
        except Exception as error:
            if retries:
                self.__init__(work, arguments, retries - 1)
            else:
                self.status, self._error = "error", error

    def result(self, timeout):
        return self._result

    def exception(self):
        return self._error


class Inline:
    """A client that runs tasks when they are submitted; `before` may replace their results."""

    status, scheduler, task_type = "running", "a scheduler", Task

    def __init__(self, before=lambda block, tries: None):
        self.keys, self.threads, self.tries, self.before = [], [], [], before

    def scheduler_info(self, n_workers):
        return {"workers": {"first": None}}

    def submit(self, work, *args, key, pure, retries=0):
        if work is not run_block:
            return work(*args)
        self.keys.append(key)
        self.threads.append(args[-1])

        def task(archive, block, *more):
            self.tries.append(block.number)
            ended = self.before(block, self.tries.count(block.number))
            return work(archive, block, *more) if ended is None else ended

        return self.task_type(task, args, retries)


@pytest.fixture(autouse=True)
def immediate_tasks(monkeypatch):
    monkeypatch.setattr(on_workers, "_wait_for_tasks", lambda client, tasks: list(tasks))
    monkeypatch.setattr(on_workers, "RETRY_SECONDS", 0.0)
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


def ensemble(client, path, system=BODY, span=(0.0, 2.0), threads=None):
    ready = PreparedRun(system, co.Splitting(), 0.125)
    return run_in_blocks(ready, X, span, 1, path, WorkerPool(client, None, threads), size=3)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("system", [BODY, BATCH], ids=["one system", "batch"])
@pytest.mark.parametrize("span", [(0.0, 2.0), (7.5, 5.5)])
def test_blocks_have_their_own_members(tmp_path, system, span):
    client = Inline()
    found = ensemble(client, tmp_path / "many.zarr", system, span, threads=2)
    assert client.tries == [0, 1, 2] and len(set(client.keys)) == 3 and client.threads == [2, 2, 2]
    expected = co.integrate(system, X, span, 0.125, co.Splitting())
    np.testing.assert_array_equal(found.x, expected.x)
    np.testing.assert_array_equal(found.energy, expected.energy)


def test_busy_block_is_submitted_again(tmp_path):
    client = Inline(lambda block, tries: BUSY if block.number == 1 and tries < 3 else None)
    found = ensemble(client, tmp_path / "many.zarr")
    assert client.tries == [0, 1, 2, 1, 1] and len(set(client.keys)) == 5 and set(client.threads) == {1}
    assert found.finished and np.isfinite(found.x).all()


def lost(block, tries):
    raise RuntimeError(f"a worker is lost with block {block.number}")


def test_blocks_of_lost_workers_are_computed_again(tmp_path):
    """A limited number of times; the other blocks are computed in any case."""
    client = Inline(lambda block, tries: None if tries > block.number else lost(block, tries))
    found = ensemble(client, tmp_path / "many.zarr")
    assert client.tries == [0, 1, 1, 2, 2, 2] and found.finished
    client = Inline(lambda block, tries: lost(block, tries) if block.number < 2 else None)
    with refused(ArchiveUnwritten, "6 members", "workers", "block 0"):
        ensemble(client, tmp_path / "other.zarr")
    assert client.tries == [0] * (1 + on_workers.RETRIES) + [1] * (1 + on_workers.RETRIES) + [2]
    client = Inline()
    assert ensemble(client, tmp_path / "other.zarr").finished and client.tries == [0, 1]


@pytest.mark.parametrize("error", [ArchiveError, ArchiveUnwritten])
def test_archive_errors_of_workers_are_raised(tmp_path, error):
    def refused(block, tries):
        if block.number == 1:
            raise error("of the worker")

    client = Inline(refused)
    with pytest.raises(error, match="of the worker"):
        ensemble(client, tmp_path / "many.zarr")
    assert set(client.tries) == {0, 1, 2}


def test_a_lost_result_is_fetched_again(tmp_path):
    """The worker that has it is lost before it is fetched."""

    class Lost(Task):
        count = 0

        def result(self, timeout):
            Lost.count += 1
            if Lost.count == 2:
                raise TimeoutError
            return super().result(timeout)

    client = Inline()
    client.task_type = Lost
    assert ensemble(client, tmp_path / "many.zarr").finished and client.tries == [0, 1, 2, 1]


def test_closed_clients_are_named(tmp_path):
    """Before the call, and in the middle of it."""
    client = Inline()
    client.status = "closed"
    with refused(ValueError, "client is closed"):
        ensemble(client, tmp_path / "many.zarr")

    def closing(client, tasks):
        client.scheduler, client.status = None, "closed"
        raise CancelledError

    with pytest.MonkeyPatch.context() as patched, refused(OSError, "the client was closed", "next call"):
        patched.setattr(on_workers, "_wait_for_tasks", closing)
        ensemble(Inline(), tmp_path / "many.zarr")


def test_a_stopped_process_loses_its_block(tmp_path, monkeypatch):
    """Its lock is taken over after the time limit, and it writes nothing when it wakes up."""
    path = tmp_path / "many.zarr"
    co.integrate_ensemble(BODY, X, (0, 2), 0.125, archive=path, members_per_block=3)
    expected = contents(path)
    (path / ".coadjoint" / "block-000001").unlink()
    block, folder = MemberBlock(1, 3, 6), ArchiveFolder(path)
    stopped = ArchiveStore(folder, *read_root(folder), block.lock_file)
    run = stopped.attributes["archive_run"]
    assert stopped.lock()
    arguments = str(path), block, PreparedRun(BODY, None, 0.125), (), True, run, 1
    assert run_block(*arguments) == BUSY
    monkeypatch.setenv("COADJOINT_TIMEOUT", "0.05")
    time.sleep(0.1)
    assert run_block(*arguments)["archive_finished"]
    for write in (
        lambda: stopped.write("x", np.zeros((17, 3, 3)), (0, 3)),
        lambda: stopped.write_marker(block, {"rows": 0}, {}),
    ):
        with pytest.raises(OSError, match="its lock file was moved or replaced"):
            write()
    stopped.close()
    kept = contents(path)
    chunks = [name for name in expected if name.name.startswith("c.")]
    assert chunks and all(kept[name] == expected[name] for name in chunks)
    assert co.open_archive(path).status.tolist() == [1] * 7


def test_a_process_that_writes_keeps_its_block(tmp_path):
    """Whatever it writes renews the time of its lock, by which others see that it is alive; without writes it ages."""
    path = tmp_path / "many.zarr"
    co.integrate_ensemble(BODY, X, (0, 2), 0.125, archive=path, members_per_block=3)
    block, folder = MemberBlock(1, 3, 6), ArchiveFolder(path)
    working, other = (ArchiveStore(folder, *read_root(folder), block.lock_file) for _ in range(2))
    assert working.lock() and not other.lock()
    lock = path / ".coadjoint" / block.lock_file
    for write in (
        lambda: working.write("x", np.zeros((17, 3, 3)), (0, 3)),
        lambda: working.write_marker(block, {"rows": 0}, {}),
    ):
        os.utime(lock, (1e9, 1e9))
        write()
        assert not other.take_over(3600.0)
    os.utime(lock, (1e9, 1e9))
    assert other.take_over(3600.0)
    working.close(), other.close()


ENCRYPTED_OR_NEAR = ("tls://192.0.2.7:8786", "tcp://127.1.2.3:8786", "tcp://[::1]:8786", "tcp://localhost:8786",
    "inproc://192.0.2.7/1/1")  # fmt: skip
REMOTE = ("tcp://192.0.2.7:8786", "tcp://[2001:db8::7]:8786", "ucx://192.0.2.7:8786", "tcp://somewhere:8786",
    "tcp://localhost.somewhere:8786", "tcp://127.0.0.1.somewhere:8786")  # fmt: skip


@pytest.mark.parametrize("address", [*REMOTE, *ENCRYPTED_OR_NEAR])
def test_unencrypted_remote_client_warns(address):
    client = object.__new__(Client)
    client.scheduler, client.status = SimpleNamespace(address=address), "closed"
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("default")
        for _ in range(3):
            assert read_worker_pool(client, None, None).client is client
    assert [warning.category for warning in found] == [RuntimeWarning] * (address in REMOTE)
    assert all(address in str(warning.message) for warning in found)


def run_one_block(path, number=1):
    ready = PreparedRun(BODY, None, 0.125)
    return run_block(str(path), MemberBlock(number, 3 * number, min(3 * number + 3, 7)), ready, (), True, "", 1)


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


def test_block_sizes():
    sizes = {(1, 3, 1): 1, (7, 3, 4): 1, (10**6, 3, 2): 125024, (10**6, 9, 100): 2528}
    assert {arguments: size_of_blocks(*arguments) for arguments in sizes} == sizes
    assert size_of_blocks(10**6, 100, 1) == 2**22 // 800
    blocks = blocks_of(11, 4)
    assert [member for block in blocks for member in range(block.first, block.last)] == list(range(11))


def test_worker_count():
    class Cluster:
        def __init__(self, count):
            self.scheduler_info = lambda n_workers: {"workers": dict.fromkeys(range(count))}

    pools = (WorkerPool(), WorkerPool(None, 3), WorkerPool(Cluster(4)), WorkerPool(Cluster(0)))
    assert [pool.worker_count for pool in pools] == [1, 3, 4, 1]
