"""Execution of the blocks of an ensemble on Dask workers, which return only a few numbers each."""

from __future__ import annotations

import logging
import secrets
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from typing import Any

import dask
from distributed import Client, Nanny, Scheduler, SpecCluster, Worker, wait
from distributed.security import Security

from coadjoint.files.archives.archive import MemberBlock, identity_of
from coadjoint.files.archives.archived_run import PlannedRun
from coadjoint.files.archives.ensemble import BUSY, run_block
from coadjoint.files.archives.folder import ArchiveError, timeout
from coadjoint.files.archives.store import ArchiveStore, ArchiveUnwritten
from coadjoint.long_operations import progress_bar
from coadjoint.private_folders import private_folder
from coadjoint.runs.prepared_run import PreparedRun

RETRIES = 3
"""Attempts after failures of a block."""
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
    try:
        with progress_bar(sum(block.last - block.first for block in remaining), progress, "member") as bar:
            failure, missing = _run_blocks(client, store, remaining, planned, threads or 1, bar)
    except (OSError, CancelledError) as reason:
        lost = "the client was closed" if client.scheduler is None else "the scheduler of the cluster is lost"
        raise ArchiveUnwritten(
            f"{store.path}: {lost}; computed blocks are in the archive, and the next call with this archive continues"
        ) from reason
    if isinstance(failure, ArchiveError | ArchiveUnwritten):
        raise failure
    if failure is not None:
        raise ArchiveUnwritten(
            f"{store.path}: {missing} members could not be computed, since workers were lost repeatedly "
            f"({type(failure).__name__}: {failure}); the next call with this archive continues"
        ) from failure


def _run_blocks(
    client: Any, store: ArchiveStore, remaining: list[MemberBlock], planned: PlannedRun, threads: int, bar: Any
) -> tuple[BaseException | None, int]:
    """Submit blocks and wait for them; return the first failure, and the number of members without results."""
    archive, token, prepared = str(store.path), secrets.token_hex(4), planned.prepared
    run, is_shared, options = identity_of(store.attributes), not prepared.system.is_batch, {"pure": False}
    # A task, since Dask sends scattered data not again if all workers that have them are lost.
    tables = client.submit(_unchanged, prepared, key=f"coadjoint-{token}", **options) if is_shared else None

    def submitted(block: MemberBlock, attempt: int) -> Any:
        of_block = tables if is_shared else prepared.among(block.first, block.last)
        key = f"coadjoint-{token}-{block.number}-{attempt}"
        arguments = archive, block, of_block, planned.events, is_shared, run, threads
        return client.submit(run_block, *arguments, key=key, retries=RETRIES, **options)

    tasks = {submitted(block, 0): block for block in remaining}
    failure: BaseException | None = None
    missing, attempts, last_response = 0, 0, time.monotonic()
    try:
        while tasks:
            ended_tasks = _wait_for_tasks(client, tasks)
            last_response = time.monotonic() if client.status == "running" else last_response
            if time.monotonic() - last_response > SCHEDULER_TIMEOUT:
                raise TimeoutError("the scheduler does not respond")
            again = []
            for task in ended_tasks:
                block, result = tasks.pop(task), BUSY
                if task.status == "error":
                    failure, missing = failure or task.exception(), missing + block.last - block.first
                    continue
                with suppress(TimeoutError):  # the result is lost with its worker
                    result = task.result(timeout())
                if result == BUSY:
                    again.append(block)
                else:
                    bar(block.last - block.first)
            if again:
                # A task of an earlier call still runs these blocks; it will end, or be lost with its worker.
                time.sleep(RETRY_SECONDS)
                attempts += 1
                tasks |= {submitted(block, attempts): block for block in again}
    except BaseException as error:
        if client.status == "running" and not isinstance(error, OSError | CancelledError):
            client.cancel(list(tasks), force=True)
        raise
    return failure, missing


def _unchanged(prepared: PreparedRun) -> PreparedRun:
    return prepared


def _wait_for_tasks(client: Any, tasks: Any) -> Any:
    """Wait until a task has ended, or for a timeout; return the ended tasks."""
    try:
        return wait(list(tasks), timeout=POLL_SECONDS, return_when="FIRST_COMPLETED").done  # type: ignore[no-untyped-call]
    except TimeoutError:
        return set()


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
            # Dask gives the tasks of workers that are silent for so long to others, and restarts them.
            with dask.config.set({"distributed.scheduler.worker-ttl": timeout()}):
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
