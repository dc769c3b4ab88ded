"""Ensembles computed in blocks: `integrate_ensemble`; an archive is begun or continued, and what is missing is run."""

from __future__ import annotations

import json
import platform
import tempfile
import time
import warnings
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np

from coadjoint import __version__
from coadjoint.errors import IntegrationError
from coadjoint.files.archives.archive import (
    FINISHED,
    HIDDEN_FOLDER,
    MemberBlock,
    identity_of,
    read_root,
    total_progress,
)
from coadjoint.files.archives.archived_run import ArchiveSink, PlannedRun, create_archive
from coadjoint.files.archives.archived_solution import closing, open_archive, raise_if_failed
from coadjoint.files.archives.folder import ArchiveError, ArchiveFolder, read_archive_path, reading, timeout
from coadjoint.files.archives.run_checks import CROSSING_PREFIX, RESERVED_NAMES, SERIES_PREFIXES, check_archive
from coadjoint.files.archives.store import ArchiveStore, ArchiveUnwritten, unwritten_archive
from coadjoint.files.datasets.named_axes import MEMBER
from coadjoint.files.datasets.variables import TIME, Variables, joined_complex
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import progress_bar, read_progress
from coadjoint.methods.protocol.method import Method
from coadjoint.optional_packages import require_packages
from coadjoint.runs.error_estimates import warn_of_blocks, warn_of_large_step
from coadjoint.runs.events import Event, read_events
from coadjoint.runs.piecewise_run import PiecewiseRun
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.start import combined
from coadjoint.runs.times import times_of
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.system import System
from coadjoint.validation import read_integer, read_numbers

if TYPE_CHECKING:
    from distributed import Client


BUSY = {"busy": True}
INSECURE_PROTOCOLS = ("tcp", "ws", "ucx", "ucxx")
"""Dask protocols without authentication."""


class WorkerPool(NamedTuple):
    """Workers of an ensemble: of a Dask `client`, processes of this machine, or (both None) this process."""

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
    if protocol not in INSECURE_PROTOCOLS or host in (None, "localhost"):
        return
    with suppress(ValueError):  # a name
        if ip_address(host).is_loopback:
            return
    warnings.warn(
        f"the client is connected to {address} without TLS; anyone who reaches it can run code on the workers "
        "and in this process: start the cluster with TLS credentials and connect by Client(address, security=...)",
        RuntimeWarning,
        stacklevel=2,
    )


@suggest_keywords
def integrate_ensemble(
    system: System | Batch,
    x0: Any,
    t_span: tuple[float, float],
    step: float,
    method: Method | str | Mapping[str, Any] | None = None,
    *,
    save_every: int = 1,
    attitude: Any = False,
    watch: bool = True,
    observe: Mapping[str, Any] | None = None,
    archive: str | Path | None = None,
    client: Client | None = None,
    workers: int | None = None,
    members_per_block: int | None = None,
    threads: int | None = None,
    progress: bool = False,
    coordinates: Mapping[str, Any] | None = None,
    events: Any = None,
) -> Solution:
    """Integrate many members in blocks, on the workers of a cluster or here, into one archive.

    Use it for ensembles that take hours, or exceed the memory of the machine. (`integrate` holds all members in memory,
    where they are lost if the process is killed.) Each block of members is a task that writes its own files of the
    archive. Results never pass through the client. If workers, the scheduler or the client are lost, a second call with
    the same archive computes what is missing. Each member is bitwise equal to its run alone.

    Parameters
    ----------
    system, x0, t_span, step, method, save_every, attitude, watch, observe
        As for `integrate`; x0 is (members, n), or of a `batch` also (n,), and a batch with named axes is combined
        with every state.
    archive : str or Path, optional
        The folder of the archive, new or one of the same ensemble; all workers must see it by the same name. It is
        required with a client. Otherwise the default is a temporary folder that exists as long as the solution.
    client : distributed.Client, optional
        Client of the cluster.
    workers : int, optional
        Number of processes on this machine, instead of a client. They take some seconds to start, so that threads are
        faster on one machine, unless functions of the user run in Python. A script must guard such a call by ``if
        __name__ == "__main__":``, since each process imports it. With neither, this process runs all blocks.
    members_per_block : int, optional
        Number of members of a block. By default there are about four blocks for each worker, or more if members have
        many numbers. For an existing archive, the number is that of the archive.
    threads : int, optional
        Number of threads for the members of a block. The default is one on workers, and otherwise one for each core.
    progress : bool
        Show a progress bar over the members.
    coordinates : mapping, optional
        Name -> numbers, one for each member, such as parameters that differ: coordinates of the dataset.
    events : Event or sequence of Event, optional
        Events to locate, as for `integrate`; a terminal event ends the run of a member.

    Returns
    -------
    Solution
        The solution, as from `open_archive`; arrays are read lazily. `status` has the progress of the members.

    Raises
    ------
    ValueError, TypeError
        For wrong input, before the first step.
    ArchiveError
        The archive is of another ensemble, written by another process, or cannot be created.
    ArchiveUnwritten
        The archive could not be written during the run, or the cluster is lost. Call again to compute what is missing.
    IntegrationError
        Members failed. The others are computed to their ends first; ``.partial`` is the ensemble.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> states = np.random.default_rng(1).standard_normal((100, 3))
    >>> many = co.integrate_ensemble(body, states, (0, 10), 0.1, members_per_block=32)
    >>> many.x.shape, many.finished
    ((101, 100, 3), True)
    >>> bool((many.x[:, 7] == co.integrate(body, states[7], (0, 10), 0.1).x).all())
    True
    """
    require_packages("an ensemble in an archive", "xarray", "zarr")
    system, x0 = combined(system, x0)
    progress, pool = read_progress(progress), read_worker_pool(client, workers, threads)
    if archive is None and client is not None:
        raise TypeError(
            "ensemble was given a client and no archive; give archive=, a folder that all workers can reach, since "
            "results do not pass through the client"
        )
    size = None if members_per_block is None else read_integer(members_per_block, "members_per_block", floats=True)
    prepared = PreparedRun(system, method, step, attitude=attitude, watch=watch, observe=observe, threads=pool.threads)
    members = len(prepared.start(x0).momenta)
    along = _along_members({} if coordinates is None else coordinates, members)
    arguments = prepared, x0, t_span, save_every, archive, pool
    return run_in_blocks(*arguments, size=size, progress=progress, coordinates=along, events=events)


