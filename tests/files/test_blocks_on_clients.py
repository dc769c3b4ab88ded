"""Blocks of an ensemble as tasks of a client: members, resubmission and errors.

The client here runs tasks immediately in this process; `test_clusters.py` has real workers.
"""

import os
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.archives import dask_blocks as on_workers
from coadjoint.files.archives.block_run import BUSY
from coadjoint.files.archives.reading import ArchiveError
from coadjoint.files.archives.run_in_blocks import WorkerPool, run_in_blocks
from coadjoint.files.archives.store import ArchiveUnwritten
from coadjoint.runs.prepared_run import PreparedRun

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
BATCH = co.batch([co.systems.rigid_body(inertia=(1, 2, 2 + 0.0625 * k)) for k in range(7)])
X = np.random.default_rng(3).standard_normal((7, 3))


class Task:
    def __init__(self, work, arguments):
        self.status = "finished"
        try:
            self._result = work(*arguments)
        except Exception as error:
            self.status, self._error = "error", error

    def result(self):
        return self._result

    def exception(self):
        return self._error


class Inline:
    """A client that runs tasks when they are submitted; `before` may replace their results."""

    status = "running"

    def __init__(self, before=lambda block, tries: None):
        self.keys, self.threads, self.tries, self.before = [], [], [], before

    def scheduler_info(self, n_workers):
        return {"workers": {"first": None}}

    def scatter(self, ready, broadcast, hash):
        return ready

    def submit(self, work, *args, key, pure):
        self.keys.append(key)
        self.threads.append(args[-1])
        self.tries.append(args[1].number)

        def task(archive, block, *more):
            ended = self.before(block, self.tries.count(block.number))
            return work(archive, block, *more) if ended is None else ended

        return Task(task, args)


@pytest.fixture(autouse=True)
def immediate_tasks(monkeypatch):
    monkeypatch.setattr(on_workers, "_wait_for_tasks", lambda client, tasks: list(tasks))
    monkeypatch.setattr(on_workers, "_scheduler_responds", lambda client: True)
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


def test_blocks_of_lost_workers_are_submitted_again(tmp_path):
    """Always after progress, and a limited number of times without."""
    client = Inline(lambda block, tries: None if tries > block.number else lost(block, tries))
    found = ensemble(client, tmp_path / "many.zarr")
    assert client.tries == [0, 1, 2, 1, 2, 2] and found.finished
    client = Inline(lambda block, tries: lost(block, tries) if block.number else None)
    with pytest.raises(ArchiveUnwritten, match=r"4 members .*workers were lost .*with block 1"):
        ensemble(client, tmp_path / "other.zarr")
    assert client.tries == [0] + [1, 2] * (1 + on_workers.RETRIES)
    client = Inline()
    assert ensemble(client, tmp_path / "other.zarr").finished and client.tries == [1, 2]


@pytest.mark.parametrize("error", [ArchiveError, ArchiveUnwritten])
def test_archive_errors_of_workers_are_raised(tmp_path, error):
    def refused(block, tries):
        if block.number == 1:
            raise error("of the worker")

    client = Inline(refused)
    with pytest.raises(error, match="of the worker"):
        ensemble(client, tmp_path / "many.zarr")
    assert client.tries == [0, 1, 2]


@pytest.mark.parametrize(("span", "step"), [("[0.0, 2.0]", 0.5), ("[2.0, 0.5]", -0.5), ("[-1.0, -3.0]", -0.5)])
def test_step_has_the_sign_of_the_span(span, step):
    store = SimpleNamespace(attributes={"t_span": span})
    assert on_workers._signed_step(store, SimpleNamespace(step=0.5)) == step
