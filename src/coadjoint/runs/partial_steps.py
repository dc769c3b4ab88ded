"""States between two steps, by a shorter step of the same scheme: of a run at output times, of a solution at any."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.interface import codes
from coadjoint.kernels.loop import Extent, NamedArrays, layout_of, single_blas_thread
from coadjoint.kernels.tables.compiled import as_structure
from coadjoint.kernels.tables.recording import partial_step_schedule
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.events import TerminalEvent
from coadjoint.runs.loops.loops import Loops
from coadjoint.runs.loops.member_batches import failure_text, rows_of_groups, run_in_threads, status_name
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import ends_by_events, last_times, members_text, unfinished_members
from coadjoint.runs.results.solution_output import StateAt
from coadjoint.runs.run import Run
from coadjoint.runs.times import OutputTimes, Times, accumulated_rounding
from coadjoint.short_repr import distinct, short
from coadjoint.validation import are_finite, read_numbers

Floats = NDArray[np.float64]

MAX_STEPS = 10**7
"""Largest number of steps recomputed by one call."""


def state_at(solution: Solution, t: Any) -> StateAt:
    """Return the states of a solution at times within its run, (k,) or a single one; see `Solution.at`."""
    given = read_numbers(t, "t")
    if given.ndim > 1 or not given.size:
        raise ValueError(f"t has the shape {given.shape}; it must be a time, or a row of times")
    if not are_finite(given):
        raise ValueError(f"t is {short(t)}; every time must be finite")
    requested, direction = np.atleast_1d(given), 1.0 if solution.t_span[1] >= solution.t_span[0] else -1.0
    unfinished = unfinished_members(solution)
    ends = np.where(unfinished, last_times(solution, unfinished, direction), ends_by_events(solution))
    if solution.failed is not None and (solution.failed & np.isnan(ends)).any():
        raise ValueError("members of the run have failed; integrate the others alone for states at any time")
    # t_eval may omit the start, and exceed the span by rounding.
    low, high = sorted(solution.t_span)
    known = np.clip(np.append(solution.t_span[0], solution.t), low, high)
    end = float(solution.t[-1]) if solution.t_eval is None else solution.t_span[1]
    saved = direction * known
    count = max(len(requested), len(solution.t), solution.stats.steps + 1)
    beyond = near = accumulated_rounding(count, *solution.t_span, solution.step)
    noisy = bool(noises_of(solution.system))
    if not noisy:
        near = 4 * np.spacing(max(abs(solution.t_span[0]), abs(solution.t_span[1])))
    outside = np.flatnonzero(
        (direction * requested < saved[0] - beyond) | (direction * requested > direction * end + beyond)
    )
    if len(outside):
        shown = distinct(requested[outside[0]], known[0], end)
        raise ValueError(f"t is {shown[0]}; it must lie within the run, from {shown[1]} to {shown[2]}")
    low, high = sorted((float(known[0]), end))
    queries = np.clip(requested, low, high)
    late = np.flatnonzero(np.all(direction * queries[:, None] > direction * ends + near, axis=1))
    if len(late) and unfinished.all():
        raise ValueError(f"t is {requested[late[0]]:g}, which {members_text(unfinished)} of this run have not reached")
    if len(late):
        shown = distinct(requested[late[0]], float(direction * np.max(direction * ends)))
        raise ValueError(f"t is {shown[0]}, after events ended the runs of all members, the last at {shown[1]}")
    before = np.clip(np.searchsorted(saved, direction * queries + near, side="right") - 1, 0, None)
    if noisy:
        # The noise of a step depends on every bit of its time, which is that from the start of the run.
        before[direction * queries - saved[before] > near] = 0
    ahead = np.maximum(direction * queries - saved[before], 0.0)
    steps = np.ceil(np.where(ahead > near, ahead - near, 0.0) / solution.step).astype(np.int64)
    pieces = np.unique(before)
    last = [int(steps[before == j].max()) for j in pieces]
    if sum(last) > MAX_STEPS:
        raise ValueError(
            f"the times lie {sum(last)} steps after saved points, and at most {MAX_STEPS} steps are recomputed; "
            "integrate with t_eval, or with a smaller save_every"
        )
    order = np.lexsort((direction * queries, before))
    edges = np.searchsorted(before[order], [*pieces, pieces[-1] + 1])
    states = [
        _from_point(
            solution, j - 1, float(known[j]), count, queries[order[low:high]], direction, direction * ends + near
        )
        for j, count, low, high in zip(pieces.tolist(), last, edges[:-1], edges[1:], strict=True)
    ]
    positions = 0 if given.ndim == 0 else np.argsort(order, kind="stable")

    def in_order(series: Sequence[Any]) -> Any:
        return None if series[0] is None else np.concatenate(series)[positions]

    casimirs = {name: in_order([state.casimirs[name] for state in states]) for name in states[0].casimirs}
    x, energy, attitude = (in_order([getattr(state, name) for state in states]) for name in ("x", "energy", "attitude"))
    return StateAt(float(given) if given.ndim == 0 else given, x, energy, casimirs, attitude)


def _from_point(
    solution: Solution, j: int, start: float, count: int, queries: Floats, direction: float, until: Floats
) -> StateAt:
    """Return the states at ascending times after saved point j (-1: the start); NaN beyond `until` (members,)."""
    x, element, values = solution.x0, solution.attitude0, solution.initial
    if j >= 0:
        x, element = solution.x[j], None if solution.attitude is None else solution.attitude[j]
        values = {name: series[j] for name, series in solution.casimirs.items()}
    times = Times(start, direction * solution.step, count, 1)
    low, high = sorted((start, times.end))
    t_eval = np.concatenate([[start], np.clip(queries, low, high)])
    past_end = direction * t_eval[:, None] > until
    if past_end[0].any():
        # Ended members need some valid start; their results are discarded.
        x, element = _where(past_end[0], solution.x0, x), _where(past_end[0], solution.attitude0, element)
    try:
        run = _prepared_run(solution).run(x, (start, times.end), t_eval=t_eval, attitude=element)
    except IntegrationError as error:
        run = error.partial
        # A failure after the end of a member is irrelevant.
        if run.failed is None or len(run.t) < len(t_eval) or not past_end[-1][run.failed].all():
            raise
    # Multivalued invariants continue from the branch at the saved point, by whole periods.
    offsets = {name: values[name] - computed[0] for name, computed in run.casimirs.items()}
    casimirs = {
        name: np.where(offsets[name] == 0.0, computed, computed + offsets[name])
        for name, computed in run.casimirs.items()
    }
    x, energy, attitude = run.x, run.energy, run.attitude
    if past_end.any():
        x, energy, attitude = (_where(past_end, np.nan, series) for series in (x, energy, attitude))
        casimirs = {name: _where(past_end, np.nan, series) for name, series in casimirs.items()}
    casimirs = {name: series[1:] for name, series in casimirs.items()}
    return StateAt(queries, x[1:], energy[1:], casimirs, None if attitude is None else attitude[1:])


def _where(mask: NDArray[np.bool_], values: Any, otherwise: Any) -> Any:
    """Like np.where over members and trailing axes; None if `otherwise` is None."""
    if otherwise is None:
        return None
    return np.where(mask.reshape(mask.shape + (1,) * (otherwise.ndim - mask.ndim)), values, otherwise)


def _prepared_run(solution: Solution) -> PreparedRun:
    """Return the prepared run of a solution, cached; copies of the solution build their own."""
    prepared: PreparedRun | None = solution.__dict__.get("_prepared_run")
    if prepared is None:
        attitude: Any = {None: False, "coadjoint": "coadjoint"}.get(solution.carried, True)
        prepared = PreparedRun(solution.system, solution.method, solution.step, attitude=attitude, watch=False)
        solution.__dict__["_prepared_run"] = prepared
    return prepared


MAX_NUMBERS = 2**20
"""Array entries processed at a time."""
ROWS_PER_CALL = 2**16
"""States processed at once."""
SINGLE_THREAD_NUMBERS = 2**10
"""Up to this many numbers in states one thread is faster than starting others."""


def noises_of(system: Any) -> list[str]:
    """Return the labels of the forces that are noise over whole steps; that of measurements is at their beginning."""
    forces = zip(system.labels, system.forces, strict=True)
    return [label for label, force in forces if force.random and not force.sampled]


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
        numbers = np.ascontiguousarray(owners[rows], dtype=np.int64)
        schedule = partial_step_schedule(starts, steps, numbers, self._inside)
        with single_blas_thread(loops.rows):
            run_in_threads(member_batches, (layout, schedule, saved, state, 0, 1), loops.raised, workers)
        slots = np.empty(len(momenta), dtype=np.int64)
        slots[rows[filled]] = np.flatnonzero(filled)
        arrays = (saved["x"][0], saved["group"][0], saved["values"][0], state["first"])
        status = state["status"][slots]
        ends = [np.where(status[:, None] == codes("Status")["DONE"], array[slots], np.nan) for array in arrays]
        return [*ends, status, state["residual"][slots]]

    def _failure(self, result: StepResult, row: int, owner: int, start: float, length: float) -> IntegrationError:
        residual = float(result.residual[row])
        reason = failure_text(status_name(result.status[row]), self.method, residual, bool(self.loops.work_integrals))
        return IntegrationError(
            f"in a part of a step, of length {length:g} from t = {start:g}, {reason} for member {owner}; "
            "take a smaller step",
            step=0,
            time=start,
            residual=residual,
        )


def check_partial_steps(system: Any, moments: OutputTimes, *, differentiated: bool = False) -> None:
    """Reject output times between steps for systems without partial steps (noise), or without derivatives of them."""
    if np.any(moments.length):
        reject_noise(system)
        if differentiated:
            reject_noisy_derivatives(system)


def reject_noisy_derivatives(system: Any) -> None:
    """Reject a system with noise for derivatives of states between two steps, or at events."""
    if system.has_noise:
        raise ValueError(
            f"{system.of_member(0).name} has noise, and states between two steps or at events have no derivatives "
            "then; give times that are whole numbers of steps from the start, and no events"
        )


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
