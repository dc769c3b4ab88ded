"""Ensembles in blocks: an archive is begun or continued, and its unfinished blocks are run."""

from __future__ import annotations

import shutil
import tempfile
import time
import warnings
import weakref
from collections.abc import Mapping
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np

from coadjoint.errors import IntegrationError
from coadjoint.files.archives.archived_solution import open_archive
from coadjoint.files.archives.block_run import BUSY, run_block
from coadjoint.files.archives.ensemble_archive import (
    Ensemble,
    check_same_run,
    create_archive,
    finish_ensemble,
    unfinished_blocks,
)
from coadjoint.files.archives.metadata_checks import check_archive
from coadjoint.files.archives.reading import read_archive_path
from coadjoint.files.archives.store import ArchiveStore, ArchiveUnwritten, unwritten_archive
from coadjoint.files.datasets.variables import NO_METADATA, ExtraMetadata
from coadjoint.files.records.required_functions import resume_arguments
from coadjoint.optional_packages import require_packages
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.progress import progress_bar
from coadjoint.runs.step_error import warn_of_large_step
from coadjoint.short_repr import short
from coadjoint.validation import read_integer

if TYPE_CHECKING:
    from coadjoint.files.archives.blocks import Block
    from coadjoint.runs.results.solution import Solution


INSECURE_PROTOCOLS = ("tcp", "ws", "ucx", "ucxx")
"""Dask protocols without authentication."""


class WorkerPool(NamedTuple):
    """Workers of an ensemble: those of a Dask `client`, so many processes on this machine, or (both None) this process.

    `threads` is the number per block; None is one on workers, and otherwise one for each core.
    """

    client: Any = None
    workers: int | None = None
    threads: int | None = None

    @property
    def worker_count(self) -> int:
        """Number of workers."""
        if self.client is not None:
            return max(1, len(self.client.scheduler_info(n_workers=-1)["workers"]))
        return self.workers or 1


def read_worker_pool(client: Any, workers: Any, threads: Any) -> WorkerPool:
    """Validate client, workers and threads."""
    if client is not None and workers is not None:
        raise TypeError("ensemble was given a client and workers; give only one: workers are processes of this machine")
    if client is not None:
        require_packages("ensemble(client=)", "distributed")
        from distributed import Client

        if not isinstance(client, Client):
            raise TypeError(f"client is {short(client)}; it must be a distributed.Client")
        warn_without_tls(client)
    if workers is not None:
        require_packages("ensemble(workers=)", "distributed", "cryptography")
        workers = read_integer(workers, "workers", floats=True)
    return WorkerPool(client, workers, None if threads is None else read_integer(threads, "threads", floats=True))


def warn_without_tls(client: Any) -> None:
    """Warn if a client reaches its scheduler over a network without TLS."""
    address = getattr(client.scheduler, "address", "")
    protocol, _, location = address.partition("://")
    host = urlsplit(f"//{location}").hostname
    if protocol not in INSECURE_PROTOCOLS or host is None or is_loopback(host):
        return
    warnings.warn(
        f"the client is connected to {address} without TLS; anyone who reaches it can run code on the workers "
        "and in this process: start the cluster with TLS credentials and connect by Client(address, security=...)",
        RuntimeWarning,
        stacklevel=2,
    )


