"""Runs in new archives, and their resumption."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.errors import IntegrationError
from coadjoint.files.archives.archived_run import (
    ACCOUNTS_ATTRIBUTE,
    FINISHED,
    FIRST_STEP,
    SAVE_EVERY,
    STATES,
    STEPS,
    ArchiveSink,
    first_step,
    new_arrays,
    states_of,
)
from coadjoint.files.archives.archived_solution import open_archive
from coadjoint.files.archives.blocks import BLOCK_SIZE_ATTRIBUTE
from coadjoint.files.archives.extended_runs import extend_run, extended_times
from coadjoint.files.archives.metadata_checks import as_archive_errors
from coadjoint.files.archives.reading import ArchiveError, read_archive_path, read_state
from coadjoint.files.archives.store import ArchiveStore, unwritable_error
from coadjoint.files.datasets.export import attributes_of
from coadjoint.files.datasets.variables import NO_METADATA, ExtraMetadata, accounts_of
from coadjoint.files.output.atomic_output import PendingOutput, remove_leftovers
from coadjoint.files.records.required_functions import function_attributes, resume_arguments
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.optional_packages import require_packages
from coadjoint.runs.events import read_events
from coadjoint.runs.piecewise_run import PiecewiseRun

if TYPE_CHECKING:
    from coadjoint.runs.prepared_run import PreparedRun
    from coadjoint.runs.results.solution import Solution
    from coadjoint.runs.start import Start
    from coadjoint.runs.times import Times


def archive_run(
    prepared: PreparedRun,
    x0: Any,
    t_span: tuple[float, float],
    save_every: int,
    archive: str | Path,
    *,
    t_eval: Any = None,
    progress: bool = False,
    events: Any = None,
    until: int | None = None,
    about: ExtraMetadata = NO_METADATA,
) -> Solution:
    """Run into a new archive; parameters as for `coadjoint.integrate`.

    `until` is the number of steps after which the run stops, to be resumed; `about` has further metadata to write.
    ArchiveError: the folder exists or cannot be written. IntegrationError: its partial solution is the archive.
    """
    require_packages("an archive of a run", "xarray", "zarr")
    if t_eval is not None or read_events(events):
        raise ValueError("an archive saves every save_every-th step and has no events; give neither t_eval nor events")
    began, target = time.perf_counter(), check_new(archive)
    times, start = prepared.times_of(t_span, save_every)[0], prepared.start(x0)
    store = created_in_place(
        target, lambda folder: create_archive(prepared, times, start, folder, int(save_every), about)
    )
    return _continue_run(store, prepared, times, start, None, progress, until, began)


def create_archive(
    prepared: PreparedRun, times: Times, start: Start, folder: Path, save_every: int, metadata: ExtraMetadata
) -> ArchiveStore:
    """Create an archive from which the run can be resumed, before its first step."""
    run = PiecewiseRun(prepared, times, start, 1)
    run.advance(0)
    piece = run.piece()
    metadata = metadata.with_batch_parameters(piece.system)
    arrays, growing, fixed = new_arrays(piece, times.total_points, metadata.coordinates)
    store = ArchiveStore.create_archive(folder, arrays)
    try:
        for name, (_, values, _) in (growing | fixed).items():
            store.write(name, values)
        lengths = {"time": run.points_held}
        state = store.store_state(run.stored(), {"number": 0, **lengths, "block": 1})
        attributes = {
            **attributes_of(piece),
            **metadata.attributes,
            **({"coordinates": " ".join(metadata.coordinates)} if metadata.coordinates else {}),
            ACCOUNTS_ATTRIBUTE: json.dumps(accounts_of(piece)),
            **function_attributes(prepared, ()),
            FIRST_STEP: first_step(prepared, times, start),
            "platform": f"{platform.platform()}, Python {platform.python_version()}, NumPy {np.__version__}",
            FINISHED: int(run.is_over),
            STEPS: 0,
            STATES: json.dumps([state]),
            SAVE_EVERY: save_every,
        }
        store.commit(attributes, lengths, [state])
    except BaseException:
        store.close()
        raise
    return store


def check_new(archive: str | Path) -> Path:
    """Validate the path of a new archive; ArchiveError if it exists or cannot be created."""
    target = read_archive_path(archive)
    try:
        if os.path.lexists(target):
            raise ArchiveError(f"{target}: exists; co.resume continues an archive, and a new one needs another name")
        if not target.parent.is_dir():
            raise ArchiveError(f"{target}: the folder {target.parent} does not exist; create it first")
        remove_leftovers(target)
    except OSError as reason:
        raise creation_error(target, reason) from None
    return target


def created_in_place(target: Path, create: Callable[[Path], ArchiveStore]) -> ArchiveStore:
    """Return the archive that is created in a hidden folder, under its name; an interrupt leaves it unlocked."""
    with ExitStack() as after_interrupts:
        try:
            with PendingOutput(target) as unfinished:
                store = create(unfinished.path)
                after_interrupts.callback(store.close)
                store.moved(target)
        except OSError as reason:
            raise creation_error(target, reason) from None
        after_interrupts.pop_all()
    return store


def creation_error(target: Path, reason: OSError) -> ArchiveError:
    """Return the error for a new archive that cannot be created."""
    return ArchiveError(f"{target}: cannot be created ({reason.strerror}); give another name")


@suggest_keywords
def resume(
    path: str | Path,
    t_end: float | None = None,
    *,
    system: Any = None,
    observe: Mapping[str, Any] | None = None,
    events: Any = None,
    threads: int | None = None,
    progress: bool = False,
    until: int | None = None,
    client: Any = None,
    workers: int | None = None,
) -> Solution:
    """Continue the run of an archive; bitwise equal to an uninterrupted run.

    A finished run is only opened, unless a later end is given.

    Parameters
    ----------
    path : str or Path
        The folder that ``integrate(..., archive=path)`` has written.
    t_end : float, optional
        A new end, a whole number of steps from the start (up to rounding, as in `integrate`) and later than what was
        computed. The result is bitwise equal
        to a run with this end from the beginning. Some steps, usually less than a sixth, are recomputed to find the
        drifts in each tenth of the new run.
    system, observe, events : optional
        Those of the run, if they contain Python functions, which are not stored. They are compared with those with
        which the run began, as far as `coadjoint.files.records.fingerprints` can, and rejected if they differ.
    threads : int, optional
        As for `integrate`; it does not affect the result.
    progress : bool
        Show a progress bar.
    until : int, optional
        Number of steps after which the run stops again.
    client, workers : optional
        Workers for an ensemble in blocks, as for `coadjoint.ensemble`; by default this process.

    Returns
    -------
    Solution
        The solution, which reads from disk lazily.

    Raises
    ------
    ArchiveError
        The archive is missing, damaged, or written by another process.
    ArchiveUnwritten
        The archive could not be written during the run; it holds the last commit.
    IntegrationError
        The run fails, or failed before.

    Examples
    --------
    >>> import coadjoint as co
    >>> import tempfile
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     sol = co.integrate(body, (1.0, 0.2, 0.1), (0, 10), 0.1, archive=f"{folder}/run.zarr")
    ...     sol = co.resume(f"{folder}/run.zarr", t_end=20.0)
    ...     float(sol.t[-1])
    20.0
    """
    from coadjoint.runs.prepared_run import PreparedRun

    require_packages("an archive of a run", "xarray", "zarr")
    began, archive_path = time.perf_counter(), read_archive_path(path)
    archive = open_archive(archive_path, system)
    if BLOCK_SIZE_ATTRIBUTE in archive.attributes:
        from coadjoint.files.archives.run_in_blocks import read_worker_pool, resume_in_blocks

        if t_end is not None or events is not None or until is not None:
            raise ValueError("resume takes no t_end, events or until for an ensemble in blocks; omit them")
        return resume_in_blocks(archive, system, observe, read_worker_pool(client, workers, threads), progress)
    if client is not None or workers is not None:
        raise ValueError(f"{archive_path}: is the archive of one run; client and workers are for ensembles in blocks")
    if archive.finished and (t_end is None or archive.attributes.get("run_failed")):
        return _return_or_raise(archive)
    store = ArchiveStore.open_existing(archive_path)
    try:
        archive = open_archive(archive_path, system)
        archive.check_complete()
        arguments = resume_arguments(archive_path, archive, system, observe, events)
        with as_archive_errors(archive_path):
            inputs = archive.inputs(arguments.events)
        prepared = PreparedRun(
            inputs["system"],
            inputs["method"],
            inputs["step"],
            attitude=inputs["attitude"],
            watch=inputs["watch"],
            observe=arguments.observe,
            threads=threads,
        )
        start = prepared.start(inputs["x0"])
        times, _ = prepared.times_of(inputs["t_span"], inputs["save_every"])
        if first_step(prepared, times, start) != store.attributes[FIRST_STEP]:
            raise ArchiveError(
                f"{archive_path}: the recomputed first step differs in bits from that of the archive, begun by "
                f"coadjoint {store.attributes['coadjoint_version']} on {store.attributes['platform']}; resume it "
                "there, and with the same system"
            )
        if t_end is not None:
            extended = extended_times(store, times, prepared, t_end)
            if extended.steps != times.steps:
                times = extended
                try:
                    with as_archive_errors(archive_path):
                        extend_run(store, prepared, times, start)
                except OSError as reason:
                    raise unwritable_error(archive_path, reason) from None
        if store.attributes[FINISHED]:
            store.close()
            return archive
        stored = read_state(archive_path, states_of(store.attributes)[-1])
    except BaseException:
        store.close()
        raise
    return _continue_run(store, prepared, times, start, stored, progress, until, began)


def _continue_run(
    store: ArchiveStore,
    prepared: PreparedRun,
    times: Times,
    start: Start,
    stored: Any,
    progress: bool,
    until: int | None,
    began: float,
) -> Solution:
    try:
        with as_archive_errors(store.path):
            run = PiecewiseRun(prepared, times, start, store.arrays["time"].chunk[0], stored)
            sink = ArchiveSink(store, began)
        run.advance_into(sink, until, progress)
    except KeyboardInterrupt as interrupt:
        interrupt.partial = open_archive(store.path, prepared.system)  # type: ignore[attr-defined]
        interrupt.add_note(
            f"{store.path} contains the computed steps; co.resume({str(store.path)!r}) continues the run"
        )
        raise
    finally:
        store.close()
    archive = open_archive(store.path, prepared.system)
    if sink.failure is not None:
        sink.failure.partial = archive
        raise sink.failure
    return archive


def _return_or_raise(archive: Solution) -> Solution:
    """Return a finished run, or raise the failure that ended it."""
    attributes = archive.attributes
    if not attributes.get("run_failed"):
        return archive
    raise IntegrationError(
        attributes["failed_reason"],
        step=int(attributes["failed_step"]),
        time=float(attributes["failed_time"]),
        residual=float(attributes["failed_residual"]),
        partial=archive,
    )
