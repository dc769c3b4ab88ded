"""States between two steps, by a shorter step of the same scheme for many states at once, and at output times."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.interface import codes
from coadjoint.kernels.loop import Extent, NamedArrays, layout_of, limited_blas_threads
from coadjoint.kernels.tables.compiled import as_structure
from coadjoint.kernels.tables.recording import partial_step_schedule
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.events import TerminalEvent
from coadjoint.runs.loops.loops import Loops
from coadjoint.runs.loops.member_batches import failure_text, rows_of_groups, run_in_threads, status_name
from coadjoint.runs.run import Run
from coadjoint.runs.times import OutputTimes, Times

Floats = NDArray[np.float64]

MAX_NUMBERS = 2**20
"""Array entries processed at a time."""
ROWS_PER_CALL = 2**16
"""States processed at once."""
SINGLE_THREAD_NUMBERS = 2**10
"""Up to this many numbers in states one thread is faster than starting others."""


def noises_of(system: Any) -> list[str]:
    """Return the labels of the forces that are noise."""
    return [label for label, force in zip(system.labels, system.forces, strict=True) if force.random]


def reject_noise(system: Any) -> None:
    """Reject a system with noise: its increment over a partial step is not determined by that of the whole step."""
    noises = noises_of(system)
    if noises:
        raise ValueError(
            f"{noises[0]} of {system.of_member(0).name} is a noise, drawn once for a step: there is no state between "
            "two steps; give times that are whole numbers of steps from the start"
        )


@cache
def _no_values(dim: int) -> Any:
    from coadjoint.kernels.tables.invariants import invariants_table

    return as_structure(invariants_table([], dim).tables)


class StepResult(NamedTuple):
    """Momenta, elements and invariants after one step of each row; NaN in failed rows, whose `status` is not zero."""

    momenta: Floats
    groups: Floats
    values: Floats
    before: Floats
    status: NDArray[np.int64]
    residual: Floats


class PartialSteps:
    """Steps of any lengths by the scheme of a run, without history; the bits of a row depend on that row only."""

    def __init__(self, system: Any, method: Method, loops: Loops, workers: int = 1, inside: int = 1) -> None:
        reject_noise(system)
        self.method, self.loops, self.workers, self._inside = method, loops, workers, inside
        self._no_values = _no_values(system.dim)

    def take(
        self,
        momenta: Floats,
        groups: Floats,
        times: Floats,
        lengths: Floats,
        owners: NDArray[np.int64] | None = None,
    ) -> tuple[Floats, Floats]:
        """Return the momenta and elements after one step of each row (of member `owners`), as stored in the loops."""
        result = self.attempt(momenta, groups, times, lengths, owners)
        failed = np.flatnonzero(result.status)
        if len(failed):
            row = int(failed[0])
            owner = row if owners is None else int(owners[row])
            raise self._failure(result, row, owner, float(times[row]), float(lengths[row]))
        return result[:2]

    def attempt(
        self,
        momenta: Floats,
        groups: Floats,
        times: Floats,
        lengths: Floats,
        owners: NDArray[np.int64] | None = None,
        watched: bool = False,
    ) -> StepResult:
        """Like `take`, but return failures instead of raising, and the tracked invariants if `watched`."""
        tracked, m = self.loops.tracked if watched else 0, len(momenta)
        x, group, after, before = (
            np.full((m, width), np.nan) for width in (momenta.shape[1], groups.shape[1], tracked, tracked)
        )
        result = StepResult(x, group, after, before, np.zeros(m, dtype=np.int64), np.zeros(m))
        owners = np.arange(len(momenta)) if owners is None else owners
        finite = np.flatnonzero(np.isfinite(momenta).all(axis=1))
        numbers = 4 * momenta.shape[1] + 4 * groups.shape[1] + self.loops.memory + 16 * tracked + 8
        chunk = max(1, MAX_NUMBERS // numbers)
        workers = self.workers if momenta.size > SINGLE_THREAD_NUMBERS else 1
        for first in range(0, len(finite), chunk):
            chunk_rows = finite[first : first + chunk]
            arguments = (
                momenta[chunk_rows],
                groups[chunk_rows],
                times[chunk_rows],
                lengths[chunk_rows],
                owners[chunk_rows],
            )
            for target, values in zip(result, self._take(*arguments, watched, workers), strict=True):
                target[chunk_rows] = values
        return result

    def _take(
        self,
        momenta: Floats,
        groups: Floats,
        times: Floats,
        lengths: Floats,
        owners: NDArray[np.int64],
        watched: bool,
        workers: int,
    ) -> list[NDArray[Any]]:
        loops = self.loops
        groups_of_loops = loops.groups if watched else [group._replace(watch=self._no_values) for group in loops.groups]
        rows, filled, member_batches = rows_of_groups(groups_of_loops, owners, workers, loops.block)
        count = loops.tracked if watched else 0
        layout = layout_of(Extent(len(rows), 1, momenta.shape[1], groups.shape[1], count, loops.memory))
        saved, state = NamedArrays(layout.saved), NamedArrays(layout.state)
        state["momenta"][:], state["groups"][:] = momenta[rows], groups[rows]
        starts, steps = times[rows].astype(np.float64), np.where(filled, lengths[rows], 0.0)
        schedule = partial_step_schedule(starts, steps, self._inside)
        with limited_blas_threads(loops.rows, workers):
            run_in_threads(member_batches, (layout, schedule, saved, state, 0, 1), loops.raised, workers)
        slots = np.empty(len(momenta), dtype=np.int64)
        slots[rows[filled]] = np.flatnonzero(filled)
        arrays = (saved["x"][0], saved["group"][0], saved["values"][0], state["first"])
        status = state["status"][slots]
        ends = [np.where(status[:, None] == codes("Status")["DONE"], array[slots], np.nan) for array in arrays]
        return [*ends, status, state["residual"][slots]]

    def _failure(self, result: StepResult, row: int, owner: int, start: float, length: float) -> IntegrationError:
        residual = float(result.residual[row])
        reason = failure_text(status_name(result.status[row]), self.method, residual, bool(self.loops.accounts))
        return IntegrationError(
            f"in a part of a step, of length {length:g} from t = {start:g}, {reason} for member {owner}; "
            "take a smaller step",
            step=0,
            time=start,
            residual=residual,
        )


def check_partial_steps(system: Any, moments: OutputTimes) -> None:
    """Reject output times between steps for systems without partial steps (noise)."""
    if np.any(moments.length):
        reject_noise(system)


def resample(run: Run, moments: OutputTimes) -> None:
    """Replace the saved points of a finished run, the steps in `moments.marks`, by its states at `moments`."""
    marked_points, members = run.saved, len(run.start.momenta)
    direction, ends = (1.0 if run.times.h > 0.0 else -1.0), run.ends
    if run.ending is not None:
        before = direction * moments.t < direction * run.ending.t
        moments = OutputTimes(moments.t[before], moments.number[before], moments.length[before])
    # Exactly n h at a step, independent of the rounding of its time.
    elapsed = moments.number * run.times.h + moments.length
    times = run.times.with_saved_steps(moments.marks)._replace(marks=moments.ends, between=moments.t, elapsed=elapsed)
    if run.ending is not None:
        times = _with_ending(times, run.ending)
        run.ending = run.ending._replace(points=times.points)
    plan = run.plan.with_times(times)
    saved, points = NamedArrays(plan.layout.saved), np.searchsorted(run.times.saved, moments.number)
    names = ("x", "group", "values")
    source, target = ([arrays[name] for name in names] for arrays in (marked_points, saved))
    for to_array, from_array in zip(target, source, strict=True):
        to_array[: len(points)] = from_array[points]
    if run.ending is not None:
        saved["x"][-1, 0], saved["values"][-1, 0] = run.ending.x, run.ending.values
    partial = np.flatnonzero(moments.length)
    if len(partial):
        parts = PartialSteps(run.plan.system, run.plan.method, run.loops, run.plan.workers)
        # A failed member has no partial steps within its failed step.
        last = np.where(run.state["status"] == 0, run.times.steps + 1, run.state["step"])
        chunk = max(1, ROWS_PER_CALL // members)
        for first in range(0, len(partial), chunk):
            chunk_points = partial[first : first + chunk]
            _fill(parts, run, moments, chunk_points, (last, direction * ends), target)
        late = (moments.ends[:, None] >= last) & (run.state["status"] != 0)
        for array in target:
            array[: len(late)][late] = np.nan
    run.initial, run.saved, run.plan = marked_points["values"][0], saved, plan


def _with_ending(times: Times, ending: TerminalEvent) -> Times:
    assert times.marks is not None and times.between is not None and times.elapsed is not None
    return times._replace(
        marks=np.append(times.marks, ending.steps),
        between=np.append(times.between, ending.t),
        elapsed=np.append(times.elapsed, ending.t - times.t0),
    )


def _fill(
    parts: PartialSteps, run: Run, moments: OutputTimes, some: NDArray[np.int64], limits: Any, target: list[Floats]
) -> None:
    """Compute the states at these output times by partial steps, for members that have neither failed nor ended."""
    x, group, values = target
    k, owners = (axis.ravel() for axis in np.meshgrid(some, np.arange(x.shape[1]), indexing="ij"))
    failing, ending = limits
    past_end = (1.0 if run.times.h > 0.0 else -1.0) * moments.t[k] > ending[owners]
    active = (moments.ends[k] < failing[owners]) & ~past_end
    for array in target:
        array[k[~active], owners[~active]] = np.nan
    k, owners = k[active], owners[active]
    if not len(k):
        return
    starts = run.times.at(moments.number[k])
    result = parts.attempt(x[k, owners], group[k, owners], starts, moments.length[k], owners, watched=True)
    x[k, owners], group[k, owners] = result.momenta, result.groups
    for row in np.flatnonzero(result.status).tolist():
        m, step = int(owners[row]), int(moments.ends[k[row]])
        if step < failing[m]:
            failing[m] = step
            run.mark_failed(m, step, status_name(result.status[row]), float(result.residual[row]))
    if run.loops.matrices is not None:
        rows = zip(result.momenta, moments.t[k].tolist(), strict=True)
        measured = np.concatenate([run.loops.values_of_matrices(x[None], t) for x, t in rows])
    else:
        # Multivalued invariants were followed along the run, and are continued from there by whole periods.
        saved = values[k, owners]
        with np.errstate(invalid="ignore"):  # an energy that overflowed
            measured = np.where(saved == result.before, result.values, result.values + (saved - result.before))
    values[k, owners] = measured