def is_loopback(host: str) -> bool:
    """Whether a host is an address of this machine that other machines cannot reach."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def run_in_blocks(
    prepared: PreparedRun,
    x0: Any,
    t_span: tuple[float, float],
    save_every: int,
    archive: str | Path | None,
    pool: WorkerPool,
    *,
    size: int | None = None,
    progress: bool = False,
    about: ExtraMetadata = NO_METADATA,
) -> Solution:
    """Run an ensemble in blocks of `size` members; see `coadjoint.ensemble`.

    `prepared` is prepared for all members; `about` has further metadata to write.
    """
    times, start = prepared.times_of(t_span, save_every)[0], prepared.start(x0)
    if start.single:
        raise ValueError(f"x0 has the shape {np.shape(x0)}; an ensemble needs (members, ...), and integrate takes one")
    members_run = Ensemble(prepared, times, start)
    if archive is not None:
        return _run_unfinished(members_run, read_archive_path(archive).absolute(), pool, size, progress, about)
    folder = tempfile.mkdtemp(prefix="coadjoint-")
    result: Any = None
    try:
        result = _run_unfinished(members_run, Path(folder, "ensemble.zarr"), pool, size, progress, about)
    except (IntegrationError, KeyboardInterrupt) as error:
        result = getattr(error, "partial", None)
        raise
    finally:
        if result is None:
            shutil.rmtree(folder, ignore_errors=True)
        else:
            weakref.finalize(result, shutil.rmtree, folder, ignore_errors=True)
    solution: Solution = result
    return solution


def _run_unfinished(
    ensemble: Ensemble, path: Path, pool: WorkerPool, size: int | None, progress: bool, about: ExtraMetadata
) -> Solution:
    """Begin or continue the archive, and run its unfinished blocks."""
    began, prepared, is_new = time.perf_counter(), ensemble.prepared, False
    if path.exists():
        store = ArchiveStore.open_existing(path)
        try:
            check_archive(path, store.arrays, store.attributes)
            check_same_run(ensemble, store)
        except BaseException:
            store.close()
            raise
    else:
        store = create_archive(ensemble, path, size, pool.worker_count, about)
        is_new = True
    try:
        if is_new:
            # A copy, since loops of half a step are not sent to workers.
            warn_of_large_step(open_archive(path, prepared.system), prepared.in_one_thread())
        remaining = unfinished_blocks(store)
        if pool.client is None and pool.workers is None:
            _run_serially(store, remaining, prepared, progress)
        else:
            from coadjoint.files.archives.dask_blocks import on_client, on_processes

            if pool.client is not None:
                on_client(pool.client, store, remaining, prepared, pool.threads, progress)
            else:
                on_processes(pool.worker_count, store, remaining, prepared, pool.threads, progress)
        try:
            attributes = finish_ensemble(store, began)
        except OSError as reason:
            raise _unwritten(store, reason) from reason
    except KeyboardInterrupt as interrupt:
        interrupt.partial = open_archive(path, prepared.system)  # type: ignore[attr-defined]
        raise
    finally:
        store.close()
    archive = open_archive(path, prepared.system)
    if attributes.get("run_failed"):
        raise IntegrationError(
            attributes["failed_reason"],
            step=int(attributes["failed_step"]),
            time=float(attributes["failed_time"]),
            residual=float(attributes["failed_residual"]),
            partial=archive,
        )
    return archive


def _run_serially(store: ArchiveStore, remaining: list[Block], prepared: PreparedRun, progress: bool) -> None:
    """Run blocks in this process, one after the other."""
    with progress_bar(sum(block.last - block.first for block in remaining), progress, "member") as bar:
        for block in remaining:
            try:
                store.check_not_replaced()
            except OSError as reason:
                raise _unwritten(store, reason) from reason
            if run_block(str(store.path), block, prepared, True, None) == BUSY:
                raise ArchiveUnwritten(f"{store.path}: another process is still running some members; try again later")
            bar(block.last - block.first)


def _unwritten(store: ArchiveStore, reason: OSError) -> ArchiveUnwritten:
    """Return the error for an archive that the blocks could not write."""
    if_replaced, if_not = "the new content of this path was not changed", "the next call with this archive continues"
    return unwritten_archive(store.path, reason, if_replaced, if_not)


def resume_in_blocks(
    archive: Solution, system: Any, observe: Mapping[str, Any] | None, pool: WorkerPool, progress: bool
) -> Solution:
    """Compute the missing members of an ensemble, as `coadjoint.resume` does."""
    arguments, inputs = resume_arguments(archive.path, archive, system, observe, None), archive.inputs()
    prepared = PreparedRun(
        inputs["system"],
        inputs["method"],
        inputs["step"],
        attitude=inputs["attitude"],
        watch=inputs["watch"],
        observe=arguments.observe,
        threads=pool.threads,
    )
    return run_in_blocks(
        prepared, inputs["x0"], inputs["t_span"], inputs["save_every"], archive.path, pool, progress=progress
    )