def _along_members(coordinates: Mapping[str, Any], members: int) -> Variables:
    """Validate coordinates and return them as variables of an archive."""
    if not isinstance(coordinates, Mapping):
        raise TypeError(
            f"coordinates is {short(coordinates)}; give a mapping from names to numbers, one for each member"
        )
    variables: Variables = {}
    for name, values in coordinates.items():
        if not isinstance(name, str) or not name.isidentifier():
            raise ValueError(f"coordinates has the name {short(name)}; give one of letters, digits and underscores")
        if name in RESERVED_NAMES or name.startswith((*SERIES_PREFIXES, CROSSING_PREFIX)):
            raise ValueError(f"coordinates has the name {name!r}, which is reserved")
        numbers = read_numbers(values, f"coordinates[{short(name)}]")
        if numbers.shape != (members,):
            raise ValueError(f"coordinates has {short(numbers)} for {name!r}; give numbers of shape ({members},)")
        variables[name] = ((MEMBER,), numbers, {})
    return variables


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
    coordinates: Variables | None = None,
    attributes: Mapping[str, Any] | None = None,
    events: Any = None,
) -> Solution:
    """Run an ensemble in blocks of `size` members; see `integrate_ensemble`."""
    times, start = prepared.times_of(t_span, save_every)[0], prepared.start(x0)
    planned = PlannedRun(prepared, times, start, coordinates or {}, attributes or {}, read_events(events))
    if planned.start.single:
        raise ValueError(f"x0 has the shape {np.shape(x0)}; an ensemble needs (members, ...), and integrate takes one")
    if archive is not None:
        return _run_unfinished(planned, read_archive_path(archive), pool, size, progress)
    folder = tempfile.TemporaryDirectory(prefix="coadjoint-", ignore_cleanup_errors=True)
    result: Any = None
    try:
        result = _run_unfinished(planned, Path(folder.name, "ensemble.zarr"), pool, size, progress)
    except (IntegrationError, KeyboardInterrupt) as error:
        result = getattr(error, "partial", None)
        raise
    finally:
        # The folder exists as long as the solution.
        if result is None:
            folder.cleanup()
        else:
            weakref.finalize(result, folder.cleanup)
    solution: Solution = result
    return solution


def _run_unfinished(planned: PlannedRun, path: Path, pool: WorkerPool, size: int | None, progress: bool) -> Solution:
    """Begin or continue the archive, and run its unfinished blocks."""
    began, prepared, is_new, warned = time.perf_counter(), planned.prepared, not path.exists(), False
    if pool.client is not None and pool.client.status != "running":
        raise ValueError(f"the client is {pool.client.status}; give one that is connected to a scheduler")
    if is_new:
        store = create_archive(planned, path, pool.worker_count, size)
    else:
        store = ArchiveStore.open_existing(path)
    with closing(store, prepared.system):
        if is_new:
            # A copy, since loops of half a step are not sent to workers.
            warned = warn_of_large_step(open_archive(path, prepared.system), prepared.in_one_thread())
            remaining = store.blocks
        else:
            check_archive(store)
            planned.check_same_run(store)
            remaining = unfinished_blocks(store)
        if pool.client is None and pool.workers is None:
            _run_serially(store, remaining, planned, progress)
        else:
            from coadjoint.files.archives.dask_blocks import on_client, on_processes

            if pool.client is not None:
                on_client(pool.client, store, remaining, planned, pool.threads, progress)
            elif remaining:
                on_processes(min(pool.worker_count, len(remaining)), store, remaining, planned, pool.threads, progress)
        with _writing(store):
            heads = finish_ensemble(store, began)
    solution = raise_if_failed(open_archive(path, prepared.system))
    lost = [head["lost"] for head in heads if "lost" in head]
    if remaining and lost and not warned:
        warn_of_blocks(solution, prepared, lost)
    return solution


