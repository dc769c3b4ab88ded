"""Runs in new archives, and the resumption of runs and ensembles."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coadjoint.files.archives.archive import (
    BLOCK_SIZE_ATTRIBUTE,
    FINISHED,
    FIRST_STEP,
    SAVE_EVERY,
    ArchiveError,
    read_archive_path,
)
from coadjoint.files.archives.archived_solution import closing, open_archive, raise_if_failed
from coadjoint.files.archives.ensemble import read_worker_pool, run_in_blocks
from coadjoint.files.archives.extended_runs import extend_run, extended_times
from coadjoint.files.archives.metadata_checks import as_archive_errors
from coadjoint.files.archives.new_archive import PlannedRun, create_archive
from coadjoint.files.archives.sinks import ArchiveSink
from coadjoint.files.archives.store import ArchiveStore, unwritable_error
from coadjoint.files.datasets.variables import NO_METADATA, ExtraMetadata
from coadjoint.files.records.required_functions import resume_arguments
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.optional_packages import require_packages
from coadjoint.runs.events import read_events
from coadjoint.runs.prepared_run import PreparedRun

if TYPE_CHECKING:
    from coadjoint.runs.results.solution import Solution


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
    about: ExtraMetadata = NO_METADATA,
) -> Solution:
    """Run into a new archive; parameters as for `coadjoint.integrate`, and further metadata to write.

    ArchiveError: the folder exists or cannot be written. IntegrationError: its partial solution is the archive.
    """
    require_packages("an archive of a run", "xarray", "zarr")
    if t_eval is not None or read_events(events):
        raise ValueError("an archive saves every save_every-th step and has no events; give neither t_eval nor events")
    began = time.perf_counter()
    planned = PlannedRun(prepared, prepared.times_of(t_span, save_every)[0], prepared.start(x0))
    about = about._replace(attributes={**about.attributes, SAVE_EVERY: int(save_every)})
    store = create_archive(planned, archive, about)
    return _continue_run(store, planned, None, progress, None, began)


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
        computed. The result is bitwise equal to a run with this end from the beginning. Some steps, usually less than
        a sixth, are recomputed to find the drifts in each tenth of the new run.
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
        Workers for an ensemble in blocks, as for `integrate_ensemble`; by default this process.

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
    require_packages("an archive of a run", "xarray", "zarr")
    began, archive_path = time.perf_counter(), read_archive_path(path)
    archive = open_archive(archive_path, system)
    if BLOCK_SIZE_ATTRIBUTE in archive.attributes:
        if t_end is not None or events is not None or until is not None:
            raise ValueError("resume takes no t_end, events or until for an ensemble in blocks; omit them")
        pool = read_worker_pool(client, workers, threads)
        prepared, inputs = _prepared_again(archive, system, observe, None, pool.threads)
        arguments = inputs["x0"], inputs["t_span"], inputs["save_every"], archive.path, pool
        return run_in_blocks(prepared, *arguments, progress=progress)
    if client is not None or workers is not None:
        raise ValueError(f"{archive_path}: is the archive of one run; client and workers are for ensembles in blocks")
    if archive.finished and (t_end is None or archive.attributes.get("run_failed")):
        return raise_if_failed(archive)
    store = ArchiveStore.open_existing(archive_path)
    try:
        archive = open_archive(archive_path, system)
        archive.check_complete()
        prepared, inputs = _prepared_again(archive, system, observe, events, threads)
        times, _ = prepared.times_of(inputs["t_span"], inputs["save_every"])
        planned = PlannedRun(prepared, times, prepared.start(inputs["x0"]))
        if planned.first_step() != store.attributes[FIRST_STEP]:
            raise ArchiveError(
                f"{archive_path}: the recomputed first step differs in bits from that of the archive, begun by "
                f"coadjoint {store.attributes['coadjoint_version']} on {store.attributes['platform']}; resume it "
                "there, and with the same system"
            )
        if t_end is not None:
            extended = extended_times(store, planned, t_end)
            if extended.steps != times.steps:
                planned = planned._replace(times=extended)
                try:
                    with as_archive_errors(archive_path):
                        extend_run(store, planned)
                except OSError as reason:
                    raise unwritable_error(archive_path, reason) from None
        if store.attributes[FINISHED]:
            store.close()
            return archive
        stored = store.read_state(store.states[-1])
    except BaseException:
        store.close()
        raise
    return _continue_run(store, planned, stored, progress, until, began)


def _prepared_again(
    archive: Solution, system: Any, observe: Mapping[str, Any] | None, events: Any, threads: int | None
) -> tuple[PreparedRun, dict[str, Any]]:
    """Prepare the run of an archive again; return also all its arguments."""
    given = resume_arguments(archive, system, observe, events)
    with as_archive_errors(archive.path):
        inputs = archive.inputs(given.events)
    options = {name: inputs[name] for name in ("attitude", "watch")}
    return PreparedRun(
        inputs["system"], inputs["method"], inputs["step"], observe=given.observe, threads=threads, **options
    ), inputs


def _continue_run(
    store: ArchiveStore, planned: PlannedRun, stored: Any, progress: bool, until: int | None, began: float
) -> Solution:
    with closing(store, planned.prepared.system):
        with as_archive_errors(store.path):
            run = planned.in_pieces(store.arrays["time"].chunk[0], stored)
            sink = ArchiveSink(store, began)
        run.advance_into(sink, until, progress)
    return raise_if_failed(open_archive(store.path, planned.prepared.system))
