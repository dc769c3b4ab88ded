"""Runs in new archives, and the resumption of runs and ensembles."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator, Mapping
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archives.archive import (
    BLOCK_SIZE_ATTRIBUTE,
    FINISHED,
    FIRST_STEP,
    SAVE_EVERY,
    STEPS,
    StoredState,
    sums_among,
)
from coadjoint.files.archives.archived_run import ArchiveSink, PlannedRun, create_archive
from coadjoint.files.archives.archived_solution import closing, open_archive, raise_if_failed
from coadjoint.files.archives.ensemble import read_worker_pool, run_in_blocks
from coadjoint.files.archives.folder import ArchiveError, read_archive_path, reading
from coadjoint.files.archives.run_checks import events_again, observed_again
from coadjoint.files.archives.store import ArchiveStore, unwritable_error
from coadjoint.files.datasets.export import ENDED_ATTRIBUTE
from coadjoint.files.datasets.variables import Variables
from coadjoint.kernels.interface import codes
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.forced import check_steps
from coadjoint.optional_packages import require_packages
from coadjoint.runs.events import read_events
from coadjoint.runs.piecewise_run import STATE_PREFIX, larger_deviations
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.times import Times, is_divided, times_between
from coadjoint.short_repr import distinct
from coadjoint.validation import read_number


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
    coordinates: Variables | None = None,
    attributes: Mapping[str, Any] | None = None,
) -> Solution:
    """Run into a new archive; parameters as for `coadjoint.integrate`, and what is stored beside the run."""
    require_packages("an archive of a run", "xarray", "zarr")
    if t_eval is not None:
        raise ValueError("an archive saves every save_every-th step; omit t_eval")
    began = time.perf_counter()
    times, further = prepared.times_of(t_span, save_every)[0], {**(attributes or {}), SAVE_EVERY: int(save_every)}
    planned = PlannedRun(prepared, times, prepared.start(x0), coordinates or {}, further, read_events(events))
    store = create_archive(planned, archive)
    with closing(store, prepared.system):
        return _continued(store, planned, None, progress, None, began)


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
        which the run began, as far as `coadjoint.files.archives.run_checks` can, and rejected if they differ.
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
        if t_end is not None or until is not None:
            raise ValueError("resume takes no t_end or until for an ensemble in blocks; omit them")
        pool = read_worker_pool(client, workers, threads)
        prepared, inputs = _prepared_again(archive, system, observe, events, pool.threads)
        arguments = inputs["x0"], inputs["t_span"], inputs["save_every"], archive.path, pool
        return run_in_blocks(prepared, *arguments, progress=progress, events=inputs["events"])
    if client is not None or workers is not None:
        raise ValueError(f"{archive_path}: is the archive of one run; client and workers are for ensembles in blocks")
    if archive.finished and (t_end is None or archive.attributes.get("run_failed")):
        return raise_if_failed(archive)
    store = ArchiveStore.open_existing(archive_path)
    with closing(store, system):
        archive = open_archive(archive_path, system)
        archive.check_complete()
        prepared, inputs = _prepared_again(archive, system, observe, events, threads)
        times, _ = prepared.times_of(inputs["t_span"], inputs["save_every"])
        planned = PlannedRun(prepared, times, prepared.start(inputs["x0"]), {}, {}, inputs["events"])
        if planned.first_step() != store.attributes[FIRST_STEP]:
            raise ArchiveError(
                f"{archive_path}: the recomputed first step differs in bits from that of the archive, begun by "
                f"coadjoint {store.attributes['coadjoint_version']} on {store.attributes['platform']}; resume it "
                "there, and with the same system"
            )
        if t_end is not None:
            extended = extended_times(store, planned, t_end)
            check_steps(prepared.system, prepared.scheme, extended.t0, extended.h, extended.steps)
            if extended.steps != times.steps:
                planned = planned._replace(times=extended)
                with reading(archive_path, "the archive"):
                    try:
                        extend_run(store, planned)
                    except OSError as reason:
                        raise unwritable_error(archive_path, reason) from None
        if store.attributes[FINISHED]:
            return archive
        return _continued(store, planned, store.read_state(store.states[-1]), progress, until, began)


def _prepared_again(
    archive: Solution, system: Any, observe: Mapping[str, Any] | None, events: Any, threads: int | None
) -> tuple[PreparedRun, dict[str, Any]]:
    """Prepare the run of an archive again; return also all its arguments."""
    observed = observed_again(archive, system, observe)
    with reading(archive.path, "the archive"):
        inputs = {**archive.inputs(), "method": archive.method}
    inputs["events"] = events_again(archive, inputs["system"], events)
    options = {name: inputs[name] for name in ("attitude", "watch")}
    return PreparedRun(
        inputs["system"], inputs["method"], inputs["step"], observe=observed, threads=threads, **options
    ), inputs


def _continued(
    store: ArchiveStore, planned: PlannedRun, stored: Any, progress: bool, until: int | None, began: float
) -> Solution:
    """Run from stored numbers, or from the start, into an archive; return its solution."""
    with reading(store.path, "the archive"):
        run = planned.in_pieces(store.arrays["time"].chunk[0], stored)
        sink = ArchiveSink(store, store.attributes, began=began)
    run.advance_into(sink.take, until, progress)
    return raise_if_failed(open_archive(store.path, planned.prepared.system))


def extended_times(store: ArchiveStore, planned: PlannedRun, t_end: Any) -> Times:
    """Return the times of a run with another end, a whole number of steps after those already taken."""
    end, attributes, times, step = read_number(t_end, "t_end"), store.attributes, planned.times, planned.prepared.step
    ends = times.t0, end
    if math.isfinite((end - times.t0) / step) and not is_divided(ends, step):
        # The step of a run that has begun cannot be changed.
        before = times.t0 + math.floor((end - times.t0) / times.h) * times.h
        raise ArchiveError(
            f"{store.path}: t_end {end!r} is between two steps of {step!r}; give {before!r} or {before + times.h!r}"
        )
    extended = times_between(ends, step, attributes[SAVE_EVERY])
    if extended.steps == times.steps and extended.h == times.h:
        return times
    if archive_ended := attributes.get(ENDED_ATTRIBUTE):
        raise ArchiveError(
            f"{store.path}: an event has ended the run in step {archive_ended}, before its end; omit t_end"
        )
    if attributes["between_steps"]:
        raise ArchiveError(f"{store.path}: the run saves states at given times, and cannot be continued to a later end")
    done = attributes[STEPS]
    if extended.h != times.h or extended.steps < done or (attributes[FINISHED] and extended.steps == done):
        given, reached, last = distinct(end, times.t0 + done * times.h, times.end)
        raise ArchiveError(
            f"{store.path}: t_end is {given}, but the run has reached t = {reached} on its way to {last}; give a later "
            "end"
        )
    return extended


def extend_run(store: ArchiveStore, planned: PlannedRun) -> None:
    """Set the end of a planned run, and return the run to the last state that does not depend on the old one."""
    # A block of steps that overlaps two tenths of the longer run is recomputed, as the drifts are maxima of tenths.
    states, times = store.states, planned.times
    # The last state of a finished run depends on the end, unless it has no steps.
    retained = (states[:-1] if store.attributes[FINISHED] else states) or states
    last_state = retained[-1]
    stored = store.read_state(last_state)
    stored["earlier"] = reduce(larger_deviations, _deviations(store, retained, planned))
    stored[f"{STATE_PREFIX}worst"] = np.zeros_like(stored[f"{STATE_PREFIX}worst"])
    store.sums = sums_among(stored)
    new = store.store_state(stored, {**last_state.about, "block": 1})
    blocks = [state for state in retained[:-1] if state.about["block"]]
    attributes = {
        "t_span": json.dumps([times.t0, times.end]),
        "steps": times.steps,
        "save_every": times.save_every,
        STEPS: last_state.about["number"],
        FINISHED: 0,
    }
    lengths = {name: length for name, length in last_state.about.items() if name not in ("number", "block")}
    store.commit(attributes, lengths, [*blocks, new])


def _deviations(store: ArchiveStore, states: list[StoredState], planned: PlannedRun) -> Iterator[NDArray[np.float64]]:
    """Yield the largest deviations in each tenth of a longer run, over the steps up to each state from the last one."""
    previous: dict[str, Any] | None = None
    for state in states:
        stored = store.read_state(state)
        first, last = 1 if previous is None else int(previous[f"{STATE_PREFIX}number"]) + 1, state.about["number"]
        deviations = np.zeros_like(stored["earlier"])
        tenths = [(step - 1) * deviations.shape[1] // planned.times.steps for step in (first, max(first, last))]
        if tenths[0] == tenths[1]:
            deviations[:, tenths[0]] = stored["block"]
        else:
            deviations = _recompute(store, previous, stored, planned)
        yield deviations
        previous = stored


def _recompute(store: ArchiveStore, previous: Any, next_state: Any, planned: PlannedRun) -> NDArray[np.float64]:
    """Recompute the steps between two states; return the largest deviations in each tenth."""
    if previous is not None:
        zeros = np.zeros_like(previous["earlier"])
        previous = {**previous, "earlier": zeros, f"{STATE_PREFIX}worst": zeros}
    run, last = planned.in_pieces(store.arrays["time"].chunk[0], previous), int(next_state[f"{STATE_PREFIX}number"])
    while run.number < last:
        run.advance(min(last, run.reach))
        if run.number < last:
            run.release_points()
    # Members that events have ended are computed to the end of a piece, which may be another one now.
    continued = next_state[f"{STATE_PREFIX}status"] != codes("Status")["ENDED"]
    own, stored = run.run.state["momenta"], next_state[f"{STATE_PREFIX}momenta"]
    if not np.array_equal(own[continued], stored[continued], equal_nan=True):
        raise ArchiveError(
            f"{store.path}: recomputed steps have other bits than before; resume on the machine where "
            "the archive was begun, and with the same system"
        )
    return run.worst