def _run_serially(store: ArchiveStore, remaining: list[MemberBlock], planned: PlannedRun, progress: bool) -> None:
    """Run blocks in this process, one after the other."""
    about = planned.prepared, planned.events, True, identity_of(store.attributes), None
    with progress_bar(sum(block.last - block.first for block in remaining), progress, "member") as bar:
        for block in remaining:
            with _writing(store):
                store.check_lock()
            if run_block(str(store.path), block, *about) == BUSY:
                raise ArchiveUnwritten(f"{store.path}: another process is still running some members; try again later")
            bar(block.last - block.first)


@contextmanager
def _writing(store: ArchiveStore) -> Iterator[None]:
    """Convert OSError to ArchiveUnwritten."""
    try:
        yield
    except OSError as reason:
        raise unwritten_archive(store.path, reason, "the next call with this archive continues") from reason


def run_block(
    archive: str,
    block: MemberBlock,
    prepared: PreparedRun,
    events: tuple[Event, ...],
    all_members: bool,
    run: str,
    threads: int | None,
) -> dict[str, Any]:
    """Run a block of the archive of a run from its marker to its end; return the new head, or ``BUSY`` if locked."""
    path, host = Path(archive), platform.node()
    try:
        folder = ArchiveFolder(path)
        store = ArchiveStore(folder, *read_root(folder), block.lock_file)
    except ArchiveError as reason:
        raise ArchiveError(
            f"{reason} on the machine {host}; every worker must reach the folder by the same path"
        ) from None
    arrays, attributes = store.arrays, store.attributes
    try:
        if identity_of(attributes) != run:
            raise ArchiveError(f"{path}: another run has taken its place on {host}; nothing was written to it")
        if attributes["coadjoint_version"] != __version__:
            raise ArchiveError(
                f"{path}: was begun by coadjoint {attributes['coadjoint_version']}, and the worker on {host} has "
                f"{__version__}; install the same version everywhere"
            )
        if not store.lock() and not store.take_over(timeout()):
            return BUSY
        times = times_of(json.loads(attributes["t_span"]), float(attributes["step"]), int(attributes["save_every"]))
        first, last = (block.first, block.last) if all_members else (0, block.last - block.first)
        x0, attitude = (_start_of(store, name, block) for name in ("x0", "attitude0"))
        of_block, marker = prepared.among(first, last, threads), store.begin_block(block)
        head, stored = marker or ({FINISHED: 0}, None)
        sink = ArchiveSink(store, head, block)
        with reading(path, f"{HIDDEN_FOLDER}/{block.marker}"):
            start = of_block.start(x0, attitude)
            pieces = PiecewiseRun(of_block, times, start, arrays[TIME].chunk[0], stored, events)
        if marker is None:
            pieces.advance(0)
        if not head[FINISHED]:
            pieces.advance_into(sink.take)
        return dict(sink.head)
    except ArchiveUnwritten:
        raise
    except OSError as reason:
        raise ArchiveUnwritten(
            f"{path}: members {block.first} to {block.last - 1} could not be written on {host} "
            f"({reason.strerror or reason}); the next call with this archive continues"
        ) from reason
    finally:
        store.close()


def _start_of(store: ArchiveStore, name: str, block: MemberBlock) -> Any:
    """Return the initial values of the members of a block, or None if the archive has no such array."""
    if name not in store.arrays:
        return None
    array = store.arrays[name]
    values = store.read(name, [range(block.first, block.last), *map(range, array.shape[1:])])
    return joined_complex(values, array.dims)


def unfinished_blocks(store: ArchiveStore) -> list[MemberBlock]:
    """Return the unfinished blocks; those of which committed chunks are lost begin again."""
    blocks, lost, store.heads = store.blocks, set[int](), store.read_heads(whole_markers=True)
    for name, indices in store.lost_chunks():
        axis = store.axis_of_blocks(name)
        if axis is not None:
            lost.add(indices[axis])
    for number in lost:
        store.folder.remove(HIDDEN_FOLDER, blocks[number].marker)
    return [block for block in blocks if block.number in lost or not store.heads[block.number].get(FINISHED)]


def finish_ensemble(store: ArchiveStore, began: float) -> list[dict[str, Any]]:
    """Mark the ensemble as finished in the root, with the time since its call began; return the heads of its blocks."""
    heads = store.read_heads()
    attributes = total_progress(heads)
    attributes["elapsed"] = float(store.attributes.get("elapsed", 0.0)) + time.perf_counter() - began
    failures = [head for head in heads if head.get("run_failed")]
    if failures:
        count, first = sum(head["failed"] for head in heads), failures[0]
        attributes |= {name: value for name, value in first.items() if name.startswith(("run_failed", "failed_"))}
        if count:
            attributes["failed_reason"] = (
                f"{count} of {store.members} members failed, the first of them is member {first['first_failed']}: "
                f"{first['failed_reason']}"
            )
    store.commit(attributes, {TIME: store.arrays[TIME].shape[0]}, store.states)
    for block in store.blocks:
        store.folder.remove(HIDDEN_FOLDER, block.lock_file)
    return heads
