"""Execution of the blocks of an ensemble on Dask workers, which return only a few numbers each."""

from __future__ import annotations

import importlib
import json
import secrets
import time
from concurrent.futures import CancelledError
from typing import TYPE_CHECKING, Any

from coadjoint.files.archives.block_run import BUSY, run_block
from coadjoint.files.archives.store import ArchiveError, ArchiveStore, ArchiveUnwritten
from coadjoint.runs.progress import progress_bar
from coadjoint.systems.batch import Batch

if TYPE_CHECKING:
    from coadjoint.files.archives.blocks import Block
    from coadjoint.runs.prepared_run import PreparedRun

RETRIES = 3
"""Attempts without progress, after losses of workers or of their data, before giving up."""
POLL_SECONDS = 0.5
SCHEDULER_TIMEOUT = 10.0
RETRY_SECONDS = 2.0


def on_processes(
    workers: int, store: ArchiveStore, remaining: list[Block], ready: PreparedRun, threads: int | None, progress: bool
) -> None:
    """Run blocks in processes of this machine, which end with this call."""
    if not remaining:
        return
    from coadjoint.files.archives.local_cluster import local_cluster

    with local_cluster(min(workers, len(remaining))) as client:
        on_client(client, store, remaining, ready, threads, progress)


def on_client(
    client: Any,
    store: ArchiveStore,
    remaining: list[Block],
    ready: PreparedRun,
    threads: int | None,
    progress: bool,
) -> None:
    """Run blocks on the workers of a client.

    Shared tables are sent to each worker once; if members have individual tables, each block gets its own.
    ArchiveUnwritten: the cluster is lost, or a block cannot be written. ArchiveError: a worker does not see the
    archive, or has another version of the library.
    """
    with progress_bar(sum(block.last - block.first for block in remaining), progress, "member") as bar:
        tries = 0
        while tries < RETRIES:
            before = len(remaining)
            remaining, failure = _run_round(client, store, remaining, ready, threads or 1, bar)
            if not remaining:
                return
            if isinstance(failure, ArchiveError | ArchiveUnwritten):
                raise failure
            tries = 0 if len(remaining) < before else tries + 1
    members = sum(block.last - block.first for block in remaining)
    raise ArchiveUnwritten(
        f"{store.path}: {members} members could not be computed, since workers were lost repeatedly "
        f"({type(failure).__name__}: {failure}); the next call with this archive continues"
    ) from failure


def _run_round(
    client: Any, store: ArchiveStore, remaining: list[Block], ready: PreparedRun, threads: int, bar: Any
) -> tuple[list[Block], BaseException | None]:
    """Submit blocks and wait for them; return the unfinished ones, and the first reason."""
    archive, token, whole = str(store.path), secrets.token_hex(4), not isinstance(ready.system, Batch)
    ready.loops(_signed_step(store, ready)).build_all()  # built here rather than by each worker
    try:
        everything: Any = client.scatter(ready, broadcast=True, hash=False) if whole else None
    except (OSError, CancelledError) as lost:
        # A worker that dies while it receives the tables fails this request, but not the cluster.
        if not _scheduler_responds(client):
            raise _cluster_lost_error(store) from lost
        return remaining, lost

    def submitted(block: Block, again: int) -> Any:
        given = everything if whole else ready.among(block.first, block.last)
        key = f"coadjoint-{token}-{block.number}-{again}"
        return client.submit(run_block, archive, block, given, whole, threads, key=key, pure=False)

    tasks = {submitted(block, 0): block for block in remaining}
    undone: list[Block] = []
    failure: BaseException | None = None
    tries, seen = 0, time.monotonic()
    try:
        while tasks:
            try:
                done = _wait_for_tasks(client, tasks)
            except CancelledError as lost:
                # All workers with the tables are lost, or the scheduler is.
                if not _scheduler_responds(client):
                    raise
                return [*undone, *tasks.values()], failure or lost
            seen = time.monotonic() if client.status == "running" else seen
            if time.monotonic() - seen > SCHEDULER_TIMEOUT:
                raise _cluster_lost_error(store)
            busy = []
            for task in done:
                block = tasks.pop(task)
                ended, reason = _task_result(client, task)
                if reason is not None:
                    undone.append(block)
                    failure = failure or reason
                elif ended == BUSY:
                    busy.append(block)
                else:
                    bar(block.last - block.first)
            if busy:
                # A task of an earlier call still runs them; it ends, or is lost with its worker.
                time.sleep(RETRY_SECONDS)
                tries += 1
                tasks |= {submitted(block, tries): block for block in busy}
    except ArchiveUnwritten:
        raise
    except (OSError, CancelledError) as reason:
        # Raised by a lost connection.
        raise _cluster_lost_error(store) from reason
    except BaseException:
        if client.status == "running":
            client.cancel(list(tasks), force=True)
        raise
    return undone, failure


def _wait_for_tasks(client: Any, tasks: Any) -> Any:
    """Wait until a task has ended, or for a timeout; return those that have."""
    distributed: Any = importlib.import_module("distributed")
    try:
        return distributed.wait(list(tasks), timeout=POLL_SECONDS, return_when="FIRST_COMPLETED").done
    except TimeoutError:
        return set()


def _task_result(client: Any, task: Any) -> tuple[Any, BaseException | None]:
    """Return the result of a task, or the reason why it has none."""
    try:
        if task.status == "finished":
            return task.result(), None
        return None, (task.exception() if task.status == "error" else RuntimeError(f"a task is {task.status}"))
    except CancelledError as lost:
        # The worker may be lost before its result is fetched.
        if not _scheduler_responds(client):
            raise
        return None, lost


def _scheduler_responds(client: Any) -> bool:
    """Whether the scheduler responds."""
    try:
        client.sync(client.scheduler.identity, n_workers=0, callback_timeout=SCHEDULER_TIMEOUT)
    except (OSError, CancelledError):
        return False
    return bool(client.status == "running")


def _cluster_lost_error(store: ArchiveStore) -> ArchiveUnwritten:
    return ArchiveUnwritten(
        f"{store.path}: the scheduler of the cluster is lost; what was done is kept, and the next call with this "
        "archive goes on"
    )


def _signed_step(store: ArchiveStore, ready: PreparedRun) -> float:
    """Return the step with its sign."""
    first, last = json.loads(store.attributes["t_span"])
    return ready.step if last >= first else -ready.step
