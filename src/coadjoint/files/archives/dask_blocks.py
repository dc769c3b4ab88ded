"""Execution of the blocks of an ensemble on Dask workers, which return only a few numbers each."""

from __future__ import annotations

import logging
import math
import secrets
import time
import warnings
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import partial
from typing import Any

from distributed import Client, Nanny, Scheduler, SpecCluster, Worker, wait
from distributed.security import Security

from coadjoint.files.archives.archive import MemberBlock
from coadjoint.files.archives.ensemble import BUSY, run_block
from coadjoint.files.archives.folder import ArchiveError, timeout, within_limit
from coadjoint.files.archives.new_archive import PlannedRun
from coadjoint.files.archives.root import identity_of
from coadjoint.files.archives.store import ArchiveStore, ArchiveUnwritten
from coadjoint.long_operations import progress_bar
from coadjoint.private_folders import private_folder

RETRIES = 3
"""Attempts without progress, after losses of workers or of their data, before giving up."""
POLL_SECONDS = 0.5  # between two checks of the tasks
SCHEDULER_TIMEOUT = 10.0  # s, for an answer of a scheduler that may be lost
RETRY_SECONDS = 2.0  # before a block is tried again, whose lock may be that of a lost worker


def on_processes(workers: int, *arguments: Any) -> None:
    """Run blocks in processes of this machine, which end with this call; further arguments as for `on_client`."""
    with local_cluster(workers) as client:
        on_client(client, *arguments)


def on_client(
    client: Any,
    store: ArchiveStore,
    remaining: list[MemberBlock],
    planned: PlannedRun,
    threads: int | None,
    progress: bool,
) -> None:
    """Run blocks on the workers of a client; shared tables are sent once, individual ones with each block."""
    planned.prepared.loops(planned.times.h).build_all()  # built here rather than by each worker
    with progress_bar(sum(block.last - block.first for block in remaining), progress, "member") as bar:
        attempts, silent = 0, SilentWorkers(client)
        while attempts < RETRIES:
            remaining_before = len(remaining)
            try:
                remaining, failure = _run_round(client, store, remaining, planned, threads or 1, bar, silent)
            except (OSError, CancelledError) as reason:
                lost = "the client was closed"
                if client.scheduler is not None:
                    lost = str(reason) if isinstance(reason, TimeoutError) else "the scheduler of the cluster is lost"
                raise ArchiveUnwritten(
                    f"{store.path}: {lost}; computed blocks are in the archive, and the next call with this archive "
                    "continues"
                ) from reason
            if not remaining:
                return
            if isinstance(failure, ArchiveError | ArchiveUnwritten):
                raise failure
            attempts = 0 if len(remaining) < remaining_before else attempts + 1
    members = sum(block.last - block.first for block in remaining)
    raise ArchiveUnwritten(
        f"{store.path}: {members} members could not be computed, since workers were lost repeatedly "
        f"({type(failure).__name__}: {failure}); the next call with this archive continues"
    ) from failure


class SilentWorkers:
    """Workers of a client from which its scheduler has heard nothing for the time limit, such as stopped processes."""

    def __init__(self, client: Any) -> None:
        self._client, self._heard, self._asked = client, dict[str, tuple[Any, float]](), -math.inf
        self.silent: set[str] = set()

    @property
    def elsewhere(self) -> dict[str, list[str]]:
        """Option of the client by which tasks and data go to other workers."""
        return {"workers": [address for address in self._heard if address not in self.silent]} if self.silent else {}

    def find(self) -> set[str]:
        """Update the sets of workers from time to time; return those that are newly silent, with a warning."""
        now, limit = time.monotonic(), timeout()
        if now - self._asked < limit / 20:
            return set()
        self._asked, before = now, self.silent
        workers = within_limit(partial(self._client.scheduler_info, n_workers=-1))["workers"]
        heard = {address: (about or {}).get("last_seen") for address, about in workers.items()}
        earlier = self._heard
        self._heard = {
            address: earlier[address] if address in earlier and earlier[address][0] == seen else (seen, now)
            for address, seen in heard.items()
        }
        self.silent = {address for address, (_, since) in self._heard.items() if now - since > limit}
        for address in self.silent - before:
            warnings.warn(
                f"the worker {address} has not answered for {limit:g} s; its members are computed by other workers",
                RuntimeWarning,
                stacklevel=2,
            )
        if self.silent and not self.elsewhere["workers"]:
            raise TimeoutError(f"no worker has answered for {limit:g} s")
        return self.silent - before


