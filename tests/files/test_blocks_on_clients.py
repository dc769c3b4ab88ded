"""Blocks of an ensemble as tasks of a client: what each task is given, and what follows from how it ends.

The client of these tests runs its tasks at once in this process; those of `test_clusters.py` have workers.
"""

import os
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.archives import dask_blocks as on_workers
from coadjoint.files.archives.block_run import BUSY
from coadjoint.files.archives.run_in_blocks import WorkerPool, run_in_blocks
from coadjoint.files.archives.store import ArchiveError, ArchiveUnwritten
from coadjoint.runs.prepared_run import PreparedRun

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
BATCH = co.batch([co.systems.rigid_body(inertia=(1, 2, 2 + 0.0625 * k)) for k in range(7)])
X = np.random.default_rng(3).standard_normal((7, 3))


class Task:
    def __init__(self, work, given):
        self.status = "finished"
        try:
            self._result = work(*given)
        except Exception as error:
            self.status, self._error = "error", error

    def result(self):
        return self._result

    def exception(self):
        return self._error


class Inline:
    """A client whose tasks have ended when they are submitted; `before` may end a task in another way."""

    status = "running"

    def __init__(self, before=lambda block, tries: None):
        self.keys, self.threads, self.tries, self.before = [], [], [], before

    def scheduler_info(self, n_workers):
        return {"workers": {"first": None}}

    def scatter(self, ready, broadcast, hash):
        return ready

    def submit(self, work, *given, key, pure):
        self.keys.append(key)
        self.threads.append(given[-1])
        self.tries.append(given[1].number)

        def task(archive, block, *more):
            ended = self.before(block, self.tries.count(block.number))
            return work(archive, block, *more) if ended is None else ended

        return Task(task, given)


@pytest.fixture(autouse=True)
def at_once(monkeypatch):
    monkeypatch.setattr(on_workers, "_wait_for_tasks", lambda client, tasks: list(tasks))
    monkeypatch.setattr(on_workers, "_scheduler_responds", lambda client: True)
    monkeypatch.setattr(on_workers, "RETRY_SECONDS", 0.0)
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


def ensemble(client, path, system=BODY, span=(0.0, 2.0), threads=None):
    ready = PreparedRun(system, co.Splitting(), 0.125)
    return run_in_blocks(ready, X, span, 1, path, WorkerPool(client, None, threads), size=3)


@pytest.mark.parametrize("system", [BODY, BATCH], ids=["one system", "batch"])
@pytest.mark.parametrize("span", [(0.0, 2.0), (7.5, 5.5)])
def test_every_block_has_its_own_members(tmp_path, system, span):
    client = Inline()
    found = ensemble(client, tmp_path / "many.zarr", system, span, threads=2)
    assert client.tries == [0, 1, 2] and len(set(client.keys)) == 3 and client.threads == [2, 2, 2]
    whole = co.integrate(system, X, span, 0.125, co.Splitting())
    np.testing.assert_array_equal(found.x, whole.x)
    np.testing.assert_array_equal(found.energy, whole.energy)


def test_a_block_that_another_task_runs_is_submitted_again(tmp_path):
    client = Inline(lambda block, tries: BUSY if block.number == 1 and tries < 3 else None)
    found = ensemble(client, tmp_path / "many.zarr")
    assert client.tries == [0, 1, 2, 1, 1] and len(set(client.keys)) == 5 and set(client.threads) == {1}
    assert found.finished and np.isfinite(found.x).all()


def lost(block, tries):
    raise RuntimeError(f"a worker is lost with block {block.number}")


def test_blocks_of_lost_workers_are_submitted_again(tmp_path):
    """As often as there is progress, and some times without; what was computed stays."""
    client = Inline(lambda block, tries: None if tries > block.number else lost(block, tries))
    found = ensemble(client, tmp_path / "many.zarr")
    assert client.tries == [0, 1, 2, 1, 2, 2] and found.finished
    client = Inline(lambda block, tries: lost(block, tries) if block.number else None)
    with pytest.raises(
        ArchiveUnwritten, match=r"4 members could not be computed, since workers were lost .*with block 1"
    ):
        ensemble(client, tmp_path / "other.zarr")
    assert client.tries == [0] + [1, 2] * (1 + on_workers.RETRIES)
    client = Inline()
    assert ensemble(client, tmp_path / "other.zarr").finished and client.tries == [1, 2]


@pytest.mark.parametrize("error", [ArchiveError, ArchiveUnwritten])
def test_what_a_worker_says_of_the_archive_is_raised(tmp_path, error):
    def refused(block, tries):
        if block.number == 1:
            raise error("said by the worker")

    client = Inline(refused)
    with pytest.raises(error, match="said by the worker"):
        ensemble(client, tmp_path / "many.zarr")
    assert client.tries == [0, 1, 2]


@pytest.mark.parametrize(("span", "step"), [("[0.0, 2.0]", 0.5), ("[2.0, 0.5]", -0.5), ("[-1.0, -3.0]", -0.5)])
def test_tables_are_made_for_the_direction_of_the_run(span, step):
    store = SimpleNamespace(attributes={"t_span": span})
    assert on_workers._signed_step(store, SimpleNamespace(step=0.5)) == step