def _run_round(
    client: Any,
    store: ArchiveStore,
    remaining: list[MemberBlock],
    planned: PlannedRun,
    threads: int,
    bar: Any,
    silent: SilentWorkers,
) -> tuple[list[MemberBlock], BaseException | None]:
    """Submit blocks and wait for them; return the unfinished ones, and the first failure."""
    archive, token, prepared = str(store.path), secrets.token_hex(4), planned.prepared
    run, shared_tables = identity_of(store.attributes), not prepared.system.is_batch
    try:
        silent.find()
        scatter = partial(client.scatter, prepared, broadcast=True, hash=False, **silent.elsewhere)
        shared_run: Any = within_limit(scatter) if shared_tables else None
    except (OSError, CancelledError) as lost:
        # A worker that dies while it receives the tables fails this request, but not the cluster.
        if not _scheduler_responds(client):
            raise
        return remaining, lost

    def submitted(block: MemberBlock, attempt: int) -> Any:
        prepared_run = shared_run if shared_tables else prepared.among(block.first, block.last)
        key = f"coadjoint-{token}-{block.number}-{attempt}"
        arguments = archive, block, prepared_run, shared_tables, run, threads
        return client.submit(run_block, *arguments, key=key, pure=False, **silent.elsewhere)

    tasks = {submitted(block, 0): block for block in remaining}
    unfinished: list[MemberBlock] = []
    failure: BaseException | None = None
    attempts, last_response = 0, time.monotonic()
    try:
        while tasks:
            try:
                ended_tasks = _wait_for_tasks(client, tasks)
            except CancelledError as lost:
                # All workers with the tables are lost, or the scheduler is.
                if not _scheduler_responds(client):
                    raise
                return [*unfinished, *tasks.values()], failure or lost
            last_response = time.monotonic() if client.status == "running" else last_response
            if time.monotonic() - last_response > SCHEDULER_TIMEOUT:
                raise TimeoutError("the scheduler does not respond")
            locked = []
            for task in ended_tasks:
                block = tasks.pop(task)
                result, reason = _task_result(client, task)
                if reason is not None:
                    unfinished.append(block)
                    failure = failure or reason
                elif result == BUSY:
                    locked.append(block)
                else:
                    bar(block.last - block.first)
            if silent.find():
                # Tables may be on silent workers alone: they are sent again to the others.
                client.cancel(list(tasks), force=True)
                return [*unfinished, *locked, *tasks.values()], failure or TimeoutError("workers do not answer")
            if locked:
                # A task of an earlier call still runs these blocks; it will end, or be lost with its worker.
                time.sleep(RETRY_SECONDS)
                attempts += 1
                tasks |= {submitted(block, attempts): block for block in locked}
    except BaseException as error:
        if client.status == "running" and not isinstance(error, OSError | CancelledError):
            client.cancel(list(tasks), force=True)
        raise
    return unfinished, failure


def _wait_for_tasks(client: Any, tasks: Any) -> Any:
    """Wait until a task has ended, or for a timeout; return the ended tasks."""
    try:
        return wait(list(tasks), timeout=POLL_SECONDS, return_when="FIRST_COMPLETED").done  # type: ignore[no-untyped-call]
    except TimeoutError:
        return set()


def _task_result(client: Any, task: Any) -> tuple[Any, BaseException | None]:
    """Return the result of a task, or the exception that prevented it."""
    try:
        if task.status == "finished":
            return within_limit(task.result), None
        return None, (task.exception() if task.status == "error" else RuntimeError(f"a task is {task.status}"))
    except (CancelledError, TimeoutError) as lost:
        # The worker may be lost before its result is fetched.
        if not _scheduler_responds(client):
            raise
        return None, lost


def _scheduler_responds(client: Any) -> bool:
    """Whether the scheduler responds."""
    if client.scheduler is None:  # the client was closed
        return False
    try:
        client.sync(client.scheduler.identity, n_workers=0, callback_timeout=SCHEDULER_TIMEOUT)
    except (OSError, CancelledError):
        return False
    return bool(client.status == "running")


LOOPBACK = "127.0.0.1"


class QuietScheduler(Scheduler):
    """A scheduler without an HTTP server."""

    def start_http_server(self, *args: Any, **kwargs: Any) -> None:
        """Do not start it: it has no authentication, and runs even without a dashboard."""


class QuietWorker(Worker):
    """A worker without an HTTP server."""

    def start_http_server(self, *args: Any, **kwargs: Any) -> None:
        """Do not start it, as in `QuietScheduler`."""


@contextmanager
def local_cluster(workers: int) -> Iterator[Client]:
    """Start single-threaded workers that end with the context, and connect by TLS with temporary credentials."""
    security = Security.temporary()  # type: ignore[no-untyped-call]
    with private_folder() as folder:
        # Dask imports code from its temporary folder, whose default name all users share.
        options = {"host": LOOPBACK, "protocol": "tls://", "security": security, "dashboard": False}
        options["local_directory"] = str(folder)
        worker = {
            "cls": Nanny,
            "options": {
                **options,
                "worker_class": QuietWorker,
                "nthreads": 1,
                "memory_limit": None,
                # The call raises failures; a worker that dies within a block is replaced.
                "silence_logs": logging.CRITICAL,
            },
        }
        try:
            cluster = SpecCluster(  # type: ignore[no-untyped-call]
                workers=dict.fromkeys(range(workers), worker),
                scheduler={"cls": QuietScheduler, "options": options},
                security=security,
                silence_logs=logging.CRITICAL,
            )
        except RuntimeError as reason:
            raise RuntimeError(
                "the workers of ensemble(workers=) did not start; each of them imports the script, so that the call "
                'must be guarded by if __name__ == "__main__":'
            ) from reason
        with cluster, Client(cluster) as client:  # type: ignore[no-untyped-call]
            yield client
